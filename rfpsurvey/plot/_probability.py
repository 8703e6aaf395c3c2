"""Plots of collision probabilities against a parameter, and of differences as a function of two parameters."""

from collections.abc import Iterable

import numpy as np
from astropy.table import QTable
from matplotlib.axes import Axes
from matplotlib.patches import Patch

from rfpsurvey._units import to_plain
from rfpsurvey.errors import InputError
from rfpsurvey.plot._axes import check_columns, labeled, new_axes, values_of
from rfpsurvey.plot._style import DIVERGING, MARKERS, SERIES

DEVIATIONS = 1.96
LINES = ("-", "--", ":", "-.")


def plot_probability(
    table: QTable,
    x: str = "ratio",
    *,
    values: str | Iterable[str] = "value",
    by: str | None = None,
    ax: Axes | None = None,
    **kwargs: object,
) -> Axes:
    """Plot collision probabilities against a design parameter, with a line and an interval for each column and group.

    Parameters
    ----------
    table : QTable
        Table with a row for each design, for example a table of estimates.
    x : str, optional
        Column along the x axis, such as ``ratio`` or ``pitch``.
    values : str or list of str, optional
        Columns to plot. The interval of the column ``value`` extends from the column ``low`` to the column ``high``. If
        the table lacks these columns, the interval extends by 1.96 times ``standard_error`` to either side. The
        interval of another column, such as ``formula``, is defined by the columns ``formula_low`` and ``formula_high``,
        or ``formula_error``. If the table has none of these columns, only a line is drawn.
    by : str, optional
        Column that defines groups of rows: rows with the same value are one group, which has its own lines.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on; by default, a new figure is created.
    **kwargs
        Passed to ``Axes.plot`` for each line, for example ``linewidth``.

    Returns
    -------
    matplotlib.axes.Axes
        The axes. Shaded bands are the intervals of the estimates.

    Raises
    ------
    InputError
        If a column is missing or does not contain numbers.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astropy.table import QTable
    >>> import rfpsurvey as rs
    >>> rows, targets = [], rs.probability.RandomTargets(number=200)
    >>> for ratio in (1, 1.5, 2):
    ...     robot = rs.Positioner(8.25 * u.mm, 8.25 * ratio * u.mm, 2.25 * u.mm)
    ...     plane = rs.FocalPlane.hexagonal(robot, rings=2, pitch=25.6 * u.mm)
    ...     found = rs.collision_probability(plane, targets=targets, precision=0.01)
    ...     rows.append((ratio, found.value, found.low, found.high))
    >>> ax = rs.plot.plot_probability(QTable(rows=rows, names=["ratio", "value", "low", "high"]))
    >>> ax.get_ylabel()
    'collision probability'
    """
    names = [values] if isinstance(values, str) else list(values)
    check_columns(table, {x, *names} | ({by} if by else set()))
    if not names:
        raise InputError("values must name at least one column, got none")
    ax = new_axes() if ax is None else ax
    if by:
        known = np.array([value == value for value in to_plain(table[by]).tolist()])  # NaN does not equal itself
        table = table[known & ~np.ma.getmaskarray(np.ma.asarray(table[by]))]
    groups = list(dict.fromkeys(np.asarray(table[by]).tolist())) if by else [None]
    k, shaded = 0, False
    for group in groups:
        part = table if group is None else table[np.asarray(table[by]) == group]
        part = part[np.argsort(values_of(part, x), kind="stable")]
        for name in names:
            label = ", ".join(_words(group, name, names, by))
            style = {"color": SERIES[(k + 1) % 8], "marker": MARKERS[k % 8], "linestyle": LINES[k % 4], "markersize": 5}
            (line,) = ax.plot(values_of(part, x), values_of(part, name), label=label, **{**style, **kwargs})
            low, high = _interval(part, name)
            if low is not None:
                shaded = True
                ax.fill_between(values_of(part, x), low, high, color=line.get_color(), alpha=0.25, linewidth=0)
            k += 1
    ax.set(xlabel=labeled(table, x), ylabel="collision probability")
    handles, _ = ax.get_legend_handles_labels()
    if shaded:
        handles.append(Patch(facecolor="0.5", alpha=0.35, label="interval"))
    if len(handles) > 1:
        ax.legend(handles=handles, fontsize="small")
    return ax


def plot_residuals(
    table: QTable,
    value: str = "value",
    reference: str = "closed_form",
    *,
    x: str = "ratio",
    y: str = "pitch",
    ax: Axes | None = None,
    **kwargs: object,
) -> Axes:
    """Plot the differences of two columns as a function of two other columns, such as arm ratio and pitch.

    Triangles point up if the difference is positive, and down if it is negative; disks show differences of 0.

    Parameters
    ----------
    table : QTable
        Table with a row for each design.
    value, reference : str, optional
        Columns whose difference, ``value`` minus ``reference``, is plotted; rows whose difference is NaN are omitted.
    x, y : str, optional
        Columns along the x axis and along the y axis.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on; by default, a new figure is created.
    **kwargs
        Passed to ``scatter``, for example ``s``, ``vmin`` and ``vmax``.

    Returns
    -------
    matplotlib.axes.Axes
        The axes, with a color bar that is symmetric around 0.

    Raises
    ------
    InputError
        If a column is missing or does not contain numbers, or if no row has a number in both columns.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astropy.table import QTable
    >>> import rfpsurvey as rs
    >>> designs = QTable({"ratio": [1, 1.5, 2], "pitch": [26, 26, 30] * u.mm})
    >>> l1, l2 = 8.25 * u.mm, 8.25 * u.mm * designs["ratio"]
    >>> designs["value"] = rs.probability.surrogate_probability(l1, l2, designs["pitch"], 4.5 * u.mm)
    >>> designs["wider"] = rs.probability.surrogate_probability(l1, l2, designs["pitch"], 5.5 * u.mm)
    >>> rs.plot.plot_residuals(designs, "wider", "value").get_ylabel()
    'pitch [mm]'
    """
    check_columns(table, {x, y, value, reference})
    away = values_of(table, value) - values_of(table, reference)
    known = np.isfinite(away)
    if not known.any():
        raise InputError(f"{value} and {reference} must both have a number in at least one row")
    ax = new_axes(6.0, 4.8) if ax is None else ax
    most = np.abs(away[known]).max() or 1.0
    across, up = values_of(table, x), values_of(table, y)
    style = {"cmap": DIVERGING, "vmin": -most, "vmax": most, "edgecolors": "0.3", "linewidths": 0.6, "s": 42, **kwargs}
    for rows, marker in ((known & (away > 0), "^"), (known & (away < 0), "v"), (away == 0, "o")):
        points = ax.scatter(across[rows], up[rows], c=away[rows], marker=marker, **style)
    label = f"{value} - {reference}".replace("_", " ")
    ax.figure.colorbar(points, ax=ax, label=label)
    ax.set(xlabel=labeled(table, x), ylabel=labeled(table, y))
    return ax


def _words(group, name, names, by):
    """Yield the parts of the label of a line: the group, and the name of the column."""
    if group is not None:
        yield group if isinstance(group, str) else f"{by.replace('_', ' ')} {group}"
    if len(names) > 1 or group is None:
        yield name.replace("_", " ")


def _interval(table, name):
    """Return the ends of the interval of a column, or (None, None) if the table has no interval."""
    before = "" if name == "value" else f"{name}_"
    if {f"{before}low", f"{before}high"} <= set(table.colnames):
        return values_of(table, f"{before}low"), values_of(table, f"{before}high")
    error = "standard_error" if name == "value" else f"{name}_error"
    if error not in table.colnames:
        return None, None
    half = DEVIATIONS * values_of(table, error)
    return values_of(table, name) - half, values_of(table, name) + half
