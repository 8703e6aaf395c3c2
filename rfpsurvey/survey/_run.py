"""The loop over the tiles of a survey."""

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import BrokenExecutor, Executor
from contextlib import contextmanager, nullcontext
from itertools import islice

import numpy as np

from rfpsurvey import _io
from rfpsurvey._executors import is_local, submit
from rfpsurvey._progress import Progress
from rfpsurvey._roles import has_role
from rfpsurvey.errors import InputError, warn
from rfpsurvey.pipeline import OUTCOMES
from rfpsurvey.survey._finished import read_finished
from rfpsurvey.survey._flags import flags_of
from rfpsurvey.survey._folder import JOINT, TABLES, Folder
from rfpsurvey.survey._history import begin, digest_of, extra_digest
from rfpsurvey.survey._joint import plan_together
from rfpsurvey.survey._request import Request
from rfpsurvey.survey._result import completeness_table, outcome_table, tile_table
from rfpsurvey.survey._survey import Survey
from rfpsurvey.survey._unmet import UNKNOWN, WORDS, counts_in
from rfpsurvey.survey._work import (
    COUNTS,
    LOST_TO_RULES,
    N_FIELD,
    N_LOST,
    Done,
    cards_of,
    early_sentences,
    reach_of,
    work,
)

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
        where = Folder(
            path,
            {
                **request.identity(),
                "given": digest_of(request.given),
                "extra": extra_digest(request.given),
                "required_ids": [str(one) for one in request.options.required_ids],
            },
            len(request.tiling),
            resume=resume,
            state=request.state,
            of_first_tiles=request.of_first_tiles,
        )
    with where as folder:
        n = len(request.tiling)
        found = None
        if folder is not None:
            kinds = {"joint": request.joint is not None, "cadences": request.cadences is not None}
            found = read_finished(folder.path, n, **kinds, state=request.state)
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
                    slot = np.append(job.field.slot, -1)[done.target]
                    kept = state.enter(job.field, done.flags, slot, done.observed, request.number[tile], tile)
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
    begin(request, state)
    is_same = folder is not None and folder.path.resolve() == history.folder.resolve()
    if is_same and history.until is None and history.events.files:
        history.replayed.write(folder.path)
    cards = cards_of(request.options)
    for tile, event in history.kept.items():
        if folder is None:
            content = history.events.plan(tile, event.plan)
            parts[tile] = _io.read_fits_bytes(content, f"the plan of tile {event.tile}")[0]
        elif not folder.has_part(tile, event.plan):
            folder.put_part(tile, history.events.plan(tile, event.plan))
        if tile in history.closed:
            own = history.replayed.counts[tile]
            found = counts_in(own, cards) | {"n_observed": history.replayed.n_good[tile]}
        else:
            job, content = request.job(tile, np.ones_like(state.left)), history.events.plan(tile, event.plan)
            done = _done_of(content, job, is_kept=True)
            if request.builder.lasting is not None:  # standards that are also science targets may spend no visit
                visits = _io.read_fits_bytes(content, f"the plan of tile {event.tile}")[0]
                others = visits["target_row"][~has_role(visits["kind"], "science")]
                field = request.builder.in_other_roles(job.field, np.isin(job.field.row, others))
                job = job._replace(field=field)
            slot = np.append(job.field.slot, -1)[done.target]
            open_ = (slot < 0) | (state.left[slot] > 0)
            found = done.counts
            found["n_observed"] = state.enter(job.field, done.flags, slot, done.observed & open_, request.number[tile])
        for name, value in found.items():
            counts.setdefault(name, np.zeros(len(request.tiling), dtype=np.int64))[tile] = value
    return [*history.closed, *history.begun]


def _jobs_of(request, tiles, state, folder, executor) -> Iterator:
    """Yield, for each tile, its job, the job that a worker receives, and the stored result of the tile, if any.

    Workers on this machine write the file of a tile, unless they would replace another file.
    """
    writes = is_local(executor)
    for tile in tiles.tolist():
        job, known = state.open_job(request, tile), None
        if folder is not None:
            known = _read(folder, tile, job)
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


def _read(folder, tile, job) -> Done | None:
    """Return the result that the file of a tile contains, or None if the tile must be planned again."""
    part = folder.part(tile)
    if part is None:
        return None
    try:
        done = _done_of(part, job)
        if done.counts[COUNTS[N_FIELD][0]] != len(job.field.row):
            raise InputError("its stored result was planned for a different set of targets with remaining visits")
    except InputError as error:  # the checksum is correct; therefore, the index was also changed
        folder.distrust(tile, str(error))
        return None
    return done


def _done_of(part: bytes, job, *, is_kept: bool = False) -> Done:
    """Return the result that the content of the file of a tile states, or raise an error if it is not possible.

    The file of a tile that keeps its plan can lack the numbers of constraints, which are then not checkable.
    """
    visits, cards = _io.read_fits_bytes(part, f"the stored result of tile {job.tile}")
    lacking = [name for name in ("target_row", "in_collision", "observed") if name not in visits.dtype.names]
    counted = every = cards_of(job.model.options)
    if is_kept:
        counted = {card: one for card, one in counted.items() if card in cards or not one[0].startswith(WORDS)}
    # files of earlier versions do not state whether constraints are checkable, and the numbers of lost targets
    optional = [card for card, one in counted.items() if card in (N_LOST, *LOST_TO_RULES) or one[0].startswith(UNKNOWN)]
    counted = {card: one for card, one in counted.items() if card in cards or card not in optional}
    lacking += [card for card in counted if not isinstance(cards.get(card), int)]
    if lacking:
        raise InputError(f"its file lacks {', '.join(lacking)}")
    _check_part(visits, {card: cards[card] for card in counted})
    cards.setdefault(N_LOST, int(visits["in_collision"].sum()))
    given = visits["target_row"] >= 0
    rows = np.append(job.field.row, -1)
    target = np.where(given, np.searchsorted(job.field.row, visits["target_row"]), -1)
    if not np.array_equal(rows[target], visits["target_row"]):
        raise InputError("its stored result was planned for a different set of targets with remaining visits")
    reach = reach_of(job)
    flags = flags_of(reach.pairs.covered, reach.excluded)
    return Done(None, None, target, visits["observed"].astype(bool), flags, counts_in(cards, every))


def _check_part(visits: np.ndarray, cards: dict) -> None:
    """Raise an error if the stored visits of a tile, or their numbers, have other types or are impossible."""
    for name, kind in (("target_row", "i"), ("in_collision", "b"), ("observed", "b")):
        words = {"i": "integers", "b": "booleans"}[kind]
        if visits.dtype[name].kind != kind:
            raise InputError(f"its column {name} must contain {words}, got the type {visits.dtype[name]}")
    wrong = [card for card, number in cards.items() if not 0 <= number < 2**53]
    if wrong:
        raise InputError(f"its header card {wrong[0]} must be a number of at least 0, got {cards[wrong[0]]}")
