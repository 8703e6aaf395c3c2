"""Plot the additional visits of joint plans, relative to plans of one tile after the other, and upper bounds.

``tests/benchmarks/joint_figures.py`` prints the numbers.
"""

import matplotlib.pyplot as plt
import numpy as np

# Columns: distance between tiles / diameter of the field; targets per fiber; 1 if the targets are clustered, 0 if not;
# number of visits if the tiles are planned one after the other; number of visits of the joint plan; upper bound of the
# number of visits of any plan
ROWS = np.array(
    [
        [0.2, 1, 0, 2347, 2411, 2418],
        [0.4, 1, 0, 2396, 2465, 2474],
        [0.6, 1, 0, 2428, 2458, 2462],
        [0.8, 1, 0, 2421, 2430, 2430],
        [1, 1, 0, 2026, 2026, 2026],
        [0.4, 0.25, 0, 716, 716, 716],
        [0.4, 0.5, 0, 1385, 1391, 1392],
        [0.4, 2, 0, 3286, 3385, 3398],
        [0.4, 4, 0, 3500, 3500, 3500],
        [0.2, 1, 1, 2175, 2261, 2273],
        [0.4, 1, 1, 2056, 2132, 2150],
        [0.6, 1, 1, 1896, 1967, 1975],
        [0.8, 1, 1, 1606, 1621, 1621],
        [1, 1, 1, 1292, 1292, 1292],
        [0.4, 0.25, 1, 589, 597, 597],
        [0.4, 0.5, 1, 1090, 1123, 1124],
        [0.4, 2, 1, 2985, 3120, 3138],
        [0.4, 4, 1, 3436, 3484, 3487],
    ]
)

fig, axes = plt.subplots(1, 2, figsize=(8, 3.4), sharey=True, layout="constrained")
for ax, column, fixed, label in (
    (axes[0], 0, ROWS[:, 1] == 1, "distance between tiles / diameter of the field"),
    (axes[1], 1, ROWS[:, 0] == 0.4, "targets per fiber"),
):
    for clustered, color, word in ((0, "#0072B2", "Poisson"), (1, "#D55E00", "clustered")):
        part = ROWS[fixed & (ROWS[:, 2] == clustered)]
        part = part[np.argsort(part[:, column])]
        gain, most = (100 * (part[:, k] / part[:, 3] - 1) for k in (4, 5))
        ax.plot(part[:, column], gain, "o-", color=color, label=f"{word}, joint plan")
        ax.plot(part[:, column], most, "v:", color=color, mfc="white", label=f"{word}, upper bound")
    ax.set_xlabel(label)
axes[1].set_xscale("log")
axes[1].set_xticks([0.25, 0.5, 1, 2, 4], ["0.25", "0.5", "1", "2", "4"])
axes[1].minorticks_off()
axes[0].set_ylabel("additional visits (%)")
axes[0].set_ylim(0, None)
fig.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=4, fontsize="small")
