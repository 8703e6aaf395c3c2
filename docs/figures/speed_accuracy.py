"""Plot the error of each method against its time, for four tasks and one instrument.

``python docs/figures/speed_accuracy.py INSTRUMENT FILE`` plots the results for another instrument (a preset or a file).
"""

import matplotlib.pyplot as plt
import measured
import numpy as np
import trade_offs

NAMES = {"close_pair": "close pair", "overlap_ratio": "overlap", "closed_form": "closed form", "sweep 65": "sweep"}
NAMES |= {"lamost_rule": "LAMOST's rule", "network_flow": "flow", "monte_carlo": "Monte Carlo"}
SELECTED = {"quadrature", "monte_carlo", "conditional"}

instrument, _ = trade_offs.start()
figure, axes = plt.subplots(2, 2, figsize=(7, 6.6), layout="constrained")
entries = {}
for ax, task, title, form, default in (
    (axes[0, 0], measured.collisions, "Collisions: wrong pairs", trade_offs.percent, {"exact"}),
    (axes[0, 1], measured.probabilities, "Collision probability: error", trade_offs.percent, SELECTED),
    (axes[1, 0], measured.allocations, "Allocation: fibers lost", trade_offs.percent, {"repair"}),
    (axes[1, 1], measured.projections, "Position of a target: error", trade_offs.micrometers, {"full"}),
):
    found, limit = task(instrument)
    entries[ax] = []
    for k, (name, values) in enumerate(found.items()):
        time, error = np.transpose(values)
        color = trade_offs.COLORS[k % len(trade_offs.COLORS)]
        shown = np.maximum(error, limit)
        ax.plot(time, shown, "o-", color=color, ms=7 if name in default else 4)
        for x, y in zip(time[error < limit], shown[error < limit], strict=True):
            trade_offs.point_down(ax, x, y, color)
        style = {"color": color, "weight": "bold" if name in default else "normal"}
        entries[ax].append((NAMES.get(name, name), style, np.transpose([time, shown])))
    ax.margins(0.22, 0.15)
    trade_offs.logarithmic(ax.xaxis, trade_offs.duration)
    trade_offs.logarithmic(ax.yaxis, form)
    low, high = ax.get_ylim()
    ax.set_ylim(low / (high / low) ** 0.12, high)
    ax.set_title(title, loc="left", weight="bold")
    ax.set_ylabel(trade_offs.FACTOR if task == measured.probabilities else "")
    ax.grid(color="0.92")
    ax.set_axisbelow(True)
note = "bold: selected automatically; arrow: no error found"
figure.supxlabel(f"computing time   ({instrument.name}; {note})", fontsize=10)
for ax, own in entries.items():
    trade_offs.label(ax, own)
trade_offs.finish(figure)
