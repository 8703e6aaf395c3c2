"""Plots of tables of designs: two columns with the Pareto front, collision probabilities, and differences."""

from collections.abc import Iterable

import numpy as np
from astropy.table import QTable
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.patches import Patch

from rfpsurvey._common.units import to_plain
from rfpsurvey._studies.design_rows import instruments_of
from rfpsurvey.errors import InputError, check_choice
from rfpsurvey.plot._axes import (
    COLLISION,
    DIVERGING,
    MARKERS,
    SERIES,
    check_columns,
    labeled,
    legend_below,
    legend_line,
    light_scale,
    new_axes,
    values_of,
)

LABELS = {
    "ratio": "ratio of the arms (eccentric over central)",
    "min_separation": "minimum separation D",
    "multiplicity": "patrol area divided by area per positioner",
    "loss": "fraction of fibers lost to collisions",
    "coverage": "fraction of the focal plane in reach",
    "usable": "fibers on targets per positioner",
    "usable_per_area": "fibers on targets per area",
    "positioners_per_area": "positioners per area",
}


def plot_designs(
    table: QTable,
    *,
    x: str | None = None,
    y: str | None = None,
    color: str | None = None,
    mark: dict[str, QTable] | None = None,
    ax: Axes | None = None,
    **kwargs: object,
) -> Axes:
    """Plot two columns of a table of designs against each other, with the Pareto front.

    Large points with black edges are on the Pareto front: no other design is better in both objectives. If the color
    column has only a few values, each value has its own marker. A star with a name is the design of the instrument that
    was passed to `~rfpsurvey.design.explore_around`.

    Parameters
    ----------
    table : QTable
        Table returned by `~rfpsurvey.design.explore_designs` or `~rfpsurvey.design.explore_around`.
    x, y : str, optional
        Columns to plot; by default, the two objectives of the table. The points on the Pareto front of the objectives
        are marked even if other columns are plotted. If the objectives are plotted, a line connects these points.
    color : str, optional
        Column that determines the color; by default ``ratio`` if it varies, otherwise the parameter with the most
        values.
    mark : dict of str to QTable, optional
        Designs to mark with a star, such as existing instruments. Each key is a name, which is written beside the star.
        Each value is a table of one or a few designs that `~rfpsurvey.design.explore_designs` returned for the same
        targets.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on; by default, a new figure is created.
    **kwargs
        Passed to ``Axes.scatter``.

    Returns
    -------
    matplotlib.axes.Axes
        The axes.

    Raises
    ------
    InputError
        If a table was not returned by `~rfpsurvey.design.explore_designs`, if a column is missing, or if the
        column ``loss`` is defined differently in ``mark`` and in ``table``.

    Examples
    --------
    >>> import astropy.units as u
    >>> import rfpsurvey as rs
    >>> table = rs.design.explore_designs(central_arm=[7, 8, 9] * u.mm, ratio=1.5, pitch=25 * u.mm, clearance=2 * u.mm)
    >>> rs.plot.plot_designs(table).get_ylabel()
    'fraction of fibers lost to collisions (independent)'
    """
    mark = {**_instruments(table), **(mark or {})}
    for designs in (table, *mark.values()):
        if not isinstance(designs, QTable) or "loss" not in designs.colnames or "objectives" not in designs.meta:
            raise InputError("table, and each table in mark, must be a table that explore_designs returned")
        if _question(designs) != _question(table):
            same = f"the same definition as in the plotted table ({_question(table)})"
            raise InputError(f"the column loss of each table in mark must have {same}, got {_question(designs)}")
    objectives = list(table.meta["objectives"])
    x, y = (o if name is None else name for name, o in zip((x, y), objectives, strict=True))
    numbers = [name for name in table.colnames if table[name].dtype.kind in "if"]
    color = _parameter(table) if color is None else color
    for name in (x, y, color):
        check_choice(name, numbers, "column of designs")
    ax = new_axes() if ax is None else ax
    front, values, across, up = np.asarray(table["pareto"]), *(values_of(table, name) for name in (color, x, y))
    not_instrument = instruments_of(table) == ""  # the design of an instrument is drawn as a star
    few = len(np.unique(values[not_instrument])) <= len(MARKERS)
    style = {"vmin": np.nanmin(values), "vmax": np.nanmax(values), "cmap": light_scale(), "linewidths": 0.3}
    style |= {"s": float(np.clip(6e4 / len(table), 16, 60)), "edgecolors": "0.35", "alpha": 0.8, **kwargs}
    look = {**style, "s": 2 * style["s"], "linewidths": 1.2, "edgecolors": "black", "alpha": 1.0, "zorder": 3}
    handles = []
    for k, level in enumerate(np.unique(values[not_instrument]) if few else [None]):
        rows = not_instrument & (values == level) if few else not_instrument
        marker = {"marker": MARKERS[k]}
        points = ax.scatter(across[rows], up[rows], c=values[rows], **{**marker, **style})
        ax.scatter(across[rows & front], up[rows & front], c=values[rows & front], **{**marker, **look})
        if few:
            face = {"linestyle": "none", "color": points.cmap(points.norm(level)), "markeredgecolor": "0.35"}
            handles.append(legend_line(f"{_label(table, color, short=True)} {level:g}", **face, **marker))
    if {x, y} == set(objectives):
        order = np.flatnonzero(front)[np.argsort(across[front], kind="stable")]
        ax.plot(across[order], up[order], color="black", linewidth=1, zorder=2.5)
        better = f"Pareto front ({front.sum()} of {len(table)} designs)"
        handles.append(legend_line(color="black", linewidth=1, marker="o", markerfacecolor="none", label=better))
    for name, designs in mark.items():
        _mark(ax, name, values_of(designs, x), values_of(designs, y))
    ax.set(xlabel=_label(table, x), ylabel=_label(table, y))
    if not few:
        ax.figure.colorbar(ScalarMappable(points.norm, points.cmap), ax=ax, label=_label(table, color))
    legend_below(ax, handles, columns=3 if few else 1)
    return ax


def _mark(ax, name, across, up):
    """Draw designs as stars, and write their name beside the first star, toward the center of the axes."""
    ax.scatter(across, up, marker="*", s=260, color=COLLISION, edgecolors="white", linewidths=1.2, zorder=4)
    right = across[0] > np.mean(ax.get_xlim())
    style = {"fontweight": "bold", "zorder": 5, "xytext": (-11 if right else 11, 6), "ha": "right" if right else "left"}
    text = ax.annotate(name, (across[0], up[0]), textcoords="offset points", **style)
    text.set_bbox({"facecolor": "white", "alpha": 0.85, "linewidth": 0, "pad": 1.5})


def _instruments(table):
    """Return a dict from the name of each instrument to a table of the designs of this instrument."""
    if not isinstance(table, QTable):
        return {}
    names = instruments_of(table)
    return {name: table[names == name] for name in dict.fromkeys(names.tolist()) if name}


def _question(table):
    """Return the definition of ``loss``: the estimand and, unless it is ``independent``, the number of targets."""
    asked = table.meta["request"]
    targets = f", {asked['targets']:g} targets per {'mm^2' if asked['by_area'] else 'positioner'}"
    return asked["estimand"] + ("" if asked["estimand"] == "independent" else targets)


def _parameter(table):
    """Return ``ratio`` if the ratio of the arms varies, otherwise the name of the parameter with the most values."""
    numbers = {name: len(np.unique(values_of(table, name))) for name in ("ratio", "pitch", "central_arm", "clearance")}
    return "ratio" if numbers["ratio"] > 1 else max(numbers, key=numbers.get)


def _label(table, name, *, short=False):
    """Return the label of a column, with its unit; a ``short`` label is for a legend."""
    text, unit = LABELS.get(name, name.replace("_", " ")), getattr(table[name], "unit", None)
    if short:
        return f"{'arm ratio' if name == 'ratio' else text}" + (f" [{unit:unicode}]" if unit else "")
    of = f" ({_question(table).replace('_', ' ')})" if name in ("loss", "usable", "usable_per_area") else ""
    return f"{text}{of}" + (f" [{unit:unicode}]" if unit else "")


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
