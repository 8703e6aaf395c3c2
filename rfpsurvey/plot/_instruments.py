"""Plots that compare instruments."""

import numpy as np
from astropy.table import QTable
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from rfpsurvey.plot._axes import check_columns, legend_below, new_axes
from rfpsurvey.plot._style import ARM, COLLISION, HATCH, IDLE, LEVELS

COLUMNS = {"instrument", "positioners", "allocator", "assigned", "usable", "loss", "probability", "low", "high"}
SHADES = (LEVELS[0], LEVELS[1], LEVELS[3], LEVELS[5])
"""Colors from white to dark blue. On a page with a dark background, white becomes dark gray; other shades of blue would
look similar to this gray."""
REACH = ("reach_0", "reach_1", "reach_2", "reach_3")


def plot_instruments(table: QTable, *, ax: Axes | None = None, **kwargs: object) -> Axes:
    """Plot the fractions of positioners of each instrument that observe a target, collide, or have no target.

    Parameters
    ----------
    table : QTable
        Table returned by `~rfpsurvey.compare_instruments`.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on; by default, a new figure is created.
    **kwargs
        Passed to the bars, for example ``height``.

    Returns
    -------
    matplotlib.axes.Axes
        The axes. A bar for each instrument and allocator shows fractions of the positioners; the number to the right is
        the loss, the fraction of fibers lost to collisions.

    Raises
    ------
    InputError
        If ``table`` lacks a column that the plot shows.

    Examples
    --------
    >>> import rfpsurvey as rs
    >>> table = rs.compare_instruments("poisson", ["sdss_apo", "pfs"], n_realizations=1)
    >>> rs.plot.plot_instruments(table).get_xlabel()
    'fraction of the positioners'
    """
    check_columns(table, COLUMNS, "compare_instruments")
    ax = new_axes(7.0, 1.3 + 0.36 * len(table)) if ax is None else ax
    number, assigned, usable = (np.asarray(table[name], float) for name in ("positioners", "assigned", "usable"))
    y, labels = _places(table)
    style = {"height": 0.8, "linewidth": 0.5, "edgecolor": "white", **kwargs}
    pieces = (
        (usable, "science target", {"color": ARM}),
        (assigned - usable, "science target, in collision", {"color": COLLISION, "hatch": HATCH}),
        (number - assigned, "no science target", {"color": IDLE, "alpha": 0.4}),
    )
    left, handles = np.zeros(len(table)), []
    for sizes, label, colors in pieces:
        bars = ax.barh(y, sizes / number, left=left / number, label=label, **{**style, **colors})
        handles += [bars] if sizes.any() else []
        left = left + sizes
    for height, lost in zip(y, table["loss"], strict=True):
        if np.isfinite(lost):
            ax.annotate(f"{lost:.3f}", (1, height), (5, 0), textcoords="offset points", va="center", fontsize="small")
    header = {"fontsize": "small", "fontstyle": "italic", "linespacing": 1.0}
    ax.annotate("fraction\nlost to\ncollisions", (1, 1), (5, 3), "axes fraction", "offset points", **header)
    ax.set_yticks(y, labels)
    ax.set(ylim=(y.min() - 0.6, 0.6), xlim=(0, 1), xlabel="fraction of the positioners")
    legend_below(ax, handles)
    return ax


def draw_instruments(table: QTable, figure: Figure | None = None) -> Figure:
    """Return a figure with three panels: reach, use of fibers, and collision probability of each instrument."""
    if figure is None:
        figure = Figure(layout="constrained")
        figure.get_layout_engine().set(w_pad=0.1, h_pad=0.08)
    figure.set_size_inches(11, 1.9 + 0.34 * len(table))
    left, middle, right = figure.subplots(1, 3, width_ratios=(1, 1.6, 1.15))
    right.sharey(middle)
    _draw_reach(table, left)
    plot_instruments(table, ax=middle)
    _draw_probability(table, right)
    right.tick_params(labelleft=False)
    return figure


def _draw_reach(table, ax):
    """Draw the fractions of the footprint that are reached by no, one, two, and three or more positioners."""
    rows = np.sort(np.unique(np.asarray(table["instrument"]), return_index=True)[1])
    y = -np.arange(len(rows), dtype=float)
    left, handles = np.zeros(len(rows)), []
    for name, color, label in zip(REACH, SHADES, ("none", "1", "2", "3 or more"), strict=True):
        part = np.asarray(table[name][rows], float)
        style = {"color": color, "edgecolor": "0.5", "linewidth": 0.5, "height": 0.7, "label": label}
        handles.append(ax.barh(y, part, left=left, **style))
        left += part
    ax.set_yticks(y, [str(table["instrument"][row]) for row in rows])
    ax.set(xlim=(0, 1), xlabel="fraction of the footprint")
    title = {"title": "positioners that reach a point", "title_fontsize": "small"}
    legend_below(ax, handles, columns=4, columnspacing=1.0, handlelength=1.2, **title)


def _draw_probability(table, ax):
    """Draw the collision probability and its 95 % interval for each row of the table."""
    y, _ = _places(table)
    value, low, high = (np.asarray(table[name], float) for name in ("probability", "low", "high"))
    style = {"fmt": "o", "color": COLLISION, "ms": 4, "lw": 1, "capsize": 2, "clip_on": False}
    ax.errorbar(value, y, xerr=[value - low, high - value], **style)
    top = np.nanmax(np.append(high, value), initial=0.0) or 1.0
    ax.set_xlim(-0.04 * top, 1.06 * top)  # so that markers at 0 are not cut off
    ax.axvline(0, color="0.6", lw=0.8, zorder=0.5)
    ax.grid(axis="x", color="0.9", lw=0.6)
    ax.set_axisbelow(True)
    ax.set_xlabel("collision probability\n(95 % interval)")


def _places(table):
    """Return the position and the label of each row on the y axis, with gaps between instruments."""
    names = np.asarray(table["instrument"])
    changes = np.concatenate([[False], names[1:] != names[:-1]])
    y = -np.arange(len(names)) - 0.5 * np.cumsum(changes)
    return y, [f"{row['instrument']}, {row['allocator']}" for row in table]
