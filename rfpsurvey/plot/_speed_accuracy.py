"""Plots of the errors of methods against their computing time."""

import astropy.units as u
import numpy as np
from astropy.table import QTable
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from rfpsurvey.errors import InputError
from rfpsurvey.plot._axes import MARKERS, SERIES, check_columns, new_grid

SHORT_AXIS = 100.0
"""If the upper limit of an axis is at least this number times the lower limit, only powers of ten are labeled."""
BARS = {"linestyle": "none", "capsize": 2, "elinewidth": 0.9, "zorder": 1.5}
LABEL_POINTS, LETTER_POINTS, GAP_POINTS = 7.0, 4.4, 1.5
"""Height of a label, width of a letter, and free space around a label, in points."""


def plot_speed_accuracy(table: QTable, *, axes: tuple[Axes, Axes] | None = None, **kwargs: object) -> tuple[Axes, Axes]:
    """Plot the errors of collision tests against the time per tile, for each method and number of points per arm.

    Parameters
    ----------
    table : QTable
        Table returned by `~rfpsurvey.benchmark.benchmark_collisions`.
    axes : tuple of matplotlib.axes.Axes, optional
        Two axes, for the number of misclassified pairs per colliding pair and for the largest error of the distance
        between two arms; by default, a new figure is created.
    **kwargs
        Passed to ``Axes.plot`` for each method, for example ``markersize``.

    Returns
    -------
    tuple of matplotlib.axes.Axes
        Two axes. Bars in the first axes show the standard error: the square root of the number of misclassified pairs,
        divided by the number of colliding pairs. If no pair is misclassified, an arrow points down from an upper limit,
        which is one divided by the number of colliding pairs. Methods to the lower left are faster and more accurate.

    Raises
    ------
    InputError
        If ``table`` lacks a column that the plot shows, or if ``axes`` does not contain two axes.

    Examples
    --------
    >>> import rfpsurvey as rs
    >>> table = rs.benchmark.benchmark_collisions("sdss_apo", methods=["exact", "sampled"], repeats=1)
    >>> above, below = rs.plot.plot_speed_accuracy(table)
    >>> below.get_xlabel()
    'time per tile [ms]'
    """
    columns = {"method", "n_points", "time", "n_colliding_true", "misclassified", "max_error"}
    check_columns(table, columns, "benchmark_collisions")
    axes = tuple(new_grid(2, 1, (7.5, 7), sharex=True)[1].flat) if axes is None else axes
    if len(axes) != 2:
        raise InputError(f"axes must be two Axes, got {len(axes)}")
    limit = 1 / np.maximum(np.asarray(table["n_colliding_true"], float), 1)
    errors, misclassified = table["max_error"].to_value(u.mm), np.asarray(table["misclassified"], float)
    least = errors[errors > 0].min(initial=1.0)
    panels = (
        (misclassified, limit, np.sqrt(misclassified * limit), "misclassified pairs per colliding pair"),
        (errors, np.full(len(table), least), None, "largest error of a distance [mm]"),
    )
    labels = []
    for ax, (values, limits, uncertain, label) in zip(axes, panels, strict=True):
        labels.append(_draw_methods(ax, table, values, limits, uncertain, kwargs))
        ax.set_ylabel(label)
    n = int(np.max(table["n_colliding_true"], initial=0))
    words = "bars: standard errors\narrows: upper limits for results without misclassified pairs"
    _state(axes[0], table, f"{n} colliding pairs", f"labels: points per arm; {words}")
    axes[0].legend(fontsize="small", ncols=2)
    axes[1].set_xlabel("time per tile [ms]")
    for ax, labels_of_panel in zip(axes, labels, strict=True):
        _label(ax, labels_of_panel)
    return axes


def _draw_methods(ax, table, values, limits, uncertain, style):
    """Draw a line for each method, with arrows at upper limits if the error is 0; return points with their labels."""
    time, points = table["time"].to_value(u.ms), np.ma.asarray(table["n_points"])
    heights = np.where(values > 0, values, limits)
    for k, method in enumerate(dict.fromkeys(table["method"])):
        rows = np.flatnonzero(table["method"] == method)
        look = {"color": SERIES[k % len(SERIES)], "marker": MARKERS[k % 8], "linestyle": ":", "label": method}
        look["markerfacecolor"] = look["color"] if k == 0 else "none"  # so that other markers remain visible
        (line,) = ax.plot(time[rows], heights[rows], **{**look, **style})
        line.set_linestyle("none")  # upper limits are not connected by lines
        some = rows[values[rows] > 0]
        ax.plot(time[some], heights[some], color=look["color"], linestyle=":", linewidth=line.get_linewidth(), zorder=1)
        if uncertain is not None and len(some):
            bars = _bars(heights[some], uncertain[some])
            ax.errorbar(time[some], heights[some], yerr=bars, color=look["color"], **BARS)
        for row in rows[values[rows] == 0]:
            arrow = {"arrowstyle": "<-", "color": look["color"], "shrinkA": 0, "shrinkB": 3}
            ax.annotate("", (time[row], heights[row]), (0, -22), textcoords="offset points", arrowprops=arrow)
    ax.set(xscale="log", yscale="log")
    known = heights[np.isfinite(heights) & (heights > 0)]
    low, high = known.min(initial=1e-3), known.max(initial=1e-3)
    stretch = max(np.log10(high / low), 1.0)
    ax.set_ylim(low * 10 ** (-0.18 * stretch), high * 10 ** (0.12 * stretch))
    _set_ticks(ax)
    return [(time[k], heights[k], "" if points[k] is np.ma.masked else str(points[k])) for k in range(len(table))]


def plot_probability_accuracy(
    table: QTable, *, axes: tuple[Axes, ...] | None = None, **kwargs: object
) -> tuple[Axes, ...]:
    """Plot the errors of collision probabilities against the computing time, with a line for each method.

    Estimates for allocated and for independent targets are in separate panels, because they cannot be compared.

    Parameters
    ----------
    table : QTable
        Table returned by `~rfpsurvey.benchmark.benchmark_probability`.
    axes : tuple of matplotlib.axes.Axes, optional
        Axes to draw on, one for each value of the column ``estimand``, in alphabetic order; by default, a new figure is
        created.
    **kwargs
        Passed to ``errorbar`` of each method, for example ``markersize``.

    Returns
    -------
    tuple of matplotlib.axes.Axes
        The axes. Bars show one standard error. Open markers show formulas, for which the column ``effort`` is 0.
        Errors below the gray line are smaller than the standard error of the reference value. Methods to the lower left
        are faster and more accurate.

    Raises
    ------
    InputError
        If ``table`` lacks a column that the plot shows, or if the number of ``axes`` differs from the number of values
        of ``estimand``.

    Examples
    --------
    >>> import astropy.units as u
    >>> import rfpsurvey as rs
    >>> robot = rs.Positioner(7.4 * u.mm, 15 * u.mm, 2.5 * u.mm)
    >>> plane = rs.FocalPlane.hexagonal(robot, rings=2, pitch=22.4 * u.mm)
    >>> table = rs.benchmark.benchmark_probability(plane, efforts={"quadrature": [64]}, repeats=2, precision=2e-3)
    >>> (ax,) = rs.plot.plot_probability_accuracy(table)
    >>> ax.get_xlabel()
    'time [ms]'
    """
    columns = {"method", "effort", "time", "error", "error_error", "estimand", "truth_error"}
    check_columns(table, columns, "benchmark_probability")
    estimands = sorted(set(np.asarray(table["estimand"]).tolist()))
    n = len(estimands)
    axes = tuple(new_grid(1, n, (5.2 * n + 0.6, 4.8))[1].flat) if axes is None else axes
    if len(axes) != n:
        raise InputError(f"axes must be {n} Axes, one for each estimand, got {len(axes)}")
    methods = list(dict.fromkeys(table["method"]))
    for ax, estimand in zip(axes, estimands, strict=True):
        rows = table[table["estimand"] == estimand]
        for k, method in enumerate(methods):
            part = rows[rows["method"] == method]
            if len(part):
                _draw_errors(ax, part, method, {"color": SERIES[k % len(SERIES)], "marker": MARKERS[k % 8]}, kwargs)
        ax.set(xscale="log", yscale="log")
        ax.axhline(rows["truth_error"][0], color="0.6", lw=0.8, zorder=0)
        ax.margins(x=0.12, y=0.08)
        _set_ticks(ax)
        ax.set_title(f"{estimand} targets", fontsize="medium")
        ax.set(xlabel="time [ms]", ylabel="root mean square error of the probability")
        ax.legend(fontsize="small")
    repeats = table.meta.get("repeats", "?")
    words = (
        f"{repeats} runs per point",
        "labels: iterations, realizations or points\ngray line: standard error of the reference",
    )
    _state(axes[0], table, *words, figure=True)
    for ax, estimand in zip(axes, estimands, strict=True):
        rows = table[table["estimand"] == estimand]
        efforts = [str(n) if n else "" for n in rows["effort"]]
        _label(ax, list(zip(rows["time"].to_value(u.ms), rows["error"], efforts, strict=True)))
    return axes


def _draw_errors(ax, part, method, style, options):
    """Draw the errors of a method, with error bars that end above zero."""
    formula = not np.asarray(part["effort"]).any()
    error, uncertain = np.asarray(part["error"]), np.nan_to_num(np.asarray(part["error_error"]))
    bars = _bars(error, uncertain)
    style = {**style, "linestyle": ":", "capsize": 2, "elinewidth": 0.9, "label": method}
    style["markerfacecolor"] = "none" if formula else style["color"]
    ax.errorbar(part["time"].to_value(u.ms), error, yerr=None if formula else bars, **{**style, **options})


def _bars(values, uncertain):
    """Return the lower and upper lengths of error bars; older versions of matplotlib need bars that end above zero."""
    return [np.minimum(uncertain, 0.9 * values).tolist(), uncertain.tolist()]


def _set_ticks(ax):
    """Label the values 1, 2 and 5 of each decade if there are few decades; otherwise, label only powers of ten."""
    for axis, (low, high) in ((ax.xaxis, ax.get_xlim()), (ax.yaxis, ax.get_ylim())):
        axis.set_minor_formatter(NullFormatter())
        if high < SHORT_AXIS * low:
            axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
            axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))


def _state(ax, table, number, legend, *, figure=False):
    """Write a title with the instrument, the machine, and the meaning of labels, bars and arrows."""
    meta = table.meta
    machine = f"{meta['machine']}; " if "machine" in meta else ""
    first = f"{meta.get('instrument', '')}: {meta.get('n_positioners', '?')} positioners, {number}"
    write = ax.figure.suptitle if figure else ax.set_title
    write(f"{first}\n{legend}\n{machine}lower left is better", fontsize="small")


def _label(ax, points):
    """Write a label beside each point (x, y, text), if possible without overlap with markers and other labels.

    This function must be called after all other text is drawn, because other text changes the size of the axes.
    """
    ax.figure.draw_without_rendering()
    scale = 72 / ax.figure.dpi
    places = scale * ax.transData.transform([point[:2] for point in points])
    taken = [(x - 3, y - 3, x + 3, y + 3) for x, y in places if np.isfinite([x, y]).all()]
    for (x, y, text), (left, low) in zip(points, places, strict=True):
        if not text or not np.isfinite([left, low]).all():
            continue
        wide = LETTER_POINTS * len(text)
        offsets = [(side, up) for up in (3, -10, 11, -18, 19) for side in (5, -5 - wide)]
        boxes = [
            (left + a - GAP_POINTS, low + up, left + a + wide + GAP_POINTS, low + up + LABEL_POINTS)
            for a, up in offsets
        ]
        best = int(np.argmin([sum(_overlap(box, label_box) for label_box in taken) for box in boxes]))
        taken.append(boxes[best])
        ax.annotate(text, (x, y), xytext=offsets[best], textcoords="offset points", fontsize=LABEL_POINTS)


def _overlap(first, second):
    """Return the area that two boxes (left, low, right, high) share."""
    wide = min(first[2], second[2]) - max(first[0], second[0])
    high = min(first[3], second[3]) - max(first[1], second[1])
    return max(wide, 0.0) * max(high, 0.0)
