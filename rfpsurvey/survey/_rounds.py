"""The loop over the rounds of tiles, which surveys, joint plans and selection probabilities share."""

from collections.abc import Callable, Collection, Iterable, Iterator
from concurrent.futures import Executor

import numpy as np

from rfpsurvey._executors import IN_FLIGHT, in_order

# A task of an executor plans up to 8 tiles of a large round, because starting a task takes as long as planning a tile
# by a simple rule. In rounds with fewer than 16 times as many tiles, or if fewer than 32 times as many tiles may wait,
# tasks are smaller, so that all workers have tasks.
SHARE = 16


def run_rounds(
    rounds: Iterable[np.ndarray],
    executor: Executor | None,
    function: Callable,
    open_job: Callable,
    enter: Callable = lambda *_: None,
    *,
    argument: Callable = lambda _, job: (job.bare(), None),
    known: Collection[int] = (),
    most: int = IN_FLIGHT,
) -> Iterator[tuple]:
    """Plan the tiles of all rounds; yield the row, the job and the result of each tile, and whether it is new.

    The tiles of a round share no targets. For the row of a tile, ``open_job`` makes the job from the state of the
    survey. For the row and the job, ``argument`` returns the argument of ``function``, which workers call, and the
    result if it is already known. ``enter`` records the row, the job and the result in the state. The tiles in
    ``known`` are omitted, and at most about ``most`` tiles wait for workers (see `in_order`).
    """
    for tiles in rounds:
        tiles = tiles[~np.isin(tiles, [*known])].tolist()
        together = max(min(len(tiles), most // 2) // SHARE, 1)
        jobs = map(open_job, tiles)
        given = ((job, *argument(tile, job)) for tile, job in zip(tiles, jobs, strict=True))
        for tile, (job, done, is_new) in zip(tiles, in_order(executor, function, given, most, together), strict=True):
            enter(tile, job, done)
            yield tile, job, done, is_new
