"""Tables of a survey: tiles, completeness, and the outcome of each target."""

import numpy as np
from astropy.table import QTable

from rfpsurvey._descriptions import describe
from rfpsurvey.errors import brief
from rfpsurvey.pipeline import OUTCOMES
from rfpsurvey.survey._bookkeeping import Bookkeeping, rows_by_class
from rfpsurvey.survey._columns import ALSO_SCIENCE, LOST, MOTION, OUTCOME, TILES
from rfpsurvey.survey._unmet import CountOfRule, is_unknown, rule_records, sentences_of, texts_of
from rfpsurvey.tile import model_sentence
from rfpsurvey.tiling import when_of


def tile_table(request, state: Bookkeeping, counts: dict, outcomes: QTable) -> QTable:
    """Return a table with a row for each tile, and with the summary and the provenance of the survey in its meta."""
    names = ["tile", "ra", "dec", "position_angle", "pass"]
    when = None if request.conditions is None else when_of(request.tiling.table)
    table = QTable(request.tiling.table[names if when is None else [*names, when]])
    sizes = [len(tiles) for tiles in request.rounds]
    # the argsort of a permutation is its inverse, here from rows to places in the order of planning
    table["round"] = np.repeat(np.arange(len(sizes)), sizes)[np.argsort(np.concatenate(request.rounds))]
    lacking = {name: values for name, values in counts.items() if isinstance(name, CountOfRule)}
    counts = {name: values for name, values in counts.items() if name not in lacking}
    if request.joint is not None:
        counts.pop(LOST, None)  # a joint plan does not determine this number
    if not np.any(counts.get(ALSO_SCIENCE.name, 0)):
        counts.pop(ALSO_SCIENCE.name, None)
    of_state = _state_columns(request)
    for name, values in (of_state | counts).items():
        table[name] = values
    n_usable = int(request.instrument.focal_plane.arrays.usable.sum())
    if lacking:
        table["unmet"] = texts_of(lacking)
    if any(map(is_unknown, lacking)):
        table["not_checkable"] = texts_of(lacking, unknown=True)
    table["collision_rate"] = counts["n_colliding"] / np.maximum(counts["n_counted"], 1)
    table["fiber_use"] = counts["n_assigned"] / max(n_usable, 1)
    centers, near = request.tiling.vectors, request.source.sum_near
    wanted, done = (near(centers, request.radius_rad, visits) for visits in (state.wanted, state.counted()))
    table["completeness"] = done / np.where(wanted > 0, wanted, np.nan)
    outcome_counts = np.bincount(outcomes["outcome"], minlength=len(OUTCOMES))
    summary = _summary(request, state, counts, outcome_counts, n_usable, lacking, of_state)
    table.meta = {"summary": summary, "provenance": request.provenance}
    return describe(table, TILES)


def _state_columns(request) -> dict[str, np.ndarray]:
    """Return the columns of the table of tiles that state what was observed; an empty dict without events."""
    state, n = request.state, len(request.tiling)
    if state is None:
        return {}
    names, dates, failed = np.full(n, "planned", dtype="U8"), np.full(n, "", dtype="U10"), np.zeros(n, dtype=np.int64)
    names[request.dropped] = "dropped"
    for row, event in state.kept.items():
        names[row], dates[row] = event.state, event.date
        failed[row] = state.replayed.counts.get(row, {"n_failed": 0})["n_failed"]
    return {"state": names, "date": dates, "n_failed": failed}


def _summary(request, state, counts, outcome_counts, n_usable, lacking, of_state) -> dict:
    tally = state.tallies["priority"]
    wanted, observed = int(tally.n_requested.sum()), int(tally.n_observed.sum())
    is_required, plane = request.builder.is_required, request.instrument.focal_plane
    tiles = np.asarray(request.tiling.table["tile"])
    required = np.flatnonzero([] if is_required is None else is_required)
    missed, why = state.never_observed(required)
    targets, complete = int(tally.n_targets.sum()), int(tally.n_complete.sum())
    total = {name: int(values.sum()) for name, values in counts.items()}
    kept = of_state["state"] != "dropped" if of_state else slice(None)
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
        **{name: total[name] for name in ("n_assigned", "n_science", "n_standard", "n_sky")},
        "fiber_use": total["n_assigned"] / max(n_usable * len(request.tiling), 1),
        **{name: total[name] for name in ("n_colliding", "n_colliding_assigned", "n_colliding_pairs")},
        "arm_model": plane.positioner.arm_model,
        **({"margins": str(plane.margins)} if plane.margins else {}),
        "n_obstacle_collisions": total["n_obstacle_collisions"],
        **{count.name: total[count.name] for count in MOTION if count.name in total},
        **{name: total[name] for name in (LOST, ALSO_SCIENCE.name) if total.get(name)},
        "collision_rate": total["n_colliding"] / max(total["n_counted"], 1),
        "collision_rate_assigned": total["n_colliding_assigned"] / max(total["n_assigned"], 1),
        "n_unmet": total["n_unmet"],
        "n_required": len(required),
        "n_required_observed": len(required) - len(missed),
        "unmet": sentences_of(lacking, tiles) + _never_observed(request.source, missed, why),
        **({"rules": rule_records(lacking, tiles, kept)} if lacking else {}),
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
    names, rows = ("n_targets", "n_requested", "n_observed", "n_complete"), []
    for k, number in enumerate(request.passes):
        for row in rows_by_class({column: tally.until(k) for column, tally in state.tallies.items()}):
            rows.append((number, n_tiles[k], *row, row[-2] / max(row[-3], 1)))
    return QTable(rows=rows, names=("pass", "n_tiles", *state.tallies, *names, "completeness"))


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
