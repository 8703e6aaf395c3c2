"""Many configurations in one call, compared with single configurations."""

from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from raising import refused

import flat
import rfpsurvey as rs
from rfpsurvey._kernels import allocation as kernels
from scenes import MM, SCENES, both_hands, lamost_like, many_tips, sdss_like, two_fibers, with_troubles


def assert_same(counts, reports):
    assert counts.n_pairs.tolist() == [len(r.pairs) for r in reports]
    assert counts.n_obstacle_pairs.tolist() == [len(r.obstacle_pairs) for r in reports]
    assert counts.n_in_collision.tolist() == [int((r.in_collision & r.counted).sum()) for r in reports]
    assert counts.n_counted.tolist() == [int(r.counted.sum()) for r in reports]
    assert counts.n_assigned.tolist() == [int(r.assigned.sum()) for r in reports]
    assert counts.n_borderline.tolist() == [r.n_borderline for r in reports]
    np.testing.assert_array_equal(counts.rate, [r.rate for r in reports])
    np.testing.assert_array_equal(counts.rate_assigned, [r.rate_assigned for r in reports])
    np.testing.assert_array_equal(counts.per_positioner, sum(r.in_collision.astype(int) for r in reports))


@pytest.mark.parametrize("name", SCENES)
def test_counts_are_those_of_single_configurations(name, rng):
    plane, options = SCENES[name]
    tips = many_tips(plane, rng, 70)
    reports = [rs.find_collisions(plane, t, **options) for t in tips]
    assert sum(len(r.pairs) for r in reports) > 5
    assert_same(rs.collision.count_collisions(plane, tips, **options), reports)


@pytest.mark.parametrize(
    "plane",
    [lamost_like(), two_fibers(), with_troubles(sdss_like()), with_troubles(two_fibers()), both_hands()],
    ids=["equal arms", "capsules", "troubles", "capsules with troubles", "both hands"],
)
def test_draws_are_configurations_of_the_queues(plane, rng):
    """The same uniform numbers give the same configurations if they are used in single calls of public functions."""
    edge = np.abs(plane.arrays.xy).max()
    xy = rng.uniform(-edge, edge, (4 * len(plane), 2))
    types = None if plane.fiber_types == ("",) else rng.choice(["A", "B", ""], len(xy))
    allocation = rs.allocate(plane, xy * MM, fiber_type=types, allocator="balanced")
    counts = rs.collision.count_collisions(plane, allocation, n_configurations=70, rng=5)
    if plane.positioner.handedness == "both":
        assert (allocation.handedness == "left").any()
    uniform = np.concatenate(
        [g.random((m, len(plane))) for g, m in zip(np.random.default_rng(5).spawn(2), (64, 6), strict=True)]
    )
    reports = []
    for row in uniform:
        indptr, queue = allocation.queues
        place = np.empty((1, len(plane)), np.int64)
        kernels.draw_places(indptr, row[None], place)
        target = np.where(place[0] >= 0, queue[place[0]], -1)
        used = target >= 0
        tips = np.where(used[:, None], xy[target], np.nan)
        drawn = replace(
            allocation,
            target_of_positioner=target,
            tips_mm=tips,
            handedness=np.where(plane.arrays.sides(tips) < 0, "left", "right"),
            fiber_type=np.where(used & (types is not None), types[target] if types is not None else "", ""),
        )
        reports.append(rs.find_collisions(plane, drawn))
    assert sum(len(r.pairs) for r in reports) > 5
    assert_same(counts, reports)


@pytest.mark.parametrize("pool", [ThreadPoolExecutor, ProcessPoolExecutor])
def test_an_executor_changes_nothing(pool, rng):
    plane = lamost_like()
    tips = many_tips(plane, rng, 130)
    allocation = rs.allocate(plane, rng.uniform(-70, 70, (150, 2)) * MM, allocator="balanced")
    with pool(2) as executor:
        for given, options in ((tips, {}), (allocation, {"n_configurations": 200, "rng": 3})):
            here = rs.collision.count_collisions(plane, given, **options)
            there = rs.collision.count_collisions(plane, given, executor=executor, **options)
            assert there.n_pairs.sum() > 0
            for field in here.__dataclass_fields__:
                np.testing.assert_array_equal(getattr(here, field), getattr(there, field))


def test_idle_arms_of_an_allocation_stand_as_it_says(rng):
    plane = lamost_like()
    for parked in (True, False):
        allocation = flat.allocate(plane, rng.uniform(-70, 70, (12, 2)) * MM, "balanced", parked_obstacles=parked)
        counts = rs.collision.count_collisions(plane, allocation, n_configurations=3)
        assert (counts.n_counted == (len(plane) if parked else allocation.n_assigned)).all()
        assert rs.find_collisions(plane, allocation).counted.sum() == counts.n_counted[0]


def test_the_configuration_with_bad_tips_is_named_beyond_the_first_chunk():
    plane = lamost_like(1)
    limited = replace(plane, positioner=replace(plane.positioner, phi_range=[0, 170] * u.deg))
    tips = np.stack([plane.xy + 3 * MM] * 140)
    tips[130, 2] += 50 * MM
    words = "configuration 130: 1 tips are out of reach; the first is the tip of positioner 2"
    refused(words, rs.collision.count_collisions, plane, tips)
    tips[130, 2] = limited.xy[2] + 0.1 * MM
    refused("configuration 130: 1 tips are beyond the joint limits", rs.collision.count_collisions, limited, tips)


def test_joint_limits_hold_for_the_elbow_in_use():
    """A right-handed positioner with phi in [0, 180] deg cannot use its left elbow."""
    unit = rs.Positioner(8 * MM, 8 * MM, 2 * MM, phi_range=[0, 180] * u.deg)
    plane = rs.FocalPlane([[0, 0], [25, 0]] * MM, unit)
    tips = plane.xy + 5 * MM
    assert len(rs.find_collisions(plane, tips).pairs) == 0
    for call in (
        lambda: rs.find_collisions(plane, tips, handedness="left"),
        lambda: rs.collision.count_collisions(plane, tips[None], handedness="left"),
    ):
        refused("2 tips are beyond the joint limits", call)


def test_nothing_to_count():
    plane = lamost_like(1)
    empty = rs.collision.count_collisions(plane, np.empty((0, 7, 2)) * MM)
    assert (len(empty), empty.per_positioner.tolist()) == (0, [0] * 7)
    idle = rs.collision.count_collisions(sdss_like(1), np.full((2, 7, 2), np.nan) * MM)
    assert np.isnan(idle.rate).all()
    assert idle.n_pairs.tolist() == [0, 0]
    apart = rs.FocalPlane.hexagonal(plane.positioner, rings=1, pitch=60 * MM)
    assert rs.collision.count_collisions(apart, np.stack([apart.xy + 3 * MM] * 2)).n_assigned.tolist() == [7, 7]


IDLE = np.full((2, 7, 2), np.nan) * MM
BAD_INPUT = [
    ({"tips": np.zeros((2, 3, 2)) * MM}, r"a Quantity of shape \(m, 7, 2\), got the shape \(2, 3, 2\)"),
    ({"tips": np.zeros((2, 7, 2))}, r"got ndarray"),
    ({"tips": np.zeros((2, 7, 2)) * u.deg}, "tips must have a unit convertible to mm, got deg"),
    ({"tips": np.zeros((2, 7, 2)) * MM}, "configuration 0: 6 tips are out of reach; the first is the tip of"),
    ({"tips": IDLE, "n_configurations": 3}, "n_configurations can be given only with an Allocation"),
    ({"tips": IDLE, "executor": 2}, "executor must be a concurrent.futures.Executor"),
    ({"tips": IDLE, "method": "sampled"}, "unknown method of counting collisions"),
]


@pytest.mark.parametrize(("arguments", "message"), BAD_INPUT)
def test_bad_input_is_named(arguments, message):
    refused(message, lambda: rs.collision.count_collisions(lamost_like(1), **arguments))


def test_bad_draws_are_named():
    plane, xy = lamost_like(1), lamost_like(1).xy + 1 * MM
    queues, count = rs.allocate(plane, xy, allocator="balanced"), rs.collision.count_collisions
    rule, elsewhere = rs.allocate(plane, xy, allocator="lamost_rule"), replace(plane, xy=plane.xy + 1000 * MM)
    draw = {"n_configurations": 3}
    refused("n_configurations must be a whole number of at least 0, got None", count, plane, queues)
    refused("such as those by 'balanced', got an allocation by 'lamost_rule'", count, plane, rule, **draw)
    words = "the method must be 'exact' if configurations are drawn from queues, got 'cuda'"
    refused(words, count, plane, queues, method="cuda", **draw)
    words = "the allocation must be for the 19 positioners of the focal plane, got 7"
    refused(words, count, lamost_like(2), queues, **draw)
    refused("for another focal plane: 7 of its targets are out of reach", count, elsewhere, queues, **draw)
    words = r"rng must be a seed from 0 to 2\^128 - 1, a numpy Generator"
    refused(words, count, plane, queues, rng=np.random.RandomState(1), **draw)
    for wrong in ("lamost", rs.Instrument.preset("lamost")):
        for call in (count, rs.find_collisions):
            refused("focal_plane must be a FocalPlane, got", call, wrong, xy)
    refused("handedness and fiber_type must be None for an Allocation", count, plane, queues, handedness="left", **draw)
