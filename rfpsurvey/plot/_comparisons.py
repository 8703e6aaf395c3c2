"""Plots that compare allocators or instruments."""

import astropy.units as u
import numpy as np
from astropy.table import QTable
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from rfpsurvey.plot._axes import (
    ARM,
    COLLISION,
    HATCH,
    IDLE,
    LEVELS,
    OUTLINE,
    check_columns,
    legend_below,
    legend_line,
    new_axes,
    new_figure,
)
from rfpsurvey.plot._classes import draw_parts


def plot_allocators(table: QTable, *, ax: Axes | None = None, **kwargs: object) -> Axes:
    """Plot the numbers of usable, lost and missing fibers for each allocator.

    Usable fibers are fibers on science targets that are not lost to collisions. Fibers are missing if a plan has fewer
    fibers, for example on sky positions, than the requirements demand.

    Parameters
    ----------
    table : QTable
        Table returned by `~rfpsurvey.compare_allocators`.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on; by default, a new figure with the legend below the axes is created.
    **kwargs
        Passed to ``barh``, for example ``height``.

    Returns
    -------
    matplotlib.axes.Axes
        The axes, with a bar and the computing time of each allocator in the order of the table. The dashed line
        shows the number of science fibers of the best plan that ignores collisions.

    Raises
    ------
    InputError
        If ``table`` lacks a column that the plot shows.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astropy.coordinates import SkyCoord
    >>> import rfpsurvey as rs
    >>> center = SkyCoord("6h20m +23d")
    >>> sky = rs.synthetic_catalog("uniform", center, 0.2 * u.deg, n_targets=2000, rng=1)
    >>> ax = rs.plot.plot_allocators(rs.compare_allocators(sky, "moons", center, allocators=["lamost_rule", "repair"]))
    >>> [text.get_text() for text in ax.get_yticklabels()]
    ['lamost_rule', 'repair']
    """
    needed = {"allocator", "science", "usable", "missing", "seconds"}
    check_columns(table, needed, "compare_allocators")
    n = len(table)
    ax = new_axes(7.0, 1.6 + 0.42 * n) if ax is None else ax
    rows, usable, science, missing = np.arange(n), *(np.asarray(table[c]) for c in ("usable", "science", "missing"))
    pieces = (
        (usable, "usable science fibers", {"color": ARM}),
        (science - usable, "lost to collisions", {"color": COLLISION, "edgecolor": "white", "hatch": HATCH}),
        (missing, "fibers missing for requirements", {"facecolor": "white", "edgecolor": IDLE, "hatch": "...."}),
    )
    pieces = [piece for piece in pieces if piece[0].any() or piece is pieces[0]]
    left, handles = draw_parts(ax, rows, pieces, {"height": 0.7}, kwargs, with_empty=True)
    for row, number in zip(rows, usable, strict=True):
        ax.text(0.015 * left.max(), row, str(number), color="white", va="center", fontsize="small")
    style = {"transform": ax.get_yaxis_transform(), "ha": "right", "va": "center", "fontsize": "small"}
    for row, seconds in zip(rows, table["seconds"].to_value(u.s), strict=True):
        ax.text(0.99, row, _in_words(seconds), **style)
    blind = table.meta.get("blind_science")
    if blind:
        ax.axvline(blind, color=OUTLINE, linestyle="--", linewidth=1)
        handles.append(legend_line(color=OUTLINE, linestyle="--", label="science fibers if collisions are ignored"))
    ax.set_yticks(rows, list(table["allocator"]))
    ax.invert_yaxis()
    longest = 1.16 * max(left.max(), blind or 0, 1)
    ax.set(xlim=(0, longest), xlabel="number of fibers", title=table.meta.get("instrument", ""))
    legend_below(ax, handles, columns=2)
    return ax


def _in_words(seconds):
    """Return a time as text with two significant digits."""
    if seconds < 0.0995:
        return f"{1e3 * seconds:.2g} ms"
    return f"{seconds:.2g} s" if seconds < 99.5 else f"{seconds:.0f} s"


COLUMNS = {"instrument", "positioners", "allocator", "assigned", "usable", "loss", "probability", "low", "high"}
SHADES = (LEVELS[0], LEVELS[1], LEVELS[3], LEVELS[5])
"""Colors from white to dark blue. On a page with a dark background, white becomes dark gray; other shades of blue would
look similar to this gray."""


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
    pieces = (
        (usable / number, "science target", {"color": ARM}),
        ((assigned - usable) / number, "science target, in collision", {"color": COLLISION, "hatch": HATCH}),
        ((number - assigned) / number, "no science target", {"color": IDLE, "alpha": 0.4}),
    )
    style = {"height": 0.8, "linewidth": 0.5, "edgecolor": "white", **kwargs}
    _, handles = draw_parts(ax, y, pieces, style, {})
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
    """Draw a figure with three panels: reach, use of fibers, and collision probability of each instrument.

    Parameters
    ----------
    table : QTable
        Table that `rfpsurvey.compare_instruments` returned.
    figure : matplotlib.figure.Figure, optional
        Figure to draw on; by default, a new figure is created.

    Returns
    -------
    matplotlib.figure.Figure
        The figure.

    Raises
    ------
    InputError
        If ``table`` lacks a column that the plot shows.

    Examples
    --------
    >>> import rfpsurvey as rs
    >>> table = rs.compare_instruments("poisson", ["sdss_apo", "moons"], n_realizations=1)
    >>> len(rs.plot.draw_instruments(table).axes)
    3
    """
    check_columns(table, {"instrument", "probability", "low", "high", "reach_0", "reach_3"}, "compare_instruments")
    size = 11, 1.9 + 0.34 * len(table)
    figure = new_figure(*size, w_pad=0.1) if figure is None else figure
    figure.set_size_inches(size)
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
    labels, style = ("none", "1", "2", "3 or more"), {"edgecolor": "0.5", "linewidth": 0.5, "height": 0.7}
    parts = [np.asarray(table[f"reach_{k}"][rows], float) for k in range(len(labels))]
    pieces = [(part, label, {"color": color}) for part, label, color in zip(parts, labels, SHADES, strict=True)]
    _, handles = draw_parts(ax, y, pieces, style, {}, with_empty=True)
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
    limits = -0.04 * top, 1.06 * top  # so that markers at 0 are not cut off
    ax.axvline(0, color="0.6", lw=0.8, zorder=0.5)
    ax.grid(axis="x", color="0.9", lw=0.6)
    ax.set(xlim=limits, axisbelow=True, xlabel="collision probability\n(95 % interval)")


def _places(table):
    """Return the position and the label of each row on the y axis, with gaps between instruments."""
    names = np.asarray(table["instrument"])
    changes = np.concatenate([[False], names[1:] != names[:-1]])
    y = -np.arange(len(names)) - 0.5 * np.cumsum(changes)
    return y, [f"{row['instrument']}, {row['allocator']}" for row in table]
