"""
Collision probability against the ratio of the arms
===================================================

This example computes the collision probability for LAMOST's pitch and central arm, and for eccentric arms that are one
to two times as long as the central arm. The error bars are 95 % confidence intervals.
"""

import astropy.units as u
import matplotlib.pyplot as plt
import numpy as np

import rfpsurvey as rs

ratios = np.linspace(1, 2, 6)
found = []
for ratio in ratios:
    unit = rs.Positioner(8.25 * u.mm, 8.25 * ratio * u.mm, 2.25 * u.mm)
    plane = rs.FocalPlane.hexagonal(unit, rings=5, pitch=25.6 * u.mm)
    targets = rs.probability.RandomTargets(number=4 * len(plane))
    found.append(rs.collision_probability(plane, targets=targets, precision=0.003, rng=1))
for ratio, one in zip(ratios, found, strict=True):
    print(f"{ratio:.1f}: {one.value:.3f} ({one.low:.3f} to {one.high:.3f}), {one.n} realizations")

# %%
# The plot compares two definitions of the collision probability. For allocated targets (points), each target is
# assigned to at most one positioner. For independent targets (line), every positioner has its own random target. The
# line is computed by the surrogate, a fast interpolation for a positioner far from the edge of the focal plane.

fig, ax = plt.subplots(figsize=(6.5, 4.2), layout="constrained")
values = np.array([one.value for one in found])
errors = np.abs([[one.low, one.high] for one in found] - values[:, None]).T
ax.errorbar(ratios, values, errors, fmt="o", capsize=4, color="#0072B2", label="allocated targets, four per positioner")
line = np.linspace(1, 2, 101)
independent = rs.probability.surrogate_probability(8.25 * u.mm, 8.25 * line * u.mm, 25.6 * u.mm, 4.5 * u.mm)
ax.plot(line, independent, color="#E69F00", label="independent targets, far from the edge")
ax.set(xlabel="length of the eccentric arm / length of the central arm", ylabel="collision probability", ylim=(0, None))
ax.set_title("Collision probability against the ratio of the arms")
ax.legend()
