"""Plot the times of calls against the size of the problem; tests/benchmarks/growth_figures.py prints the numbers."""

import matplotlib.pyplot as plt
import numpy as np

# For each call: the sizes of the problem, and the times (s) of the call.
TARGETS = {
    "plan_tile, lamost": (
        [1000, 3000, 10000, 30000, 100000, 300000, 1000000],
        [0.0115, 0.0122, 0.015, 0.0192, 0.0276, 0.055, 0.149],
    ),
    "plan_tile, nearest": (
        [1000, 3000, 10000, 30000, 100000, 300000, 1000000],
        [0.00884, 0.00887, 0.0152, 0.0153, 0.0307, 0.0528, 0.161],
    ),
    "plan_tile, repair": (
        [1000, 3000, 10000, 30000, 100000, 300000, 1000000],
        [0.0153, 0.0169, 0.0176, 0.0294, 0.0882, 0.565, 1.27],
    ),
    "index of a catalog": ([1000, 10000, 100000, 1000000, 10000000], [7.14e-05, 0.00141, 0.0195, 0.252, 4.47]),
}
OTHERS = {
    "find_collisions, positioners": (
        [37, 127, 397, 1141, 3997, 12097, 40021],
        [8.21e-05, 8.18e-05, 8.53e-05, 9.77e-05, 0.000139, 0.000337, 0.000961],
    ),
    "count_collisions, configurations": (
        [10, 30, 100, 300, 1000, 3000, 10000],
        [0.000574, 0.0011, 0.0036, 0.011, 0.0372, 0.113, 0.368],
    ),
    "collision_probability, realizations": (
        [10, 30, 100, 300, 1000, 3000, 10000],
        [0.0134, 0.0373, 0.116, 0.377, 2, 4.14, 14.8],
    ),
    "plan_tile, positioners": (
        [37, 127, 397, 1141, 3997, 12097, 40021],
        [0.00527, 0.00529, 0.00597, 0.00823, 0.0147, 0.0435, 0.129],
    ),
    "place_tiles, tiles": (
        [17, 45, 125, 327, 1065, 3081, 10033],
        [0.285, 0.239, 0.122, 0.109, 0.146, 0.43, 1.04],
    ),
    "plan_survey, tiles": (
        [7, 17, 45, 125, 327, 1065, 3081],
        [0.0108, 0.0225, 0.0587, 0.165, 0.396, 1.72, 6.19],
    ),
    "selection_probabilities, realizations": (
        [4, 16, 64, 256, 1024, 4096],
        [0.0179, 0.0293, 0.0367, 0.126, 0.407, 2.05],
    ),
}
COLORS = ["#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#999999"]
MARKERS = "osD^vP*"

fig, axes = plt.subplots(1, 2, figsize=(8, 5.6), sharey=True, layout="constrained")
for ax, cases, label in ((axes[0], TARGETS, "targets"), (axes[1], OTHERS, "positioners, tiles, ...")):
    for (name, (n, seconds)), color, marker in zip(cases.items(), COLORS, MARKERS, strict=False):
        ax.loglog(n, seconds, color=color, marker=marker, ms=4, label=name)
    low, high = min(n[0] for n, _ in cases.values()), max(n[-1] for n, _ in cases.values())
    n = np.geomspace(low, high, 50)
    ax.loglog(n, n * np.log(n) / (high * np.log(high)) * 0.5, ":", color="0.5", label="proportional to n log n")
    ax.set_xlabel(f"number n of {label}")
    ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.13), fontsize="x-small")
axes[0].set_ylabel("time (s)")
axes[0].set_ylim(5e-5, 30)
