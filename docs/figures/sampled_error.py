"""Plot the largest error of the distances between sampled arms, and the proven upper limit of this error."""

import matplotlib.pyplot as plt
import numpy as np

import rfpsurvey as rs

POINTS = (3, 5, 9, 17, 33, 65, 129)
figure, ax = plt.subplots(figsize=(6.5, 4), layout="constrained")
for name, color in (("lamost", "#0072B2"), ("sdss_apo", "#D55E00"), ("moons", "#009E73")):
    unit = rs.Instrument.preset(name).focal_plane.positioner
    table = rs.benchmark.benchmark_collisions(name, methods=["sampled"], n_configurations=8, repeats=1, seconds=0)
    h = unit.eccentric_arm.value / (np.array(POINTS) - 1)
    ax.loglog(POINTS, h / np.sqrt(2), "--", color=color, label=f"{name}, bound $h / \\sqrt{{2}}$ (crossing arms)")
    ax.loglog(table["n_points"], table["max_error"].value, "o", color=color, label=f"{name}, measured")
    needed = 1 + unit.eccentric_arm.value / (np.sqrt(2) * unit.min_separation.value)
    ax.axvline(needed, color=color, lw=0.8, ls=":")
ax.set_xlabel("points on each arm (dotted: fewer points can miss crossings)")
ax.set_ylabel("largest error of a distance [mm]")
ax.legend(fontsize="x-small")
