"""Plot the displacement of the elbow as a function of the displacement of the fiber tip.

The three curves are for a tip inside the patrol area and for tips at the two limits of the patrol area.
"""

import astropy.units as u
import matplotlib.pyplot as plt
import numpy as np

import rfpsurvey as rs
from rfpsurvey.collision import place_arms

unit = rs.Positioner(7.4 * u.mm, 15 * u.mm, 2.5 * u.mm)
plane = rs.FocalPlane([[0, 0]] * u.mm, unit)
shifts = np.logspace(-13, -1, 49)
figure, ax = plt.subplots(figsize=(6.5, 4), layout="constrained")
for label, r, color in (
    ("r = 15 mm", 15.0, "#0072B2"),
    ("r = l1 + l2", 22.4, "#D55E00"),
    ("r = l2 - l1", 7.6, "#E69F00"),
):
    inward = 1 if r < 10 else -1
    start = place_arms(plane, [[r, 0]] * u.mm).elbow[0]
    moved = [np.hypot(*(place_arms(plane, [[r + inward * s, 0]] * u.mm).elbow[0] - start)) for s in shifts]
    ax.loglog(shifts, moved, color=color, label=label)
ax.loglog(shifts, shifts, ":", color="black", label="elbow moves as far as the tip")
ax.axvline(22.4 * 2**-24, color="gray", lw=0.8)
ax.text(22.4 * 2**-24, 1e-11, " single precision", color="gray", fontsize="small")
ax.axvline(22.4 * 2**-53, color="gray", lw=0.8)
ax.text(22.4 * 2**-53, 1e-11, " double precision", color="gray", fontsize="small")
ax.set_xlabel("displacement of the tip [mm]")
ax.set_ylabel("displacement of the elbow [mm]")
ax.legend()
