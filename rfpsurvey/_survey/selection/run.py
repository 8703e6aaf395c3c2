"""The loop over the blocks of realizations, and over the tiles of each block, and the folder of its results.

The *slot* of a target is its index in the arrays that describe the state of a survey.
"""

from collections.abc import Callable, Iterator
from concurrent.futures import Executor
from contextlib import nullcontext
from dataclasses import replace
from functools import partial
from itertools import accumulate
from time import monotonic

import numpy as np
from astropy.table import QTable

from rfpsurvey._assignment.constraints.text import with_present_texts
from rfpsurvey._common.descriptions import Column, describe, table_of
from rfpsurvey._common.executors import Progress
from rfpsurvey._common.folder import RequestFolder
from rfpsurvey._common.io import written
from rfpsurvey._field.facts import model_sentence
from rfpsurvey._kernels.batch import MOST
from rfpsurvey._survey.joint.plan import plan_jointly
from rfpsurvey._survey.request import Request
from rfpsurvey._survey.selection.alternate import plan_history
from rfpsurvey._survey.selection.probabilities import PER_WORD, SelectionProbabilities, count_type, n_words
from rfpsurvey._survey.selection.work import BlockJob, State, in_batch, is_reached, plan_alone, plan_together, seeds_of
from rfpsurvey._survey.work import Job, run_rounds
from rfpsurvey.errors import InputError

EVERY = 60.0
"""Minimum time between two checkpoints of a block, in seconds."""
NAME = "selection.fits"
"""Name of the file with the result."""
BLOCK, STATE = "block-{:04d}", "state-{:04d}"
"""Names of the files of a finished block, and of the state of an unfinished block."""


class SelectionFolder(RequestFolder):
    """The folder of a computation of selection probabilities, which is locked during the computation.

    A block is a group of realizations that are planned together. Finished blocks, and the state of the unfinished
    block, are stored in NumPy files with checksums. These files are removed when the result is written.
    """

    request_name = "selection.json"
    work, parts, again = "computation of selection probabilities", "realizations", "its tiles are planned again"

    def _compare(self, before: dict, now: dict):
        super()._compare(with_present_texts(before, now), now)

    def _open(self):
        super()._open()
        self._last = monotonic()

    def save(self, name: str, **arrays: np.ndarray) -> None:
        """Write arrays to a file; if writing fails, no incomplete file remains."""
        with self.writing(f"{name}.npz") as temporary:
            np.savez(temporary, **arrays)

    def save_state(self, number: int, state: State) -> None:
        """Write the state of an unfinished block, if the last checkpoint is at least ``EVERY`` seconds old."""
        if monotonic() - self._last >= EVERY:
            self.save(STATE.format(number), left=state.left, counts=state.counts, n_rounds=np.array(state.n_rounds))
            self._last = monotonic()

    def load_state(self, number: int, state: State, n_rounds: int) -> None:
        """Restore ``state`` from the file of an unfinished block of ``n_rounds`` rounds, if there is such a file."""
        left, counts = ("u1", state.left.shape), ("i8", state.counts.shape)
        stored = self.load(STATE.format(number), left=left, counts=counts, n_rounds=("i8", ()))
        if stored is not None:
            done = int(stored["n_rounds"])
            if not 0 <= done < n_rounds:
                raise InputError(
                    f"{self.path} is damaged: block {number} must have at most {n_rounds} rounds, got {done}"
                )
            state.restore(stored["left"], stored["counts"], done)

    def save_block(self, number: int, mask: np.ndarray, counts: np.ndarray, visits: np.ndarray | None) -> None:
        """Write the masks, the counts and, with cadences, the visits of a finished block, and remove its state."""
        self.save(BLOCK.format(number), mask=mask, counts=counts, **({} if visits is None else {"visits": visits}))
        with written(self.path):
            (self.path / f"{STATE.format(number)}.npz").unlink(missing_ok=True)

    def load_block(self, number: int, n_targets: int, n: int, *, visits: bool) -> tuple | None:
        """Return what `save_block` wrote for n realizations, with or without visits; None if it is not finished."""
        expected = {"mask": ("u4", (n_targets,)), "counts": ("i8", (n, 3)), "visits": ("u1", (n_targets, n))}
        names = [*expected][: 3 if visits else 2]
        stored = self.load(BLOCK.format(number), **{name: expected[name] for name in names})
        return None if stored is None else (stored["mask"], stored["counts"], stored.get("visits"))

    def finish(self) -> None:
        """Remove the files that are required only to continue an unfinished computation, and their checksums."""
        with written(self.path):
            for path in self.path.glob("*.npz"):
                path.unlink()
        self._known = {NAME: self._known[NAME]}
        super().finish()


IN_FLIGHT = 32
"""Number of tiles that are submitted before the first result is awaited."""
REALIZATIONS = table_of(
    Column("realization", "number of the realization, and of its bit in BITWEIGHTS"),
    Column("seed", "seed of the subpriorities and of the random numbers of the realization"),
    Column("n_assigned", "number of usable positioners with a target, summed over all tiles"),
    Column("n_lost", "number of targets lost to collisions, summed over all tiles"),
    Column("n_observed", "number of visits to science targets, without lost targets, summed over all tiles"),
)


def run(
    request: Request, n: int, path: object, executor: Executor | None, progress, *, resume: bool, generations=None
) -> SelectionProbabilities:
    """Plan all realizations of a survey, and return the result; if ``path`` is not None, also write the result.

    ``generations`` are the plans of a survey with recorded events (see `generations_of`).
    """
    where = nullcontext()
    if path is not None:
        request.check_text()
        where = SelectionFolder(path, {**request.identity(), "n_realizations": n}, resume=resume)
    with where as folder:
        if folder is not None and folder.verified(NAME) is not None:
            folder.finish()  # the earlier run may have ended between writing the result and removing the checkpoints
            return SelectionProbabilities.read(folder.path)
        seeds, size, builder = seeds_of(request.seed, n), MOST if in_batch(request) else 1, request.builder
        bits = np.zeros((len(builder.wanted), n_words(n)), dtype=np.uint64)
        counts, tiles, with_visits, is_dated = [], len(request.tiling), None, request.cadences is not None
        if is_dated:
            most = max(int(generation.requested.max()) for generation in generations)
            with_visits = np.zeros((len(builder.wanted), most + 1), dtype=count_type(n))
        with Progress(progress, (n + 1) * tiles, "plans of tiles") as tell:
            n_tiles = _tiles_of_targets(request, folder, executor, tell)
            for number, first in enumerate(range(0, n, size)):
                block_seeds = seeds[first : first + size]
                sizes = len(builder.wanted), len(block_seeds)
                done = None if folder is None else folder.load_block(number, *sizes, visits=is_dated)
                is_known = done is not None
                plan_rounds = partial(_plan_rounds, seeds=block_seeds, executor=executor)
                if done is None and generations is not None:
                    done = plan_history(generations, len(block_seeds), plan_rounds)
                elif done is None:
                    state = State(builder, len(block_seeds))
                    _plan_block(request, number, state, folder, tell, tiles * (1 + first), plan_rounds)
                    done = state.masks(), state.counts, None
                if folder is not None and not is_known:
                    folder.save_block(number, *done)
                word, shift = divmod(first, PER_WORD)
                bits[:, word] |= done[0].astype(np.uint64) << np.uint64(shift)
                counts.append(done[1])
                for visits in () if with_visits is None else done[2].T:
                    with_visits[np.arange(len(visits)), visits] += 1
                tell(tiles * (1 + first + len(block_seeds)), new=generations is not None and not is_known)
        source, last = request.source, builder if generations is None else generations[-1].request.builder
        columns = [source.by_row(values) for values in (last.wanted, n_tiles, bits)]
        if generations is not None and (limits := generations[-1].request.state.limits) is not None:
            columns[0][limits.row] += limits.expired  # realizations can make these visits before they expire
        table = realization_table(request, seeds, np.concatenate(counts))
        with_visits = with_visits if with_visits is None else source.by_row(with_visits)
        result = SelectionProbabilities(source.ids(), *columns, table, with_visits)
        if folder is not None:
            with folder.writing(NAME) as temporary:
                result.write(temporary)
            folder.finish()
    return result


def _tiles_of_targets(request, folder, executor, tell) -> np.ndarray:
    """Return the number of tiles in which a positioner reaches each target, in the order of the slots of targets."""
    n = len(request.source)
    stored = None if folder is None else folder.load("reach", n_tiles=(count_type(len(request.tiling)), (n,)))
    if stored is not None:
        tell(len(request.tiling), new=False)
        return stored["n_tiles"]
    n_tiles = np.zeros(n, dtype=count_type(len(request.tiling)))
    open_job, rounds = partial(request.job, left=np.ones(n, dtype=np.uint8)), [np.arange(len(request.tiling))]
    results = run_rounds(rounds, executor, is_reached, open_job, known=request.dropped, most=IN_FLIGHT)
    for k, (_, job, is_in_reach, _) in enumerate(results, 1):
        n_tiles[job.field.slot[is_in_reach]] += 1
        tell(k)
    if folder is not None:
        folder.save("reach", n_tiles=n_tiles)
    return n_tiles


def _plan_block(request, number: int, state: State, folder, tell, begin: int, plan_rounds: Callable) -> None:
    """Plan all tiles for the realizations of a block."""
    if folder is not None:
        folder.load_state(number, state, len(request.rounds))
    ends, n = [*accumulate(map(len, request.rounds), initial=0)], len(state.counts)
    tell(begin + n * ends[state.n_rounds], new=False)
    results = plan_rounds(request, request.rounds[state.n_rounds :], state)
    for done, _ in enumerate(results, ends[state.n_rounds] + 1):
        tell(begin + n * done)
        if done == ends[state.n_rounds + 1]:
            state.n_rounds += 1
            if folder is not None and done < ends[-1]:
                folder.save_state(number, state)


def _plan_rounds(
    request, rounds, state: State, failed: Callable = lambda _: None, *, seeds: list[int], executor
) -> Iterator[tuple]:
    """Plan the tiles of all rounds for the realizations of a block, and yield the results as `run_rounds` does.

    The function ``failed`` of the row of a tile returns its `Failures`; None if the tile was not observed.
    """
    together = in_batch(request)
    has_field = any(constraint.uses_field for constraint in request.options.all_constraints)
    if not together:
        options = replace(request.options, subpriority=seeds[0])
        request = replace(request, builder=state.builder, options=options, seed=seeds[0])
    if request.joint is not None:
        request = plan_jointly(request, None, executor, progress=False)[0]

    def open_job(tile: int) -> Job:
        job = state.open_job(request, tile)
        if not has_field:  # no constraint uses the further columns
            job = job._replace(field=job.field._replace(targets=job.field.targets._replace(extra={})))
        return job

    def argument(tile: int, job: Job) -> tuple[BlockJob, None]:
        return BlockJob(job, state.open_left(job.field.slot, tile), tuple(seeds), failed(tile)), None

    function = plan_together if together else plan_alone
    return run_rounds(rounds, executor, function, open_job, state.enter, argument=argument, most=IN_FLIGHT)


def realization_table(request, seeds: list[int], counts: np.ndarray) -> QTable:
    """Return a table with a row for each realization, and with the provenance in its meta."""
    columns = [np.arange(len(seeds)), np.array(seeds, dtype=np.int64), *counts.T]
    table = QTable(columns, names=[*REALIZATIONS])
    n_fibers = int(np.delete(request.n_usable, request.dropped).sum())
    n_tiles = len(request.tiling) - len(request.dropped)
    summary = {"n_realizations": len(seeds), "n_tiles": n_tiles, "n_rounds": len(request.rounds)}
    summary |= {"n_fibers": n_fibers, **({} if request.moved is None else {"epoch": request.moved})}
    summary["model"] = model_sentence(request.instrument, projection=request.projection)
    table.meta = {"summary": summary, "provenance": request.provenance}
    return describe(table, REALIZATIONS)
