"""The loop over the blocks of realizations, and over the tiles of each block.

The *slot* of a target is its index in the arrays that describe the state of a survey.
"""

from collections.abc import Callable, Iterator
from concurrent.futures import Executor
from contextlib import nullcontext
from functools import partial

import numpy as np

from rfpsurvey._progress import Progress
from rfpsurvey.selection._alternate import Generation, plan_history
from rfpsurvey.selection._bits import n_words
from rfpsurvey.selection._folder import NAME, SelectionFolder
from rfpsurvey.selection._probabilities import SelectionProbabilities
from rfpsurvey.selection._realizations import Block, blocks_of, in_batch, request_of, seeds_of
from rfpsurvey.selection._result import realization_table
from rfpsurvey.selection._state import State
from rfpsurvey.selection._work import BlockJob, plan_alone, plan_together, reach_counts
from rfpsurvey.survey import Request, in_order

IN_FLIGHT = 32
"""Number of tiles that are submitted before the first result is awaited."""


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
        together = in_batch(request)
        seeds, blocks = seeds_of(request.seed, n), blocks_of(n, together=together)
        builder = request.builder
        bits = np.zeros((len(builder.wanted), n_words(n)), dtype=np.uint64)
        counts = []
        tiles = len(request.tiling)
        with Progress(progress, (n + 1) * tiles, "plans of tiles") as tell:
            n_tiles = _tiles_of_targets(request, folder, executor, tell)
            for block in blocks:
                own = seeds[block.first : block.last]
                done = None if folder is None else folder.load_block(block.number, len(builder.wanted), len(block))
                is_known = done is not None
                if done is None and generations is not None:
                    plan = partial(_plan_generation, seeds=own, executor=executor, together=together)
                    done = plan_history(generations, len(block), plan)
                elif done is None:
                    state = State(builder, len(block))
                    one = request if together else request_of(request, own[0])
                    begin = tiles * (1 + block.first)
                    _plan_block(one, block, own, state, folder, executor, tell, begin, together=together)
                    done = state.masks(), state.counts
                if folder is not None and not is_known:
                    folder.save_block(block.number, *done)
                word, shift = divmod(block.first, 64)
                bits[:, word] |= done[0].astype(np.uint64) << np.uint64(shift)
                counts.append(done[1])
                tell(tiles * (1 + block.last), new=generations is not None and not is_known)
        source = request.source
        result = SelectionProbabilities(
            source.ids(),
            source.by_row(builder.wanted if generations is None else generations[-1].request.builder.wanted),
            source.by_row(n_tiles),
            source.by_row(bits),
            realization_table(request, seeds, np.concatenate(counts), together=together),
        )
        if folder is not None:
            with folder.writing(NAME) as temporary:
                result.write(temporary)
            folder.finish()
    return result


def _tiles_of_targets(request, folder, executor, tell) -> np.ndarray:
    """Return the number of tiles in which a positioner reaches each target, in the order of the slots of targets."""
    n = len(request.source)
    found = None if folder is None else folder.load("reach", n_tiles=(count_type(len(request.tiling)), (n,)))
    if found is not None:
        tell(len(request.tiling), new=False)
        return found["n_tiles"]
    n_tiles = count_tiles(request, executor, tell)
    if folder is not None:
        folder.save("reach", n_tiles=n_tiles)
    return n_tiles


def count_tiles(request: Request, executor: Executor | None, tell: Callable) -> np.ndarray:
    """Return the number of tiles in which a positioner reaches each target, in the order of the slots of targets."""
    n_tiles = np.zeros(len(request.source), dtype=count_type(len(request.tiling)))
    everything = np.ones(len(request.source), dtype=np.uint8)
    tiles = np.delete(np.arange(len(request.tiling)), request.dropped).tolist()
    jobs = (request.job(tile, everything) for tile in tiles)
    given = ((job, job, None) for job in jobs)
    for k, (job, found, _) in enumerate(in_order(executor, reach_counts, given, IN_FLIGHT), 1):
        n_tiles[job.field.slot[found > 0]] += 1
        tell(k)
    return n_tiles


def count_type(n: int) -> type:
    """Return uint16 if this type can represent all integers up to n, otherwise uint32."""
    return np.uint16 if n < 1 << 16 else np.uint32


def _plan_block(request, block: Block, seeds, state: State, folder, executor, tell, begin: int, *, together) -> None:
    """Plan all tiles for the realizations of a block."""
    if folder is not None:
        folder.load_state(block.number, state, len(request.rounds))
    done = begin + len(block) * sum(len(tiles) for tiles in request.rounds[: state.n_rounds])
    tell(done, new=False)
    plan = plan_together if together else plan_alone
    for tiles in request.rounds[state.n_rounds :]:
        jobs = (_job(request, tile, state, seeds) for tile in tiles.tolist())
        given = ((block_job.job, block_job, None) for block_job in jobs)
        for job, found, _ in in_order(executor, plan, given, IN_FLIGHT):
            state.enter(job.field.slot, found.mask, found.counts)
            done += len(block)
            tell(done)
        state.n_rounds += 1
        if folder is not None and state.n_rounds < len(request.rounds):
            folder.save_state(block.number, state)


def _plan_generation(generation: Generation, state: State, *, seeds, executor, together) -> Iterator:
    """Plan the tiles of a generation for the realizations of a block, and yield the job and the result of each tile."""
    request = generation.request if together else request_of(generation.request, seeds[0])
    for tiles in generation.rounds:
        jobs = (_job(request, tile, state, seeds) for tile in tiles.tolist())
        jobs = (job._replace(failed=generation.failed(job.tile)) for job in jobs)
        given = ((job, job, None) for job in jobs)
        for job, found, _ in in_order(executor, plan_together if together else plan_alone, given, IN_FLIGHT):
            state.enter(job.job.field.slot, found.mask, found.counts)
            yield job, found


def _job(request, tile: int, state: State, seeds) -> BlockJob:
    job = request.job(tile, state.is_open)
    if not any(one.uses_field for one in request.options.all_constraints):  # no constraint uses the further columns
        job = job._replace(field=job.field._replace(targets=job.field.targets._replace(extra={})))
    return BlockJob(job, tile, state.take(job.field.slot), tuple(seeds))
