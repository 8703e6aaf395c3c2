import pickle
from collections import Counter

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from raising import refused

import flat
import rfpsurvey as rs
from oracles import balanced_owner
from rfpsurvey.allocation import METHODS, AllocationAnswer

MM = u.mm
PLANES = {
    "equal": rs.FocalPlane.hexagonal(rs.Positioner(8.25 * MM, 8.25 * MM, 2 * MM), rings=1, pitch=25.6 * MM),
    "unequal": rs.FocalPlane.hexagonal(rs.Positioner(7.4 * MM, 15 * MM, 2 * MM), rings=1, pitch=22.4 * MM),
}
# a lattice of targets, which has many ties in distance, or random targets
TARGETS = st.integers(1, 25).flatmap(
    lambda n: st.one_of(
        arrays(float, (n, 2), elements=st.integers(-7, 7).map(lambda k: 6.4 * k)),
        arrays(float, (n, 2), elements=st.floats(-45, 45, allow_subnormal=False)),
    )
)


def reaches(plane, xy):
    return plane.reachable(xy * MM).toarray()


@given(st.sampled_from(sorted(PLANES)), TARGETS)
def test_balanced_is_the_rule_as_written(name, xy):
    plane = PLANES[name]
    allocation = rs.allocate(plane, xy * MM, allocator="balanced")
    owner = balanced_owner(xy, plane.arrays.xy, reaches(plane, xy))
    indptr, queue = allocation.queues
    for i in range(len(plane)):
        mine = [t for t in range(len(xy)) if owner[t] == i]
        assert queue[indptr[i] : indptr[i + 1]].tolist() == mine
        assert (allocation.target_of_positioner[i] in mine) if mine else (allocation.target_of_positioner[i] == -1)


@pytest.mark.few(2)
@pytest.mark.parametrize("method", METHODS)
@given(st.sampled_from(sorted(PLANES)), TARGETS)
def test_one_target_a_positioner_and_one_positioner_a_target(method, name, xy):
    plane = PLANES[name]
    allocation = rs.allocate(plane, xy * MM, allocator=method)
    target_of, positioner_of = allocation.target_of_positioner, allocation.positioner_of_target
    assert all(t < 0 or positioner_of[t] == i for i, t in enumerate(target_of))
    assert all(i < 0 or target_of[i] == t for t, i in enumerate(positioner_of))
    can = reaches(plane, xy)
    assert all(can[i, t] for i, t in enumerate(target_of) if t >= 0)
    np.testing.assert_array_equal(np.isnan(allocation.tips[:, 0].value), target_of < 0)
    assert allocation.n_reachable == can.any(axis=0).sum()
    if method == "lamost_rule":  # no free positioner reaches an unassigned target
        assert not can[np.ix_(np.flatnonzero(target_of < 0), np.flatnonzero(positioner_of < 0))].any()


def test_balanced_draws_uniformly_from_each_queue():
    plane = PLANES["equal"]
    xy = [[1, 0], [2, 0], [3, 0], [4, 0]] * MM  # all targets are in the queue of the central positioner
    draws = Counter(
        int(rs.allocate(plane, xy, rng=np.random.default_rng(k), allocator="balanced").target_of_positioner[3])
        for k in range(2000)
    )
    assert set(draws) == {0, 1, 2, 3}
    # with 3 degrees of freedom, chi-squared exceeds 21.1 once in 10^4 cases
    assert sum((n - 500) ** 2 / 500 for n in draws.values()) < 21.1


@pytest.mark.parametrize("method", METHODS)
def test_the_same_input_gives_the_same_allocation(method, rng):
    xy = rng.uniform(-50, 50, (60, 2)) * MM
    first, second = (rs.allocate(PLANES["unequal"], xy, allocator=method) for _ in range(2))
    np.testing.assert_array_equal(first.target_of_positioner, second.target_of_positioner)
    other = rs.allocate(PLANES["unequal"], xy, allocator=method, rng=5).target_of_positioner
    assert np.array_equal(other, first.target_of_positioner) == (method != "balanced")


def test_fiber_types_are_respected_and_recorded():
    unit = rs.Positioner(8.25 * MM, 8.25 * MM, 2 * MM)
    plane = rs.FocalPlane([[0, 0], [20, 0]] * MM, unit, fiber_type=["B+A", "B"])
    allocation = rs.allocate(plane, [[12, 0], [8, 0]] * MM, allocator="lamost_rule", fiber_type=["A", ""])
    assert (allocation.target_of_positioner.tolist(), allocation.fiber_type.tolist()) == ([0, 1], ["A", "B"])


def test_both_hands_are_used_where_the_joints_ask_for_it():
    unit = rs.Positioner(7.4 * MM, 15 * MM, 2 * MM, handedness="both", theta_range=[-10, 100] * u.deg)
    plane = rs.FocalPlane([[0, 0], [100, 0]] * MM, unit)
    allocation = rs.allocate(plane, [[0, 15], [115, 0]] * MM, allocator="lamost_rule")
    assert allocation.target_of_positioner.tolist() == [0, 1]
    assert allocation.handedness.tolist() == ["right", "left"]
    arms = allocation.place_arms(plane)
    assert ((np.rad2deg(arms.theta) > -10) & (np.rad2deg(arms.theta) < 100)).all()


def test_nothing_in_reach_is_not_an_error():
    allocation = rs.allocate(PLANES["equal"], [[500, 0], [np.nan, 0]] * MM, allocator="balanced")
    assert allocation.n_assigned == 0
    assert rs.allocate(PLANES["equal"], np.empty((0, 2)) * MM, allocator="lamost_rule").n_assigned == 0


LATTICES = [
    ("lamost", 8.25, 8.25, 25.6, 1.5070, 4, 0.00241),
    ("sdss_apo", 7.4, np.hypot(14.965, 0.376), 22.4, 3.2035, 1, 0.0406),
    ("desi", 3.0, 3.0, 10.4, 1.2074, 5, 0.00239),
    ("pfs", 2.375, 2.375, 8.0, 1.2789, 1, 0.278),
    ("moons", 8.0, 17.0, 25.058, 3.1428, 1, 0.0432),
]


@pytest.mark.parametrize(("name", "l1", "l2", "pitch", "multiplicity", "per_cell", "empty"), LATTICES)
def test_patrol_multiplicity_and_empty_positioners(presets, name, l1, l2, pitch, multiplicity, per_cell, empty, rng):
    """On an infinite lattice, m = 4 pi l1 l2 / cell.

    With t Poisson targets per cell, exp(-t m) of the positioners reach none.
    """
    unit, cell = presets[name].focal_plane.positioner, np.sqrt(3) / 2 * pitch**2
    assert 4 * np.pi * l1 * l2 / cell == pytest.approx(multiplicity, abs=7e-5)
    area = np.pi * (unit.outer_radius.value**2 - unit.inner_radius.value**2)
    assert area / cell == pytest.approx(multiplicity, abs=7e-5)
    # the targets are periodic, so that every positioner of a wide lattice is an interior one
    plane = rs.FocalPlane.hexagonal(unit, rings=40, pitch=pitch * MM)
    half = np.abs(plane.arrays.xy).max() + unit.outer_radius.value
    alone, seen, total = 0, 0, 0
    for _ in range(10):
        n = rng.poisson(per_cell * (2 * half) ** 2 / cell)
        counts = np.diff(plane.reachable(rng.uniform(-half, half, (n, 2)) * MM).indptr)
        alone, seen, total = alone + (counts == 0).sum(), seen + counts.sum(), total + len(counts)
    assert np.exp(-per_cell * multiplicity) == pytest.approx(empty, rel=3e-3)
    # neighbors share targets, so that 5 binomial errors are about 4 true errors
    assert alone / total == pytest.approx(empty, abs=5 * np.sqrt(empty / total))
    assert seen / total == pytest.approx(per_cell * multiplicity, rel=0.01)


NONE = np.full(7, -1)
REFUSED = [
    ({"allocator": "best"}, "unknown allocator 'best'; choose one of: .*balanced, .*lamost_rule"),
    ({"priority": [1, 2]}, r"priority must have one value per target, shape \(1,\), got \(2,\)"),
    ({"priority": [np.nan]}, "priority must be a finite number for every target, but 1 of 1 rows"),
    ({"priority": [np.inf]}, "priority must be a finite number for every target, but 1 of 1 rows"),
    ({"xy": [[0, 0]]}, "xy must be a Quantity"),
    ({"requirements": "instrument"}, "requirements='instrument' can be used only with an instrument"),
    (
        {"requirements": "sky=1", "sky_separation": 3 * u.arcsec},
        "sky_separation=3.0 arcsec can be used only with an instrument",
    ),
    ({"sky_separation": 3 * u.s}, "or a length on the focal plane such as 0.5 .* got <Quantity 3. s>"),
    ({"start": 5}, "start must be an Allocation, a Tile or the name of an allocator, got 5"),
    ({"objective": "most"}, "unknown objective 'most'"),
    ({"time_limit": 5}, "time_limit must be a Quantity"),
    # allocators that change the problem, and answers with claims that are not valid
    ({"allocator": lambda problem: problem.xy.fill(0)}, "failed: ValueError: assignment destination is read-only"),
    (
        {"allocator": lambda _: AllocationAnswer(NONE, levels=[("science", 5.0, 5.0)])},
        "levels must contain the values of the objectives of the",
    ),
    ({"allocator": lambda _: AllocationAnswer(NONE, queues=(np.zeros(2), np.zeros(0)))}, "queues must contain indptr"),
]


@pytest.mark.parametrize(("options", "message"), REFUSED)
def test_wrong_input_is_refused(options, message):
    refused(message, flat.allocate, PLANES["equal"], **{"xy": [[0, 0]] * MM, "allocator": "repair", **options})


def test_options_say_what_differs_from_the_default():
    assert repr(rs.AllocationOptions()) == "AllocationOptions('repair')"
    changed = rs.AllocationOptions("optimal", requirements=np.array(["sky=2", "standard=1"]), parked_obstacles=False)
    names = "(Requirement('sky=2'), Requirement('standard=1'))"
    assert repr(changed) == f"AllocationOptions('optimal', requirements={names}, parked_obstacles=False)"
    assert changed.record["requirements"] == ["sky=2", "standard=1"]
    assert pickle.loads(pickle.dumps(changed)) == changed


def test_a_fiber_type_for_all_may_be_a_broadcast_array():
    plane = rs.FocalPlane([[0, 0]] * u.mm, PLANES["equal"].positioner, fiber_type=["A+B"])
    plan = rs.allocate(plane, [[8, 0], [0, 8]] * u.mm, fiber_type=np.broadcast_to("B", 2), allocator="balanced")
    assert (plan.fiber_type.tolist(), plan.target_fiber_type.tolist()) == (["B"], ["B", "B"])


def test_the_time_limit_reaches_the_plan_to_begin_with():
    seen = []

    def look(problem):
        seen.append(problem.time_limit)
        return np.full(len(problem.focal_plane), -1)

    options = rs.AllocationOptions("repair", start="optimal", time_limit=0.5 * u.s).for_instrument(None)
    assert options.seconds == 0.5
    rs.allocate(PLANES["equal"], [[0, 0]] * u.mm, allocator=rs.AllocationOptions(look, time_limit=2 * u.s))
    assert seen == [2.0]


def test_what_holds_for_one_field_is_refused_for_several():
    plane, sky = PLANES["equal"], SkyCoord([0, 0.1] * u.deg, [0, 0] * u.deg)
    own = rs.AllocationOptions("repair", start=rs.allocate(plane, [[0, 0]] * u.mm, allocator="balanced"))
    refused("for a survey, start must be the name of an", rs.plan_survey, sky, "moons", sky, allocator=own)
    refused("for place_tiles, start must be the name of an", rs.place_tiles, sky, "moons", allocator=own)
    options = rs.AllocationOptions(requirements="sky=2")
    refused("requirements", rs.collision_probability, plane, method="quadrature", allocator=options)


def test_stuck_fibers_keep_their_sky_in_an_answer_that_is_handed_on():
    robot = PLANES["equal"].positioner
    plane = rs.FocalPlane([[0, 0], [25.6, 0]] * u.mm, robot, stuck=[[0, 90], [np.nan, np.nan]] * u.deg)
    options, xy = {"requirements": "sky=2", "sky_separation": 1 * u.mm}, [[30, 3], [28, -4]] * u.mm
    for start in ("lamost_rule", "network_flow", "optimal"):
        own = rs.AllocationOptions(lambda problem: problem.start(), start=start, **options)
        expected = rs.allocate(plane, xy, allocator=rs.AllocationOptions(start, **options))
        got = rs.allocate(plane, xy, allocator=own)
        assert got.target_of_positioner.tolist() == expected.target_of_positioner.tolist()
        assert [level[:2] for level in got.levels] == [level[:2] for level in expected.levels]
