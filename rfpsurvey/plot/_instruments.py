"""Instruments side by side."""

from typing import TYPE_CHECKING

import numpy as np
from astropy.table import QTable

from rfpsurvey.plot._speed_accuracy import _check_table
from rfpsurvey.plot._style import ARM, COLLISION, IDLE

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["draw_instruments", "plot_instruments"]

COLUMNS = {"instrument", "positioners", "allocator", "assigned", "usable", "loss", "probability", "low", "high"}
REACH = ("reach_0", "reach_1", "reach_2", "reach_3")


def plot_instruments(table: QTable, *, ax: "Axes | None" = None, **kwargs: object) -> "Axes":
    """Draw what the positioners of each instrument do: see a target, collide on the way to one, or none of these.

    Parameters
    ----------
    table : QTable
        What `compare_instruments` returns.
    ax : matplotlib.axes.Axes, optional
        Where to draw; a new figure by default.
    **kwargs
        Passed to the bars, for example ``height``.

    Returns
    -------
    matplotlib.axes.Axes
        The axes. A bar for each instrument and allocator, as a part of its positioners; behind it the loss to
        collisions.

    Raises
    ------
    InputError
        If the table has other columns.

    Examples
    --------
    >>> import rfpsurvey as rs
    >>> table = rs.compare_instruments("poisson", ["sdss_apo", "pfs"], n_realizations=1)
    >>> rs.plot_instruments(table).get_xlabel()
    'part of the positioners'
    """
    from matplotlib.figure import Figure

    _check_table(table, COLUMNS, "compare_instruments")
    if ax is None:
        ax = Figure(figsize=(7.5, 0.9 + 0.36 * len(table)), layout="constrained").add_subplot()
    number, assigned, usable = (np.asarray(table[name], float) for name in ("positioners", "assigned", "usable"))
    y, labels = _places(table)
    style = {"height": 0.8, "linewidth": 0.5, "edgecolor": "white", **kwargs}
    ax.barh(y, usable / number, color=ARM, label="on a target", **style)
    ax.barh(y, (assigned - usable) / number, left=usable / number, color=COLLISION, hatch="////",
            label="on a target, in collision", **style)  # fmt: skip
    ax.barh(y, 1 - assigned / number, left=assigned / number, color=IDLE, alpha=0.4, label="no target", **style)
    for height, lost in zip(y, table["loss"], strict=True):
        if np.isfinite(lost):
            ax.annotate(
                f"{100 * lost:.1f} %", (1, height), (5, 0), textcoords="offset points", va="center", fontsize="small"
            )
    ax.annotate("loss", (1, 1), (5, 3), ("axes fraction"), "offset points", fontsize="small", fontstyle="italic")
    ax.set_yticks(y, labels)
    ax.set_ylim(y.min() - 0.6, 0.6)
    ax.set_xlim(0, 1)
    ax.set_xlabel("part of the positioners")
    ax.legend(loc="lower center", bbox_to_anchor=(0.45, 1), ncols=3, fontsize="small", frameon=False)
    return ax


def draw_instruments(table: QTable, figure: "Figure | None" = None) -> "Figure":
    """Return a figure of reach, fibers and collision probability, instrument by instrument."""
    from matplotlib.figure import Figure

    figure = Figure(layout="constrained") if figure is None else figure
    figure.set_size_inches(13, 1.3 + 0.34 * len(table))
    left, middle, right = figure.subplots(1, 3, width_ratios=(1, 1.7, 1))
    right.sharey(middle)
    _draw_reach(table, left)
    plot_instruments(table, ax=middle)
    _draw_probability(table, right)
    right.tick_params(labelleft=False)
    return figure


def _draw_reach(table, ax):
    """Draw which part of the footprint one, two and more positioners reach."""
    rows = np.sort(np.unique(np.asarray(table["instrument"]), return_index=True)[1])
    y = -np.arange(len(rows), dtype=float)
    left = np.zeros(len(rows))
    shades = ("#ffffff", "#cfe3f1", "#6aa7cf", "#12456e")  # from light to dark, also in print
    for name, color, label in zip(REACH, shades, ("none", "1", "2", "3 or more"), strict=True):
        part = np.asarray(table[name][rows], float)
        ax.barh(y, part, left=left, color=color, edgecolor="0.5", linewidth=0.5, height=0.7, label=label)
        left += part
    ax.set_yticks(y, [str(table["instrument"][row]) for row in rows])
    ax.set_xlim(0, 1)
    ax.set_xlabel("part of the footprint")
    ax.legend(
        title="positioners that reach it", loc="lower center", bbox_to_anchor=(0.5, 1), ncols=4, fontsize="small",
        title_fontsize="small", frameon=False, columnspacing=1.0, handlelength=1.2,
    )  # fmt: skip


def _draw_probability(table, ax):
    """Draw the collision probability with its interval."""
    y, _ = _places(table)
    value, low, high = (np.asarray(table[name], float) for name in ("probability", "low", "high"))
    ax.errorbar(value, y, xerr=[value - low, high - value], fmt="o", color=COLLISION, ms=4, lw=1, capsize=2)
    ax.set_xlim(left=0)
    ax.grid(axis="x", color="0.9", lw=0.6)
    ax.set_axisbelow(True)
    ax.set_xlabel("collision probability, 95 %")


def _places(table):
    """Return the height of each row, with room between instruments, and its label."""
    names = list(dict.fromkeys(np.asarray(table["instrument"]).tolist()))
    y = np.array([-k - 0.5 * names.index(name) for k, name in enumerate(np.asarray(table["instrument"]).tolist())])
    return y, [f"{row['instrument']}, {row['allocator']}" for row in table]
