"""Plot that compares allocators."""

import astropy.units as u
import numpy as np
from astropy.table import QTable
from matplotlib.axes import Axes

from rfpsurvey.plot._axes import check_columns, legend_below, legend_line, new_axes
from rfpsurvey.plot._style import ARM, COLLISION, HATCH, IDLE, OUTLINE


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
    left, handles = np.zeros(n), []
    for sizes, label, style in pieces:
        if sizes.any() or label.startswith("usable"):
            handles.append(ax.barh(rows, sizes, left=left, label=label, **{"height": 0.7, **style, **kwargs}))
        left = left + sizes
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
    ax.set(
        xlim=(0, 1.16 * max(left.max(), blind or 0, 1)),
        xlabel="number of fibers",
        title=table.meta.get("instrument", ""),
    )
    legend_below(ax, handles, columns=2)
    return ax


def _in_words(seconds):
    """Return a time as text with two significant digits."""
    if seconds < 0.0995:
        return f"{1e3 * seconds:.2g} ms"
    return f"{seconds:.2g} s" if seconds < 99.5 else f"{seconds:.0f} s"
