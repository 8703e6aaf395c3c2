"""Where the convergence criterion stops, over and over, and where the interval does."""

import astropy.units as u
import matplotlib.pyplot as plt
import numpy as np

import rfpsurvey as rs

unit = rs.Positioner(8.25 * u.mm, 8.25 * u.mm, 2.25 * u.mm)
plane = rs.FocalPlane.hexagonal(unit, rings=3, pitch=25.6 * u.mm)
truth = rs.collision_probability(plane, n_targets=148, precision=2e-4).value
figure, ax = plt.subplots(figsize=(6.5, 4), layout="constrained")
for stop, color in (("convergence", "#D55E00"), ("interval", "#0072B2")):
    options = {"method": "monte_carlo", "n_targets": 148, "precision": 0.002, "stop": stop}
    found = [rs.collision_probability(plane, rng=k, **options) for k in range(60)]
    error = np.sqrt(np.mean([(e.value - truth) ** 2 for e in found]))
    label = f"{stop}: root mean square error {error / 0.002:.1f} x that asked for"
    ax.plot([e.n for e in found], [e.value for e in found], "o", color=color, ms=4, label=label)
ax.axhspan(truth - 0.002, truth + 0.002, color="0.85", label="truth +- standard error asked for")
ax.set(xlabel="iterations", ylabel="collision probability", xscale="log")
ax.legend(fontsize="small")
