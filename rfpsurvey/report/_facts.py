"""Labels and values of results; a label that begins with two spaces gives a detail of the label above it."""

from typing import TYPE_CHECKING

import numpy as np

from rfpsurvey.errors import brief, listed, number_of

if TYPE_CHECKING:
    from astropy.table import QTable

    from rfpsurvey.probability import Estimate
    from rfpsurvey.selection import SelectionProbabilities
    from rfpsurvey.survey import Survey
    from rfpsurvey.tile import Tile
    from rfpsurvey.tiling import Tiling

TILE = {
    "n_targets": "targets in the catalog",
    "n_dropped": "  removed (coordinates not finite)",
    "n_in_field": "  in the field",
    "n_set_aside": "  sky, standards or 0 visits",
    "n_reachable": "  in reach of a positioner",
    "n_rows_ignored": "table rows without an assignment",
    "n_skipped": "assigned rows without a position",
    "n_positioners": "positioners",
    "n_assigned": "  assigned",
    "n_lost_to_rules": "  lost to rules on the distribution",
    "n_out_of_reach": "  with a target out of reach",
    "n_within_margins": "  with a target within the margins",
    "margins": "    margins",
    "n_wrong_fiber": "  without the required fiber type",
    "n_unusable": "rows not scored: disabled or stuck",
    "n_parked": "  parked, as obstacles",
    "n_recorded": "  at recorded poses, as obstacles",
    "n_idle": "  idle, not as obstacles",
    "n_colliding": "  in collision",
    "arm_model": "    arm model",
    "n_colliding_pairs": "colliding pairs",
    "n_obstacle_collisions": "collisions with obstacles",
    "n_unfolding_pairs": "pairs that collide while unfolding",
    "n_unfolding_obstacle_collisions": "  with obstacles while unfolding",
    "n_needs_planner": "positioners to plan paths for",
    "collision_rate_assigned": "collision rate of assigned arms",
    "collision_rate": "  of assigned and parked arms",
}
TILING = {
    "n_tiles": "tiles",
    "radius_deg": "radius of a field in degrees",
    "area_deg2": "area of the region in square degrees",
    "covering_fraction": "fraction of the region that fields cover",
    "fraction_in_reach": "  in reach of a positioner",
    "fraction_beyond_declination": "  outside the limits of declination",
    "mean_depth": "mean number of fields that cover a position",
    "n_samples": "positions at which the coverage is measured",
    "fibers": "fibers per tile",
    "n_targets": "targets with requested visits",
    "n_beyond_declination": "  outside the limits of declination",
    "n_on_tiles": "  on at least one tile",
    "n_requested": "visits requested",
    "n_observed": "  observed",
    "completeness": "completeness",
    "completeness_means": "definition of the completeness",
    "fiber_use": "fraction of the fibers used",
    "n_isolated": "targets with no other target too close",
    "completeness_isolated": "  completeness of these targets",
}
SELECTION = {
    "n_realizations": "realizations",
    "n_tiles": "tiles",
    "n_targets": "targets with requested visits",
    "n_unreachable": "targets in reach of no tile",
    "n_never_observed": "targets never observed",
    "n_sometimes_observed": "targets sometimes observed",
    "n_always_observed": "targets always observed",
    "mean_probability": "mean selection probability",
    "n_assigned": "assigned fibers, all realizations",
    "n_lost": "  lost to collisions",
    "n_observed": "visits observed, all realizations",
}
STATUS = {
    "n_targets": "targets with requested visits",
    "n_complete": "  complete",
    "n_requested": "visits requested",
    "n_observed": "  observed",
    "n_left": "  remaining",
    "n_planned": "    planned",
    "n_not_assigned": "    in reach, not assigned",
    "n_lost": "    lost to a collision",
    "n_impossible": "    out of reach or excluded",
    "n_failed": "failed visits",
}
STATES = {
    "observed": "  finished",
    "partly observed": "  partly observed",
    "bad": "  observed without success",
    "dropped": "  dropped",
    "planned": "  not yet observed",
}
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
MOTION = ("n_unfolding_pairs", "n_needs_planner")
"""Numbers that are shown, even if they are 0, if a constraint refers to the motion of the arms."""
ALWAYS = ("n_colliding", "n_colliding_pairs", "collision_rate_assigned")


ZERO_IS_LEFT_OUT = (
    "  collisions with obstacles",
    "  to standard stars",
    "  to sky",
    "unmet requirements, sum over tiles",
)


def tile_facts(tile: "Tile") -> dict:
    """Return the counts and rates of a tile; most counts that are 0 are omitted."""
    values = {key: tile.summary.get(key, 0) for key in TILE}
    always = (*ALWAYS, *(name for name in MOTION if name in tile.summary))
    facts = {TILE[key]: value for key, value in values.items() if value or key in always}
    if np.isnan(values["collision_rate_assigned"]):
        facts |= {TILE["collision_rate_assigned"]: "undefined, because no arm is assigned"}
    if np.isnan(values["collision_rate"]) or values["collision_rate"] == values["collision_rate_assigned"]:
        facts.pop(TILE["collision_rate"], None)
    facts |= _required(tile.summary) | _checked(tile.summary)
    kinds = tile.summary.get("kinds", {})
    if len(kinds) < 2:
        return facts
    found = {}
    for label, value in facts.items():
        found[label] = value
        if label == TILE["n_assigned"]:
            for kind, counts in kinds.items():
                found[f"    {KINDS[kind]}"] = counts["n_assigned"]
                if "n_also_science" in counts:  # these fibers cost no science target
                    found[f"      that are science targets ({kind})"] = counts["n_also_science"]
    return found


def tile_problems(tile: "Tile") -> list[str]:
    """Return texts on the targets out of reach and on the constraints that are not met, for the first lines."""
    unmet = tile.summary.get("unmet", [])
    n_out, n = tile.summary.get("n_out_of_reach", 0), len(unmet)
    texts = [f"{number_of(n_out, 'target')} out of reach"] if n_out else []
    return texts + ([f"{number_of(n, 'constraint')} not met: {listed(unmet, 2)}"] if n else [])


def rules_of_tile(rules: "QTable") -> list[dict]:
    """Return the verdicts as dicts; one dict stands for many rows that differ in the number and the place."""
    groups: dict[tuple, list] = {}
    for row in rules:
        one = dict(zip(rules.colnames, row, strict=True))
        groups.setdefault(tuple(one[name] for name in ("rule", "limit", "verdict")), []).append(one)
    found = []
    for rows in groups.values():
        found += rows if len(rows) <= MOST_ROWS else [_merged(rows)]
    return found


def _merged(rows: list[dict]) -> dict:
    """Return one verdict for many rows, with the largest and smallest number, and the first places."""
    low, high = min(one["number"] for one in rows), max(one["number"] for one in rows)
    notes = f"{len(rows)} times: {listed(filter(None, (one['note'] for one in rows)), 3)}"
    fibers = " ".join(filter(None, (one["fibers"] for one in rows)))
    return rows[0] | {"number": low, "note": notes if low == high else f"to {high:.6g}; {notes}", "fibers": fibers}


def _checked(summary: dict) -> dict:
    """Return how many constraints that a score checked are not met, and the number of targets of each requirement."""
    if "n_constraints" not in summary:
        return {}
    found = {"constraints not met": f"{summary['n_unmet']} of {summary['n_constraints']}"}
    for text, numbers in summary["requirements"].items():
        low, high = min(numbers), max(numbers)
        found[f"  targets that {text} counts"] = low if low == high else f"{low} to {high}"
    return found


def _required(summary: dict) -> dict:
    """Return the number of required targets that are observed; an empty dict if no targets are required."""
    n = summary.get("n_required", 0)
    return {"required targets observed": f"{summary['n_required_observed']} of {n}"} if n else {}


def tile_objectives(tile: "Tile", most: int) -> list[tuple[str, float, str]]:
    """Return, for each class of targets, its name, its number of fibers, and text with a bound of this number.

    The text is empty if the number is known to be optimal, or if no bound is known. The list has at most ``most``
    items; if there are more classes, one item contains the sum of the remaining classes. The last items can be the
    number of targets of any kind and the sum of the subpriorities, which include all classes.
    """
    objectives = tile.summary.get("objectives", [])
    if len(objectives) < 2:
        return []
    totals = [one for one in objectives[-2:] if one[0] in (TOTAL, SUM)]
    classes = objectives[: len(objectives) - len(totals)]
    shown = classes if len(objectives) <= most else classes[: most - 1 - len(totals)]
    rest, found = classes[len(shown) :], [_objective(*one) for one in shown]
    if rest:
        # the last class in a summary can itself be the sum of many classes
        last, _, words = rest[-1][0].partition(" ")
        n_classes = len(rest) - 1 + (int(last) if words == "more classes" else 1)
        value = round(sum(abs(value) for _, value, _ in rest))
        found.append((number_of(n_classes, "more class", "more classes"), value, ""))
    return found + [_objective(*one) for one in totals]


def _objective(name: str, value: float, bound: float | None) -> tuple[str, float, str]:
    """Return the label and the value of an objective, and text with its bound."""
    if name == SUM:
        return LEVELS[name], float(f"{value:.6g}"), "" if bound in (None, value) else f"at most {bound:.6g}"
    limit = "at least" if name == "requirements" else "at most"
    return LEVELS.get(name, name), round(abs(value)), "" if bound in (None, value) else f"{limit} {abs(bound):.0f}"


def survey_facts(survey: "Survey") -> dict:
    """Return the counts and rates of a survey, and the number of targets with each outcome."""
    s = survey.summary
    facts = {
        "tiles": s["n_tiles"],
        "  rounds of non-overlapping tiles": s["n_rounds"],
        **_strange_tiles(survey.tiles),
        "targets with requested visits": s["n_targets"],
        "visits requested": s["n_visits_requested"],
        "  observed": s["n_visits_observed"],
        "completeness": s["completeness"],
        "  fraction of completed targets": s["completeness_targets"],
        "fibers assigned": s["n_assigned"],
        "  to science targets": s["n_science"],
        "  to standard stars": s.get("n_standard", 0),
        "  to sky": s.get("n_sky", 0),
        "  fraction of usable positioners": s["fiber_use"],
        **_assigned_in_collision(s),
        "positioners in collision": s["n_colliding"],
        **({"  margins": s["margins"]} if "margins" in s else {}),
        "  arm model": s.get("arm_model", "unknown"),  # surveys of earlier versions have no arm model
        "  fraction of assigned and parked": s["collision_rate"],
        "  collisions with obstacles": s["n_obstacle_collisions"],
        **{TILE[name]: s[name] for name in MOTION if name in s},
        "unmet requirements, sum over tiles": s["n_unmet"],
    }
    facts = {label: n for label, n in facts.items() if n or label not in ZERO_IS_LEFT_OUT}
    return facts | _required(s) | {f"targets {outcome}": number for outcome, number in s["outcomes"].items()}


def _strange_tiles(tiles: "QTable") -> dict:
    """Return the tiles without targets in their fields, and those at right ascension and declination 0."""
    at_zero = (np.asarray(tiles["ra"]) == 0) & (np.asarray(tiles["dec"]) == 0)
    found = {"  without targets": np.isnan(tiles["completeness"]), "  at ra 0, dec 0": at_zero}
    names = {label: tuple(np.asarray(tiles["tile"])[mask].tolist()) for label, mask in found.items()}
    return {label: brief(tiles) for label, tiles in names.items() if tiles}


def _assigned_in_collision(summary: dict) -> dict:
    """Return the number and the fraction of assigned arms in collision, which surveys of earlier versions lack."""
    if "n_colliding_assigned" not in summary:
        return {}
    number, rate = summary["n_colliding_assigned"], summary["collision_rate_assigned"]
    return {"  in collision": number, "  collision rate of assigned arms": rate}


def selection_facts(found: "SelectionProbabilities") -> dict:
    """Return the counts of selection probabilities."""
    return {label: found.summary[key] for key, label in SELECTION.items()}


def tiling_facts(tiling: "Tiling") -> dict:
    """Return the values in the summary of a tiling; a value without a label is labeled by its key."""
    return {TILING.get(key, key.replace("_", " ")): value for key, value in tiling.summary.items() if value != ""}


def estimate_facts(estimate: "Estimate") -> dict:
    """Return the values of an estimate as text, with as many digits as its error allows."""
    formula, error = np.isnan(estimate.low), estimate.standard_error
    digits = 5 if formula or not 0 < error < 1e-5 else 1 - int(np.floor(np.log10(error)))
    digits = max(digits, 1 - int(np.floor(np.log10(estimate.value)))) if 0 < estimate.value < 1e-4 else digits
    unknown = f"none: {estimate.meta['no_interval']}" if "no_interval" in estimate.meta else "no error is known"
    interval = unknown if formula else f"{estimate.low:.{digits}f} to {estimate.high:.{digits}f}"
    lines = {
        "collision probability": f"{estimate.value:.{digits}f}",
        f"  {100 * estimate.meta['confidence']:g} % interval": interval,
        "  standard error": "" if formula else f"{estimate.standard_error:.2g}",
        "  of assigned positioners only": f"{estimate.value_assigned:.{digits}f}",
        "colliding pairs per positioner": "" if formula else f"{estimate.pairs_per_positioner:.5f}",
        "iterations": estimate.n or "",
        "effective number of trials": "" if formula else f"{estimate.n_effective:.0f}",
        "seconds": f"{estimate.seconds:.3f}",
    }
    return {label: value for label, value in lines.items() if value not in ("", "nan")}


def status_facts(status: "QTable") -> dict:
    """Return the labels and values of the status of a survey."""
    one, tiles = status[0], status.meta["tiles"]
    count = {label: sum(row[name] for row in tiles) for name, label in STATES.items()}
    values = {name: int(one[name]) for name in status.colnames if name.startswith("n_")}
    dates = [date for date in status.meta["progress"]["date"] if date]
    return {
        "tiles": sum(count.values()),
        **count,
        **({"first and last date": f"{dates[0]} {dates[-1]}"} if dates else {}),
        **{label: values[name] for name, label in STATUS.items()},
    }
