"""Stacked bars that show fractions of a total, with one bar for each class and numbers beside each bar."""

import numpy as np
from astropy.table import QTable

from rfpsurvey.plot._axes import legend_below

FEWEST = 4
HEADING = 0.9  # position of the word "observed" above the first bar


def stacked_bars(
    ax,
    y: np.ndarray,
    total: np.ndarray,
    pieces: tuple,
    labels: list[str],
    counted: np.ndarray,
    kwargs: dict,
    *,
    columns: int = 2,
) -> None:
    """Draw a stacked bar from 0 to 1 for each class, and write two numbers beside each bar.

    The first number is the number of observed targets (or visits) of the class (``counted``). The second number is the
    number of all targets (or requested visits) of the class (``total``). ``pieces`` contains the parts of the bars from
    left to right. Each part is a tuple of the number of targets (or visits) in each class, the label of the part, and
    its style.
    """
    left, handles = np.zeros(len(y)), []
    style = {"height": 0.75, "linewidth": 0.4, "edgecolor": "white"}
    for number, label, look in pieces:
        part = number / np.maximum(total, 1)
        bars = ax.barh(y, part, left=left, label=label, **{**style, **look, **kwargs})
        handles += [bars] if number.any() else []
        left = left + part
    text = {"textcoords": "offset points", "fontsize": "small", "annotation_clip": False}
    text |= {"xycoords": ("axes fraction", "data"), "va": "center"}
    for place, done, of in zip(y, counted, total, strict=True):
        ax.annotate(f"{done:.0f} of {of:.0f}", (1, place), (4, 0), **text)
    ax.annotate("observed", (1, HEADING), (4, 0), **text)
    ax.set_yticks(y, labels, fontsize="small")
    around = 0.6 + max(FEWEST - len(y), 0) / 2  # a single bar must not fill the panel
    ax.set_ylim(y.min() - around, max(around, HEADING + 0.4))
    ax.set_xlim(0, 1)
    legend_below(ax, handles, columns=columns)


def by_name(rows: QTable) -> list[dict]:
    """Return the rows of a table of completeness as dicts."""
    return [dict(zip(rows.colnames, row, strict=True)) for row in rows.as_array().tolist()]


def class_label(row: dict) -> str:
    """Return the name of the class of targets that a row of a table of completeness describes."""
    if row.get("category", "all") != "all":
        return row["category"]
    return row.get("kind", "all") if row["priority"] == "all" else f"priority {row['priority']}"
