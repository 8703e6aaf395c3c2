"""The slow methods of finding collisions: cases in which they agree with the exact method, and cases in which they must
fail.
"""

from dataclasses import replace
from fractions import Fraction

import astropy.units as u
import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st
from raising import refused

import rfpsurvey as rs
from oracles import closer_than, squared_distance
from rfpsurvey._kernels import batch as reference
from rfpsurvey._kernels import collisions
from rfpsurvey.collision import METHODS, place_arms
from scenes import MM, SCENES, lamost_like, random_tips, sdss_like

METHODS_HERE = [m for m in METHODS if m != "cuda"]  # the exact method has separate tests


def pairs_of(report):
    return {tuple(p) for p in report.pairs.tolist()}


def sampled_distance(first, second, n):
    return np.sqrt(reference.sampled_squared(np.array([first, second], dtype=float).T.copy(), 0, 1, n))


@pytest.mark.parametrize("method", METHODS_HERE)
def test_all_methods_find_a_clear_collision_and_nothing_else(method):
    """Two stretched arms point toward each other, and a third arm is far from both."""
    plane, tips = sdss_like(rings=1), np.full((7, 2), np.nan)
    tips[2], tips[3], tips[4] = plane.arrays.xy[2] - [15, 0], plane.arrays.xy[3] + [10, 0], plane.arrays.xy[4] - [11, 1]
    report = rs.find_collisions(plane, tips * MM, method=method)
    assert report.pairs.tolist() == [[3, 4]]
    assert report.in_collision.tolist() == [False, False, False, True, True, False, False]
    assert (report.n_borderline is None) == (method != "exact")


@pytest.mark.parametrize("plane", [lamost_like(), sdss_like()], ids=["equal arms", "unequal arms"])
def test_sampled_arms_are_never_nearer_and_agree_with_many_points(plane, rng):
    missed, spacing = 0, plane.positioner.eccentric_arm.value / 399
    for _ in range(10):
        tips = random_tips(plane, rng, part=0.9)
        exact = rs.find_collisions(plane, tips)
        coarse, fine = (rs.find_collisions(plane, tips, method="sampled", n_points=n) for n in (3, 400))
        assert pairs_of(coarse) <= pairs_of(fine) <= pairs_of(exact)
        missed += len(exact.pairs) - len(coarse.pairs)
        np.testing.assert_array_equal(fine.pairs, exact.pairs)
        delta, excess = exact.distances.value, (fine.distances - exact.distances).value
        bound = np.where(delta > 0, np.sqrt(delta**2 + spacing**2 / 4) - delta, np.inf)
        assert ((excess > -1e-12) & (excess <= bound + 1e-12))[delta > 0].all()
    assert missed > 0


@pytest.mark.parametrize(
    ("length", "separation", "n"), [(8.25, 4.5, 3), (15.0, 5.0782, 4), (17.0, 3.2, 5), (15.0, 4.0782, 4)]
)
def test_the_crossing_condition_is_sharp(length, separation, n):
    """The condition is n > 1 + l2 / (sqrt(2) D).

    With one point less, a perpendicular crossing between points is missed.
    """
    assert n == int(np.floor(1 + length / (np.sqrt(2) * separation))) + 1
    # the midpoint between two points of one arm is on the midpoint between two points of the other arm
    for points, found in ((n - 1, False), (n, True)):
        at = length / (points - 1) / 2
        cross = (-at, 0.0, length - at, 0.0), (0.0, -at, 0.0, length - at)
        assert collisions.segments_squared(*cross[0], *cross[1]) == 0
        assert sampled_distance(*cross, points) == pytest.approx(np.sqrt(2) * at)
        assert (sampled_distance(*cross, points) < separation) == found


@given(st.floats(0, 1), st.floats(0, 1), st.floats(0, np.pi), st.sampled_from([(8.25, 4.5), (15, 5.0782), (17, 3.2)]))
def test_enough_points_never_miss_a_crossing(s, t, angle, arm):
    length, separation = arm
    n = int(np.floor(1 + length / (np.sqrt(2) * separation))) + 1
    ux, uy = np.cos(angle), np.sin(angle)
    first = (-s * length, 0, (1 - s) * length, 0)
    second = (-t * length * ux, -t * length * uy, (1 - t) * length * ux, (1 - t) * length * uy)
    assert sampled_distance(first, second, n) < separation


def test_the_distance_error_of_sampled_arms_is_sharp():
    """The largest error occurs for parallel arms that are shifted by half the distance of their points."""
    for n in (4, 9, 65):
        for delta in (0.01, 1.0, 5.0):
            h = 15 / (n - 1)
            got = sampled_distance((0, 0, 15, 0), (h / 2, delta, 15 + h / 2, delta), n)
            assert got == pytest.approx(np.sqrt(delta**2 + h**2 / 4), rel=1e-12)


def test_no_number_of_points_is_enough_for_every_grazing_pair():
    for n in (9, 65, 1001):
        h, delta = 15 / (n - 1), 5.0
        limit = (delta + np.sqrt(delta**2 + h**2 / 4)) / 2
        first, second = (0.0, 0.0, 15.0, 0.0), (h / 2, delta, 15 + h / 2, delta)
        assert np.sqrt(collisions.segments_squared(*first, *second)) < limit < sampled_distance(first, second, n)


@pytest.mark.parametrize("name", ["equal arms", "unequal arms", "capsules", "troubles", "fiber tips", "both hands"])
def test_no_method_misses_what_it_must_find(name, rng):
    """Sweeping finds every collision, and more."""
    (plane, options), n_found, n_swept = SCENES[name], 0, 0
    for _ in range(5):
        tips = random_tips(plane, rng, 0.8)
        exact, sampled, swept, scipy = (
            pairs_of(rs.find_collisions(plane, tips, method=m, n_points=9, **options))
            for m in ("exact", "sampled", "sweep", "scipy")
        )
        assert sampled <= exact <= swept
        assert scipy == exact
        n_found, n_swept = n_found + len(exact), n_swept + len(swept)
    assert n_found > 0
    assert n_swept > (1.5 if name in ("equal arms", "unequal arms") else 0) * n_found


@pytest.mark.parametrize("method", METHODS_HERE)
@pytest.mark.parametrize("plane", [lamost_like(), sdss_like()], ids=["equal arms", "unequal arms"])
def test_the_mirror_image_has_the_same_pairs(plane, method, rng):
    """Mirror the elbows, the y coordinates and the parked arms."""
    mirrored = replace(plane, xy=plane.xy * [1, -1])
    for _ in range(3):
        tips = random_tips(plane, rng, 0.9)
        here = rs.find_collisions(plane, tips, method=method, n_points=9)
        there = rs.find_collisions(mirrored, tips * [1, -1], method=method, n_points=9, handedness="left")
        np.testing.assert_array_equal(there.pairs, here.pairs)
        np.testing.assert_allclose(there.distances.value, here.distances.value, atol=1e-9)


def test_a_swept_capsule_keeps_its_angle():
    """Between 90 and 0 deg, a capsule bent by 40 deg passes a neighbor, and a capsule bent by -40 deg does not."""
    shape = {"arm_model": "capsule", "arm_length": 8 * MM, "home": [90, 0] * u.deg}
    for angle, n in ((40, 1), (-40, 0)):
        unit = rs.Positioner(4 * MM, 4 * MM, 1 * MM, arm_angle=angle * u.deg, **shape)
        plane = rs.FocalPlane([[0, 0], [-5, 19]] * MM, unit, stuck=[[np.nan, np.nan], [-90, 0]] * u.deg)
        pose = {"theta": [0, np.nan] * u.deg, "phi": [0, np.nan] * u.deg}
        assert len(rs.find_collisions(plane, **pose).pairs) == 0
        assert len(rs.find_collisions(plane, **pose, method="sweep").pairs) == n


def test_an_arm_that_does_not_move_does_not_sweep():
    """The stuck arm points away. If it had moved from its parked position, it would have met its neighbor."""
    unit = rs.Positioner(8 * MM, 8 * MM, 2 * MM, home=[180, 0] * u.deg)
    for stuck, n in (([0, 0], 0), ([150, 0], 1)):
        plane = rs.FocalPlane([[0, 0], [20, 0]] * MM, unit, stuck=[[np.nan, np.nan], stuck] * u.deg)
        pose = {"theta": [60, np.nan] * u.deg, "phi": [0, np.nan] * u.deg}
        assert len(rs.find_collisions(plane, **pose, method="sweep").pairs) == n


def test_sweeping_goes_the_short_way_round():
    """From 100 to -79 deg, the arm passes the neighbor at 0 deg. From 100 to -81 deg, it rotates through 180 deg."""
    unit = rs.Positioner(8 * MM, 8 * MM, 3 * MM, home=[100, 180] * u.deg)
    plane = rs.FocalPlane([[0, 0], [20, 0]] * MM, unit, disabled=[False, True])
    for theta, n in ((-79, 1), (-81, 0)):
        pose = {"theta": [theta, np.nan] * u.deg, "phi": [0, np.nan] * u.deg}
        assert len(rs.find_collisions(plane, **pose).pairs) == 0
        assert len(rs.find_collisions(plane, **pose, method="sweep").pairs) == n


def test_four_ends_alone_miss_crossings(rng):
    """Some collisions of SDSS-V arms are crossings far from all four ends, which the exact method finds."""
    plane = sdss_like(rings=12)
    n_found = n_missed = 0
    for _ in range(20):
        tips = random_tips(plane, rng)
        report = rs.find_collisions(plane, tips)
        segments = np.ascontiguousarray(place_arms(plane, tips).segments.T)
        squared = np.empty(len(report.pairs))
        reference.endpoints(segments, *report.pairs.T.copy(), squared)
        wrong = np.sqrt(squared) >= plane.positioner.min_separation.value
        assert (report.distances.value[wrong] == 0).all()
        assert shapely.crosses(
            *(shapely.linestrings(segments.T[p[wrong]].reshape(-1, 2, 2)) for p in report.pairs.T)
        ).all()
        n_found, n_missed = n_found + len(wrong), n_missed + wrong.sum()
    assert 0.003 < n_missed / n_found < 0.02


def test_the_same_scene_in_other_units_and_far_away(rng):
    """Meters and single precision change the last digits of the distances; offsets of 1e6 mm change more digits."""
    for plane in (lamost_like(6), sdss_like(6)):
        tips, unit = random_tips(plane, rng), plane.positioner
        report = rs.find_collisions(plane, tips)
        arms = {name: getattr(unit, name).to(u.m) for name in ("central_arm", "eccentric_arm")}
        in_meters = rs.FocalPlane(plane.xy.to(u.m), replace(unit, clearance=unit.clearance.to(u.um), **arms))
        far = replace(plane, xy=plane.xy + 1e6 * MM)
        for other, moved, tolerance in ((in_meters, tips.to(u.m), 1e-11), (far, tips + 1e6 * MM, 1e-7)):
            found = rs.find_collisions(other, moved)
            np.testing.assert_array_equal(found.pairs, report.pairs)
            np.testing.assert_allclose(found.distances.value, report.distances.value, atol=tolerance)


def test_single_precision_moves_arms_by_less_than_a_micrometer_except_at_full_stretch(rng):
    plane = sdss_like(6)
    tips = random_tips(plane, rng)
    r = np.hypot(*(tips.value - plane.arrays.xy).T)
    inside = (r > 7.7) & (r < 22.3)
    tips[~inside] = np.nan * MM
    rough = place_arms(plane, tips.astype(np.float32))
    assert 1e-7 < np.abs(rough.segments - place_arms(plane, tips).segments)[inside].max() < 1e-3


@pytest.mark.parametrize(("l1", "l2"), [(8.25, 8.25), (7.4, 15.0), (15.0, 7.4)])
def test_arms_at_the_limits_of_their_reach(l1, l2):
    """For (almost) stretched and (almost) folded arms, the elbow and the tip are those of exact geometry."""
    plane = rs.FocalPlane([[0, 0]] * MM, rs.Positioner(l1 * MM, l2 * MM, 1 * MM))
    for angle in np.linspace(0, 2 * np.pi, 7):
        ux, uy = np.cos(angle), np.sin(angle)
        for r, along in ((l1 + l2, l1), (abs(l1 - l2), np.copysign(l1, l1 - l2))):
            posed = place_arms(plane, [[r * ux, r * uy]] * MM)
            # a rounding error of the radius moves the elbow by its square root
            expected = (along * ux, along * uy) if r > 0 else (l1, 0)
            np.testing.assert_allclose(posed.elbow[0], expected, atol=1e-6)
            assert np.hypot(*posed.elbow[0]) == pytest.approx(l1, rel=1e-14)
            assert np.hypot(*(posed.tip[0] - posed.elbow[0])) == pytest.approx(l2, rel=1e-12)


def test_fiber_tips_alone():
    """Two fibers collide only if the distance of their targets is less than D, for all poses of the arms."""
    unit = rs.Positioner(7.4 * MM, 15 * MM, 1 * MM, arm_model="fiber_tip")
    plane = rs.FocalPlane([[0, 0], [22.4, 0]] * MM, unit)
    for gap, n in ((1.99, 1), (2.01, 0)):
        assert len(rs.find_collisions(plane, [[11, gap / 2], [11, -gap / 2]] * MM).pairs) == n
    crossing = replace(plane, positioner=replace(unit, arm_model="elbow_to_tip"))
    assert len(rs.find_collisions(crossing, [[11, 1.005], [11, -1.005]] * MM).pairs) == 1


def test_borderline_pairs_are_counted_and_settled():
    """Parallel arms have the distance D, or a distance that is smaller by one unit in the last place."""
    unit = rs.Positioner(4 * MM, 4 * MM, 2.25 * MM)
    for gap, n in ((4.5, 0), (np.nextafter(4.5, 0), 1), (4.5 - 1e-9, 1), (4.5 + 1e-9, 0)):
        plane = rs.FocalPlane([[0, 0], [0, gap]] * MM, unit)
        report = rs.find_collisions(plane, [[8, 0], [8, gap]] * MM)
        assert (len(report.pairs), report.n_borderline) == (n, abs(gap - 4.5) < 1e-10)
        counts = rs.collision.count_collisions(plane, [[[8, 0], [8, gap]]] * MM)
        assert (counts.n_pairs[0], counts.n_borderline[0]) == (n, report.n_borderline)


@given(st.floats(0.5, 4), st.floats(0, 3), st.integers(-5, 5), st.floats(0, 15))
def test_obstacles_that_just_touch_are_settled(clearance, radius, ulps, along):
    """Circles beside, before and behind an arm differ from the clearance by a few units in the last place."""
    unit = rs.Positioner(7.4 * MM, 15 * MM, clearance * MM)
    edge = radius + clearance + ulps * np.spacing(radius + clearance)
    circles = [[7.4 + along, edge, radius], [22.4 + edge, 0, radius], [22.4 + 0.6 * edge, 0.8 * edge, radius]]
    plane = rs.FocalPlane([[0, 0]] * MM, unit, obstacles=circles * MM)
    report = rs.find_collisions(plane, [[22.4, 0]] * MM)
    arm = place_arms(plane, [[22.4, 0]] * MM).segments[0]
    expected = [
        k
        for k, (x, y, r) in enumerate(circles)
        if squared_distance(arm, (x, y, x, y)) < (Fraction(r) + Fraction(clearance)) ** 2
    ]
    assert report.obstacle_pairs[:, 1].tolist() == expected
    assert report.n_borderline > 0


def test_random_scenes_have_no_borderline_pairs(rng):
    for plane in (lamost_like(12), sdss_like(12)):
        assert rs.find_collisions(plane, random_tips(plane, rng)).n_borderline == 0


def test_arms_that_only_rounding_lets_touch():
    """The distance of the centers is twice the reach plus D. Rounding can reduce the distance of stretched tips."""
    unit = rs.Positioner(3.398 * MM, 4.381 * MM, 0.571 * MM)
    reach, separation = 3.398 + 4.381, unit.min_separation.value
    pitch = reach + reach + separation
    plane = rs.FocalPlane([[0, 0], [pitch, 0]] * MM, unit)
    assert (plane.collision_type, len(plane.neighbor_pairs())) == (1, 0)
    report = rs.find_collisions(plane, [[reach, 0], [pitch - reach, 0]] * MM)
    assert (Fraction(pitch - reach) - Fraction(reach)) < Fraction(separation)
    assert (report.pairs.tolist(), report.n_borderline) == ([[0, 1]], 1)


def test_almost_equal_arms_are_as_long_as_equal_ones():
    """If the arm lengths differ by less than 1e-9 mm, the distance of the elbow is between both lengths."""
    unit = rs.Positioner(8.0000000009 * MM, 8.0 * MM, 2 * MM)
    plane = rs.FocalPlane([[0, 0], [12.0000000005, 0]] * MM, unit)
    assert closer_than(*place_arms(plane, plane.xy).segments, 4.0)
    assert rs.find_collisions(plane, plane.xy).pairs.tolist() == [[0, 1]]


def test_sweeping_misses_nothing_at_the_limit(rng):
    """The distance of parallel arms differs from D by a few units in the last place."""
    unit, n_found = rs.Positioner(8 * MM, 8 * MM, 1.2345 * MM), 0
    for angle in rng.uniform(0, 2 * np.pi, 400):
        along = np.array([np.cos(angle), np.sin(angle)])
        gap = unit.min_separation.value * (1 + rng.integers(-3, 4) * 2.0**-53) * np.array([-along[1], along[0]])
        plane, tips = rs.FocalPlane([[0, 0], gap] * MM, unit), [16 * along, 16 * along + gap] * MM
        exact, swept = (len(rs.find_collisions(plane, tips, method=m, n_points=2).pairs) for m in ("exact", "sweep"))
        assert exact <= swept
        n_found += exact
    assert 50 < n_found < 350


def test_an_instrument_whose_arms_cannot_touch_costs_nothing(monkeypatch):
    """For collision type 1, no pairs are tested and no poses are computed, but invalid tips are reported."""
    plane = rs.FocalPlane.hexagonal(rs.Positioner(8 * MM, 8 * MM, 1 * MM), rings=2, pitch=40 * MM)
    assert (plane.collision_type, len(plane.arrays.neighbors)) == (1, 0)
    tips = plane.xy + [12, 3] * MM
    expected = rs.find_collisions(plane, tips)
    monkeypatch.setattr("rfpsurvey._instruments.find_collisions.pose_tips", None)
    monkeypatch.setattr(
        "rfpsurvey._instruments.find_collisions.METHODS",
        {name: replace(one, function=None) for name, one in METHODS.items()},
    )
    for method in METHODS:
        report = rs.find_collisions(plane, tips, method=method)
        assert report.pairs.shape == (0, 2)
        assert report.counted.all()
        assert report.n_borderline == expected.n_borderline == 0
    refused("out of reach", rs.find_collisions, plane, tips * 2)


def test_pairs_do_not_depend_on_the_order_of_positioners(rng):
    for plane in (lamost_like(5), sdss_like(5)):
        tips, order = random_tips(plane, rng, 0.9), rng.permutation(len(plane))
        report = rs.find_collisions(plane, tips)
        shuffled = rs.find_collisions(
            replace(plane, xy=plane.xy[order], **dict.fromkeys(("id", "spectrograph", "fiber_type", "disabled"))),
            tips[order],
        )
        assert pairs_of(shuffled) == {tuple(sorted(p)) for p in np.argsort(order)[report.pairs].tolist()}
        assert shuffled.pairs.tolist() == sorted(shuffled.pairs.tolist())


@pytest.mark.parametrize("n_points", [1, 2.5, "many", None, 10**20])
def test_n_points_must_make_sense(n_points):
    with pytest.raises(rs.InputError, match="n_points must be a whole number from 2 to 10000"):
        rs.find_collisions(lamost_like(1), np.full((7, 2), np.nan) * MM, n_points=n_points)
