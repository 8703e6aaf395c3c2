"""Plots of surveys: completeness, selection probabilities, status, and the quality of a survey."""

import numpy as np
from astropy.table import QTable
from matplotlib.axes import Axes
from matplotlib.dates import ConciseDateFormatter, date2num
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from rfpsurvey._field.verdicts import OUTCOMES, Outcome
from rfpsurvey._sky.arrays import JOINED
from rfpsurvey._survey.columns import NOT_PLANNED
from rfpsurvey._survey.selection.probabilities import SelectionProbabilities
from rfpsurvey._survey.survey import Survey
from rfpsurvey.errors import InputTypeError, number_of
from rfpsurvey.plot._axes import (
    ARM,
    COLLISION,
    FADED,
    HATCH,
    LEVELS,
    MARKERS,
    OUTLINE,
    PATROL,
    SERIES,
    check_columns,
    legend_below,
    legend_line,
    light_scale,
    new_axes,
    new_grid,
)
from rfpsurvey.plot._classes import KIND_COLORS, OUTCOME_COLORS, by_name, stacked_bars


def plot_completeness(survey: Survey, *, ax: Axes | None = None, **kwargs: object) -> Axes:
    """Plot the completeness of a survey against the number of tiles, with a marker for each priority after each pass.

    Parameters
    ----------
    survey : Survey
        Survey to plot.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on; by default, a new figure is created.
    **kwargs
        Passed to ``Axes.plot`` for the line of all visits, for example ``linewidth``.

    Returns
    -------
    matplotlib.axes.Axes
        The axes.

    Raises
    ------
    InputError
        If ``survey`` is not a survey.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astropy.coordinates import SkyCoord
    >>> import rfpsurvey as rs
    >>> sky = rs.synthetic_catalog("poisson", SkyCoord("6h20m +23d"), 1 * u.deg, density=500 / u.deg**2, rng=1)
    >>> survey = rs.plan_survey(sky, "moons", SkyCoord([94.9, 95.1] * u.deg, [23, 23] * u.deg))
    >>> rs.plot.plot_completeness(survey).get_xlabel()
    'tiles'
    """
    if not isinstance(survey, Survey):
        raise InputTypeError(f"survey must be a Survey, got {type(survey).__name__}")
    ax = new_axes(7, 4.5) if ax is None else ax
    tiles, after = survey.tiles, survey.completeness
    if "category" in after.colnames:
        after = after[after["category"] == "all"]
    order = np.lexsort((np.arange(len(tiles)), tiles["round"]))
    share = np.cumsum(tiles["n_observed"][order]) / max(survey.summary["n_visits_requested"], 1)
    ax.plot(np.arange(len(tiles) + 1), np.append(0, share), **{"color": "k", "label": "all visits", **kwargs})
    classes = [name for name in dict.fromkeys(after["priority"]) if name != "all"]
    for k, name in enumerate(classes):
        rows = after["priority"] == name
        style = {"color": SERIES[k % len(SERIES)], "marker": MARKERS[k % len(MARKERS)], "ls": ":", "clip_on": False}
        ax.plot(after["n_tiles"][rows], after["completeness"][rows], label=f"priority {name}", **style)
    every = after["priority"] == "all"
    complete = after["n_complete"][every] / np.maximum(after["n_targets"][every], 1)
    ax.plot(after["n_tiles"][every], complete, "kX", clip_on=False, label="fraction of complete targets")
    for number, end in zip(after["pass"][every], after["n_tiles"][every], strict=True):
        ax.axvline(end, color="0.8", lw=0.8, zorder=0)
        style = {"rotation": 90, "ha": "right", "va": "bottom", "fontsize": "x-small", "color": "0.4"}
        ax.annotate(f"pass {number}", (end, 0.01), **style)
    ax.set(xlim=(0, 1.03 * len(tiles)), ylim=(0, 1.02), xlabel="tiles", ylabel="completeness")
    ax.legend(fontsize="small", loc="best")
    return ax


N_BINS = 20
CUT = 2.0
"""A bar that is higher than the second highest bar by this factor is cut."""


def plot_selection(found: SelectionProbabilities, *, ax: Axes | None = None, **kwargs: object) -> Axes:
    """Plot a histogram of the probabilities with which the targets of a survey are observed.

    The colors of the bars show the number of tiles in which at least one positioner reaches the target. Targets that no
    tile reaches are not drawn. A bar that is much higher than all others is cut, with its number beside it.

    Parameters
    ----------
    found : SelectionProbabilities
        Selection probabilities to plot.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on; by default, a new figure is created.
    **kwargs
        Passed to ``Axes.bar``, for example ``linewidth``.

    Returns
    -------
    matplotlib.axes.Axes
        The axes. The title states the numbers of targets that all realizations and that no realization observed.

    Raises
    ------
    InputError
        If ``found`` does not contain selection probabilities.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astropy.coordinates import SkyCoord
    >>> import rfpsurvey as rs
    >>> sky = rs.synthetic_catalog("uniform", SkyCoord("6h20m +23d"), 0.3 * u.deg, n_targets=4000, rng=1)
    >>> found = rs.selection_probabilities(sky, "desi", SkyCoord(["6h20m"], ["+23d"]), n_realizations=64)
    >>> rs.plot.plot_selection(found).get_xlabel()
    'selection probability'
    """
    if not isinstance(found, SelectionProbabilities):
        raise InputTypeError(f"found must be SelectionProbabilities, got {type(found).__name__}")
    ax = new_axes(7, 4.5) if ax is None else ax
    asked = (found.requested > 0) & ~found.unreachable
    bins = np.minimum((found.probability[asked] * N_BINS).astype(int), N_BINS - 1)
    level = np.minimum(found.n_tiles[asked], len(LEVELS) - 1).astype(int)
    x, below, handles = (np.arange(N_BINS) + 0.5) / N_BINS, np.zeros(N_BINS), []
    for k in np.unique(level).tolist():
        number = np.bincount(bins[level == k], minlength=N_BINS)
        label = f"{k} or more tiles" if k == len(LEVELS) - 1 else number_of(k, "tile")
        style = {"color": LEVELS[k], "edgecolor": OUTLINE, "linewidth": 0.5, **kwargs}
        ax.bar(x, number, 1 / N_BINS, bottom=below, **style)
        handles.append(Patch(facecolor=LEVELS[k], edgecolor=OUTLINE, linewidth=0.5, label=f"{label}: {number.sum()}"))
        below += number
    s = found.summary
    title = f"{number_of(s['n_targets'], 'target')}, {number_of(s['n_realizations'], 'realization')}: "
    title += f"{s['n_always_observed']} always observed, {s['n_never_observed']} never"
    title += f" ({s['n_unreachable']} in reach of no tile, not drawn)" if s["n_unreachable"] else ""
    second, most = np.sort(below)[-2:]
    highest = 1.05 * max(most, 1)
    if most > CUT * second > 0:  # the other bars would be too small
        highest = CUT * second
        k = int(np.argmax(below))
        side = -1 if k > N_BINS / 2 else 1
        style = {"ha": "right" if side < 0 else "left", "va": "top", "xytext": (14 * side, -4)}
        ax.annotate(f"\N{UPWARDS ARROW} {most:.0f}", (x[k], highest), textcoords="offset points", **style)
    ax.set(xlim=(0, 1), ylim=(0, highest), xlabel="selection probability", ylabel="number of targets")
    ax.set_title(title, fontsize="small")
    legend_below(ax, handles, title="number of tiles that reach the target", title_fontsize="small")
    return ax


PIECES = {
    "n_observed": ("observed", {"color": ARM}),
    "n_planned": ("planned", {"color": PATROL}),
    "n_not_assigned": ("in reach, not assigned", {"color": FADED, "alpha": 0.5}),
    "n_lost": ("lost to a collision", {"color": COLLISION, "hatch": HATCH}),
    "n_impossible": ("out of reach or excluded", {"color": "white", "edgecolor": "0.5"}),
}
"""Label and style of each part of the bars."""
MOST_ROWS, MOST_CLASSES, MOST_CATEGORIES, MOST_PASSES = 16, 6, 8, 5


def plot_survey_status(status: QTable, *, axes: "np.ndarray | None" = None, **kwargs: object) -> np.ndarray:
    """Plot the observed tiles and visits by date, and the visits of each class of targets.

    Parameters
    ----------
    status : QTable
        Table of `rfpsurvey.survey.survey_status`.
    axes : array_like of matplotlib.axes.Axes, shape (2,), optional
        Axes to draw on; by default, a new figure is created.
    **kwargs
        Passed to ``Axes.barh`` for the bars of the classes, for example ``height``.

    Returns
    -------
    ndarray of matplotlib.axes.Axes, shape (2,)
        The axes: progress by date, and visits of each class.

    Raises
    ------
    InputError
        If the table is not a status of a survey.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astropy.coordinates import SkyCoord
    >>> from tempfile import TemporaryDirectory
    >>> import rfpsurvey as rs
    >>> sky = rs.synthetic_catalog("uniform", SkyCoord("6h20m +23d"), 0.3 * u.deg, n_targets=4000, rng=1)
    >>> with TemporaryDirectory() as folder:
    ...     survey = rs.plan_survey(sky, "desi", SkyCoord(["6h20m"], ["+23d"]), folder=f"{folder}/survey")
    ...     status = rs.survey.survey_status(survey, survey.state(sky))
    >>> rs.plot.plot_survey_status(status)[0].get_ylabel()
    'visits'
    """
    check_columns(status, {"priority", "n_requested", *PIECES}, "survey_status")
    axes = new_grid(1, 2, (13, 4.6))[1][0] if axes is None else np.asarray(axes)
    _draw_progress(axes[0], status)
    _draw_classes(axes[1], status, kwargs)
    return axes


def _draw_progress(ax: Axes, status: QTable) -> None:
    """Draw the numbers of observed visits and tiles up to each date."""
    progress = status.meta["progress"]
    dates = [date for date in progress["date"] if date]
    first = len(progress["date"]) - len(dates)
    x = date2num(np.array(dates, dtype="datetime64[D]")) if dates else np.array([])
    handles = []
    for k, (name, values) in enumerate(list(progress["n_observed"].items())[: 1 + MOST_CLASSES]):
        look = {"color": "k", "marker": "."} if k == 0 else {"ls": ":", "color": SERIES[(k - 1) % len(SERIES)]}
        look |= {} if k == 0 else {"marker": MARKERS[(k - 1) % len(MARKERS)], "markersize": 4}
        label = "all visits" if k == 0 else f"priority {name}"
        ax.plot(x, values[first:], **look)
        handles.append(legend_line(label, **look))
    tiles = ax.twinx()
    tiles.step(x, progress["n_tiles"][first:], where="post", color="0.6", zorder=0)
    handles.append(legend_line("tiles (right axis)", color="0.6"))
    others = "pass", *NOT_PLANNED
    total = sum(n for row in status.meta["tiles"] for state, n in row.items() if state not in others)
    tiles.set(ylim=(0, 1.03 * max(total, 1)), ylabel="tiles")
    tiles.yaxis.set_major_locator(MaxNLocator(integer=True))
    ax.set(ylim=(0, 1.03 * max(int(status["n_requested"][0]), 1)), ylabel="visits", xlabel="date")
    if not dates:
        ax.set_xticks([])
        ax.annotate("no observation with a date", (0.5, 0.5), xycoords="axes fraction", ha="center", color="0.4")
    else:
        locator = MaxNLocator(6, integer=True)  # whole days
        ax.xaxis.set_major_locator(locator)
        ax.xaxis.set_major_formatter(ConciseDateFormatter(locator))
        ax.set_xlim(x[0] - 1, x[-1] + 1)
    legend_below(ax, handles, columns=4)


def _draw_classes(ax: Axes, status: QTable, kwargs: dict) -> None:
    """Draw a bar for each class: the fractions of its visits that are observed, planned, and neither."""
    rows = status[:MOST_ROWS]
    pieces = tuple((np.asarray(rows[name], float), *look) for name, look in PIECES.items())
    wanted, observed = np.asarray(rows["n_requested"]), np.asarray(rows["n_observed"])
    label, left_out = "fraction of the requested visits", len(status) - len(rows)
    y = -np.arange(len(rows), dtype=float)
    stacked_bars(ax, y, rows, wanted, observed, pieces, kwargs, label=label, left_out=left_out)


MOST_DOTS = 3000
KINDS = {"science": "science", "standard": "standard stars", "sky": "sky"}


def draw_survey_quality(survey: Survey, axes: tuple, kwargs: dict) -> None:
    """Draw the four panels with the quality of a survey."""
    classes, outcomes, fibers, tiles = axes
    _draw_visits(classes, survey, kwargs)
    _draw_outcomes(outcomes, survey)
    _draw_fibers(fibers, survey)
    _draw_tiles(tiles, survey)
    s, name = survey.summary, survey.provenance["instrument"]["name"]
    visits = f"{s['n_visits_observed']} of {number_of(s['n_visits_requested'], 'visit')} observed"
    title = f"{name}: {visits} on {number_of(s['n_tiles'], 'tile')}"
    classes.set_title(title, loc="left", fontsize="medium")


def class_rows(survey: Survey) -> QTable:
    """Return the rows of the completeness table that are drawn as bars, with the completeness after the last pass."""
    return _after(survey, -1)[:MOST_ROWS]


def _after(survey, k) -> QTable:
    """Return the rows of the completeness table after the k-th planned pass, with categories before priorities."""
    passes = list(dict.fromkeys(np.asarray(survey.completeness["pass"]).tolist()))
    rows = survey.completeness[np.asarray(survey.completeness["pass"]) == passes[k]]
    if "category" not in rows.colnames:
        return rows
    category = np.asarray(rows["category"]) != "all"
    few = category & (np.cumsum(category) <= MOST_CATEGORIES)
    group = np.where(few, 1, np.where(category, 3, 2))
    group[0] = 0  # the row of all targets is the first one
    return rows[np.argsort(group, kind="stable")]


def _draw_visits(ax, survey, kwargs):
    """Draw a bar for each class: the fractions of its visits that were observed in each pass."""
    passes = list(dict.fromkeys(np.asarray(survey.completeness["pass"]).tolist()))
    rows = class_rows(survey)
    wanted, observed = (np.asarray(rows[name], float) for name in ("n_requested", "n_observed"))
    # if there are many passes, the last color stands for several passes
    ends = [*range(min(len(passes), MOST_PASSES) - 1), len(passes) - 1]
    colors = [ARM] if len(ends) == 1 else light_scale()(np.linspace(0.0, 0.85, len(ends)))
    pieces, before = [], np.zeros(len(rows))
    for k, (end, color) in enumerate(zip(ends, colors, strict=True)):
        after = np.asarray(_after(survey, end)["n_observed"][:MOST_ROWS], float)
        several = k > 0 and end > ends[k - 1] + 1
        words = f"in passes {passes[ends[k - 1] + 1]} to {passes[end]}" if several else f"in pass {passes[end]}"
        words = "observed" if len(ends) == 1 else words
        pieces.append((after - before, words, {"color": color}))
        before = after
    pieces.append((wanted - observed, "not observed", {"color": FADED, "alpha": 0.5}))
    groups = [2 if row["priority"] != "all" else int(row.get("category", "all") != "all") for row in by_name(rows)]
    y = -np.arange(len(rows)) - 0.4 * np.cumsum(np.diff(groups, prepend=0) != 0)
    label, left_out = "fraction of the requested visits", len(_after(survey, -1)) - len(rows)
    stacked_bars(ax, y, rows, wanted, observed, pieces, kwargs, label=label, left_out=left_out, columns=3)


def _draw_outcomes(ax, survey):
    """Draw the number of targets with each outcome."""
    known = {OUTCOMES[code]: color for code, color in OUTCOME_COLORS.items()}
    counts = {name: survey.summary["outcomes"].get(name, 0) for name in known}
    counts = {name: n for name, n in counts.items() if n}
    total, y = sum(counts.values()), -np.arange(len(counts))
    lost = OUTCOMES[Outcome.LOST_TO_A_COLLISION]
    for place, (name, n) in zip(y, counts.items(), strict=True):
        look = {"hatch": HATCH} if name == lost else {}
        ax.barh(place, n, 0.75, color=known[name], edgecolor="white", linewidth=0.4, **look)
        text = f"{n} ({n / total:.1%})"
        ax.annotate(text, (n, place), (4, 0), textcoords="offset points", va="center", fontsize="small")
    ax.set_yticks(y, list(counts), fontsize="small")
    around = 0.6 + max(4 - len(counts), 0) / 2
    room = 1.35 * max(counts.values(), default=1)  # for the numbers
    ax.set(xlim=(0, room), ylim=(y.min(initial=0) - around, around), xlabel="number of targets of the catalog")


def _draw_fibers(ax, survey):
    """Draw the numbers of fibers on science targets, standard stars and sky in each pass."""
    tiles, s = survey.tiles, survey.summary
    passes, place = np.unique(np.asarray(tiles["pass"]), return_inverse=True)
    n_fibers = s["n_fibers"] / max(s["n_tiles"], 1) * np.bincount(place)
    bottom, handles = np.zeros(len(passes)), []
    # surveys that older versions saved have only the column n_science
    columns = {kind: f"n_{kind}" for kind in KINDS if f"n_{kind}" in tiles.colnames}
    numbers = {kind: np.asarray(tiles[name], float) for kind, name in columns.items()}
    several = {}
    for k in np.flatnonzero(sum(numbers.values()) > np.asarray(tiles["n_assigned"])).tolist():
        kinds, counts = np.unique(np.asarray(survey.tile(tiles["tile"][k])["kind"]), return_counts=True)
        for kind, n in zip(kinds.tolist(), counts.tolist(), strict=True):
            if kind in JOINED:
                several.setdefault(kind, np.zeros(len(tiles)))[k] = n
                for role in kind.split("+"):
                    numbers[role][k] -= n
    for kind, values in {**numbers, **several}.items():
        n = np.bincount(place, weights=values)
        if n.any():
            label = f"{KINDS.get(kind, kind).replace('+', ' and ')}: {n.sum():.0f}"
            handles.append(ax.bar(np.arange(len(passes)), n, 0.75, bottom, color=KIND_COLORS[kind], label=label))
        bottom = bottom + n
    n_unused = np.maximum(n_fibers - np.bincount(place, weights=np.asarray(tiles["n_assigned"], float)), 0)
    look = {"color": FADED, "alpha": 0.5, "label": f"without a target: {n_unused.sum():.0f}"}
    handles.append(ax.bar(np.arange(len(passes)), n_unused, 0.75, bottom, **look))
    step = -(-len(passes) // MOST_ROWS)
    ax.set_xticks(np.arange(len(passes))[::step], [str(p) for p in passes[::step]], fontsize="small")
    around = 0.6 + max(4 - len(passes), 0) / 2
    ax.set(xlim=(-around, len(passes) - 1 + around), xlabel="pass", ylabel="fibers, all tiles of the pass")
    ax.yaxis.set_major_locator(MaxNLocator(integer=True))
    legend_below(ax, handles, columns=2)


def _draw_tiles(ax, survey):
    """Draw the fiber use and the collision rate of the assigned arms of each tile, in the order of planning."""
    tiles = survey.tiles
    order = np.lexsort((np.arange(len(tiles)), np.asarray(tiles["round"])))
    x, handles = np.arange(1, len(tiles) + 1), []
    size = float(np.clip(120 / np.sqrt(max(len(tiles), 1)), 2, 6))
    name, rate = "collision_rate", np.asarray(tiles["collision_rate"], float)
    among = "assigned and parked arms"
    if "n_colliding_assigned" in tiles.colnames:  # surveys of earlier versions have no such column
        rate = np.asarray(tiles["n_colliding_assigned"]) / np.maximum(tiles["n_assigned"], 1)
        name, among = "collision_rate_assigned", "assigned arms"
    use = np.asarray(tiles["fiber_use"], float)
    for values, total, label, color, marker in (
        (use, survey.summary["fiber_use"], "fraction of the fibers used", ARM, "o"),
        (rate, survey.summary[name], f"collision rate of {among}", COLLISION, "D"),
    ):
        style = {"color": color, "marker": marker, "linestyle": "none", "markersize": size, "markeredgecolor": OUTLINE}
        style |= {"markeredgewidth": 0.3, "clip_on": False, "rasterized": len(tiles) > MOST_DOTS}
        ax.plot(x, values[order], **style)
        text = f"{label} (all tiles together: {total:.3f})"
        handles.append(legend_line(text, color=color, marker=marker, linestyle="none", markersize=5))
    labels = {"xlabel": "tiles, in the order of planning", "ylabel": "fraction"}
    ax.set(xlim=(0.5, len(tiles) + 0.5), ylim=(0, 1.02), axisbelow=True, **labels)
    ax.xaxis.set_major_locator(MaxNLocator(8, integer=True, min_n_ticks=1))
    ax.grid(axis="y", color="0.9", linewidth=0.6)
    legend_below(ax, handles, columns=1)
