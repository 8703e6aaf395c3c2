"""The loop over rounds of tiles: what is recorded before a job is made, omitted tiles, and the size of tasks."""

from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from typing import NamedTuple

import numpy as np
import pytest

from rfpsurvey.survey import run_rounds

ROUNDS = [np.arange(0, 40)[::-1], np.arange(40, 43), np.arange(43, 43), np.arange(43, 343)]
KNOWN = [3, 41, 99]


class Named(NamedTuple):
    """A job, of which only the name of the tile is needed."""

    tile: int


class Counting(ThreadPoolExecutor):
    """Threads that count the jobs of each task."""

    def submit(self, function, worker, calls):
        self.sizes = [*getattr(self, "sizes", []), len(calls)]
        return super().submit(function, worker, calls)


@pytest.mark.parametrize(("most", "size"), [(256, 8), (64, 2), (32, 1), (None, 0)])
def test_a_round_is_recorded_before_the_next_round_begins(most, size):
    entered, earlier = [], {tile: np.concatenate([[], *ROUNDS[:k]]) for k in range(4) for tile in ROUNDS[k].tolist()}

    def open_job(tile):
        assert {*entered} >= {*earlier[tile].tolist()} - {*KNOWN}
        return Named(tile)

    def enter(tile, job, result):
        assert (job.tile, result) == (tile, 2 * tile if tile % 50 else -1)
        entered.append(tile)

    def argument(tile, job):
        return job.tile, None if tile % 50 else -1

    with nullcontext() if most is None else Counting(2) as executor:
        given = {"argument": argument, "known": KNOWN, **({} if most is None else {"most": most})}
        found = list(run_rounds(ROUNDS, executor, lambda tile: 2 * tile, open_job, enter, **given))
    tiles = [tile for tile in np.concatenate(ROUNDS).tolist() if tile not in KNOWN]
    assert entered == tiles == [tile for tile, *_ in found]
    assert [is_new for *_, is_new in found] == [tile % 50 > 0 for tile in tiles]
    if executor is not None:
        assert max(executor.sizes) == size
        assert sum(executor.sizes) == sum(tile % 50 > 0 for tile in tiles)
