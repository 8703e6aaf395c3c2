"""Separate parts of the placement of tiles: the targets that a tile serves, network flow, searches."""

from itertools import combinations
from types import SimpleNamespace

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from scipy.optimize import linear_sum_assignment

import rfpsurvey as rs
from rfpsurvey._sky.arrays import SkyIndex
from rfpsurvey._survey.tiling import greedy as _greedy
from rfpsurvey._survey.tiling.centers import FreeFibers, neighbors_within
from rfpsurvey._survey.tiling.network import UNASSIGNED, _Cells, _cost, _flow, _relax
from rfpsurvey._survey.tiling.problem import TilingProblem, TilingState, visit_all

DEG = u.deg


def sky(center=(95, 23), radius=3, n=300, seed=1, kind="uniform", **options):
    center = SkyCoord(*center, unit="deg")
    return rs.synthetic_catalog(kind, center, radius * DEG, n_targets=n, rng=seed, **options)


@pytest.mark.few(1)
@pytest.mark.parametrize("search", [_greedy._climb_sum, _greedy._shift_to_mean])
def test_searches_never_lose_and_sometimes_gain(search):
    """The searches start at random positions among few targets, where sums have steps and means are irregular."""
    gains = []
    for seed in range(40):
        catalog = sky(n=25, radius=2, seed=seed)
        index = SkyIndex(catalog.arrays.vectors)
        state = TilingState(
            TilingProblem(np.deg2rad(1), index, np.ones(25, dtype=int), 25, FreeFibers(25, None, None), np.deg2rad(1))
        )
        begin = catalog.arrays.vectors[0]
        end = search(state, begin)
        assert np.linalg.norm(end) == pytest.approx(1)
        gains.append(np.diff(index.sum_near(np.array([begin, end]), np.deg2rad(1), state.weight))[0])
    assert min(gains) >= 0
    assert np.mean(np.array(gains) > 0) > 0.3


def test_targets_that_more_tiles_cover_can_wait():
    serve = FreeFibers(2, None, None)
    served = serve(None, np.arange(4), SimpleNamespace(chances=np.array([3, 1, 2, 1])))
    assert served.tolist() == [1, 3]


@pytest.mark.parametrize("seed", range(3))
def test_overlaps_help_where_fibers_are_short(seed):
    """Two fields overlap, and have as many fibers as targets.

    All targets are served, because targets in one field are served first.
    """
    rng = np.random.default_rng(seed)
    ra = np.concatenate([rng.uniform(9.1, 9.9, 10), rng.uniform(10.1, 10.4, 20), rng.uniform(10.6, 11.4, 10)])
    coord = SkyCoord(rng.permutation(ra) * DEG, np.zeros(40) * DEG)
    index = SkyIndex(coord.cartesian.xyz.value.T)
    state = TilingState(
        TilingProblem(np.deg2rad(1), index, np.ones(40, dtype=int), 20, FreeFibers(20, None, None), np.deg2rad(1))
    )
    centers = SkyCoord([9.5, 11.0] * DEG, [0, 0] * DEG).cartesian.xyz.value.T
    assert (visit_all(state, np.ascontiguousarray(centers), 1), state.completeness) == (2, 1)


def test_fibers_keep_their_distance(rng):
    """The number of targets is that of a brute-force search, and no targets are too close to each other."""
    for _ in range(30):
        points = rng.uniform(0, 1, (9, 2))
        vectors = SkyCoord(points[:, 0] * DEG, points[:, 1] * DEG).cartesian.xyz.value.T
        near = neighbors_within(vectors, np.deg2rad(0.35))
        coord = SkyCoord(points * DEG)
        close = coord[:, None].separation(coord[None]).deg
        close = (close < 0.35) & ~np.eye(9, dtype=bool)
        np.testing.assert_array_equal(np.diff(near[0]), close.sum(axis=1))
        served = FreeFibers(9, None, near)(None, np.arange(9), SimpleNamespace(chances=None))
        assert not close[np.ix_(served, served)].any()
        sets = [s for n in range(10) for s in combinations(range(9), n) if not close[np.ix_(s, s)].any()]
        best = max(map(len, sets))
        assert best - 1 <= len(served) <= best
        # each target that is not served is too close to a served target
        assert all(close[k, served].any() for k in set(range(9)) - set(served.tolist()))


def test_network_flow_is_the_best_assignment(rng):
    """Compare with the assignment of single targets to single fibers (Hungarian method)."""
    coord = sky(n=40, radius=3).coord
    index = SkyIndex(coord.cartesian.xyz.value.T)
    problem = SimpleNamespace(index=index, wanted=np.ones(40, dtype=int), radius=np.deg2rad(1), fibers=5)
    cells = _Cells(problem)
    centers = index.vectors[rng.choice(40, 4, replace=False)]
    _, tile, amount, total = _flow(problem, cells, centers)
    np.testing.assert_allclose(amount, np.rint(amount), atol=1e-6)
    assert np.bincount(tile, amount, 4).max() <= 5
    distance = np.arccos(np.clip(cells.vectors @ centers.T, -1, 1))
    cost = np.repeat(np.repeat(_cost(distance, problem.radius), 5, axis=1), cells.supply.astype(int), axis=0)
    cost = np.hstack([cost, np.full((40, 40), UNASSIGNED)])
    assert total == pytest.approx(cost[linear_sum_assignment(cost)].sum(), rel=1e-9)


def test_tiles_move_to_what_they_are_given(rng):
    """All targets are in a field at the end. Two initial centers are shifted, and one is far from all targets."""
    clusters = [sky(center, 0.5, 20, seed) for seed, center in enumerate([(10, 5), (14, 5), (18, 5)])]
    vectors = np.vstack([c.arrays.vectors for c in clusters])
    problem = TilingProblem(
        np.deg2rad(1), SkyIndex(vectors), np.ones(60, dtype=int), 25, FreeFibers(25, None, None), np.deg2rad(1)
    )
    cells = _Cells(problem)
    begin = SkyCoord([10.6, 13.4, 40] * DEG, [5, 5.4, -30] * DEG).cartesian.xyz.value.T
    before = _flow(problem, cells, begin)[-1]
    centers = _relax(problem, cells, np.ascontiguousarray(begin))
    assert _flow(problem, cells, centers)[-1] < before
    away = np.linalg.norm(vectors[:, None] - centers[None], axis=2).min(axis=1)
    assert away.max() <= np.deg2rad(1)


def test_chances_are_the_tiles_to_come():
    catalog = sky(n=100, radius=2)
    index, seen = SkyIndex(catalog.arrays.vectors), []

    def serve(center, near, state):
        seen.append((center, state.chances.copy()))
        return near[:5]

    state = TilingState(TilingProblem(np.deg2rad(1), index, np.ones(100, dtype=int), 5, serve, np.deg2rad(1)))
    visit_all(state, np.ascontiguousarray(index.vectors[:12]), 1)
    assert len(seen) > 5
    for k, (_, chances) in enumerate(seen):
        later = [center for center, _ in seen[k + 1 :]]
        inside = [np.linalg.norm(index.vectors - c, axis=1) <= 2 * np.sin(np.deg2rad(0.5)) for c in later]
        # the number of later tiles includes tiles that serve no target
        assert (chances >= np.sum(inside, axis=0)).all()
        assert (chances <= 11 - k).all()
