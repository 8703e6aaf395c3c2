"""Make a tile with its summary, and provide the numbers and texts that reports and printed summaries show of it."""

import json
import sys
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import PackageNotFoundError, version

import numpy as np
from astropy.table import QTable

from rfpsurvey._common.descriptions import Fact, facts_of
from rfpsurvey._field.table import TableOfTile, TargetsOfField
from rfpsurvey._field.tile import Tile
from rfpsurvey._instruments.arms import Arms
from rfpsurvey._instruments.as_built import impossible_sentence
from rfpsurvey._instruments.collision_methods import Configuration, near_pairs
from rfpsurvey._instruments.instrument import Instrument
from rfpsurvey._sky.conditions import MODELS
from rfpsurvey.errors import listed, number_of

KINDS = {"science": "to science targets", "standard": "to standard stars", "sky": "to sky"}
MOST_ROWS = 8
"""Largest number of rows with the same constraint and verdict that are listed one by one."""
TOTAL, SUM = "any target", "subpriorities"
LEVELS = {
    "requirements": "fibers missing for requirements",
    "required targets": "required targets assigned",
    TOTAL: "targets of any kind",
    SUM: "sum of the subpriorities",
}


def _of_kinds(summary: dict) -> dict:
    """Return the number of fibers on each kind of target, if there are several kinds."""
    counts_of, kinds = {}, summary.get("kinds", {}) if summary.get("n_assigned") else {}
    for kind, counts in kinds.items() if len(kinds) > 1 else ():
        counts_of[KINDS[kind]] = counts["n_assigned"]
        if "n_also_science" in counts:  # these fibers cost no science target
            counts_of[f"  that are science targets ({kind})"] = counts["n_also_science"]
    return counts_of


def _moving(name: str):
    """Return a function that returns a number of the motion of the arms, if a constraint refers to the motion."""
    return lambda t: None if t.report.motion is None else t.report.motion.counts.get(name)


def _rate_of_assigned(summary: dict) -> float | str | None:
    rate = summary.get("collision_rate_assigned")
    return "undefined, because no arm is assigned" if rate is not None and np.isnan(rate) else rate


def _rate_of_all(summary: dict) -> float | None:
    """Return the collision rate of assigned and parked arms, unless it equals that of assigned arms."""
    rate = summary["collision_rate"]
    return None if np.isnan(rate) or rate == summary.get("collision_rate_assigned") else rate


def required_of(summary: dict) -> str | None:
    """Return the number of required targets that are observed; None if no targets are required."""
    n = summary.get("n_required")
    return f"{summary['n_required_observed']} of {n}" if n else None


def _checked(summary: dict) -> dict:
    """Return how many constraints that a score checked are not met, and the number of targets of each requirement."""
    if "n_constraints" not in summary:
        return {}
    facts = {"constraints not met": f"{summary['n_unmet']} of {summary['n_constraints']}"}
    for text, numbers in summary["requirements"].items():
        low, high = min(numbers), max(numbers)
        facts[f"  targets that {text} counts"] = low if low == high else f"{low} to {high}"
    if "n_also_science" in summary:
        facts["  that are also science targets"] = summary["n_also_science"]
    return facts


ALL, LOST, RATE = "n_positioners", "n_colliding", "collision_rate_assigned"
TILE_FACTS = (
    Fact("n_targets", "targets in the catalog"),
    Fact("n_dropped", "removed (coordinates not finite)", "n_targets"),
    Fact("n_in_field", "in the field", "n_targets"),
    Fact("n_set_aside", "sky, standards or 0 visits", "n_targets"),
    Fact("n_reachable", "in reach of a positioner", "n_targets"),
    Fact("n_rows_ignored", "table rows without an assignment"),
    Fact("n_skipped", "assigned rows without a position"),
    Fact("n_unusable", "rows not scored: disabled or stuck"),
    Fact("n_positioners", "positioners", value=lambda t: len(t.plane)),
    Fact("n_assigned", "assigned", ALL, lambda t: int(t.posed.assigned.sum())),
    Fact("kinds", of="n_assigned", shown=_of_kinds),
    Fact("n_lost_to_rules", "lost to rules on the distribution", ALL),
    Fact("n_out_of_reach", "with a target out of reach", ALL),
    Fact("n_within_margins", "with a target within the margins", ALL),
    Fact("n_wrong_fiber", "without the required fiber type", ALL),
    Fact("n_parked", "parked, as obstacles", ALL, lambda t: int((t.status == "parked").sum())),
    Fact("n_recorded", "at recorded poses, as obstacles", ALL),
    Fact("n_idle", "idle, not as obstacles", ALL, lambda t: int((t.status == "idle").sum())),
    Fact(LOST, "in collision", ALL, lambda t: int((t.report.in_collision & t.report.counted).sum()), zero=True),
    Fact("n_colliding_pairs", "colliding pairs", value=lambda t: len(t.report.pairs), zero=True),
    Fact("arm_model", "arm model", LOST, lambda t: t.plane.positioner.arm_model),
    Fact("margins", "margins", "n_within_margins", lambda t: str(t.plane.margins) if t.plane.margins else None),
    Fact("n_obstacle_collisions", "collisions with obstacles", value=lambda t: len(t.report.obstacle_pairs)),
    Fact("n_unfolding_pairs", "pairs that collide while unfolding", value=_moving("n_unfolding_pairs"), zero=True),
    Fact(
        "n_unfolding_obstacle_collisions",
        "with obstacles while unfolding",
        "n_unfolding_pairs",
        _moving("n_unfolding_obstacle_collisions"),
    ),
    Fact("n_needs_planner", "positioners to plan paths for", value=_moving("n_needs_planner"), zero=True),
    Fact("n_without_path", "positioners without a path", value=_moving("n_without_path"), zero=True),
    Fact("collision_rate", "of assigned and parked arms", RATE, lambda t: t.report.rate, _rate_of_all, zero=True),
    Fact(RATE, "collision rate of assigned arms", "", lambda t: t.report.rate_assigned, _rate_of_assigned, zero=True),
    Fact("n_required_observed", "required targets observed", shown=required_of),
    Fact("n_unmet", shown=_checked, zero=True),
)
"""The numbers of the summary of a tile that are shown; ``value`` is a function of a `TableOfTile`.

The functions `plan_tile` and `score_tile` add the numbers without such a function to the summary.
"""


TILE_RESULT = ("n_assigned", "kinds", "n_lost_to_rules", "n_out_of_reach", "n_wrong_fiber", LOST, "n_positioners")
TILE_RESULT += ("n_required_observed", "n_unmet", "n_reachable", "n_targets", "n_dropped", "n_skipped", "n_unusable")
"""The numbers of the shortest summary of a tile."""


def tile_facts(tile: Tile, *, is_short: bool = False) -> dict:
    """Return the labels and values of the numbers of a tile; most numbers that are 0 are omitted."""
    return facts_of(TILE_FACTS, tile.summary, TILE_RESULT if is_short else None)


def tile_problems(tile: Tile) -> list[str]:
    """Return texts on the targets out of reach and on the constraints that are not met, for the first lines."""
    unmet = tile.summary.get("unmet", [])
    n_out, n = tile.summary.get("n_out_of_reach", 0), len(unmet)
    texts = [f"{number_of(n_out, 'target')} out of reach"] if n_out else []
    return texts + ([f"{number_of(n, 'constraint')} not met: {listed(unmet, 2)}"] if n else [])


def rules_of_tile(rules: QTable) -> list[dict]:
    """Return the verdicts as dicts; one dict stands for many rows that differ in the number and the place."""
    groups: dict[tuple, list] = {}
    for row in rules:
        verdict = dict(zip(rules.colnames, row, strict=True))
        groups.setdefault(tuple(verdict[name] for name in ("rule", "limit", "verdict")), []).append(verdict)
    verdicts = []
    for rows in groups.values():
        verdicts += rows if len(rows) <= MOST_ROWS else [_merged(rows)]
    return verdicts


def _merged(rows: list[dict]) -> dict:
    """Return one verdict for many rows, with the largest and smallest number, and the first places."""
    low, high = min(row["number"] for row in rows), max(row["number"] for row in rows)
    notes = f"{len(rows)} times: {listed(filter(None, (row['note'] for row in rows)), 3)}"
    fibers = " ".join(filter(None, (row["fibers"] for row in rows)))
    return rows[0] | {"number": low, "note": notes if low == high else f"to {high:.6g}; {notes}", "fibers": fibers}


def tile_objectives(tile: Tile, most: int) -> list[tuple[str, float, str]]:
    """Return, for each class of targets, its name, its number of fibers, and text with a bound of this number.

    The text is empty if the number is known to be optimal, or if no bound is known. The list has at most ``most``
    items; if there are more classes, one item contains the sum of the remaining classes. The last items can be the
    number of targets of any kind and the sum of the subpriorities, which include all classes.
    """
    objectives = tile.summary.get("objectives", [])
    if len(objectives) < 2:
        return []
    shown, summed, totals = split_objectives(objectives, most)
    listed_objectives = [_objective(*objective) for objective in shown]
    if summed:
        # the last class in a summary can itself be the sum of many classes
        last, _, words = summed[-1][0].partition(" ")
        n_classes = len(summed) - 1 + (int(last) if words == "more classes" else 1)
        value = round(sum(abs(value) for _, value, _ in summed))
        listed_objectives.append((number_of(n_classes, "more class", "more classes"), value, ""))
    return listed_objectives + [_objective(*objective) for objective in totals]


def split_objectives(objectives: list, most: int) -> tuple[list, list, list]:
    """Return the objectives of classes that are listed, those whose sum is listed, and those of all targets.

    The list has at most ``most`` items. The number of targets of any kind and the sum of the subpriorities, which
    include all classes, are its last items.
    """
    totals = [objective for objective in objectives[-2:] if objective[0] in (TOTAL, SUM)]
    classes = objectives[: len(objectives) - len(totals)]
    n = len(classes) if len(objectives) <= most else most - 1 - len(totals)
    return classes[:n], classes[n:], totals


def _objective(name: str, value: float, bound: float | None) -> tuple[str, float, str]:
    """Return the label and the value of an objective, and text with its bound."""
    if name == SUM:
        return LEVELS[name], float(f"{value:.6g}"), "" if bound in (None, value) else f"at most {bound:.6g}"
    limit = "at least" if name == "requirements" else "at most"
    return LEVELS.get(name, name), round(abs(value)), "" if bound in (None, value) else f"{limit} {abs(bound):.0f}"


MODEL = "static geometry in the focal plane at one wavelength; no refraction, no dynamic collisions"
REFRACTED = "static geometry in the focal plane with atmospheric refraction; no dynamic collisions"

TYPES = {
    2: "only arms of adjacent positioners can touch (collision type 2)",
    3: "arms of positioners that are not adjacent can also touch (collision type 3)",
}
ARMS = {
    "elbow_to_tip": "segments from elbow to fiber",
    "capsule": "segments of a given length from the elbow (capsules)",
    "fiber_tip": "points at the fiber",
    "outline": "outlines (polygons, capsules and discs)",
}


def build_tile(
    table: TableOfTile,
    summary: dict,
    parameters: dict,
    catalog_meta: dict,
    targets: TargetsOfField | None = None,
    software: dict | None = None,
) -> Tile:
    """Return a tile; its table is made when the table is used for the first time.

    ``targets`` contains all targets of the field. ``software`` contains the versions of further packages, which the
    provenance of the tile lists.
    """
    instrument, plane, projection = table.instrument, table.plane, parameters.get("projection", "radial")
    made = {fact.name: fact.value(table) for fact in TILE_FACTS if fact.value}
    summary = summary | {name: value for name, value in made.items() if value is not None}
    summary["model"] = model_sentence(instrument, table.posed, projection)
    meta = {
        "summary": summary,
        "provenance": {
            "software": {**versions(), **(software or {})},
            "created": datetime.now(UTC).isoformat(timespec="seconds"),
            "model": MODEL if projection in ("tangent", "radial") else REFRACTED,
            "instrument": instrument.provenance,
            "catalog": dict(catalog_meta),
            "parameters": parameters,
            "outcomes": targets is not None,
        },
        "geometry": {
            "inner_radius_mm": _one_or_all(plane.arrays.inner_radius),
            "outer_radius_mm": _one_or_all(plane.arrays.outer_radius),
            "min_separation_mm": float(plane.arrays.separation),
            "arm_model": plane.positioner.arm_model,
            "obstacles_mm": plane.arrays.obstacles.tolist(),
            "obstacle_polygons_mm": [polygon.tolist() for polygon in plane.arrays.obstacle_polygons],
            **({} if plane.positioner.outline is None else {"outline_mm": plane.positioner.outline.to_dict()}),
        },
    }
    # the values are converted to types that all file formats support
    table.meta.update(json.loads(json.dumps(meta, default=str)))
    return Tile(table, targets)


def _one_or_all(values):
    """Return one number if all numbers are equal, otherwise the list of the numbers."""
    return float(values[0]) if (values == values[0]).all() else values.tolist()


@cache
def versions() -> dict:
    """Return the versions of Python and of the packages on which results depend."""
    found_versions = {"python": sys.version.split()[0]}
    for name in ("rfpsurvey", "astropy", "numpy", "numba", "scipy"):
        try:
            found_versions[name] = version(name)
        except PackageNotFoundError:
            found_versions[name] = "unknown"
    return found_versions


def model_sentence(instrument: Instrument, posed: Arms | None = None, projection: str = "radial") -> str:
    """Return a description of the model with which collisions and positions were computed.

    Parameters
    ----------
    instrument : Instrument
        The instrument.
    posed : Arms, optional
        The arms of the tile. If None, the text describes all tiles of a survey.
    projection : str, optional
        Model of the projection, or ``auto`` if tiles have different models.

    Returns
    -------
    str
        Sentences on collisions and on positions.
    """
    plane = instrument.focal_plane
    kind = plane.collision_type
    if kind == 1:
        collisions = "No two arms can touch (collision type 1), and no pair was tested"
    else:
        n_pairs, arms = len(plane.arrays.neighbors), f"exact for arms that are {ARMS[plane.positioner.arm_model]}"
        if posed is None:
            looked = (
                f"{n_pairs} pairs of arms can touch. In each tile, distances are computed only for pairs of arms that "
                "are close to each other; the distances are"
            )
        else:
            case = Configuration(plane, np.ascontiguousarray(posed.segments.T), 2, lambda: posed)
            n_near = len(near_pairs(case)[0])
            close = f"the arms of {n_near} of these pairs" if n_near else "the arms of none of these pairs"
            looked = f"{n_pairs} pairs of arms can touch. In this plan, {close} are close to each other; distances are"
        collisions = f"Collisions: {TYPES[kind]}. {looked} {arms}"
    if instrument.distortion is None or projection == "tangent":
        positions = "a tangent plane with one plate scale"
    else:
        each = ", one for each fiber type" if isinstance(instrument.distortion, dict) else ""
        positions = f"a tangent plane with the instrument's radial map{each}"
    several = "refraction by the fastest model that is accurate enough for each tile"
    model = several if projection == "auto" else MODELS[projection]
    refraction = "without refraction" if projection in ("tangent", "radial") else f"with {model}"
    margins = f" Margins: {plane.margins.description}." if plane.margins else ""
    return f"{collisions}. Positions: {positions}, {refraction}.{margins}{impossible_sentence(instrument)}"
