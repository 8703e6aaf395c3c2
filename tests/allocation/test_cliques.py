"""Cliques of candidates, and plans of arms that almost all exclude each other."""

from itertools import combinations

import astropy.units as u
import numpy as np
import pytest

import rfpsurvey as rs
from brute import best_plan, bodies_of, conflicts_of, options_of
from rfpsurvey._assignment import candidates as _candidates
from rfpsurvey._kernels.conflicts import Options

MM = u.mm


def random_options(rng):
    """Return candidates of a few positioners, some of the candidates, and random collisions of these candidates."""
    size = rng.integers(1, 8, rng.integers(2, 9))
    own = np.repeat(np.arange(len(size)), size)
    start, target = np.append(0, np.cumsum(size)), rng.integers(-1, 12, len(own))
    rows = np.flatnonzero(rng.random(len(own)) < rng.choice([0.7, 1.0]))
    first, second = np.array([*combinations(rows, 2)], dtype=np.int64).reshape(-1, 2).T
    some = (own[first] != own[second]) & (rng.random(len(first)) < rng.choice([0.1, 0.5, 0.9]))
    empty = np.empty(0, dtype=np.int64)
    options = Options(start, own, target, *[empty] * 3, np.ones((1, 1), dtype=bool), *[empty] * 4)
    return options, rows, np.array([first[some], second[some]])


@pytest.mark.parametrize("room", [1, 200_000])
def test_cliques_are_maximal_and_contain_every_conflict(monkeypatch, room):
    monkeypatch.setattr(_candidates, "N_MEMBERS", room)  # with little room, cliques are made in several steps
    n_large = 0
    for seed in range(200):
        options, rows, edges = random_options(np.random.default_rng(seed))
        own, target, n = options.owner, options.target, len(options.owner)
        conflict, inside = (target[:, None] == target) & (target >= 0), np.isin(np.arange(n), rows)
        conflict[tuple(edges)] = conflict[tuple(edges[::-1])] = True
        excludes = (conflict | (own[:, None] == own)) & inside & inside[:, None] & ~np.eye(n, dtype=bool)
        indptr, column = _candidates.cover(options, rows, edges)
        covered = np.zeros((n, n), dtype=bool)
        for clique in np.split(column, indptr[1:-1]):
            assert (np.diff(clique) > 0).all()
            assert excludes[np.ix_(clique, clique)].sum() == len(clique) * (len(clique) - 1)
            partners = conflict[clique].any(axis=0)  # the other candidates have no conflicts at all
            assert not (excludes[clique].all(axis=0) & partners).any()
            covered[np.ix_(clique, clique)] = True
            n_large += len(np.unique(own[clique])) > 2
        assert covered[excludes & (own[:, None] != own)].all()
    assert n_large > 1000


def test_plans_of_arms_that_cross_are_the_best_of_all_plans():
    n_dense = 0
    for seed in range(12):
        rng = np.random.default_rng(seed)
        unit = rs.Positioner(20 * MM, 20 * MM, 2 * MM, handedness="both" if seed % 2 else "right")
        plane = rs.FocalPlane.hexagonal(unit, rings=1, pitch=16 * MM)
        xy, priority = rng.normal(0, 8, (9, 2)), rng.integers(0, 3, 9)
        choices = options_of(plane, xy, None, seed % 2 == 1)
        pairs, barred = conflicts_of(plane, bodies_of(plane, xy, choices, None, True))

        def value(plan, priority=priority):
            seen = [priority[option[0]] for option in plan if option is not None]
            return tuple(seen.count(one) for one in (2, 1, 0))

        best = best_plan(choices, pairs, barred, value, lambda plan: 0.0)[0]
        found = rs.allocate(plane, xy * MM, priority=priority, allocator="optimal")
        seen = priority[found.target_of_positioner[found.target_of_positioner >= 0]].tolist()
        assert tuple(seen.count(one) for one in (2, 1, 0)) == best, seed
        assert found.gap == 0
        n_dense += len(pairs) > 12 * sum(map(len, choices))
    assert n_dense > 4
