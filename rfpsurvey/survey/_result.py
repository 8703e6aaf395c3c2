"""Tables of a survey: tiles, completeness, and the outcome of each target."""

import numpy as np
from astropy.table import QTable

from rfpsurvey.errors import brief
from rfpsurvey.pipeline import OUTCOMES
from rfpsurvey.survey._bookkeeping import Bookkeeping
from rfpsurvey.survey._history import state_columns
from rfpsurvey.survey._unmet import UNKNOWN, rule_records, sentences_of, texts_of, without_shortfalls
from rfpsurvey.survey._work import LOST, MOTION
from rfpsurvey.tile import describe, model_sentence
from rfpsurvey.tiling import when_of

TILES = {
    "tile": "identifier of the tile",
    "ra": "right ascension of the field center (ICRS)",
    "dec": "declination of the field center (ICRS)",
    "position_angle": "position angle of the +y axis, from north toward east",
    "hour_angle": "hour angle of the field center at the midpoint of the exposure",
    "time": "midpoint of the exposure (UTC)",
    "round": "round in which the tile is planned; tiles of one round do not share targets",
    "state": "planned, done (observed), partly (partly observed) or dropped",
    "date": "date of the last observation",
    "n_failed": "number of failed visits to science targets of an observed tile",
    "n_in_field": "number of targets in the field that still require a visit",
    "n_reachable": "number of targets that still require a visit and are in reach of a positioner",
    "n_assigned": "number of usable positioners with a target",
    "n_science": "number of positioners with a science target",
    "n_standard": "number of positioners with a standard star",
    "n_sky": "number of positioners with a sky position",
    "n_colliding": "number of positioners in collision",
    "n_colliding_assigned": "number of usable positioners in collision that have a target",
    "n_counted": "number of positioners that have a target or are parked",
    "n_colliding_pairs": "number of pairs of arms in collision",
    "n_obstacle_collisions": "number of collisions with obstacles",
    "n_unfolding_pairs": "number of pairs of arms that collide while they unfold",
    "n_unfolding_obstacle_collisions": "number of collisions of unfolding arms with obstacles",
    "n_needs_planner": "number of positioners that need a path planner",
    "n_lost_to_rules": "number of science targets that the rules on the distribution of fibers cost",
    "n_unmet": "number of requirements that are not met",
    "unmet": "requirements that are not met, with the numbers of missing targets",
    "not_checkable": "constraints that are not checkable, because the plan lacks their data",
    "n_observed": "number of successful visits to science targets",
    "collision_rate": "n_colliding divided by n_counted",
    "fiber_use": "n_assigned divided by the number of usable positioners",
    "completeness": "successful visits divided by requested visits, for the targets in the field",
}
OUTCOME = {
    "target_id": "identifier of the target",
    "requested": "number of requested visits",
    "observed": "number of successful visits",
    "outcome": f"code of the outcome: {', '.join(f'{k} {name}' for k, name in enumerate(OUTCOMES))}",
    "n_epochs": "number of completed epochs of the cadence",
    "released": "whether the window of the next epoch has closed, so that the cadence cannot be completed",
}


def tile_table(request, state: Bookkeeping, round_of: np.ndarray, counts: dict, outcomes: QTable) -> QTable:
    """Return a table with a row for each tile, and with the summary and the provenance of the survey in its meta."""
    names = ["tile", "ra", "dec", "position_angle", "pass"]
    when = None if request.conditions is None else when_of(request.tiling.table)
    table = QTable(request.tiling.table[names if when is None else [*names, when]])
    table["round"] = round_of
    counts, lacking = without_shortfalls(counts)
    if request.joint is not None:
        counts.pop(LOST, None)  # a joint plan does not determine this number
    for name, values in {**({} if request.state is None else state_columns(request)), **counts}.items():
        table[name] = values
    n_usable = int(request.instrument.focal_plane.arrays.usable.sum())
    if lacking:
        table["unmet"] = texts_of(lacking)
    if any(name.startswith(UNKNOWN) for name in lacking):
        table["not_checkable"] = texts_of(lacking, unknown=True)
    table["collision_rate"] = counts["n_colliding"] / np.maximum(counts["n_counted"], 1)
    table["fiber_use"] = counts["n_assigned"] / max(n_usable, 1)
    centers, near = request.tiling.vectors, request.source.sum_near
    wanted, done = (near(centers, request.radius_rad, visits) for visits in (state.wanted, state.counted()))
    table["completeness"] = done / np.where(wanted > 0, wanted, np.nan)
    outcome_counts = np.bincount(outcomes["outcome"], minlength=len(OUTCOMES))
    table.meta = {
        "summary": _summary(request, state, counts, outcome_counts, n_usable, lacking),
        "provenance": request.provenance,
    }
    return describe(table, TILES)


def _summary(request, state, counts, outcome_counts, n_usable, lacking) -> dict:
    tally = state.tallies["priority"]
    wanted, observed = int(tally.n_requested.sum()), int(tally.n_observed.sum())
    is_required = request.builder.is_required
    required = np.flatnonzero([] if is_required is None else is_required)
    missed, why = state.never_observed(required)
    targets, complete = int(tally.n_targets.sum()), int(tally.n_complete.sum())
    total = {name: int(values.sum()) for name, values in counts.items()}
    kept = slice(None) if request.state is None else state_columns(request)["state"] != "dropped"
    return {
        "n_tiles": len(request.tiling),
        "n_rounds": len(request.rounds),
        "n_targets": targets,
        "n_complete": complete,
        "n_visits_requested": wanted,
        "n_visits_observed": observed,
        "completeness": observed / max(wanted, 1),
        "completeness_targets": complete / max(targets, 1),
        "outcomes": {name: int(n) for name, n in zip(OUTCOMES, outcome_counts, strict=True) if n},
        "n_fibers": n_usable * len(request.tiling),
        "n_assigned": total["n_assigned"],
        **{name: total[name] for name in ("n_science", "n_standard", "n_sky")},
        "fiber_use": total["n_assigned"] / max(n_usable * len(request.tiling), 1),
        "n_colliding": total["n_colliding"],
        "n_colliding_assigned": total["n_colliding_assigned"],
        "n_colliding_pairs": total["n_colliding_pairs"],
        "arm_model": request.instrument.focal_plane.positioner.arm_model,
        **({"margins": str(margins)} if (margins := request.instrument.focal_plane.margins) else {}),
        "n_obstacle_collisions": total["n_obstacle_collisions"],
        **{name: total[name] for name, _ in MOTION.values() if name in total},
        **({LOST: total[LOST]} if total.get(LOST) else {}),
        "collision_rate": total["n_colliding"] / max(total["n_counted"], 1),
        "collision_rate_assigned": total["n_colliding_assigned"] / max(total["n_assigned"], 1),
        "n_unmet": total["n_unmet"],
        "n_required": len(required),
        "n_required_observed": len(required) - len(missed),
        "unmet": [
            *sentences_of(lacking, np.asarray(request.tiling.table["tile"])),
            *_never_observed(request.source, missed, why),
        ],
        **({"rules": rule_records(lacking, np.asarray(request.tiling.table["tile"]), kept)} if lacking else {}),
        **({} if state.windows is None else {"n_released": int(state.windows.released.sum())}),
        **({} if request.moved is None else {"epoch": request.moved}),
        **({} if request.state is None else request.state.summary),
        "model": model_sentence(request.instrument, projection="radial" if request.conditions is None else "full"),
    }


def _never_observed(source, missed: np.ndarray, why: np.ndarray) -> list[str]:
    """Return sentences that name the required targets that were never observed, one sentence for each outcome."""
    if len(missed) == 0:
        return []
    code = np.full(len(source), len(OUTCOMES), dtype=np.uint8)
    code[missed] = why
    code = source.by_row(code)
    rows = np.flatnonzero(code < len(OUTCOMES))
    ids, code = source.ids()[rows], code[rows]
    return [
        f"required targets never observed, {OUTCOMES[k]}: {brief(tuple(ids[code == k].tolist()))}"
        for k in np.unique(code).tolist()
    ]


def completeness_table(request, state: Bookkeeping) -> QTable:
    """Return a table of the completeness after each pass.

    Each pass has one row for all targets and, if there are several priorities or categories, one row for each of them.
    """
    n_tiles = np.cumsum(np.bincount(request.number, minlength=len(request.passes)))
    columns = ("priority", "category") if "category" in state.tallies else ("priority",)
    names = ("n_targets", "n_requested", "n_observed", "n_complete")
    rows = []
    for k, number in enumerate(request.passes):
        for column, tally in state.tallies.items():
            observed, complete = tally.n_observed[: k + 1].sum(axis=0), tally.n_complete[: k + 1].sum(axis=0)
            counts = np.column_stack([tally.n_targets, tally.n_requested, observed, complete])
            classes = list(zip(tally.names, counts.tolist(), strict=True)) if len(tally.names) > 1 else []
            if column == "priority":
                classes.insert(0, ("all", counts.sum(axis=0).tolist()))
            for name, values in classes:
                labels = [name if column == other else "all" for other in columns]
                rows.append((number, n_tiles[k], *labels, *values, values[2] / max(values[1], 1)))
    return QTable(rows=rows, names=("pass", "n_tiles", *columns, *names, "completeness"))


def outcome_table(request, state: Bookkeeping) -> QTable:
    """Return a table with a row for each target, in the order of the catalog."""
    source = request.source
    table = QTable({"target_id": source.ids()}, copy=False)
    table["requested"], table["observed"] = source.by_row(state.wanted), source.by_row(state.done())
    table["outcome"] = source.by_row(state.outcomes())
    if state.windows is not None:
        table["n_epochs"] = source.by_row(state.windows.n_epochs).astype(np.int16)
        table["released"] = source.by_row(state.windows.released)
    table.meta = {"outcome": {str(k): name for k, name in enumerate(OUTCOMES)}}
    return describe(table, OUTCOME)
