"""The loop over the tiles of a survey."""

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import BrokenExecutor, Executor
from contextlib import contextmanager, nullcontext
from itertools import islice

import numpy as np

from rfpsurvey._executors import is_local, submit
from rfpsurvey._progress import Progress
from rfpsurvey._roles import has_role
from rfpsurvey.errors import warn
from rfpsurvey.pipeline import OUTCOMES
from rfpsurvey.survey._folder import JOINT, TABLES, Folder
from rfpsurvey.survey._history._events import TileState
from rfpsurvey.survey._joint._plan import plan_together
from rfpsurvey.survey._request import Request
from rfpsurvey.survey._result import completeness_table, outcome_table, tile_table
from rfpsurvey.survey._stored import done_of, read_finished, read_part
from rfpsurvey.survey._survey import Survey
from rfpsurvey.survey._unmet import counts_in
from rfpsurvey.survey._work import DONE, cards_of, early_sentences, flags_of, reach_of, work

# Largest number of tiles that are submitted to an executor before the result of the first of these tiles is awaited.
IN_FLIGHT = 256
# A task of an executor plans up to 8 tiles of a large round, because starting a task takes as long as planning a tile
# by a simple rule. In rounds with fewer than 16 times as many tiles, tasks are smaller, so that all workers have tasks.
TOGETHER, SHARE = 8, 16


def run(request: Request, path, executor: Executor | None, progress, *, resume: bool) -> Survey:
    """Plan the tiles of a survey, and write them to the folder ``path`` unless ``path`` is None."""
    joint = None
    where = nullcontext()
    if path is not None:
        request.check_text()
        where = Folder(path, request, resume=resume)
    with where as folder:
        n = len(request.tiling)
        found = None if folder is None else read_finished(folder.path, request)
        if found is not None:
            with Progress(progress, n, "tiles") as tell:
                tell(n, new=False)
            return found
        for text in early_sentences(request):
            warn(text)
        state = request.open_state()
        round_of, parts = np.empty(n, dtype=np.int64), [None] * n
        names = [name for name, _ in cards_of(request.options).values()]
        counts = {name: np.zeros(n, dtype=np.int64) for name in (*names, "n_observed")}
        known = _enter_observed(request, folder, state, counts, parts)
        if request.joint is not None:
            request, joint, progress = plan_together(request, folder, executor, progress)
        finished = len(known)
        with Progress(progress, n, "tiles") as tell:
            tell(finished, new=False)
            for k, tiles in enumerate(request.rounds):
                round_of[tiles] = k
                tiles = tiles[~np.isin(tiles, known)]
                together = int(np.clip(len(tiles) // SHARE, 1, TOGETHER))
                results = in_order(executor, work, _jobs_of(request, tiles, state, folder, executor), together=together)
                for tile, (job, done, is_new) in zip(tiles.tolist(), results, strict=True):
                    kept = state.enter(tile, job.field, done.flags, done.target, done.observed)
                    if is_new and folder is not None:
                        folder.put_part(tile, done.part)
                    parts[tile] = done.visits
                    for name, value in {**done.counts, "n_observed": kept}.items():
                        counts[name][tile] = value
                    finished += 1
                    tell(finished, new=is_new)
        if state.windows is not None:
            state.windows.close()
        outcomes = outcome_table(request, state)
        tables = tile_table(request, state, round_of, counts, outcomes), completeness_table(request, state), outcomes
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
    is_same = folder is not None and folder.path.resolve() == history.folder.resolve()
    if is_same and history.until is None and history.events.files:
        history.replayed.write(folder.path)
    cards = cards_of(request.options)
    for tile, event in history.kept.items():
        if folder is None:
            parts[tile] = history.events.visits(event)[0]
        elif not folder.has_part(tile, event.plan):
            folder.put_part(tile, history.events.plan(tile, event.plan))
        if tile in history.closed:
            own = history.replayed.counts[tile]
            found = counts_in(own, cards) | {"n_observed": own["n_good"]}
        else:
            job, (visits, cards_of_plan) = request.job(tile, np.ones_like(state.left)), history.events.visits(event)
            done = done_of(visits, cards_of_plan, job, is_kept=True)
            if request.builder.lasting is not None:  # standards that are also science targets may spend no visit
                others = visits["target_row"][~has_role(visits["kind"], "science")]
                field = request.builder.in_other_roles(job.field, np.isin(job.field.row, others))
                job = job._replace(field=field)
            slot = np.append(job.field.slot, -1)[done.target]
            open_ = (slot < 0) | (state.left[slot] > 0)
            found = done.counts
            found["n_observed"] = state.enter(tile, job.field, done.flags, done.target, done.observed & open_)
        for name, value in found.items():
            counts.setdefault(name, np.zeros(len(request.tiling), dtype=np.int64))[tile] = value
    return [*history.closed, *history.begun]


def _mark_reached(request, state) -> None:
    """Mark the targets in the fields and in reach of the observed tiles.

    The marks of a tile are stored with the state of the survey, so that they are computed only once. Targets with
    successful visits are omitted, because their outcome does not depend on the marks.
    """
    own, to_slots = request.state.replayed, request.source.to_slots
    own.mark_for([request.instrument.provenance["digest"], request.parameters])
    unseen = (own.made == 0).astype(np.uint8)
    added = unseen.copy()
    added[: own.n_searched] = 0
    for attempts, searched in ((own.attempts[: own.n_flagged], added), (own.attempts[own.n_flagged :], unseen)):
        left = to_slots(searched)
        for event in attempts if searched.any() else ():
            if event.state == TileState.DONE:
                job = request.job(event.row, left)
                reach = reach_of(job)
                own.flags[job.field.row] |= flags_of(reach.pairs.covered, reach.applied.excluded)
    own.n_flagged, own.n_searched = len(own.attempts), len(unseen)
    state.flags |= to_slots(own.flags)
    state.flags[to_slots(own.made) > 0] |= DONE


def _jobs_of(request, tiles, state, folder, executor) -> Iterator:
    """Yield, for each tile, its job, the job that a worker receives, and the stored result of the tile, if any.

    Workers on this machine write the file of a tile, unless they would replace another file.
    """
    writes = is_local(executor)
    for tile in tiles.tolist():
        job, known = state.open_job(request, tile), None
        if folder is not None:
            known = read_part(folder, tile, job)
            job = job._replace(as_file=True, path=folder.new_path(tile) if writes else None)
        yield job, job.bare(), known


def in_order(
    executor: Executor | None, function: Callable, jobs: Iterable, most: int = IN_FLIGHT, together: int = 1
) -> Iterator:
    """Yield the job of each tile, its result, and whether this run computed the result.

    ``jobs`` yields the job, the argument of ``function``, and the result if it is already known; a job is created when
    it is submitted. With an executor, each task consists of ``together`` jobs, and at most ``most`` tiles, rounded up
    to whole tasks, are submitted before the result of the first task is awaited.
    """
    waiting, jobs, together = deque(), iter(jobs), 1 if executor is None else together
    try:
        while part := list(islice(jobs, together)):
            calls = [(job.tile, argument) for job, argument, known in part if known is None]
            with _telling_remedy():
                is_task = executor is not None and calls
                results = submit(executor, _call, function, calls) if is_task else _call(function, calls)
            waiting.append((part, results))
            if executor is None or len(waiting) * together >= most:
                yield from _take(waiting)
        while waiting:
            yield from _take(waiting)
    finally:
        for _, results in waiting:
            if not isinstance(results, list):
                results.cancel()


def _take(waiting: deque) -> Iterator:
    """Wait for the task that was submitted first, and yield each of its jobs, as `in_order` does."""
    part, results = waiting.popleft()
    with _telling_remedy():
        new = iter(results if isinstance(results, list) else results.result())
    for job, _, known in part:
        yield job, next(new) if known is None else known, known is None


def _call(function: Callable, calls: list) -> list:
    """Call a function for each of several tiles; errors name the tile. Each call is a tile and an argument."""
    found = []
    for tile, argument in calls:
        try:
            found.append(function(argument))
        except Exception as error:
            error.add_note(f"while tile {tile} was planned")
            raise
    return found


@contextmanager
def _telling_remedy():
    """Add a remedy to the message if a worker process ended abruptly."""
    try:
        yield
    except BrokenExecutor as error:
        text = (
            "a worker process died; the files of finished tiles remain: continue the survey with resume=True (--resume)"
        )
        raise BrokenExecutor(text) from error
