"""Candidates that are omitted in crowded fields: the plan loses nothing, or its bound limits the loss."""

import astropy.units as u
import numpy as np
import pytest

import flat
import rfpsurvey as rs
from oracles import closest_pairs_first, lamost_target
from rfpsurvey._assignment import before_and_after as _preselect
from scenes import random_plane

MM = u.mm
ROUNDING = 1e-9
EXHAUSTIVE = pytest.mark.exhaustive


def crowded_case(seed):
    """Return a few positioners with dozens of targets in reach of each, with or without requirements."""
    rng = np.random.default_rng([seed, 14])
    plane, m = random_plane(rng), int(rng.integers(20, 60))
    xy = plane.arrays.xy[rng.integers(len(plane), size=m)] + rng.uniform(-16, 16, (m, 2))
    options = {"parked_obstacles": bool(rng.random() < 0.5)}
    # the first classes have few targets, and the last class has many
    options["priority"] = -np.floor(rng.random(m) ** 0.3 * rng.integers(1, 5))
    if plane.fiber_types != ("",):
        options["fiber_type"] = rng.choice(["", *plane.fiber_types], m)
    if rng.random() < 0.5:
        options["kind"] = rng.choice(["science", "science", "standard", "sky"], m)
        low = rng.integers(0, 3, 2)
        sky = rs.Requirement("sky", int(low[0]), int(low[0]) + 1, str(rng.choice(["tile", "spectrograph"])))
        options["requirements"] = [sky, rs.Requirement("standard", int(low[1]))]
    if rng.random() < 0.2:
        options["required"] = np.flatnonzero(rng.random(m) < 0.1)
    if rng.random() < 0.3:
        options["objective"] = "count"
    return plane, xy, options


def both_ways(monkeypatch, case, method, kept=(1, 1)):
    """Return the plan with few candidates, and the plan with all candidates."""
    plane, xy, options = case
    found = []
    for n_best, n_spread in (kept, (10**6, 10**6)):
        monkeypatch.setattr(_preselect, "N_BEST", n_best)
        monkeypatch.setattr(_preselect, "N_SPREAD", n_spread)
        found.append(flat.allocate(plane, xy * MM, allocator=method, **options))
    return found


@pytest.mark.few(1)
@pytest.mark.parametrize("chunk", [0, *(pytest.param(k, marks=EXHAUSTIVE) for k in range(1, 4))])
def test_optimum_of_few_candidates_is_that_of_all_or_its_bound_says_so(monkeypatch, chunk):
    n_left_out = n_lost = 0
    for seed in range(40 * chunk, 40 * chunk + 40):
        few, every = both_ways(monkeypatch, crowded_case(seed), "optimal")
        assert every.gap == 0, seed
        n_left_out += few.meta.get("n_left_out", 0)
        for a, b in zip(few.levels, every.levels, strict=True):
            assert a.value <= b.value <= a.bound, (seed, a, b)
            if a.value < b.value:  # the values of later levels are not comparable
                n_lost += 1
                break
        if few.gap == 0:
            assert few.levels == every.levels, seed
    assert n_left_out > 300  # many candidates were omitted, because the scenes are crowded
    assert n_lost < 40  # most plans are optimal in spite of the omissions


def test_flow_of_few_candidates_is_that_of_all(monkeypatch):
    for seed in range(40):
        case = crowded_case(seed)
        few, every = both_ways(monkeypatch, case, "network_flow")
        assert few.levels == every.levels, seed
        cost = [np.nansum((plan.tips.to_value(MM) - case[0].arrays.xy) ** 2) for plan in (few, every)]
        assert cost[0] == pytest.approx(cost[1], rel=ROUNDING), seed
        assert few.meta["n_candidates"] <= every.meta["n_candidates"], seed


@pytest.mark.parametrize("seed", [*range(16), *(pytest.param(k, marks=EXHAUSTIVE) for k in range(16, 24))])
def test_repair_of_few_candidates_keeps_its_bound_and_leaves_no_collision(monkeypatch, seed):
    plane, xy, options = case = crowded_case(seed)
    options.pop("objective", None)  # repair does not use it
    few = both_ways(monkeypatch, case, "repair")[0]
    best = flat.allocate(plane, xy * MM, allocator="optimal", **options)
    assert tuple(level.value for level in few.levels) <= tuple(level.value for level in best.levels)
    for a, b in zip(few.levels, best.levels, strict=True):
        assert not b.value > a.bound
        if a.value != b.value:
            break
    report = rs.find_collisions(plane, few)
    assert not (few.target_of_positioner[report.pairs] >= 0).any()
    assert not (few.target_of_positioner[report.obstacle_pairs[:, 0]] >= 0).any()


@pytest.mark.parametrize("seed", range(20))
def test_rules_in_a_crowd_are_the_rules_as_written(seed):
    """Each positioner keeps more candidates than it has rivals, so that no target of the rule is omitted."""
    rng = np.random.default_rng(seed)
    plane = rs.FocalPlane.hexagonal(rs.Positioner(8.25 * MM, 8.25 * MM, 2 * MM), rings=1, pitch=20 * MM)
    # many targets at equal distances
    xy = np.concatenate([rng.uniform(-36, 36, (150, 2)), 4.0 * rng.integers(-9, 9, (60, 2))])
    priority, can = rng.integers(0, 3, len(xy)).tolist(), plane.reachable(xy * MM).toarray()
    assert (can.sum(axis=1) > plane.arrays.n_sharing + 1).all()
    plan = rs.allocate(plane, xy * MM, allocator="nearest", priority=priority)
    assert plan.target_of_positioner.tolist() == closest_pairs_first(xy, plane.arrays.xy, can, priority)
    plan = rs.allocate(plane, xy * MM, allocator="lamost_rule", priority=priority)
    assert plan.target_of_positioner.tolist() == lamost_target(xy, plane.arrays.xy, can, priority)


def test_two_hundred_thousand_targets_in_a_field_of_unequal_arms_are_planned_with_a_proof():
    """Regression: all conflicts of all candidates were listed, which required gigabytes of memory."""
    model, rng, n = rs.Instrument.preset("sdss_apo"), np.random.default_rng(0), 200_000
    r, angle = 330 * np.sqrt(rng.random(n)), 2 * np.pi * rng.random(n)
    xy = np.column_stack([r * np.cos(angle), r * np.sin(angle)]) * MM
    types = rng.choice(["BOSS", "APOGEE"], n)
    plan = rs.allocate(model.focal_plane, xy, allocator="optimal", fiber_type=types, priority=rng.integers(0, 3, n))
    assert (plan.gap, plan.n_assigned) == (0, 500)
    assert plan.meta["n_left_out"] > 200_000
    assert plan.meta["n_conflicts"] < 5e6
    assert len(rs.find_collisions(model.focal_plane, plan).pairs) == 0


def test_candidates_grow_no_more_with_the_number_of_targets():
    plane = rs.FocalPlane.hexagonal(rs.Positioner(8.25 * MM, 8.25 * MM, 2.25 * MM), rings=1, pitch=25.6 * MM)
    rng, counts = np.random.default_rng(2), []
    for n in (20_000, 80_000):
        plan = rs.allocate(plane, rng.uniform(-40, 40, (n, 2)) * MM, allocator="optimal")
        counts.append(plan.meta["n_candidates"])
        assert plan.gap == 0
    assert counts[0] == counts[1] == 7 * 129
