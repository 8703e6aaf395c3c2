"""Plot the collision probability against the radius of the circle that contains the targets."""

import astropy.units as u
import matplotlib.pyplot as plt
import numpy as np

import rfpsurvey as rs
from rfpsurvey.probability import RandomTargets

figure, ax = plt.subplots(figsize=(6, 4), layout="constrained")
radii = np.linspace(100, 380, 15)
for name, l1, l2, color in (("equal arms", 8.25, 8.25, "#0072B2"), ("unequal arms", 8.25, 12.4, "#E69F00")):
    unit = rs.Positioner(l1 * u.mm, l2 * u.mm, 2.25 * u.mm)
    plane = rs.FocalPlane.hexagonal(unit, rings=12, pitch=25.6 * u.mm)
    circles = [RandomTargets(number=5000, radius=r * u.mm) for r in radii]
    found = [rs.collision_probability(plane, targets=targets, precision=0.003) for targets in circles]
    ax.plot(radii, [e.value for e in found], color=color, label=f"{name}: value")
    ax.plot(radii, [e.value_assigned for e in found], "--", color=color, label=f"{name}: value_assigned")
ax.axvline(12 * 25.6, color="0.5", lw=0.8)
ax.set(
    xlabel="radius of the circle with 5000 targets [mm]\n(vertical line: radius of the outermost ring of positioners)",
    ylabel="collision probability",
)
ax.legend(fontsize="small")
