"""Measure the collision kernels for given arms: 3997 positioners with targets that are uniform in the patrol areas.

Calls alternate between 50 configurations. With a single configuration, the branch prediction of the processor adapts to
it, and times are up to two times shorter than in a survey.

Lower limit: a tile reads 128 kB of segments, writes the same amount of midpoints and half vectors (copied here by
numpy), and tests every pair of neighbors with 5 floating-point operations. There are 59,000 pairs in the geometry of
LAMOST and 174,000 in that of SDSS-V. Pairs that pass the broad phase (6 and 12 percent) require about 40 further
operations, and the remaining pairs (2 and 4 percent) about 120.
"""

from concurrent.futures import ThreadPoolExecutor
from itertools import cycle

import astropy.units as u
import numpy as np
import pytest
from measure import hexagon

import rfpsurvey as rs
from kaiju_grid import make_grid, set_poses
from rfpsurvey._kernels import batch as reference
from rfpsurvey._kernels import collisions
from rfpsurvey._studies.benchmark_probability import random_tips
from rfpsurvey.collision import place_arms

GEOMETRIES = {"lamost": (8.25, 8.25, 2.25, 25.6, 36), "sdss": (7.4, 15.0, 2.5, 22.4, 36, 0.1)}


class Tile:
    """A focal plane, the poses of its arms, and arrays for results."""

    def __init__(self, name):
        self.plane = hexagon(*GEOMETRIES[name])
        rng = np.random.default_rng(1)
        many = [random_tips(self.plane, rng) * u.mm for _ in range(50)]
        self.tips = cycle(many)
        self.arms = [place_arms(self.plane, tips) for tips in many]
        self.segments = [np.ascontiguousarray(arms.segments.T) for arms in self.arms]
        self.next = cycle(self.segments)
        self.halves = np.empty_like(self.segments[0])
        self.columns = self.plane.arrays
        room = len(self.plane.arrays.neighbors) + 1
        self.first, self.second = self.plane.arrays.neighbors.T.copy()
        self.rows = np.empty(room, np.int64), np.empty(room, np.int64)
        self.squared = np.empty(room)


@pytest.fixture(scope="module", params=GEOMETRIES)
def tile(request):
    return Tile(request.param)


@pytest.fixture(autouse=True)
def _group(benchmark, tile):
    n = len(tile.plane.arrays.neighbors)
    benchmark.group = f"collisions, {n} pairs"


def test_0_floor_copy_the_segments(benchmark, tile):
    benchmark(lambda: np.copyto(tile.halves, next(tile.next)))


def kernel(tile, runs):
    segments = next(tile.next)
    collisions.halve(segments, tile.halves)
    return collisions.colliding_pairs(segments, tile.halves, runs, tile.columns.limits, *tile.rows, tile.squared)


def test_1_kernel(benchmark, tile):
    benchmark(kernel, tile, tile.columns.runs)


def test_1_kernel_with_unsorted_neighbors(benchmark, tile):
    """Every pair is listed separately, in random order. This measures the benefit of sorted neighbors."""
    pairs = np.random.default_rng(2).permutation(tile.plane.arrays.neighbors)
    benchmark(kernel, tile, np.column_stack([pairs, np.ones(len(pairs), np.int64)]))


def test_2_plain_loop(benchmark, tile):
    benchmark(lambda: reference.all_pairs(next(tile.next), tile.first, tile.second, tile.squared[:-1]))


def test_3_public_call(benchmark, tile):
    benchmark(lambda: rs.find_collisions(tile.plane, next(tile.tips)))


def test_4_sampled_65(benchmark, tile):
    benchmark(lambda: rs.find_collisions(tile.plane, tile.arms[0], method="sampled"))


def test_4_sampled_65_all_pairs(benchmark, tile):
    """The method of the paper: all pairs of neighbors, and all pairs of points."""
    arguments = tile.segments[0], tile.first, tile.second, 65, tile.squared[:-1]
    benchmark.pedantic(reference.sampled, arguments, rounds=5, warmup_rounds=1)


def test_5_shapely(benchmark, tile):
    shapely = pytest.importorskip("shapely", minversion="2.0")
    lines = shapely.linestrings(tile.segments[0].T.reshape(-1, 2, 2))
    first, second = lines[tile.first], lines[tile.second]
    benchmark(lambda: shapely.distance(first, second))


def test_6_scipy(benchmark, tile):
    arguments = tile.plane, tile.arms[0]
    benchmark.pedantic(rs.find_collisions, arguments, {"method": "scipy"}, rounds=5, warmup_rounds=1)


def test_7_kaiju(benchmark, tile):
    """Each robot lists the neighbors with which it collides; the pairs must be those of this package."""
    pytest.importorskip("kaiju")
    grid = make_grid(tile.plane)
    set_poses(grid, tile.arms[0].theta, tile.arms[0].phi)
    numbers = range(len(tile.plane))
    found = benchmark.pedantic(lambda: [grid.robotColliders(i) for i in numbers], rounds=5, warmup_rounds=1)
    expected = rs.find_collisions(tile.plane, tile.arms[0]).colliding_with
    assert [sorted(f) for f in found] == expected


@pytest.mark.parametrize("workers", [1, 2])
def test_8_thousand_configurations(benchmark, tile, workers):
    rng = np.random.default_rng(3)
    tips = np.stack([random_tips(tile.plane, rng) for _ in range(250)]) * u.mm
    with ThreadPoolExecutor(workers) as executor:
        pool = executor if workers > 1 else None
        benchmark.pedantic(
            lambda: [rs.collision.count_collisions(tile.plane, tips, executor=pool) for _ in range(4)],
            rounds=7,
            warmup_rounds=1,
        )


@pytest.mark.parametrize("workers", [1, 2])
def test_9_ten_thousand_draws_from_queues(benchmark, tile, workers):
    edge = np.abs(tile.plane.xy.value).max()
    xy = np.random.default_rng(4).uniform(-edge, edge, (20_000, 2)) * u.mm
    allocation = rs.allocate(tile.plane, xy, allocator="balanced")
    with ThreadPoolExecutor(workers) as executor:
        pool = executor if workers > 1 else None
        benchmark.pedantic(
            lambda: rs.collision.count_collisions(tile.plane, allocation, n_configurations=10_000, executor=pool),
            rounds=5,
            warmup_rounds=1,
        )
