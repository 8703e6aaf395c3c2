"""Plot the error of the angular correlation function against the computing time, for several methods of weighting."""

import matplotlib.pyplot as plt

# tests/benchmarks/clustering_figures.py prints these numbers. For each method: the time (s) to plan the surveys and to
# count the pairs of one mock catalog, and the errors of the correlation function for 1, 2 and 3 passes. The unit of the
# errors is the standard deviation of the correlation function of the complete sample over the mock catalogs.
METHODS = {
    "observed": (0.63, (9.34, 5.69, 4.05)),
    "nearest neighbor": (0.58, (9.10, 5.08, 3.10)),
    "individual": (1.2, (8.15, 2.72, 1.33)),
    "pairwise": (1.3, (7.95, 1.70, 0.92)),
    "pairwise, angular": (6.0, (2.89, 1.45, 0.89)),
}
MARKERS = {"observed": "o", "nearest neighbor": "s", "individual": "^", "pairwise": "D", "pairwise, angular": "v"}
COLORS = ("#D55E00", "#0072B2", "#009E73")
figure, ax = plt.subplots(figsize=(6, 4.2), layout="constrained")
for k, color in enumerate(COLORS):
    seconds, errors = zip(*((cost, error[k]) for cost, error in METHODS.values()), strict=True)
    ax.plot(seconds, errors, "-", color=color, lw=1, alpha=0.6, label=f"{k + 1} pass{'es' * (k > 0)}")
    for name, (cost, error) in METHODS.items():
        ax.plot(cost, error[k], MARKERS[name], color=color)
for name, marker in MARKERS.items():
    ax.plot([], [], marker, color="0.4", label=name)
ax.axhline(1, color="0.6", ls=":", lw=1)
ax.set(xscale="log", yscale="log", xlabel="time per mock catalog (s)", ylabel="error / scatter of the complete sample")
ax.set_xticks([0.5, 1, 2, 5, 10], ["0.5", "1", "2", "5", "10"])
ax.set_yticks([1, 2, 5, 10], ["1", "2", "5", "10"])
ax.minorticks_off()
ax.legend(ncols=2, fontsize="small")
