"""Plots of the quality of a tile or of a survey, such as targets by class and fibers by spectrograph."""

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord
from matplotlib.axes import Axes
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from rfpsurvey._assignment.constraints.requirement import Requirement
from rfpsurvey._field.table import OUTCOMES_COLUMNS
from rfpsurvey._field.tile import Tile
from rfpsurvey._field.verdicts import Outcome
from rfpsurvey._sky.arrays import has_role
from rfpsurvey._survey.survey import Survey
from rfpsurvey.errors import InputError, InputTypeError, listed, number_of
from rfpsurvey.plot._axes import (
    ARM,
    COLLISION,
    FADED,
    HATCH,
    MARKERS,
    OUTLINE,
    PATROL,
    SERIES,
    labeled,
    legend_below,
    legend_line,
    new_figure,
    values_of,
)
from rfpsurvey.plot._classes import ASSIGNED, OUTCOME_COLORS, by_name, short_names, stacked_bars
from rfpsurvey.plot._focal_plane import codes_of, outcomes_of
from rfpsurvey.plot._sky import plot_tiling, radius_of
from rfpsurvey.plot._sky_map import is_wide
from rfpsurvey.plot._survey import class_rows, draw_survey_quality, plot_completeness

MOST_BARS, MOST_CATEGORIES = 16, 8
MOST_SERIES = 6
LONGEST = 50  # largest number of letters in a row of a legend
MOST_VALUES, N_BINS = 20, 24
"""A histogram of whole numbers has a bar for each number if their range is below ``MOST_VALUES``; other histograms have
``N_BINS`` bins."""
DECADES = 100.0
"""Ratio of the largest value to the median of positive values above which the bins of a histogram are logarithmic."""
FEW_PER_RING, MOST_RINGS = 40, 12
UNEVEN = 20.0
"""Ratio of available to assigned targets above which the scale of the histogram is logarithmic."""
FIBER_COLORS = (SERIES[3], SERIES[2], SERIES[5], SERIES[4], SERIES[1], SERIES[6])


def plot_quality(
    result: Tile | Survey, *, column: str | None = None, axes: tuple[Axes, ...] | None = None, **kwargs: object
) -> tuple[Axes, ...]:
    """Plot the observed targets of a tile or of a survey, and the use of its fibers, in four panels.

    Parameters
    ----------
    result : Tile or Survey
        Tile or survey to plot. A tile must have `outcomes <rfpsurvey.Tile.outcomes>`.
    column : str, optional
        Column of numbers in the outcomes of a tile, for the histogram. By default, the histogram shows the priority or,
        without priorities, the first additional column of the catalog that contains numbers.
    axes : tuple of matplotlib.axes.Axes, optional
        Four axes to draw on; by default, a new figure is created.
    **kwargs
        Passed to the bars of the first panel, for example ``height``.

    Returns
    -------
    tuple of matplotlib.axes.Axes
        The axes of the four panels.

        For a tile, the first panel has one bar for each class (a row of `Tile.completeness
        <rfpsurvey.Tile.completeness>`). The bar shows the fraction of the targets of the class with each outcome; the
        numbers of observed targets and of all targets are on the right. The second panel shows the number of fibers on
        sky and on standard stars in each spectrograph. If the tile has requirements, the panel instead shows the
        number of fibers that count toward each requirement, with a dashed line at the required minimum. If there are
        no requirements and no fibers on sky or standard stars, the panel shows the number of fibers on science targets.
        The third panel is a histogram of ``column`` for all science targets and for assigned science targets. Its scale
        is logarithmic if the values extend over several powers of ten. The third panel is empty if there is no column
        of numbers. The fourth panel shows the fractions of science targets that
        are in reach and that are assigned, in rings of equal area around the center of the focal plane, with 68 %
        confidence intervals.

        For a survey, the first panel has one bar for each class (a row of ``Survey.completeness``). The bar shows the
        fractions of the visits that were observed in each pass; the numbers of observed and requested visits are on the
        right. The second panel shows the number of targets with each outcome. The third panel shows the number of
        fibers on science targets, standard stars and sky in each pass. The fourth panel shows, for each tile, the
        fraction of the fibers that are in use and the collision rate of assigned arms.

    Raises
    ------
    InputError
        If a tile has no outcomes, or if its outcomes have no column of numbers with the name ``column``; if a column is
        given for a survey; or if the number of axes is not four.

    See Also
    --------
    plot_focal_plane : Plot the targets on the focal plane by outcome, with ``targets="outcome"``.
    plot_targets : Plot the targets on the sky by outcome.
    plot_completeness : Plot the completeness of a survey against the number of tiles.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astropy.coordinates import SkyCoord
    >>> import rfpsurvey as rs
    >>> center = SkyCoord("6h20m +23d")
    >>> sky = rs.synthetic_catalog("poisson", center, 1.4 * u.deg, density=300 / u.deg**2, rng=1)
    >>> axes = rs.plot.plot_quality(rs.plan_tile(sky, "sdss_apo", center))
    >>> axes[0].get_xlabel()
    'fraction of the targets in the field'
    """
    if not isinstance(result, Tile | Survey):
        raise InputTypeError(f"result must be a Tile or a Survey, got {type(result).__name__}")
    if isinstance(result, Survey):
        if column is not None:
            raise InputError(f"column must be None for a survey, which has no histogram, got {column!r}")
        axes = _four_axes(axes, len(class_rows(result)))
        draw_survey_quality(result, axes, kwargs)
        return axes
    table = outcomes_of(result)
    column = _column_of(table, column)
    axes = classes, fibers, histogram, field = _four_axes(axes, len(_shown(result.completeness)))
    _draw_classes(classes, result.completeness, kwargs)
    _draw_fibers(fibers, result)
    outcome = codes_of(table)
    if "kind" in table.colnames:
        science = has_role(np.asarray(table["kind"]), "science")
        table, outcome = table[science], outcome[science]
    _draw_histogram(histogram, table, column, np.isin(outcome, ASSIGNED))
    _draw_radius(field, table, outcome)
    s = result.summary
    title = f"{result.instrument}: {s['n_assigned']} of {s['n_positioners']} positioners assigned"
    classes.set_title(f"{title}, {s['n_colliding']} in collision", loc="left", fontsize="medium")
    return axes


def _four_axes(given, n_rows):
    """Return the given axes, or four axes of a new figure; raise an error if the number of given axes is not four."""
    if given is None:
        heights = 1.7 + 0.24 * max(n_rows, 6), 3.4
        figure = new_figure(11, sum(heights), wspace=0.03, hspace=0.03)
        given = figure.subplots(2, 2, height_ratios=heights).ravel()
    if len(given) != 4:
        raise InputError(f"axes must be four Axes, got {len(given)}")
    return tuple(given)


def _column_of(table, name) -> str | None:
    """Return the name of the column of the histogram, or None if the outcomes have no column of numbers."""
    numbers = [c for c in table.colnames if c == "priority" or c not in OUTCOMES_COLUMNS]
    numbers = [c for c in numbers if np.asarray(table[c]).dtype.kind in "iuf"]
    if name is None:
        return min(numbers, key=lambda c: c != "priority", default=None)
    if name not in table.colnames or np.asarray(table[name]).dtype.kind not in "iuf":
        raise InputError(f"column must be one of the columns of numbers ({listed(numbers)}), got {name!r}")
    return name


def _shown(completeness):
    """Return the rows that are drawn as bars: kinds, the largest categories, and the most important priorities."""
    number = np.cumsum(np.asarray(completeness["category"]) != "all")
    rows = completeness[(np.asarray(completeness["category"]) == "all") | (number <= MOST_CATEGORIES)]
    return rows[:MOST_BARS]


def _draw_classes(ax, completeness, kwargs):
    """Draw a bar for each class: the fraction of its targets with each outcome."""
    rows = _shown(completeness)
    total, reach, assigned, observed = (
        np.asarray(rows[name], float) for name in ("n_in_field", "n_reachable", "n_assigned", "n_observed")
    )
    groups = [next((k for k, name in enumerate(GROUPS) if row[name] != "all"), -1) for row in by_name(rows)]
    y = -np.arange(len(rows)) - 0.4 * np.cumsum(np.diff(groups, prepend=groups[0]) != 0)
    pieces = (
        (observed, "observed", {"color": OUTCOME_COLORS[Outcome.OBSERVED]}),
        (assigned - observed, "lost to a collision", {"color": COLLISION, "hatch": HATCH}),
        (reach - assigned, "in reach not assigned", {"color": PATROL}),
        (total - reach, "out of reach, or not requested", {"color": FADED, "alpha": 0.5}),
    )
    label, left_out = "fraction of the targets in the field", len(completeness) - len(rows)
    stacked_bars(ax, y, rows, total, observed, pieces, kwargs, label=label, left_out=left_out)


GROUPS = ("category", "priority")


def _series_of(tile) -> list[tuple[str, np.ndarray, int, str]]:
    """Return the label of each requirement, the positioners that count, and the minimum with its unit.

    If there are no requirements, return the positioners on sky and on standard stars or, if there are no such
    positioners, the positioners on science targets.
    """
    t = tile.table
    asked = tile.provenance["parameters"].get("requirements") or []
    requirements = [Requirement.parse(text) for text in asked if isinstance(asked, list)]
    requirements = (requirements or [Requirement("sky"), Requirement("standard")])[:MOST_SERIES]
    values = {name: np.asarray(t[name]) if name in t.colnames else None for name in ("kind", "category", "fiber_type")}

    series = []
    names = short_names([requirement.what for requirement in requirements])
    for requirement, name in zip(requirements, names, strict=True):
        label, rows = name + (f" ({requirement.fiber_type})" if requirement.fiber_type else ""), np.zeros(len(t), bool)
        for column in ("kind", "category"):
            if values[column] is not None:
                rows |= has_role(values[column], requirement.what)
        if requirement.fiber_type and values["fiber_type"] is not None:
            rows &= values["fiber_type"] == requirement.fiber_type
        if rows.any() or requirement.minimum:
            series.append((label, rows, requirement.minimum, requirement.per))
    return series or [("science", np.isin(np.asarray(t["status"]), ("assigned", "out_of_reach")), 0, "tile")]


def _draw_fibers(ax, tile):
    """Draw the number of fibers that count toward each requirement in each spectrograph, and the required number."""
    t, series = tile.table, _series_of(tile)
    single = "spectrograph" not in t.colnames
    spectrograph = np.zeros(len(t), int) if single else np.asarray(t["spectrograph"])
    names, place = np.unique(spectrograph, return_inverse=True)
    width, colliding = 0.8 / len(series), np.asarray(t["in_collision"])
    handles, required, lost = [], [], None
    for k, (label, rows, minimum, per) in enumerate(series):
        color = ARM if label == "science" else FIBER_COLORS[k]
        free, in_collision = (np.bincount(place[rows & part], minlength=len(names)) for part in (~colliding, colliding))
        x = np.arange(len(names)) + (k - (len(series) - 1) / 2) * width
        label += f": {np.count_nonzero(rows)}"
        in_all = minimum and per == "tile" and len(names) > 1
        if in_all:
            label += f" (at least {minimum} required)"
        handles.append(ax.bar(x, free, 0.92 * width, color=color, label=label))
        if in_collision.any():
            look = {"color": COLLISION, "hatch": HATCH, "edgecolor": "white", "linewidth": 0, "label": "in collision"}
            lost = ax.bar(x, in_collision, 0.92 * width, bottom=free, **look)
        if minimum and not in_all and per in ("tile", "spectrograph"):
            ends = (x[0] - width / 2, x[0] + width / 2) if len(names) == 1 else (-0.6, len(names) - 0.4)
            ax.hlines(minimum, *ends, colors=OUTLINE, linestyles="--", linewidths=1.2, zorder=3)
            required.append(minimum)
    handles += [] if lost is None else [lost]
    if required:
        label = "required" + ("" if len(names) == 1 else " per spectrograph")
        handles.append(legend_line(label, color=OUTLINE, linestyle="--", linewidth=1.2))
    ax.set_xticks(np.arange(len(names)), [] if single else [str(name) for name in names], fontsize="small")
    ax.yaxis.set_major_locator(MaxNLocator(integer=True))
    highest = max([*required, *(bar.get_y() + bar.get_height() for bar in ax.patches), 1])
    label = "all positioners" if single else "spectrograph"
    ax.set(xlim=(-0.6, len(names) - 0.4), ylim=(0, 1.08 * highest), xlabel=label, ylabel="fibers")
    letters = sum(len(handle.get_label()) for handle in handles)
    legend_below(ax, handles, columns=3 if len(handles) == 3 and letters <= LONGEST else 2)


def _draw_histogram(ax, table, name, assigned):
    """Draw the distribution of a column for all science targets and for assigned science targets."""
    if name is None:
        ax.set_axis_off()
        ax.text(0.5, 0.5, "The targets have no column of numbers.", ha="center", transform=ax.transAxes)
        return
    values = values_of(table, name)
    known, label = np.isfinite(values), labeled(table, name)
    levels, positive = np.unique(values[known]), known & (values > 0)
    if len(levels) > 0 and (levels == np.rint(levels)).all() and np.ptp(levels) < MOST_VALUES:
        edges = np.arange(levels[0], levels[-1] + 2) - 0.5
        ax.xaxis.set_major_locator(MaxNLocator(10, integer=True))
    elif _spans_decades(values[known], values[positive]):
        edges = np.geomspace(values[positive].min(), levels[-1], N_BINS + 1)
        ax.set_xscale("log")
        n_others = np.count_nonzero(known & ~positive)
        label += f"; {number_of(n_others, 'value')} of 0 or less not shown" if n_others else ""
    else:
        edges = np.histogram_bin_edges(values[known], N_BINS)
    look = {"bins": edges, "histtype": "stepfilled"}
    handles = []
    for rows, words, color in ((known, "available", FADED), (known & assigned, "assigned", ARM)):
        ax.hist(values[rows], **look, facecolor=color, edgecolor="none", alpha=0.5 if rows is known else 0.9)
        ax.hist(values[rows], **{**look, "histtype": "step"}, edgecolor=OUTLINE, linewidth=0.8)
        style = {"edgecolor": OUTLINE, "linewidth": 0.8, "label": f"{words}: {np.count_nonzero(rows)}"}
        handles.append(Patch(facecolor=to_rgba(color, 0.5 if rows is known else 0.9), **style))
    if np.count_nonzero(known) > UNEVEN * max(np.count_nonzero(known & assigned), 1):
        ax.set_yscale("log")
        ax.set_ylim(bottom=0.7)
    ax.set(xlabel=label, ylabel="number of science targets")
    legend_below(ax, handles)


def _spans_decades(values, positive) -> bool:
    """Return whether most values are positive, and bins of equal width would put most values into the first bin."""
    return 2 * len(positive) > len(values) and positive.max() > DECADES * np.median(positive)


def _draw_radius(ax, table, outcome):
    """Draw the fractions of science targets that are in reach and that are assigned, in rings of equal area."""
    radius = np.hypot(table["x"].to_value(u.mm), table["y"].to_value(u.mm))
    known = np.isfinite(radius)
    radius, outcome = radius[known], outcome[known]
    reach = np.isin(outcome, (*ASSIGNED, Outcome.IN_REACH_NOT_ASSIGNED, Outcome.EXCLUDED_BY_A_CONSTRAINT))
    n_rings = int(np.clip(len(radius) // FEW_PER_RING, 3, MOST_RINGS))
    edges = radius.max(initial=0.0) * np.sqrt(np.arange(n_rings + 1) / n_rings)
    ring = np.clip(np.searchsorted(edges, radius, side="left") - 1, 0, n_rings - 1)
    number = np.bincount(ring, minlength=n_rings)
    some = number > 0
    x = np.sqrt((edges[1:] ** 2 + edges[:-1] ** 2) / 2)[some]
    handles = []
    for k, (rows, label, color) in enumerate(
        ((reach, "in reach", SERIES[5]), (np.isin(outcome, ASSIGNED), "assigned", ARM))
    ):
        value, bars = _fraction(np.bincount(ring[rows], minlength=n_rings)[some], number[some])
        style = {"color": color, "marker": MARKERS[1 - k], "markersize": 4, "linewidth": 1.2, "capsize": 2}
        handles.append(ax.errorbar(x, value, bars, label=label, linestyle=":" if k == 0 else "-", **style))
    limits = {"xlim": (0, (1.03 if len(x) > 1 else 2.0) * edges[-1] or 1.0), "ylim": (0, 1.05), "axisbelow": True}
    ax.set(**limits, xlabel="distance from the center of the focal plane [mm]", ylabel="fraction of science targets")
    ax.grid(color="0.9", linewidth=0.6)
    legend_below(ax, handles)


def _fraction(part, whole):
    """Return fractions, and their distances to the lower and upper ends of their 68 % Wilson intervals."""
    n, p = np.maximum(whole, 1), part / np.maximum(whole, 1)
    middle, half = (p + 0.5 / n) / (1 + 1 / n), np.sqrt(p * (1 - p) / n + 0.25 / n**2) / (1 + 1 / n)
    return p, np.maximum([p - middle + half, middle + half - p], 0)


def draw_survey(survey: Survey) -> Figure:
    """Draw a figure with two panels: a map of the tiles, colored by completeness, and the completeness curve.

    Parameters
    ----------
    survey : Survey
        Survey to plot.

    Returns
    -------
    matplotlib.figure.Figure
        The figure.

    Raises
    ------
    InputError
        If ``survey`` is not a survey.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astropy.coordinates import SkyCoord
    >>> import rfpsurvey as rs
    >>> sky = rs.synthetic_catalog("uniform", SkyCoord("6h20m +23d"), 0.3 * u.deg, n_targets=400, rng=1)
    >>> survey = rs.plan_survey(sky, "desi", SkyCoord([95, 95.1] * u.deg, [23, 23] * u.deg))
    >>> len(rs.plot.draw_survey(survey).axes) > 1
    True
    """
    if not isinstance(survey, Survey):
        raise InputTypeError(f"survey must be a Survey, got {type(survey).__name__}")
    wide = is_wide(SkyCoord(survey.tiles["ra"], survey.tiles["dec"]), radius_of(survey))
    figure = new_figure(14, 4.8, w_pad=0.15, h_pad=0.1)
    left, right = figure.add_gridspec(1, 2, width_ratios=(1.3, 1))
    plot_tiling(survey, ax=figure.add_subplot(left, projection="aitoff" if wide else None))
    plot_completeness(survey, ax=figure.add_subplot(right))
    return figure
