from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st
from outlined import capsule
from raising import refused

import rfpsurvey as rs
from oracles import segment_distances, tip_and_elbow
from rfpsurvey._instruments.arms import nearest_distance
from rfpsurvey._kernels import collisions
from rfpsurvey.collision import place_arms
from scenes import MM, lamost_like, random_tips, sdss_like
from strategies import coarse


@pytest.mark.parametrize("method", ["exact", "scipy"])
@pytest.mark.parametrize("plane", [lamost_like(), sdss_like()], ids=["equal arms", "unequal arms"])
def test_pairs_and_distances_are_those_of_shapely(plane, method, rng):
    everyone = np.array([(i, j) for i in range(len(plane)) for j in range(i + 1, len(plane))])
    for _ in range(20):
        tips = random_tips(plane, rng, part=0.9)
        report = rs.find_collisions(plane, tips, method=method)
        arms = place_arms(plane, tips).segments
        there = everyone[np.isfinite(arms[everyone[:, 0], 0]) & np.isfinite(arms[everyone[:, 1], 0])]
        distance = segment_distances(arms, there)
        close = distance < plane.positioner.min_separation.value
        np.testing.assert_array_equal(report.pairs, there[close])
        np.testing.assert_allclose(report.distances.value, distance[close], atol=1e-12)
        np.testing.assert_array_equal(np.flatnonzero(report.in_collision), np.unique(there[close]))


@given(st.tuples(*[coarse] * 8), st.floats(0, 2 * np.pi), st.tuples(coarse, coarse))
def test_distance_does_not_depend_on_where_the_scene_is(values, angle, shift):
    pair = np.array(values, dtype=float).reshape(2, 4)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    moved = (pair.reshape(-1, 2) @ turn.T + shift).reshape(2, 4)
    before, after = (np.sqrt(collisions.segments_squared(*p.ravel())) for p in (pair, moved))
    assert after == pytest.approx(before, abs=1e-6)


def test_crossing_arms_have_distance_zero_and_collinear_arms_do_not_cross():
    """The four endpoint distances of crossing arms are 10 mm; the orientations of collinear segments are all 0."""
    assert collisions.segments_squared(-10.0, 0, 10, 0, 0, -10, 0, 10) == 0
    assert collisions.segments_squared(0.0, 0, 1, 0, 5, 0, 9, 0) == 16
    assert collisions.segments_squared(0.0, 0, 6, 0, 5, 0, 9, 0) == 0


def test_the_limit_is_strict():
    """Arms at the distance D do not collide, and arms that are slightly nearer collide.

    The reach of the arms is not a limit.
    """
    unit = rs.Positioner(4 * MM, 4 * MM, 2.25 * MM)
    for gap, n in ((4.5, 0), (4.5 - 2**-40, 1)):
        plane = rs.FocalPlane([[0, 0], [0, gap]] * MM, unit)
        assert len(plane.neighbor_pairs()) == 1
        # stretched, parallel arms at the minimum separation
        assert len(rs.find_collisions(plane, [[8, 0], [8, gap]] * MM).pairs) == n
        obstacle = rs.FocalPlane([[0, 0]] * MM, unit, obstacles=[[6, gap, 2.25]] * MM)
        assert len(rs.find_collisions(obstacle, [[8, 0]] * MM).obstacle_pairs) == n


def test_obstacles_are_measured_along_the_whole_arm(rng):
    """Compare with shapely, for circles beside the midpoint of an arm, before it and behind it."""
    unit = rs.Positioner(7.4 * MM, 15 * MM, 2 * MM)
    circles = np.column_stack([rng.uniform(-25, 25, (60, 2)), rng.uniform(0, 3, 60)])
    plane = rs.FocalPlane([[0, 0]] * MM, unit, obstacles=circles * MM)
    for _ in range(20):
        tips = random_tips(plane, rng)
        report = rs.find_collisions(plane, tips)
        arm = shapely.linestrings(place_arms(plane, tips).segments.reshape(-1, 2, 2))
        gap = shapely.distance(arm, shapely.points(circles[:, :2])) - circles[:, 2]
        assert report.obstacle_pairs[:, 1].tolist() == np.flatnonzero(gap < 2).tolist()
        np.testing.assert_allclose(report.obstacle_distances.value, np.maximum(gap[gap < 2], 0), atol=1e-12)


def test_a_long_capsule_has_more_neighbors():
    unit = rs.Positioner(4 * MM, 4 * MM, 1 * MM, arm_model="capsule", arm_length=10 * MM, arm_angle=30 * u.deg)
    plane = rs.FocalPlane([[0, 0], [28, 0]] * MM, unit)  # 2 (4 + 10) + 2 = 30 mm
    assert len(plane.neighbor_pairs()) == 1
    arms, turn = place_arms(plane, [[8, 0], [20, 0]] * MM), np.deg2rad(30)
    np.testing.assert_allclose(arms.segments[0], [4, 0, 4 + 10 * np.cos(turn), 10 * np.sin(turn)], atol=1e-9)


def test_clipped_arms_point_to_their_target():
    for target, r in (([30, 40], 22.4), ([1.5, 2.0], 7.6)):
        plane = rs.FocalPlane([[0, 0]] * MM, rs.Positioner(7.4 * MM, 15 * MM, 2 * MM))
        arms = place_arms(plane, [target] * MM, clip=True)
        np.testing.assert_allclose(arms.tip[0], [0.6 * r, 0.8 * r], atol=1e-7)
        assert np.hypot(*arms.elbow[0]) == pytest.approx(7.4)
        assert np.hypot(*(arms.tip[0] - arms.elbow[0])) == pytest.approx(15)


def test_a_larger_clearance_never_removes_a_pair(rng):
    plane = sdss_like()
    tips, before = random_tips(plane, rng), set()
    for clearance in (0, 0.5, 1.5, 2.5, 4):
        wider = replace(plane, positioner=replace(plane.positioner, clearance=clearance * MM))
        pairs = {tuple(p) for p in rs.find_collisions(wider, tips).pairs}
        assert before <= pairs
        before = pairs


def test_parked_equal_arms_stand_in_the_way():
    plane = rs.FocalPlane([[0, 0], [25.6, 0]] * MM, lamost_like(rings=0).positioner)
    # the arm reaches the parked arm of the neighbor, which extends from (25.6, 0) to its elbow
    tips, home = [[16, 0], [np.nan, np.nan]] * MM, [180, 180] * u.deg
    parked_home = replace(plane, positioner=replace(plane.positioner, home=home))
    report = rs.find_collisions(parked_home, tips)
    assert (report.pairs.tolist(), report.rate, report.rate_assigned) == ([[0, 1]], 1, 1)
    ignored = rs.find_collisions(parked_home, tips, parked_obstacles=False)
    assert (len(ignored.pairs), ignored.counted.tolist()) == (0, [True, False])
    away = rs.find_collisions(plane, tips)  # the arm parked at theta = 0 points away from the neighbor
    assert (len(away.pairs), away.counted.tolist(), away.rate) == (0, [True, True], 0)


def test_idle_unequal_arms_give_way():
    plane, tips = sdss_like(rings=1), np.full((7, 2), np.nan)
    tips[3] = plane.arrays.xy[3] + [15, 0]
    report = rs.find_collisions(plane, tips * MM)
    assert (len(report.pairs), report.counted.sum()) == (0, 1)
    assert place_arms(plane, tips * MM).present.sum() == 1


def test_disabled_and_stuck_arms_are_obstacles_but_not_counted():
    base, stuck = sdss_like(rings=1), np.full((7, 2), np.nan)
    stuck[4] = [180, 0]  # the arm is stretched toward the central positioner
    plane, tips = replace(base, stuck=stuck * u.deg), np.full((7, 2), np.nan)
    tips[3] = base.arrays.xy[3] + [20, 0]
    report = rs.find_collisions(plane, tips * MM)
    assert (report.pairs.tolist(), report.counted.tolist()) == ([[3, 4]], [False] * 3 + [True] + [False] * 3)
    assert report.rate == 1
    arms = place_arms(replace(base, disabled=np.arange(7) == 4), tips * MM)
    assert arms.present.tolist() == [False] * 3 + [True, True] + [False] * 2
    home_tip, home_elbow = tip_and_elbow(base.arrays.xy[4], 7.4, 15, 0, np.pi)
    np.testing.assert_allclose(arms.segments[4], [home_elbow.real, home_elbow.imag, home_tip.real, home_tip.imag])


def test_obstacles_count():
    """An arm collides with a circle if its distance from the edge of the circle is less than the clearance."""
    unit = rs.Positioner(4 * MM, 4 * MM, 2 * MM)
    for x, n in ((13.0, 0), (12.999, 1)):
        plane = rs.FocalPlane([[0, 0]] * MM, unit, obstacles=[[x, 0, 3], [50, 0, 3]] * MM)
        report = rs.find_collisions(plane, [[8, 0]] * MM)
        assert (len(report.obstacle_pairs), report.in_collision.tolist()) == (n, [bool(n)])
    np.testing.assert_allclose(report.obstacle_distances.value, [1.999])


def test_poses_and_tips_and_allocations_say_the_same(rng):
    plane = sdss_like()
    theta, phi = rng.uniform(-180, 180, len(plane)), rng.uniform(0, 180, len(plane))
    by_pose = rs.find_collisions(plane, theta=theta * u.deg, phi=phi * u.deg)
    tips = [
        (lambda tip: (tip.real, tip.imag))(tip_and_elbow(c, 7.4, 15, t, p)[0])
        for c, t, p in zip(plane.arrays.xy, np.deg2rad(theta), np.deg2rad(phi), strict=True)
    ]
    by_tip = rs.find_collisions(plane, tips * MM)
    assert len(by_pose.pairs) > 3
    np.testing.assert_array_equal(by_pose.pairs, by_tip.pairs)
    np.testing.assert_allclose(by_pose.distances.value, by_tip.distances.value, atol=1e-9)
    mirror = replace(plane, xy=plane.xy * [1, -1])
    left = rs.find_collisions(mirror, tips * np.array([1, -1]) * MM, handedness="left")
    np.testing.assert_array_equal(left.pairs, by_tip.pairs)
    allocation = rs.allocate(plane, rng.uniform(-90, 90, (80, 2)) * MM, allocator="lamost_rule")
    again = rs.find_collisions(plane, allocation.tips)
    np.testing.assert_array_equal(rs.find_collisions(plane, allocation).pairs, again.pairs)


def test_the_capsule_is_turned_from_the_fiber():
    plane = rs.FocalPlane([[0, 0], [100, 0]] * MM, capsule(2, -2, arm=14.97), fiber_type=["B+A", "B+A"])
    arms = place_arms(plane, [[22.37, 0], [122.37, 0]] * MM, fiber_type=np.array(["B", "A"]))
    turn = np.deg2rad(2)
    expected = [7.4 + 14.7 * np.cos(turn), 14.7 * np.sin(turn)]
    np.testing.assert_allclose(arms.segments[0], [7.4, 0, *expected], atol=1e-6)
    np.testing.assert_allclose(arms.segments[1], [107.4, 0, 100 + expected[0], -expected[1]], atol=1e-6)


def test_the_capsule_of_an_arm_without_a_target_is_turned_from_its_first_fiber():
    """Regression: the arm of a stuck positioner was rotated to the fiber type that was given for it."""
    stuck = [[0, 0], [180, 0]] * u.deg
    plane = rs.FocalPlane([[0, 0], [36, 0]] * MM, capsule(2, -3), fiber_type=["B+A", "B+A"], stuck=stuck)
    x, y = 7.4 + 14.7 * np.cos(np.deg2rad(2)), 14.7 * np.sin(np.deg2rad(2))
    expected = np.array([[7.4, 0, x, y], [28.6, 0, 36 - x, -y]])
    gap = segment_distances(expected, np.array([[0, 1]]))
    for fiber_type in (None, ["B", "B"], ["A", "A"]):
        options = {"fiber_type": None if fiber_type is None else np.array(fiber_type)}
        nothing = np.full((2, 2), np.nan) * MM
        np.testing.assert_allclose(place_arms(plane, nothing, **options).segments, expected, atol=1e-9)
        report = rs.find_collisions(plane, nothing, **options)
        np.testing.assert_allclose(report.distances.to_value(u.mm), gap, atol=1e-9)


def test_nearest_distance_is_that_of_brute_force(rng):
    for plane, part in ((lamost_like(), 1.0), (sdss_like(), 0.7), (sdss_like(), 0.05), (sdss_like(), 0.0)):
        arms = place_arms(plane, random_tips(plane, rng, part))
        got, there = nearest_distance(plane, arms), np.flatnonzero(arms.present)
        assert np.isnan(got[~arms.present]).all()
        for i in there:
            pairs = np.array([(i, j) for j in there if j != i]).reshape(-1, 2)
            expected = segment_distances(arms.segments, pairs).min() if len(pairs) else np.inf
            assert got[i] == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize(
    ("length", "clearance", "step", "limit"),
    [(15.0, 2.5, 0.1, 157.27), (14.2321, 2.5, 0.1, 149.94), (14.7276, 2.0, 0.1, 149.47)],
)
def test_folded_arms_never_collide(length, clearance, step, limit, rng):
    """If phi >= arccos(((pitch - D)^2 / 4 - l1^2 - L^2) / (2 l1 L)), no two arms can touch each other."""
    unit = rs.Positioner(
        7.4 * MM, 15 * MM, clearance * MM, step=step * u.deg, arm_model="capsule", arm_length=length * MM
    )
    D = unit.min_separation.value
    phi0 = np.rad2deg(np.arccos(((22.4 - D) ** 2 / 4 - 7.4**2 - length**2) / (2 * 7.4 * length)))
    assert phi0 == pytest.approx(limit, abs=0.02)
    plane = rs.FocalPlane.hexagonal(unit, rings=3, pitch=22.4 * MM)
    n = len(plane)
    for _ in range(200):
        phi = rng.choice([phi0 + 1e-9, 180.0, rng.uniform(phi0, 180)], n)
        theta = rng.choice(np.arange(0, 360, 30), n) + rng.choice([0, rng.uniform(-15, 15)], n)
        assert len(rs.find_collisions(plane, theta=theta * u.deg, phi=phi * u.deg).pairs) == 0


def test_the_fold_bound_is_sharp():
    """At phi = 149.94 deg, full arms of 15 mm with D = 5.0782 mm can collide if elbow and tip face each other."""
    unit = rs.Positioner(7.4 * MM, 15 * MM, 2.5 * MM, step=0.1 * u.deg)
    plane = rs.FocalPlane([[0, 0], [22.4, 0]] * MM, unit)
    tip, _ = tip_and_elbow((0, 0), 7.4, 15, 0, np.deg2rad(149.94))
    assert abs(tip) > (22.4 - unit.min_separation.value) / 2
    toward = -np.rad2deg(np.angle(tip))
    report = rs.find_collisions(plane, theta=[toward, toward + 180] * u.deg, phi=[149.94, 149.94] * u.deg)
    assert report.pairs.tolist() == [[0, 1]]
    bound = np.rad2deg(np.arccos(((22.4 - 5.0781907) ** 2 / 4 - 7.4**2 - 15**2) / (2 * 7.4 * 15)))
    tip, _ = tip_and_elbow((0, 0), 7.4, 15, 0, np.deg2rad(bound + 1e-6))
    toward = -np.rad2deg(np.angle(tip))
    folded = rs.find_collisions(plane, theta=[toward, toward + 180] * u.deg, phi=[bound + 1e-6] * 2 * u.deg)
    assert len(folded.pairs) == 0


BAD_INPUT = [
    ({"tips": [[30, 0], [30, 0]] * MM}, "positioner 0: its distance from .* must be .* to .* mm, got 30 mm"),
    ({"tips": [[3, 0]] * MM}, "tips must have a row for each of the 2 positioners, got 1"),
    ({"tips": [[3, 0], [30, 0]]}, "tips must be a Quantity"),
    ({}, "either tips, or both theta and phi, must be given"),
    ({"theta": [1, 2] * u.deg}, "either tips, or both theta and phi, must be given"),
    ({"theta": [1, 2] * u.deg, "phi": [1] * u.deg}, r"phi must have the shape \(2,\)"),
    ({"tips": [[3, 0], [30, 0]] * MM, "method": "guess"}, "unknown collision method 'guess'; choose one of: "),
    ({"tips": [[3, 0], [30, 0]] * MM, "handedness": "up"}, "unknown handedness of an arm 'up'"),
]


@pytest.mark.parametrize(("arguments", "message"), BAD_INPUT)
def test_bad_input_is_named(arguments, message):
    plane = rs.FocalPlane([[0, 0], [25.6, 0]] * MM, rs.Positioner(8.25 * MM, 8.25 * MM, 2.25 * MM))
    refused(message, lambda: rs.find_collisions(plane, **arguments))


@pytest.mark.parametrize("method", ["exact", "sampled", "sweep", "scipy"])
def test_arms_that_cannot_touch_have_an_empty_report(method):
    plane = rs.FocalPlane([[0, 0], [100, 0]] * u.mm, rs.Positioner(8 * u.mm, 8 * u.mm, 2 * u.mm))
    report = rs.find_collisions(plane, plane.xy, method=method)
    assert (report.pairs.shape, report.distances.shape, report.n_borderline) == ((0, 2), (0,), 0)
    assert report.colliding_with == [[], []]
    assert not report.in_collision.any()
