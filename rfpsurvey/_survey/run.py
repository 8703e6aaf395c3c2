"""The loop over the tiles of a survey, and the tables of the result."""

from collections.abc import Callable
from concurrent.futures import Executor
from contextlib import nullcontext
from functools import partial
from pathlib import Path

import numpy as np
from astropy.table import QTable

from rfpsurvey._common.descriptions import describe
from rfpsurvey._common.executors import Progress, is_local
from rfpsurvey._field.facts import model_sentence
from rfpsurvey._field.verdicts import OUTCOMES
from rfpsurvey._sky.arrays import has_role
from rfpsurvey._survey import columns as _columns
from rfpsurvey._survey.bookkeeping import Bookkeeping, rows_by_class
from rfpsurvey._survey.folder import JOINT, TABLES, Folder
from rfpsurvey._survey.history.events import TileState
from rfpsurvey._survey.joint.plan import plan_jointly
from rfpsurvey._survey.request import Request
from rfpsurvey._survey.stored import done_of, read_finished, read_part
from rfpsurvey._survey.survey import Survey
from rfpsurvey._survey.tiling.columns import when_of
from rfpsurvey._survey.work import DONE, Done, Job, cards_of, early_sentences, flags_of, reach_of, run_rounds, work
from rfpsurvey.errors import brief, warn


def tile_table(request, state: Bookkeeping, counts: dict, outcomes: QTable) -> QTable:
    """Return a table with a row for each tile, and with the summary and the provenance of the survey in its meta."""
    names = ["tile", "ra", "dec", "position_angle", "pass"]
    when = None if request.conditions is None else when_of(request.tiling.table)
    table = QTable(request.tiling.table[names if when is None else [*names, when]])
    if request.uses_dates:
        table["time"] = request.times
    if request.projection == "auto":
        table["projection"] = request.projections
    sizes = [len(tiles) for tiles in request.rounds]
    # the argsort of a permutation is its inverse, here from rows to places in the order of planning
    table["round"] = np.repeat(np.arange(len(sizes)), sizes)[np.argsort(np.concatenate(request.rounds))]
    lacking = {name: values for name, values in counts.items() if isinstance(name, _columns.CountOfRule)}
    counts = {name: values for name, values in counts.items() if name not in lacking}
    if request.joint is not None:
        counts.pop(_columns.LOST, None)  # a joint plan does not determine this number
    if not np.any(counts.get(_columns.ALSO_SCIENCE.name, 0)):
        counts.pop(_columns.ALSO_SCIENCE.name, None)
    of_state = _state_columns(request)
    for name, values in (of_state | counts).items():
        table[name] = values
    if lacking:
        table["unmet"] = _columns.texts_of(lacking)
    if any(map(_columns.is_unknown, lacking)):
        table["not_checkable"] = _columns.texts_of(lacking, unknown=True)
    table["collision_rate"] = counts["n_colliding"] / np.maximum(counts["n_counted"], 1)
    table["fiber_use"] = counts["n_assigned"] / np.maximum(request.n_usable, 1)
    centers, near = request.tiling.vectors, request.source.sum_near
    wanted, done = (near(centers, request.radius_rad, visits) for visits in (state.wanted, state.counted()))
    table["completeness"] = done / np.where(wanted > 0, wanted, np.nan)
    outcome_counts = np.bincount(outcomes["outcome"], minlength=len(OUTCOMES))
    summary = _summary(request, state, counts, outcome_counts, lacking, of_state)
    table.meta = {"summary": summary, "provenance": request.provenance}
    return describe(table, _columns.TILES)


def _state_columns(request) -> dict[str, np.ndarray]:
    """Return the columns of the table of tiles that state what was observed; an empty dict without events."""
    state, n = request.state, len(request.tiling)
    if state is None:
        return {}
    names, dates, failed = np.full(n, "planned", dtype="U8"), np.full(n, "", dtype="U10"), np.zeros(n, dtype=np.int64)
    names[request.dropped] = "dropped"
    names[state.past] = _columns.PAST  # of the dropped rows, those that were not dropped
    for row, event in state.kept.items():
        names[row], dates[row] = event.state, event.date
        failed[row] = state.replayed.counts.get(row, {"n_failed": 0})["n_failed"]
    return {"state": names, "date": dates, "n_failed": failed}


def _summary(request, state, counts, outcome_counts, lacking, of_state) -> dict:
    tally = state.tallies["priority"]
    wanted, observed = int(tally.n_requested.sum()), int(tally.n_observed.sum())
    is_required, plane = request.builder.is_required, request.instrument.focal_plane
    tiles = np.asarray(request.tiling.table["tile"])
    required = np.flatnonzero([] if is_required is None else is_required)
    missed, why = state.never_observed(required)
    targets, complete = int(tally.n_targets.sum()), int(tally.n_complete.sum())
    total = {name: int(values.sum()) for name, values in counts.items()}
    kept = ~np.isin(of_state["state"], _columns.NOT_PLANNED) if of_state else slice(None)
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
        "n_fibers": int(request.n_usable.sum()),
        **{name: total[name] for name in ("n_assigned", "n_science", "n_standard", "n_sky")},
        "fiber_use": total["n_assigned"] / max(int(request.n_usable.sum()), 1),
        **{name: total[name] for name in ("n_colliding", "n_colliding_assigned", "n_colliding_pairs")},
        "arm_model": plane.positioner.arm_model,
        **({"margins": str(plane.margins)} if plane.margins else {}),
        "n_obstacle_collisions": total["n_obstacle_collisions"],
        **{count.name: total[count.name] for count in _columns.MOTION if count.name in total},
        **{name: total[name] for name in (_columns.LOST, _columns.ALSO_SCIENCE.name) if total.get(name)},
        "collision_rate": total["n_colliding"] / max(total["n_counted"], 1),
        "collision_rate_assigned": total["n_colliding_assigned"] / max(total["n_assigned"], 1),
        "n_unmet": total["n_unmet"],
        "n_required": len(required),
        "n_required_observed": len(required) - len(missed),
        "unmet": _columns.sentences_of(lacking, tiles) + _never_observed(request.source, missed, why),
        **({"rules": _columns.rule_records(lacking, tiles, kept)} if lacking else {}),
        **({} if state.windows is None else {"n_released": int(state.windows.released.sum())}),
        **({} if request.moved is None else {"epoch": request.moved}),
        **({} if request.state is None else request.state.summary),
        "model": model_sentence(request.instrument, projection=request.projection),
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
    return describe(table, _columns.OUTCOME)


def run(
    request: Request, path, executor: Executor | None, progress, *, resume: bool, record: Callable[[Path, Path], None]
) -> Survey:
    """Plan the tiles of a survey, and write them to the folder ``path`` unless ``path`` is None.

    The function ``record`` writes the plan file for the folder of the survey, which is locked, to a second folder.
    """
    joint, where = None, nullcontext()
    if path is not None:
        request.check_text()
        where = Folder(path, request, resume=resume)
    with where as folder:
        if folder is not None:
            record(folder.home, folder.path)
        n = len(request.tiling)
        finished_survey = None if folder is None or folder.is_beside else read_finished(folder.path, request)
        if finished_survey is not None:
            with Progress(progress, n, "tiles") as tell:
                tell(n, new=False)
            return finished_survey
        for text in early_sentences(request):
            warn(text)
        state = request.open_state()
        counts = {name: np.zeros(n, dtype=np.int64) for name, _ in cards_of(request.options).values()}
        counts["n_observed"], parts = state.n_observed, [None] * n
        known = _enter_observed(request, folder, state, counts, parts)
        if request.joint is not None:
            request, joint, progress = plan_jointly(request, folder, executor, progress)
        with Progress(progress, n, "tiles") as tell:
            tell(len(known), new=False)
            open_job, argument = partial(state.open_job, request), partial(_argument, folder, is_local(executor))
            given = {"argument": argument, "known": known}
            results = run_rounds(request.rounds, executor, work, open_job, state.enter, **given)
            for finished, (tile, _, done, is_new) in enumerate(results, len(known) + 1):
                if is_new and folder is not None:
                    folder.put_part(tile, done.part)
                parts[tile] = done.visits
                for name, value in done.counts.items():
                    counts[name][tile] = value
                tell(finished, new=is_new)
        if state.windows is not None:
            state.windows.close()
        outcomes = outcome_table(request, state)
        tables = tile_table(request, state, counts, outcomes), completeness_table(request, state), outcomes
        if joint is not None:
            tables[0].meta["summary"]["joint"] = joint.meta["summary"]
        if folder is None:
            return Survey(*tables, parts=tuple(parts), joint=joint)
        codes = {f"OUTCOME{k}": (name, f"outcome {k}") for k, name in enumerate(OUTCOMES)}
        for name, table in zip(TABLES, tables, strict=True):
            title, cards = name.split(".")[0].upper(), codes if name == "outcomes.fits" else None
            folder.put_table(name, table, cards, title)
        if joint is not None:
            stored = joint.copy()
            del stored["seconds"]  # the files of equal surveys are equal
            folder.put_table(JOINT, stored, None, "JOINT")
        folder.finish()
    return Survey(*tables, folder.path, joint=joint)


def _enter_observed(request, folder, state, counts, parts) -> list[int]:
    """Record the tiles that are not planned, because they were observed, begun or dropped, and return their rows."""
    if request.state is None:
        return []
    history = request.state
    _mark_reached(request, state)
    is_same = folder is not None and folder.home.resolve() == history.folder.resolve()
    if is_same and history.until is None and history.events.files:
        history.replayed.write(folder.home)
    cards = cards_of(request.options)
    for tile, event in history.kept.items():
        if folder is None:
            parts[tile] = history.events.visits(event)[0]
        elif not folder.has_part(tile, event.plan):
            folder.put_part(tile, history.events.plan(tile, event.plan))
        if tile in history.closed:
            counts_of_tile = history.replayed.counts[tile]
            counts_of_event = _columns.counts_in(counts_of_tile, cards) | {"n_observed": counts_of_tile["n_good"]}
        else:
            job, (visits, cards_of_plan) = request.job(tile, np.ones_like(state.left)), history.events.visits(event)
            done = done_of(visits, cards_of_plan, job, is_kept=True)
            if request.builder.lasting is not None:  # standards that are also science targets may spend no visit
                rows_of_others = visits["target_row"][~has_role(visits["kind"], "science")]
                field = request.builder.in_other_roles(job.field, np.isin(job.field.row, rows_of_others))
                job = job._replace(field=field)
            slot = np.append(job.field.slot, -1)[done.target]
            open_ = (slot < 0) | state.allows(slot, tile)
            counts_of_event = done.counts
            state.enter(tile, job, done._replace(observed=done.observed & open_))
        for name, value in counts_of_event.items():
            counts.setdefault(name, np.zeros(len(request.tiling), dtype=np.int64))[tile] = value
    return [*history.closed, *history.begun]


def _mark_reached(request, state) -> None:
    """Mark the targets in the fields and in reach of the observed tiles.

    The marks of a tile are stored with the state of the survey, so that they are computed only once. Targets with
    successful visits are omitted, because their outcome does not depend on the marks.
    """
    past, to_slots = request.state.replayed, request.source.to_slots
    past.mark_for([request.instrument.provenance["digest"], request.parameters])
    unseen = (past.made == 0).astype(np.uint8)
    added = unseen.copy()
    added[: past.n_searched] = 0
    for attempts, searched in ((past.attempts[: past.n_flagged], added), (past.attempts[past.n_flagged :], unseen)):
        left = to_slots(searched)
        for event in attempts if searched.any() else ():
            if event.state == TileState.DONE:
                job = request.job(event.row, left)
                reach = reach_of(job)
                past.flags[job.field.row] |= flags_of(reach.pairs.covered, reach.applied.excluded)
    past.n_flagged, past.n_searched = len(past.attempts), len(unseen)
    state.flags |= to_slots(past.flags)
    state.flags[to_slots(past.made) > 0] |= DONE


def _argument(folder, writes: bool, tile: int, job: Job) -> tuple[Job, Done | None]:
    """Return the job that a worker receives, and the stored result of the tile, if any.

    If ``writes`` is true, workers write the file of the tile, unless they would replace another file.
    """
    if folder is None:
        return job.bare(), None
    known = read_part(folder, tile, job)
    path, plans = folder.new_path(tile) if writes else None, (folder.generation, folder.former(tile))
    return job._replace(as_file=True, path=path, generations=plans).bare(), known
