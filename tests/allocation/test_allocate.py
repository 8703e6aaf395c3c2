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
from oracles import balanced_owner, lamost_target
from rfpsurvey.allocation import METHODS

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


@given(st.sampled_from(sorted(PLANES)), TARGETS, st.integers(1, 3), st.randoms(use_true_random=False))
def test_lamost_is_the_rule_as_written(name, xy, n_classes, random):
    plane = PLANES[name]
    priority = [random.randrange(n_classes) for _ in xy]
    allocation = rs.allocate(plane, xy * MM, allocator="lamost_rule", priority=priority)
    expected = lamost_target(xy, plane.arrays.xy, reaches(plane, xy), priority)
    assert allocation.target_of_positioner.tolist() == expected


@pytest.mark.few(2)
@pytest.mark.parametrize("method", METHODS)
@given(st.sampled_from(sorted(PLANES)), TARGETS)
def test_one_target_a_positioner_and_one_positioner_a_target(method, name, xy):
    plane = PLANES[name]
    allocation = rs.allocate(plane, xy * MM, allocator=method)
    target_of, positioner_of = allocation.target_of_positioner, allocation.positioner_of_target
    for i, t in enumerate(target_of):
        assert t < 0 or positioner_of[t] == i
    for t, i in enumerate(positioner_of):
        assert i < 0 or target_of[i] == t
    can = reaches(plane, xy)
    assert all(can[i, t] for i, t in enumerate(target_of) if t >= 0)
    np.testing.assert_array_equal(np.isnan(allocation.tips[:, 0].value), target_of < 0)
    assert allocation.n_reachable == can.any(axis=0).sum()
    # no free positioner reaches an unassigned target
    if method == "lamost_rule":
        free = np.flatnonzero(target_of < 0)
        assert not can[np.ix_(free, np.flatnonzero(positioner_of < 0))].any()


def test_balanced_draws_uniformly_from_each_queue():
    plane = PLANES["equal"]
    xy = [[1, 0], [2, 0], [3, 0], [4, 0]] * MM  # all targets are in the queue of the central positioner
    draws = Counter(
        int(rs.allocate(plane, xy, rng=np.random.default_rng(k), allocator="balanced").target_of_positioner[3])
        for k in range(4000)
    )
    assert set(draws) == {0, 1, 2, 3}
    # with 3 degrees of freedom, chi-squared exceeds 21.1 once in 10^4 cases
    assert sum((n - 1000) ** 2 / 1000 for n in draws.values()) < 21.1


@pytest.mark.parametrize("method", METHODS)
def test_the_same_input_gives_the_same_allocation(method, rng):
    xy = rng.uniform(-50, 50, (60, 2)) * MM
    first, second = (rs.allocate(PLANES["unequal"], xy, allocator=method) for _ in range(2))
    np.testing.assert_array_equal(first.target_of_positioner, second.target_of_positioner)
    other = rs.allocate(PLANES["unequal"], xy, allocator=method, rng=5).target_of_positioner
    assert np.array_equal(other, first.target_of_positioner) == (method != "balanced")


def test_higher_priority_goes_first(rng):
    xy = rng.uniform(-40, 40, (300, 2))
    priority = rng.integers(0, 3, 300)
    target_of = rs.allocate(PLANES["equal"], xy * MM, allocator="lamost_rule", priority=priority).target_of_positioner
    best = np.array([priority[row].max() for row in reaches(PLANES["equal"], xy)])
    assert (priority[target_of] <= best).all()
    assert (priority[target_of] == 2).sum() >= 6
    shifted = rs.allocate(PLANES["equal"], xy * MM, allocator="lamost_rule", priority=10 * priority - 7.5)
    np.testing.assert_array_equal(shifted.target_of_positioner, target_of)


def test_fiber_types_are_respected_and_recorded():
    unit = rs.Positioner(8.25 * MM, 8.25 * MM, 2 * MM)
    plane = rs.FocalPlane([[0, 0], [20, 0]] * MM, unit, fiber_type=["B+A", "B"])
    allocation = rs.allocate(plane, [[12, 0], [8, 0]] * MM, allocator="lamost_rule", fiber_type=["A", ""])
    assert allocation.target_of_positioner.tolist() == [0, 1]
    assert allocation.fiber_type.tolist() == ["A", "B"]


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


@pytest.mark.parametrize(
    ("name", "l1", "l2", "pitch", "multiplicity", "per_cell", "empty"),
    [
        ("lamost", 8.25, 8.25, 25.6, 1.5070, 4, 0.00241),
        ("sdss_apo", 7.4, np.hypot(14.965, 0.376), 22.4, 3.2035, 1, 0.0406),
        ("desi", 3.0, 3.0, 10.4, 1.2074, 5, 0.00239),
        ("pfs", 2.375, 2.375, 8.0, 1.2789, 1, 0.278),
        ("moons", 8.0, 17.0, 25.058, 3.1428, 1, 0.0432),
    ],
)
def test_patrol_multiplicity_and_empty_positioners(presets, name, l1, l2, pitch, multiplicity, per_cell, empty, rng):
    """On an infinite lattice, m = 4 pi l1 l2 / cell.

    With t Poisson targets per cell, exp(-t m) of the positioners reach none.
    """
    unit = presets[name].focal_plane.positioner
    cell = np.sqrt(3) / 2 * pitch**2
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


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"method": "best"}, "unknown allocator 'best'; choose one of: .*balanced, .*lamost_rule"),
        ({"priority": [1, 2]}, r"priority must have one value per target, shape \(1,\), got \(2,\)"),
        ({"priority": [np.nan]}, "priority must be a finite number for every target, but 1 of 1 rows"),
        ({"priority": [np.inf]}, "priority must be a finite number for every target, but 1 of 1 rows"),
        ({"xy": [[0, 0]]}, "xy must be a Quantity"),
    ],
)
def test_bad_input_is_named(arguments, message):
    xy = arguments.pop("xy", [[0, 0]] * MM)
    refused(message, lambda: flat.allocate(PLANES["equal"], xy, **arguments))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"requirements": "instrument"}, "requirements='instrument' can be used only with an instrument"),
        (
            {"requirements": "sky=1", "sky_separation": 3 * u.arcsec},
            "sky_separation=3.0 arcsec can be used only with an instrument",
        ),
        ({"sky_separation": 3 * u.s}, "or a length on the focal plane such as 0.5 .* got <Quantity 3. s>"),
        ({"start": 5}, "start must be an Allocation, a Tile or the name of an allocator, got 5"),
        ({"objective": "most"}, "unknown objective 'most'"),
        ({"time_limit": 5}, "time_limit must be a Quantity"),
        ({"allocator": "greedy"}, "unknown allocator 'greedy'"),
    ],
)
def test_options_are_checked(options, message):
    refused(message, lambda: rs.allocate(PLANES["equal"], [[0, 0]] * u.mm, allocator=rs.AllocationOptions(**options)))


def test_options_say_what_differs_from_the_default():
    assert repr(rs.AllocationOptions()) == "AllocationOptions('repair')"
    changed = rs.AllocationOptions("optimal", requirements="sky=2", parked_obstacles=False)
    assert repr(changed) == (
        "AllocationOptions('optimal', requirements=(Requirement('sky=2'),), parked_obstacles=False)"
    )
    assert changed.record["requirements"] == ["sky=2"]
    assert pickle.loads(pickle.dumps(changed)) == changed


def test_problems_cannot_be_changed_by_an_allocator():
    def spoil(problem):
        problem.xy[:] = 0

    with pytest.raises(rs.InputError, match="failed: ValueError: assignment destination is read-only"):
        rs.allocate(PLANES["equal"], [[0, 0]] * u.mm, allocator=spoil)


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (
            lambda n: rs.allocation.AllocationAnswer(np.full(n, -1), levels=[("science", 5.0, 5.0)]),
            "levels must contain the values of the objectives of the",
        ),
        (
            lambda n: rs.allocation.AllocationAnswer(np.full(n, -1), queues=(np.zeros(2), np.zeros(0))),
            "queues must contain indptr",
        ),
    ],
)
def test_claims_of_an_answer_are_checked(answer, message):
    plane = PLANES["equal"]
    refused(message, lambda: rs.allocate(plane, [[0, 0]] * u.mm, allocator=lambda problem: answer(len(plane))))


def test_a_fiber_type_for_all_may_be_a_broadcast_array():
    plane = rs.FocalPlane([[0, 0]] * u.mm, PLANES["equal"].positioner, fiber_type=["A+B"])
    plan = rs.allocate(plane, [[8, 0], [0, 8]] * u.mm, fiber_type=np.broadcast_to("B", 2), allocator="balanced")
    assert plan.fiber_type.tolist() == ["B"]
    assert plan.target_fiber_type.tolist() == ["B", "B"]


def test_the_time_limit_reaches_the_plan_to_begin_with():
    seen = []

    def look(problem):
        seen.append(problem.time_limit)
        return np.full(len(problem.focal_plane), -1)

    options = rs.AllocationOptions("repair", start="optimal", time_limit=0.5 * u.s).for_instrument(None)
    assert options.seconds == 0.5
    rs.allocate(PLANES["equal"], [[0, 0]] * u.mm, allocator=rs.AllocationOptions(look, time_limit=2 * u.s))
    assert seen == [2.0]


def test_requirements_may_be_an_array():
    assert len(rs.AllocationOptions(requirements=np.array(["sky=2", "standard=1"])).requirements) == 2


def test_what_holds_for_one_field_is_refused_for_several():
    plane = PLANES["equal"]
    start = rs.allocate(plane, [[0, 0]] * u.mm, allocator="balanced")
    sky = SkyCoord([0, 0.1] * u.deg, [0, 0] * u.deg)
    with pytest.raises(rs.InputError, match="for a survey, start must be the name of an allocator"):
        rs.plan_survey(sky, "moons", sky, allocator=rs.AllocationOptions("repair", start=start))
    with pytest.raises(rs.InputError, match="for place_tiles, start must be the name of an allocator"):
        rs.place_tiles(sky, "moons", allocator=rs.AllocationOptions("repair", start=start))
    with pytest.raises(rs.InputError, match="requirements"):
        rs.collision_probability(plane, method="quadrature", allocator=rs.AllocationOptions(requirements="sky=2"))


def test_stuck_fibers_keep_their_sky_in_an_answer_that_is_handed_on():
    robot = PLANES["equal"].positioner
    plane = rs.FocalPlane([[0, 0], [25.6, 0]] * u.mm, robot, stuck=[[0, 90], [np.nan, np.nan]] * u.deg)
    options = {"requirements": "sky=2", "sky_separation": 1 * u.mm}
    xy = [[30, 3], [28, -4]] * u.mm
    for start in ("lamost_rule", "network_flow", "optimal"):
        own = rs.AllocationOptions(lambda problem: problem.start(), start=start, **options)
        expected = rs.allocate(plane, xy, allocator=rs.AllocationOptions(start, **options))
        got = rs.allocate(plane, xy, allocator=own)
        assert got.target_of_positioner.tolist() == expected.target_of_positioner.tolist()
        assert [level[:2] for level in got.levels] == [level[:2] for level in expected.levels]
