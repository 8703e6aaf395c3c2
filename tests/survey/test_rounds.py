"""The order of tiles, which consists of rounds of tiles that do not overlap, and the loop over these rounds."""

import tracemalloc
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from typing import NamedTuple

import numpy as np
import pytest

from rfpsurvey._survey.request import ORDERS, make_rounds
from rfpsurvey._survey.work import run_rounds

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


@pytest.mark.parametrize(("most", "size"), [(256, 8), (32, 1), (None, 0)])
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
        assert (max(executor.sizes), sum(executor.sizes)) == (size, sum(tile % 50 > 0 for tile in tiles))


def scene(rng, n, reach):
    """Return random directions, their passes, and which of them are closer to each other than ``reach``."""
    vectors = rng.normal(size=(n, 3))
    vectors /= np.linalg.norm(vectors, axis=1, keepdims=True)
    return vectors, rng.integers(0, 3, n), np.arccos(np.clip(vectors @ vectors.T, -1, 1)) < reach


def test_rounds_keep_neighbors_apart(rng):
    vectors, passes, close = scene(rng, 300, 0.3)
    for name in ORDERS:
        rounds = make_rounds(vectors, 0.3, passes, name)
        assert np.array_equal(np.sort(np.concatenate(rounds)), np.arange(300))
        round_of = np.empty(300, dtype=int)
        for k, tiles in enumerate(rounds):
            round_of[tiles] = k
        i, j = np.nonzero(np.triu(close, 1))
        assert (round_of[i] != round_of[j]).all()
        if name == "given":
            assert (round_of[i] < round_of[j]).all()
        else:
            assert (np.sign(round_of[i] - round_of[j]) == np.sign(passes[i] - passes[j]))[passes[i] != passes[j]].all()


def test_rounds_are_those_of_a_greedy_coloring_and_of_longest_chains(rng):
    vectors, passes, near = scene(rng, 200, 0.4)
    color, level = [], []
    for k in range(200):
        before = [m for m in range(k) if near[k, m]]
        taken = {color[m] for m in before if passes[m] == passes[k]}
        color.append(min(set(range(201)) - taken))
        level.append(max((level[m] for m in before), default=-1) + 1)
    for name, number in (("color", list(zip(passes.tolist(), color, strict=True))), ("given", level)):
        rounds = make_rounds(vectors, 0.4, passes, name)
        groups = {key: [m for m in range(200) if number[m] == key] for key in sorted(set(number))}
        assert [sorted(tiles.tolist()) for tiles in rounds] == list(groups.values())


def test_rounds_of_many_tiles_on_one_another_take_little_memory():
    """Regression: the neighbors of every tile were listed, which took half a gigabyte for 10,000 tiles within 3 deg."""
    rng = np.random.default_rng(0)
    z, angle = 1 - rng.random(5000) * (1 - np.cos(0.03)), 2 * np.pi * rng.random(5000)
    vectors = np.column_stack([np.sqrt(1 - z**2) * np.cos(angle), np.sqrt(1 - z**2) * np.sin(angle), z])
    make_rounds(vectors[:10], 0.06, np.zeros(10, int), "given")
    tracemalloc.start()
    rounds = make_rounds(vectors, 0.06, np.zeros(5000, int), "given")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert len(rounds) == 5000  # all tiles overlap
    assert peak < 5e6


def test_no_tiles_have_no_rounds():
    assert make_rounds(np.empty((0, 3)), 0.1, np.empty(0, dtype=int), "given") == []
