"""Plots of the quality of a survey: visits by class, targets by outcome, fibers by kind and pass, and tiles."""

import numpy as np
from astropy.table import QTable
from matplotlib.ticker import MaxNLocator

from rfpsurvey._roles import JOINED
from rfpsurvey.errors import number_of
from rfpsurvey.pipeline import OUTCOMES, Outcome
from rfpsurvey.plot._axes import legend_below, legend_line
from rfpsurvey.plot._classes import KIND_COLORS, OUTCOME_COLORS, by_name, stacked_bars
from rfpsurvey.plot._style import ARM, COLLISION, FADED, HATCH, OUTLINE, light_scale
from rfpsurvey.survey import Survey

MOST_CLASS_ROWS, MOST_CATEGORIES, MOST_PASSES = 16, 8, 5
"""Largest numbers of bars for classes, of bars for categories, and of passes with separate colors."""
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
    return _after(survey, -1)[:MOST_CLASS_ROWS]


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
        after = np.asarray(_after(survey, end)["n_observed"][:MOST_CLASS_ROWS], float)
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
    step = -(-len(passes) // MOST_CLASS_ROWS)
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
