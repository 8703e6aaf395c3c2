"""Time against error."""

from typing import TYPE_CHECKING

import astropy.units as u
import numpy as np
from astropy.table import QTable

from rfpsurvey.errors import InputError
from rfpsurvey.plot._axes import check_columns, new_axes
from rfpsurvey.plot._style import IDLE, MARKERS, SERIES

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["plot_probability_accuracy", "plot_speed_accuracy"]


def plot_speed_accuracy(
    table: QTable, *, axes: "tuple[Axes, Axes] | None" = None, **kwargs: object
) -> "tuple[Axes, Axes]":
    """Draw the time of a tile against errors, a point for each method and number of points.

    Parameters
    ----------
    table : QTable
        What `benchmark_collisions` returns.
    axes : tuple of matplotlib.axes.Axes, optional
        Where to draw misclassified pairs, and the largest error of a distance; a new figure by default.
    **kwargs
        Passed to ``plot`` of each method, for example ``markersize``.

    Returns
    -------
    tuple of matplotlib.axes.Axes
        Both axes. Zeros are drawn at the lower edge.

    Raises
    ------
    InputError
        If the table has other columns, or there are not two axes.

    Examples
    --------
    >>> import rfpsurvey as rs
    >>> table = rs.benchmark_collisions("sdss_apo", methods=["exact", "sampled"], repeats=1)
    >>> above, below = rs.plot_speed_accuracy(table)
    >>> below.get_xlabel()
    'time of a tile [ms]'
    """
    from matplotlib.figure import Figure

    check_columns(table, {"method", "n_points", "time", "misclassified", "max_error"}, "benchmark_collisions")
    if axes is None:
        axes = tuple(Figure(figsize=(7.5, 7), layout="constrained").subplots(2, sharex=True))
    if len(axes) != 2:
        raise InputError(f"axes must be two Axes, got {len(axes)}")
    time, points = table["time"].to_value(u.ms), np.ma.asarray(table["n_points"])
    panels = (
        (np.asarray(table["misclassified"]), "misclassified pairs, for each colliding one"),
        (table["max_error"].to_value(u.mm), "largest error of a distance [mm]"),
    )
    for ax, (values, label) in zip(axes, panels, strict=True):
        seen = values[values > 0]
        floor = 10.0 ** (np.floor(np.log10(seen.min())) - 1) if len(seen) else 1e-16
        for k, method in enumerate(dict.fromkeys(table["method"])):
            rows = np.flatnonzero(table["method"] == method)
            y = np.where(values[rows] > 0, values[rows], floor)
            style = {"color": SERIES[k % len(SERIES)], "marker": MARKERS[k % 8], "linestyle": ":", "label": method}
            style["markerfacecolor"] = style["color"] if k == 0 else "none"  # let others shine through
            ax.plot(time[rows], y, **{**style, **kwargs})
            for row, height in zip(rows, y, strict=True):
                if points[row] is not np.ma.masked:
                    where = {"textcoords": "offset points", "xytext": (4, 4), "fontsize": "x-small"}
                    ax.annotate(str(points[row]), (time[row], height), **where)
        ax.set_yscale("log")
        ax.set_xscale("log")
        ax.set_ylabel(label)
        top = seen.max(initial=10 * floor)
        ax.set_ylim(floor / 2, top * (top / floor) ** 0.1)  # room for labels above the highest point
        ax.axhspan(floor / 2, 2 * floor, color=IDLE, alpha=0.2, linewidth=0)
        ax.text(0.99, floor, "none", transform=ax.get_yaxis_transform(), ha="right", va="center", fontsize="small")
    axes[0].legend(fontsize="small", ncols=2)
    axes[1].set_xlabel("time of a tile [ms]")
    title = table.meta.get("instrument", "")
    axes[0].set_title(f"{title}: {table.meta.get('n_neighbor_pairs', '?')} pairs of neighbors; labels: points an arm")
    return axes


def plot_probability_accuracy(table: QTable, *, ax: "Axes | None" = None, **kwargs: object) -> "Axes":
    """Draw the error of collision probabilities against the time they take, a line for each method.

    Parameters
    ----------
    table : QTable
        What `benchmark_probability` returns.
    ax : matplotlib.axes.Axes, optional
        Where to draw; a new figure by default.
    **kwargs
        Passed to ``loglog`` of each method, for example ``markersize``.

    Returns
    -------
    matplotlib.axes.Axes
        The axes. Open markers: formulas, whose error no effort reduces.

    Raises
    ------
    InputError
        If the table has other columns.

    Examples
    --------
    >>> import rfpsurvey as rs
    >>> table = rs.benchmark_probability("sdss_apo", efforts={"closed_form": [0], "quadrature": [64]}, repeats=2)
    >>> rs.plot_probability_accuracy(table).get_xlabel()
    'time [ms]'
    """
    check_columns(table, {"method", "effort", "time", "error", "estimand"}, "benchmark_probability")
    ax = new_axes(7.5, 5.5) if ax is None else ax
    for k, method in enumerate(dict.fromkeys(table["method"])):
        rows = table[table["method"] == method]
        formula = not np.asarray(rows["effort"]).any()
        color = SERIES[k % len(SERIES)]
        style = {"color": color, "marker": MARKERS[k % 8], "linestyle": ":"}
        style |= {"markerfacecolor": "none" if formula else color, "label": f"{method} ({rows['estimand'][0]})"}
        ax.loglog(rows["time"].to_value(u.ms), rows["error"], **{**style, **kwargs})
        for row in rows:
            if not formula:
                where = {"textcoords": "offset points", "xytext": (4, 4), "fontsize": "x-small"}
                ax.annotate(str(row["effort"]), (row["time"].to_value(u.ms), row["error"]), **where)
    ax.set_xlabel("time [ms]")
    ax.set_ylabel("root mean square error of the probability")
    ax.set_title(f"{table.meta.get('instrument', '')}: labels are iterations, realizations or points")
    ax.legend(fontsize="small")
    return ax
