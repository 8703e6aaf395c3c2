"""Plot, for four tasks and one instrument, the fastest method that suffices, a faster method, and a slower method.

``python docs/figures/needed_models.py INSTRUMENT FILE`` plots the methods for another instrument (a preset or a file).
"""

import matplotlib.pyplot as plt
import measured
import numpy as np
import trade_offs

COLUMNS = {"faster, not sufficient": "#9C3B00", "sufficient": "#00684C", "slower, more accurate": "#444444"}


def front(found):
    """Return the time, the error and the name of each result that no faster result equals, from fast to slow."""
    results = sorted((time, error, name) for name, values in found.items() for time, error in values)
    return [r for k, r in enumerate(results) if all(r[1] < faster[1] for faster in results[:k])]


instrument, _ = trade_offs.start()
figure, ax = plt.subplots(figsize=(7, 3.2), layout="constrained")
for row, (task, title, form, tolerance) in enumerate(
    (
        (measured.collisions, "Collisions", trade_offs.percent, 0),
        (measured.probabilities, "Probability", trade_offs.percent, 0.01),
        (measured.allocations, "Allocation", trade_offs.percent, 0.01),
        (measured.projections, "Position", trade_offs.micrometers, trade_offs.tolerance(instrument)),
    )
):
    results = front(task(instrument)[0])
    enough = next((k for k, (_, error, _) in enumerate(results) if error <= tolerance), len(results))
    limit = f"within {form(tolerance)}" if tolerance > 0 else "tolerance unknown" if np.isnan(tolerance) else "no error"
    ax.text(0, -row, f"{title}\n{limit}", weight="bold", va="top")
    for column, (k, color) in enumerate(zip((enough - 1, enough, enough + 1), COLUMNS.values(), strict=True)):
        text = "none"
        if 0 <= k < len(results):
            time, error, name = results[k]
            text = f"{name.replace('_', ' ')}\n{trade_offs.duration(time)}, {form(float(f'{error:.2g}'))}"
        ax.text(1 + column, -row, text, color=color, weight="bold" if k == enough else "normal", va="top")
for column, (text, color) in enumerate(COLUMNS.items()):
    ax.text(1 + column, 0.6, text, color=color, va="top")
ax.axvspan(1.94, 2.9, color="#009E73", alpha=0.18, lw=0)
ax.set(xlim=(0, 4), ylim=(-3.7, 0.8))
ax.axis("off")
figure.supxlabel(f"{instrument.name}: computing time and error of each method", fontsize=10)
trade_offs.finish(figure)
