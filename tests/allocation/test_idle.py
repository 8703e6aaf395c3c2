"""Collisions of idle arms with each other are the last objective of ``optimal``, after subpriorities."""

from itertools import product

import astropy.units as u
import numpy as np
import pytest

import rfpsurvey as rs

MM = u.mm


IDLE_ARMS = [
    ([[0.404, 7.0876]], None, [-1, 0, -1], 0),  # of two positioners, the one whose idle arm would collide twice
    # subpriorities take precedence over collisions of idle arms; the arms at these targets collide
    ([[12.1, -8.7], [13.6, -4.6]], [0.9, 0.2], [0, -1, -1], 1),
    ([[12.1, -8.7], [13.6, -4.6]], [0.2, 0.9], [-1, 1, -1], 0),
]


@pytest.mark.parametrize(("xy", "subpriority", "expected", "n_pairs"), IDLE_ARMS)
def test_collisions_of_idle_arms_are_the_last_objective(xy, subpriority, expected, n_pairs):
    plane = rs.FocalPlane([[0, 0], [12.2, 0], [24.4, 0]] * MM, rs.Positioner(8 * MM, 8 * MM, 2.25 * MM))
    found = rs.allocate(plane, xy * MM, allocator="optimal", subpriority=subpriority)
    assert (found.gap, found.target_of_positioner.tolist()) == (0, expected)
    assert len(rs.find_collisions(plane, found).pairs) == n_pairs


def enumerate_plans(plane, xy):
    """Return the number of targets and of collisions between idle arms, for plans whose other arms do not collide."""
    choices = [[-1, *np.flatnonzero(row)] for row in plane.reachable(xy).toarray()]
    for targets in product(*choices):
        used = [t for t in targets if t >= 0]
        if len(set(used)) < len(used):
            continue
        plan = rs.allocate(plane, xy, allocator=lambda _, targets=targets: np.array(targets))
        pairs = rs.find_collisions(plane, plan).pairs
        idle = np.array(targets)[pairs] < 0
        if idle.all():
            yield len(used), len(pairs)


@pytest.mark.few(1)
@pytest.mark.parametrize("size", [2000, 6])
def test_as_few_idle_arms_as_possible_collide(monkeypatch, size):
    """With a small size, only positioners around each collision are changed; the plan is then not always the best."""
    monkeypatch.setattr("rfpsurvey._assignment.local_plans.SIZE", size)
    n_better = 0
    for seed in range(30):
        rng, unit = np.random.default_rng(seed), rs.Positioner(8 * MM, 8 * MM, 2.25 * MM)
        plane = rs.FocalPlane(np.column_stack([12.2 * np.arange(5), rng.normal(0, 0.2, 5)]) * MM, unit)
        xy = np.column_stack([rng.uniform(0, 50, 2), rng.uniform(-12, 12, 2)]) * MM
        plans = list(enumerate_plans(plane, xy))
        most = max(n for n, _ in plans)
        fewest = min(k for n, k in plans if n == most)
        found = rs.allocate(plane, xy, allocator="optimal")
        assert found.n_assigned == found.bound == most
        n_pairs = len(rs.find_collisions(plane, found).pairs)
        assert n_pairs >= fewest
        if size == 2000:
            assert n_pairs == fewest
        n_better += n_pairs < max(k for n, k in plans if n == most)
    assert n_better > 3
