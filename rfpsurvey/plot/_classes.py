"""Functions that show classes of targets: bars of fractions, dots colored by outcome or by class, and short names."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from astropy.table import QTable

from rfpsurvey._field.verdicts import OUTCOMES, Outcome, category_classes, priority_classes
from rfpsurvey._sky.arrays import JOINED
from rfpsurvey._survey.columns import PAST
from rfpsurvey.errors import InputError, number_of
from rfpsurvey.plot._axes import (
    ARM,
    COLLISION,
    FADED,
    GROUP_COLORS,
    MARKERS,
    OUTLINE,
    PATROL,
    SERIES,
    diamond_size,
    legend_below,
    legend_line,
    light_scale,
    limits_of,
    points_per_unit,
)

FEWEST = 4
HEADING = 0.9  # position of the word "observed" above the first bar


def draw_parts(
    ax, y: np.ndarray, pieces: Iterable, style: dict, kwargs: dict, *, with_empty: bool = False
) -> tuple[np.ndarray, list]:
    """Draw horizontal bars that consist of several parts; return the ends of the bars, and legend entries.

    ``pieces`` contains the parts from left to right: the size of the part in each bar, its label and its style, which
    replaces the ``style`` of all parts, and which ``kwargs`` replaces. A part that is empty in all bars has a legend
    entry only if ``with_empty`` is true.
    """
    left, handles = np.zeros(len(y)), []
    for sizes, label, look in pieces:
        bars = ax.barh(y, sizes, left=left, label=label, **{**style, **look, **kwargs})
        handles += [bars] if with_empty or sizes.any() else []
        left = left + sizes
    return left, handles


def stacked_bars(
    ax,
    y: np.ndarray,
    rows: QTable,
    total: np.ndarray,
    counted: np.ndarray,
    pieces: Iterable,
    kwargs: dict,
    *,
    label: str,
    left_out: int,
    columns: int = 2,
) -> None:
    """Draw a stacked bar from 0 to 1 for each class in ``rows``, and write two numbers beside each bar.

    The first number is the number of observed targets (or visits) of the class (``counted``). The second number is the
    number of all targets (or requested visits) of the class (``total``). ``pieces`` contains the parts of the bars from
    left to right. Each part is a tuple of the number of targets (or visits) in each class, the label of the part, and
    its style. ``label`` describes the fractions, and ``left_out`` is the number of classes without a bar.
    """
    pieces = [(number / np.maximum(total, 1), label, look) for number, label, look in pieces]
    _, handles = draw_parts(ax, y, pieces, {"height": 0.75, "linewidth": 0.4, "edgecolor": "white"}, kwargs)
    text = {"textcoords": "offset points", "fontsize": "small", "annotation_clip": False}
    text |= {"xycoords": ("axes fraction", "data"), "va": "center"}
    for place, done, of in zip(y, counted, total, strict=True):
        ax.annotate(f"{done:.0f} of {of:.0f}", (1, place), (4, 0), **text)
    ax.annotate("observed", (1, HEADING), (4, 0), **text)
    ax.set_yticks(y, short_names([_class_label(row) for row in by_name(rows)]), fontsize="small")
    around = 0.6 + max(FEWEST - len(y), 0) / 2  # a single bar must not fill the panel
    ax.set(xlim=(0, 1), ylim=(y.min() - around, max(around, HEADING + 0.4)))
    label += f"; {number_of(left_out, 'more class', 'more classes')} not shown" if left_out else ""
    ax.set_xlabel(label, fontsize="small" if left_out else None)
    legend_below(ax, handles, columns=columns)


def by_name(rows: QTable) -> list[dict]:
    """Return the rows of a table of completeness as dicts."""
    return [dict(zip(rows.colnames, row, strict=True)) for row in rows.as_array().tolist()]


def _class_label(row: dict) -> str:
    """Return the name of the class of targets that a row of a table of completeness describes."""
    if row.get("category", "all") != "all":
        return row["category"]
    return row.get("kind", "all") if row["priority"] == "all" else f"priority {row['priority']}"


MOST = 22
"""Largest number of characters of an abbreviated name."""
DOTS = "\N{HORIZONTAL ELLIPSIS}"


def short_names(names: Sequence[str], most: int = MOST) -> list[str]:
    """Return names of at most ``most`` characters; different names remain different.

    Dots replace the central part of a long name. If two abbreviations would be equal, more of the beginning or of the
    end of the names is kept; if they are still equal, the abbreviations end with numbers.
    """
    names = list(names)
    for head in (most // 2, most // 4, 3 * most // 4, 1, most - 2):
        end = most - 1 - head
        shortened = [name if len(name) <= most else name[:head] + DOTS + name[-end:] for name in names]
        if len(set(shortened)) == len(set(names)):
            return shortened
    number = {name: k for k, name in enumerate(dict.fromkeys(names), 1)}
    return [f"{name[: most - 1 - len(str(number[name]))]}{DOTS}{number[name]}" for name in names]


COLORINGS = ("outcome", "kind", "category", "priority")
OUTCOME_COLORS = {
    Outcome.OBSERVED: ARM,
    Outcome.PARTLY_OBSERVED: SERIES[3],
    Outcome.LOST_TO_A_COLLISION: COLLISION,
    Outcome.IN_REACH_NOT_ASSIGNED: PATROL,
    Outcome.EXCLUDED_BY_A_CONSTRAINT: SERIES[2],
    Outcome.OUT_OF_REACH: FADED,
    Outcome.NOT_REQUESTED: SERIES[4],
    Outcome.IN_NO_FIELD: "#555555",
}
STATE_COLORS = {
    "observed": ARM,
    "partly observed": SERIES[3],
    "bad": COLLISION,
    "dropped": "#555555",
    "planned": PATROL,
    PAST: FADED,
}
"""Colors of the states of tiles; views in pages have the same colors (``scripts/status.js``), or darker ones."""
ASSIGNED = (Outcome.OBSERVED, Outcome.PARTLY_OBSERVED, Outcome.LOST_TO_A_COLLISION)
KIND_COLORS = {"science": ARM, "standard": SERIES[2], "sky": SERIES[3], **dict.fromkeys(JOINED, SERIES[4])}
LEFT, MARKED = (0.35, 0.8, 3.0), (0.5, 1.7, 5.0)
"""Sizes of the dots of unassigned targets (first tuple) and of assigned targets (second tuple). Each tuple contains the
ratio of the size to the mean distance between dots, and the smallest and the largest size in points."""
LOST = 1.3  # largest ratio of the size of a diamond to the size of a dot
LEAST_SPREAD = 0.05
"""Smallest extent of the targets from which the sizes of dots are computed, as a fraction of the extent of the axes."""
ON_ARMS = 7.0  # points, largest size of a dot that is drawn on an arm, with a white edge
MANY = 3000
"""If a layer has more than this number of targets, its dots are stored as an image in vector files."""
LONGEST = 74  # largest number of letters in a row of a legend with three columns


@dataclass(frozen=True, eq=False)
class Layer:
    """Targets that are drawn in the same way; a layer without a label has no legend entry of its own."""

    label: str
    rows: np.ndarray
    color: object
    marker: str
    assigned: bool
    place: int = 0
    """Order of drawing: layers with smaller values are on top of layers with larger values."""
    lost: bool = False


def layers_of(color: str, outcome: np.ndarray, columns: dict) -> list[Layer]:
    """Return one layer for each outcome, or two layers for each class: its assigned targets and its other targets.

    ``outcome`` contains indices into ``OUTCOMES``; ``columns`` can contain ``kind``, ``category`` and ``priority``.
    """
    if color == "outcome":
        return list(_by_outcome(outcome))
    return list(_by_class(color, np.isin(outcome, ASSIGNED), columns))


def _by_outcome(outcome) -> Iterator[Layer]:
    for code, color in OUTCOME_COLORS.items():
        rows = outcome == code
        if rows.any():
            lost = code == Outcome.LOST_TO_A_COLLISION
            label = f"{OUTCOMES[code]}: {np.count_nonzero(rows)}"
            yield Layer(label, rows, color, "D" if lost else "o", code in ASSIGNED, lost=lost)


def _by_class(color, assigned, columns) -> Iterator[Layer]:
    class_of, names = _classes(color, columns, len(assigned))
    if color == "kind":
        colors = [KIND_COLORS.get(name, OUTLINE) for name in names]
    elif color == "priority" and len(names) > 2:  # the most important class has the darkest color
        colors = [tuple(rgba) for rgba in light_scale()(np.linspace(0, 0.85, len(names)))]
    else:
        colors = [SERIES[1], SERIES[2]] if len(names) <= 2 else GROUP_COLORS
    for k, name in enumerate(names):
        rows = class_of == k
        in_class_and_assigned = rows & assigned
        if rows.any():
            label = f"{name}: {np.count_nonzero(in_class_and_assigned)} of {np.count_nonzero(rows)}"
            place = k if color == "priority" else -k  # the most important or rarest classes are on top
            yield Layer(label, in_class_and_assigned, colors[k], MARKERS[k % len(MARKERS)], assigned=True, place=place)
            yield Layer("", rows & ~assigned, colors[k], "o", assigned=False, place=place)


def _classes(color, columns, n) -> tuple[np.ndarray, list[str]]:
    """Return the class of each target, and the names of the classes."""
    values = columns.get(color)
    if color == "kind":
        values = np.full(n, "science") if values is None else np.asarray(values)
        names = [name for name in KIND_COLORS if (values == name).any()]
        return np.argmax([values == name for name in names], axis=0) if names else np.zeros(n, int), names
    if values is None:
        raise InputError(f"the catalog must have the column {color} to color targets by it, got none")
    if color == "category":
        class_of, names = category_classes(np.asarray(values), np.ones(n, dtype=bool))
        return class_of, short_names(names)
    class_of, names = priority_classes(np.asarray(values), np.ones(n, dtype=bool))
    return class_of, [f"priority {name}" for name in names]


def legend_options(color: str, labels: list[str]) -> dict:
    """Return the options of a legend: the number of columns, and a title that explains the two sizes of dots."""
    each = -(-len(labels) // 3) or 1  # the legend fills its columns one after the other
    letters = sum(max(map(len, labels[k : k + each])) for k in range(0, len(labels), each))
    options: dict = {"columns": 3 if letters <= LONGEST else 2}
    if color == "outcome":
        return options
    title = "numbers: assigned of all targets; large dots: assigned, small dots: not assigned"
    return {**options, "title": title, "title_fontsize": "small"}


def draw_layers(
    ax, xy: np.ndarray, layers: list[Layer], kwargs: dict, *, below: float, above: float, on_arms: bool = False
) -> Iterator:
    """Draw a dot for each target, and yield legend entries.

    Targets that are not assigned are small dots with the zorder ``below``; assigned targets are larger dots with the
    zorder ``above``. Targets lost to a collision are drawn as diamonds, on top of all dots; if they are few, the
    diamonds are larger than the dots. The more targets there are, the smaller are the dots. If ``on_arms`` is true, the
    dots are drawn on arms and have white edges.
    """
    spread = np.maximum(np.ptp(xy, axis=0) if len(xy) else 0.0, LEAST_SPREAD * np.ptp(limits_of(ax), axis=0))
    spread = spread * points_per_unit(ax)
    left = np.count_nonzero(np.any([layer.rows for layer in layers if not layer.assigned], axis=0))
    for layer in layers:
        number = len(xy) - left if layer.assigned else left
        part, least, most = MARKED if layer.assigned else LEFT
        edge, width = "none", 0.0
        if on_arms and layer.assigned and not layer.lost:
            edge, width, most = "white", 0.8, ON_ARMS
        size = float(np.clip(part * np.sqrt(spread.prod() / max(number, 1)), least, most))
        zorder = (above + 0.5 * layer.lost if layer.assigned else below) - 0.001 * layer.place
        if layer.lost:
            size = diamond_size(size, np.count_nonzero(layer.rows) / number, LOST)
            edge, width = "black", min(0.3, 0.1 * size)
            size -= width  # the edge is outside
        style = {"s": size**2, "marker": layer.marker, "facecolor": layer.color}
        style |= {"edgecolor": edge, "linewidths": width, "alpha": 1.0 if layer.assigned else 0.75, "zorder": zorder}
        style |= {"label": layer.label or "_left", "rasterized": np.count_nonzero(layer.rows) > MANY}
        ax.scatter(*xy[layer.rows].T, **{**style, **kwargs})
        if layer.label:
            look = {"markerfacecolor": layer.color, "markersize": 5 if layer.assigned else 3.5}
            look |= {"markeredgecolor": edge if layer.lost else "none", "markeredgewidth": width}
            yield legend_line(layer.label, linestyle="none", marker=layer.marker, **look)
