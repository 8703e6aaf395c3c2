"""Draw a petal of DESI in the coordinates of DESI and of rfpsurvey."""

import matplotlib.pyplot as plt
import numpy as np

import rfpsurvey as rs

x, y = rs.Instrument.preset("desi").focal_plane.xy.value.T
angle = np.rad2deg(np.arctan2(y, x))
own = (angle > 18) & (angle < 54)
fig, axes = plt.subplots(1, 2, figsize=(8, 4), layout="constrained", sharey=True)
for ax, sign, title, east in zip(axes, (1, -1), ("CS5 of DESI", "rfpsurvey"), ("west", "east"), strict=True):
    ax.scatter(sign * x, y, s=1, color="0.7")
    ax.scatter(sign * x[own], y[own], s=2, color="C0")
    ax.annotate(east, (380, -380), (120, -380), arrowprops={"arrowstyle": "->"}, va="center")
    ax.annotate("north", (-380, 400), (-380, 230), arrowprops={"arrowstyle": "->"}, ha="center")
    ax.set(title=title, xlabel="x (mm)", aspect="equal", xlim=(-450, 450), ylim=(-450, 450))
axes[0].set_ylabel("y (mm)")
