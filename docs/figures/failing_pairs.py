"""Plot pairs of arms for which approximate methods give wrong distances.

The title of each panel states three distances: the exact distance between the two arms, the smallest distance from an
end of one arm to the other arm, and the smallest distance between three points on one arm and three points on the
other arm.
"""

import matplotlib.pyplot as plt
import numpy as np

from rfpsurvey._kernels import batch as reference
from rfpsurvey._kernels import collisions
from rfpsurvey.plot._scene import capsules

SEPARATION, N_POINTS = 5.0782, 3
PAIRS = {
    "crossing": ((-7.5, 0, 7.5, 0), (-2, -7.5, -2, 7.5)),
    "crossing between points": ((-3.75, 0, 11.25, 0), (0, -3.75, 0, 11.25)),
    "grazing": ((-7.5, 0, 7.5, 0), (-3.75, 5.0, 11.25, 5.0)),
    "touching": ((-7.5, 0, 7.5, 0), (1.5, 0, 6, 11)),
    "collinear, 4 mm apart": ((-15, -5, -3, -1), (0.8, 0.2667, 12.8, 4.2667)),
    "overlapping": ((-10, 0, 3, 0), (-3, 0, 10, 0)),
    "almost parallel": ((-7.5, 0, 7.5, 0), (-7.5, 5.3, 7.5, 5.05)),
    "arm of zero length": ((2, 0, 2, 0), (-4, 3, 9, 6)),
}

figure, axes = plt.subplots(2, 4, figsize=(11, 6.6), layout="constrained")
for ax, (name, (first, second)) in zip(axes.flat, PAIRS.items(), strict=True):
    pair = np.array([first, second], dtype=float)
    ends = np.sqrt(collisions.endpoints_squared(*pair.ravel()))
    exact = np.sqrt(collisions.segments_squared(*pair.ravel()))
    sampled = np.sqrt(reference.sampled_squared(pair.T.copy(), 0, 1, N_POINTS))
    shades = capsules(pair, SEPARATION / 2)
    for (x0, y0, x1, y1), shade, color in zip(pair, shades, ("#0072B2", "#E69F00"), strict=True):
        ax.fill(*shade.T, color=color, alpha=0.2, lw=0)
        ax.plot([x0, x1], [y0, y1], color=color, lw=2, solid_capstyle="round")
        t = np.linspace(0, 1, N_POINTS)
        ax.plot(x0 + t * (x1 - x0), y0 + t * (y1 - y0), "o", color=color, ms=4)
    lines = [
        f"{label}: {d:.3f} mm{'' if (d < SEPARATION) == (exact < SEPARATION) else '  (wrong)'}"
        for label, d in (("exact", exact), ("four ends", ends), (f"{N_POINTS} points", sampled))
    ]
    ax.set_title(f"{name}\n" + "\n".join(lines), fontsize="small")
    middle = pair.reshape(-1, 2).mean(axis=0)
    ax.set(aspect="equal", xlim=middle[0] + [-15, 15], ylim=middle[1] + [-12, 12], xticks=[], yticks=[])
figure.supxlabel(
    f"D = {SEPARATION} mm; shaded: within D / 2 of an arm; dots: the points of the sampled arms", fontsize="small"
)
