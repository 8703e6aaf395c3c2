import os

import astropy.units as u
import numba
import numpy as np
import pytest
from moving import arms_distance, least_distance, moving_arm, segment_distance
from outlined import DESI_LIKE

import rfpsurvey as rs
from rfpsurvey._instruments.moves import extent
from rfpsurvey._kernels.motion import TOLERANCE, segments_meet
from rfpsurvey.collision import LAWS, find_motion

MM = u.mm
N_BLOCK = 500  # pairs of arms in a block
N_BLOCKS = int(os.environ.get("RFPSURVEY_MOTIONS", 6))


@numba.njit
def decide(one, two, separation, out):
    for k in range(len(separation)):
        a, b = one[k], two[k]
        out[k] = segments_meet(a[0], a[1], a[2], a[3], a[4], a[5], b[0], b[1], b[2], b[3], b[4], b[5], separation[k])


def random_arms(rng, n):
    length = rng.uniform(1, 20, n)
    inner = np.where(rng.random(n) < 0.3, length * np.minimum(rng.uniform(0, 2, n), 1), 0.0)
    turn = rng.uniform(0, np.pi, n) * rng.choice([-1, 1], n) * (rng.random(n) < 0.9)
    return np.column_stack([rng.uniform(-20, 20, (n, 2)), rng.uniform(-np.pi, np.pi, n), turn, inner, length])


def random_pairs(rng, n):
    """Return pairs of arms with minimum separations: random, in step, and close to the least distance."""
    one, two = random_arms(rng, n), random_arms(rng, n)
    in_step = rng.random(n) < 0.2  # parallel arms that rotate by the same angle have a constant distance of their ends
    two[in_step, 2:] = one[in_step, 2:]
    two[in_step, 2] += rng.choice([0.0, 0.0, 1e-9, 1e-4], in_step.sum())
    mirrored = ~in_step & (rng.random(n) < 0.1)
    two[mirrored, 2], two[mirrored, 3:] = np.pi - one[mirrored, 2], one[mirrored, 3:] * [-1, 1, 1]
    two[mirrored, 1] = one[mirrored, 1]
    offset = rng.uniform(-400, 400, (n, 2)) * (rng.random(n) < 0.5)[:, None]
    one[:, :2] += offset
    two[:, :2] += offset
    separation, close = rng.uniform(0, 6, n) * (rng.random(n) < 0.95), rng.random(n) < 0.5
    for k in np.flatnonzero(close):
        least = least_distance(one[k], two[k], n=200, rounds=2)
        separation[k] = max(least + rng.choice([-1, 1]) * 10.0 ** rng.uniform(-9, -2), 0.0)
    return one, two, separation


@pytest.mark.parametrize("block", [0, *(pytest.param(k, marks=pytest.mark.exhaustive) for k in range(1, N_BLOCKS))])
def test_arms_that_never_meet_keep_the_separation_and_others_miss_it_by_the_tolerance(block):
    one, two, separation = random_pairs(np.random.default_rng([7, block]), N_BLOCK)
    meets = np.empty(N_BLOCK, dtype=bool)
    decide(one, two, separation, meets)
    assert 0.2 < meets.mean() < 0.8
    for a, b, limit, collides in zip(one, two, separation, meets, strict=True):
        least = least_distance(a, b)
        if collides and least > limit + TOLERANCE:
            least = least_distance(a, b, rounds=4)
        assert least <= limit + TOLERANCE + 1e-9 if collides else least >= limit, (a, b, limit)


UNITS = {
    "elbow to tip": rs.Positioner(7 * MM, 9 * MM, 1 * MM),
    "equal": rs.Positioner(8 * MM, 8 * MM, 1 * MM),
    "left": rs.Positioner(8 * MM, 8 * MM, 1 * MM, handedness="left"),
    "capsule": rs.Positioner(
        7 * MM,
        15 * MM,
        2 * MM,
        arm_model="capsule",
        arm_length=14 * MM,
        arm_angle=2 * u.deg,
        phi_range=[-5, 170] * u.deg,
    ),
    "fiber tip": rs.Positioner(6 * MM, 7 * MM, 1 * MM, arm_model="fiber_tip"),
    "outline": DESI_LIKE,
}


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("name", UNITS)
@pytest.mark.parametrize("block", [0, *(pytest.param(k, marks=pytest.mark.exhaustive) for k in range(1, 4))])
def test_pairs_of_all_arm_models_agree_with_sampled_motions(name, law, block):
    rng, unit = np.random.default_rng([block, len(name), len(law)]), UNITS[name]
    separation, n, n_colliding = unit.numbers.separation, 20, 0
    for _ in range(n):
        apart = rng.uniform(0.7, 1.6) * unit.outer_radius.value
        plane = rs.FocalPlane([[0, 0], apart * np.array([np.cos(k := rng.uniform(0, 6)), np.sin(k)])] * MM, unit)
        theta, phi = rng.uniform(-180, 180, 2), rng.uniform(0, 165, 2)
        phi = -phi if unit.handedness == "left" else phi
        arms = rs.collision.place_arms(plane, theta=theta * u.deg, phi=phi * u.deg)
        found = find_motion(plane, arms, law=law)
        moves = [moving_arm(plane, i, *np.deg2rad([theta[i], phi[i]])) for i in (0, 1)]
        least = arms_distance(plane, *moves, n=2001 if unit.outline is None else 201, same_speed=law == "same_speed")
        assert len(found.pairs) == (least < separation + TOLERANCE), (theta, phi, apart, least)
        assert not len(rs.find_collisions(plane, arms).pairs) > len(found.pairs)
        n_colliding += len(found.pairs)
    assert block or 0 < n_colliding < n


def test_folding_after_a_plan_is_checked_like_unfolding_to_it():
    plane = rs.FocalPlane([[0, 0], [25, 0]] * MM, rs.Positioner(8 * MM, 17 * MM, 2 * MM))
    bad, good = [[16, -12], [14, 12]] * MM, [[-16, -12], [40, 12]] * MM
    assert len(rs.find_collisions(plane, bad).pairs) == 0
    assert (find_motion(plane, bad).pairs.tolist(), len(find_motion(plane, good).pairs)) == ([[0, 1]], 0)
    for arms, before in ((bad, good), (good, bad), (bad, bad)):
        report = find_motion(plane, arms, before=before)
        assert (report.pairs.tolist(), report.needs_planner.tolist()) == ([[0, 1]], [True, True])
    assert find_motion(plane, good, before=good).n_planner == 0


def test_idle_arms_stay_folded_and_turn_out_of_the_way_unless_they_are_ignored():
    plane = rs.FocalPlane([[0, 0], [25, 0]] * MM, rs.Positioner(8 * MM, 17 * MM, 2 * MM))
    away, over = [[18, 0], [np.nan, np.nan]] * MM, [[24, 0], [np.nan, np.nan]] * MM
    assert find_motion(plane, away).n_planner == 0  # with the theta of the parked pose, the tip would be at 16 mm
    assert find_motion(plane, over).pairs.tolist() == [[0, 1]]
    assert find_motion(plane, over, parked_obstacles=False).n_planner == 0


def test_parked_arms_do_not_turn_out_of_the_way():
    plane = rs.FocalPlane([[0, 0], [20, 0]] * MM, rs.Positioner(8 * MM, 8 * MM, 2 * MM, home=[180, 180] * u.deg))
    tips = [[10, 4], [np.nan, np.nan]] * MM
    assert len(rs.find_collisions(plane, tips).pairs) == len(find_motion(plane, tips).pairs) == 1


def test_folded_arms_that_can_touch_are_named():
    unit = rs.Positioner(8 * MM, 17 * MM, 2 * MM, phi_range=[0, 150] * u.deg)
    plane = rs.FocalPlane([[0, 0], [25, 0], [80, 0]] * MM, unit)  # folded arms extend to 10.9 mm
    report = find_motion(plane, [[-24, 0], [49, 0], [100, 0]] * MM)
    assert (report.touching.tolist(), report.needs_planner.tolist()) == ([[0, 1]], [True, True, False])


def test_folded_arms_turn_only_where_broken_arms_leave_space():
    """A stuck arm, which points at the center of its neighbor, leaves an arc to the folded arm of this neighbor."""
    unit = rs.Positioner(8 * MM, 14 * MM, 1 * MM)
    plane = rs.FocalPlane([[0, 0], [22, 0]] * MM, unit, stuck=[[np.nan, np.nan], [180, 20]] * u.deg)
    segment, clear = rs.collision.place_arms(plane, [[np.nan] * 2] * 2 * MM).segments[1], []
    for theta in np.deg2rad(np.arange(360)):
        elbow = 8 * np.array([np.cos(theta), np.sin(theta)])
        one = np.array([elbow, elbow - 14 * elbow / 8])
        clear.append(segment_distance(one, segment.reshape(2, 2)) - 2)
    clear = np.array(clear)
    assert clear.min() < 0 < clear[180]
    reference = None
    for theta in range(0, 360, 5):
        if abs(clear[theta]) < 0.1:
            continue
        pose = {"theta": [theta, np.nan] * u.deg, "phi": [179.0, np.nan] * u.deg}
        arms = rs.collision.place_arms(plane, **pose)
        report = find_motion(plane, arms)
        if clear[theta] < 0:
            assert report.blocked[0]
            assert report.pairs.tolist() == [[0, 1]]
            continue
        reference = (theta, arms) if reference is None and not report.blocked[0] else reference
        # the free directions form two arcs, on both sides of the stuck arm
        between = np.arange(reference[0], theta + 1)
        free = (clear[between] > 0).all() or (clear[np.r_[theta:360, : reference[0] + 1]] > 0).all()
        if abs(clear[between]).min() > 0.1 or not free:
            assert find_motion(plane, arms, before=reference[1]).blocked[0] == (not free)
            assert report.blocked[0] == (not free)
    assert reference is not None


def test_arms_turn_between_all_directions_that_they_reach_from_the_parked_pose():
    """A joint range of more than 360 deg contains the parked pose twice, in different arcs of joint angles."""
    unit = rs.Positioner(8 * MM, 14 * MM, 1 * MM, theta_range=[0, 380] * u.deg)
    plane = rs.FocalPlane([[0, 0], [22, 0]] * MM, unit, stuck=[[np.nan, np.nan], [180, 20]] * u.deg)
    poses = []
    for theta in range(0, 360, 10):
        pose = {"theta": [theta, np.nan] * u.deg, "phi": [179.0, np.nan] * u.deg}
        poses.append(rs.collision.place_arms(plane, **pose))
    reached = [pose for pose in poses if not find_motion(plane, pose).blocked[0]]
    assert 3 < len(reached) < len(poses)
    for before in reached:
        assert not any(find_motion(plane, pose, before=before).blocked[0] for pose in reached)


def test_the_extent_of_outlines_is_that_of_their_farthest_vertex(rng):
    """The distances of rotated vertices from the center are computed with complex numbers."""
    parts = [[[-1, -2], [9, -3], [8, 1], [-1, 1]], [[0, -4], [5, -4.5], [5, -3]]]
    outline = rs.positioner.ArmOutline([part * MM for part in parts])
    unit = rs.Positioner(6 * MM, 8 * MM, 1 * MM, arm_model="outline", outline=outline)
    plane = rs.FocalPlane(np.column_stack([np.arange(40) * 40, np.zeros(40)]) * MM, unit)
    angle = rng.uniform(-np.pi, np.pi, 40)
    vertices = np.concatenate(parts) @ [1, 1j]
    expected = np.abs(6 + np.exp(1j * angle)[:, None] * vertices).max(axis=1)
    np.testing.assert_allclose(extent(plane.arrays, angle, np.full(40, 9.0)), expected, rtol=1e-12)


@pytest.mark.parametrize(("model", "touching"), [("fiber_tip", []), ("elbow_to_tip", [[0, 1]])])
def test_only_the_part_of_a_folded_arm_that_can_collide_touches_other_folded_arms(model, touching):
    """Folded fiber tips are within 1 mm of the centers, and the elbows are 6 mm away from them."""
    plane = rs.FocalPlane([[0, 0], [12.5, 0]] * MM, rs.Positioner(6 * MM, 7 * MM, 1 * MM, arm_model=model))
    arms = rs.collision.place_arms(plane, theta=[120, 60] * u.deg, phi=[120, 120] * u.deg)
    assert find_motion(plane, arms).touching.tolist() == touching
