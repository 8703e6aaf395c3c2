"""The loop over the tiles of a survey."""

from collections.abc import Callable
from concurrent.futures import Executor
from contextlib import nullcontext
from functools import partial
from pathlib import Path

import numpy as np

from rfpsurvey._executors import is_local
from rfpsurvey._progress import Progress
from rfpsurvey._roles import has_role
from rfpsurvey.errors import warn
from rfpsurvey.pipeline import OUTCOMES
from rfpsurvey.survey._folder import JOINT, TABLES, Folder
from rfpsurvey.survey._history._events import TileState
from rfpsurvey.survey._joint._plan import plan_jointly
from rfpsurvey.survey._request import Request
from rfpsurvey.survey._result import completeness_table, outcome_table, tile_table
from rfpsurvey.survey._rounds import run_rounds
from rfpsurvey.survey._stored import done_of, read_finished, read_part
from rfpsurvey.survey._survey import Survey
from rfpsurvey.survey._unmet import counts_in
from rfpsurvey.survey._work import DONE, Done, Job, cards_of, early_sentences, flags_of, reach_of, work


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
            counts_of_event = counts_in(counts_of_tile, cards) | {"n_observed": counts_of_tile["n_good"]}
        else:
            job, (visits, cards_of_plan) = request.job(tile, np.ones_like(state.left)), history.events.visits(event)
            done = done_of(visits, cards_of_plan, job, is_kept=True)
            if request.builder.lasting is not None:  # standards that are also science targets may spend no visit
                rows_of_others = visits["target_row"][~has_role(visits["kind"], "science")]
                field = request.builder.in_other_roles(job.field, np.isin(job.field.row, rows_of_others))
                job = job._replace(field=field)
            slot = np.append(job.field.slot, -1)[done.target]
            open_ = (slot < 0) | (state.left[slot] > 0)
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
