"""Arms whose two joints turn at constant rates, compared with distances at many times."""

import os
from types import SimpleNamespace

import astropy.units as u
import numpy as np
import pytest
import shapely
from moving import MovingArm, TwoJoints, outline_distance, outline_parts, refined, segment_distance, two_joint_distance
from outlined import DESI_LIKE

import rfpsurvey as rs
from rfpsurvey._instruments.outline import make_outline
from rfpsurvey._instruments.path_arms import bodies_of
from rfpsurvey._kernels import collisions, joint_motion
from rfpsurvey._kernels.motion import TOLERANCE

MM = u.mm
N_BLOCK = 500  # pairs of arms in a block
N_BLOCKS = int(os.environ.get("RFPSURVEY_MOTIONS", 40))
SEGMENTS = collisions.limits(1.0, 20.0, 500.0)
ALL = pytest.mark.exhaustive


def blocks(few, total):
    return [*range(few), *(pytest.param(k, marks=ALL) for k in range(few, total))]


def bodies_from(arms, reach=None, central=0.0):
    """Return the sizes of `TwoJoints` in the form that the kernels require."""
    x, y, l1, inner, length = np.array([(arm.x, arm.y, arm.l1, arm.inner, arm.length) for arm in arms]).T.copy()
    return joint_motion.Bodies(x, y, l1, inner, length, length.copy() if reach is None else reach, central)


def come_near(one, two, separation, limits=SEGMENTS, reach=None, central=0.0, first=0):
    """Call the kernel for the arms 0 and 1, or the positioners ``first`` and ``first + 1`` of an outline."""
    poses = [(arm.theta, arm.theta_rate, arm.psi, arm.psi_rate) for arm in (one, two)]
    bodies = bodies_from((one, two), reach, central)
    return joint_motion.come_near(bodies, limits, 0, *poses[0], 1, *poses[1], float(separation))


def random_arm(rng, x, y):
    length, angles, rates = rng.uniform(1, 20), rng.uniform(-np.pi, np.pi, 2), rng.uniform(-np.pi, np.pi, 2)
    rates *= rng.random(2) > 0.1
    inner = length * rng.choice([0.0, 0.0, rng.random(), 1.0])
    l1 = rng.uniform(0, 12) * (rng.random() > 0.05)
    return TwoJoints(x, y, l1, angles[0], rates[0], angles[1], rates[1], inner, length)


def anything(rng):
    return random_arm(rng, *rng.uniform(-15, 15, 2)), random_arm(rng, *rng.uniform(-15, 15, 2))


def in_step(rng):
    """Return arms with the same angles and rates, so that their distance is constant or almost constant."""
    one = random_arm(rng, 0.0, 0.0)
    x, y = rng.uniform(-12, 12, 2)
    return one, one._replace(x=x, y=y, psi=one.psi + rng.choice([0.0, 1e-12, 1e-9, 1e-6, 1e-3]))


def translating(rng):
    """Return an arm whose joints rotate against each other, so that its direction remains the same."""
    one, two = anything(rng)
    return one._replace(psi_rate=0.0), two._replace(psi_rate=rng.choice([0.0, two.psi_rate]))


def rigid(rng):
    """Return arms that turn around their centers without a change of phi."""
    one, two = anything(rng)
    return one._replace(psi_rate=one.theta_rate), two._replace(psi_rate=two.theta_rate)


def one_at_rest(rng):
    one, two = anything(rng)
    return one, two._replace(theta_rate=0.0, psi_rate=0.0)


def at_rest(rng):
    return tuple(arm._replace(theta_rate=0.0, psi_rate=0.0) for arm in anything(rng))


def mirrored(rng):
    """Return arms that are mirror images of each other, so that they meet at the mirror."""
    x = rng.uniform(0, 18)
    one = random_arm(rng, -x, 0.0)
    two = one._replace(x=x, theta=np.pi - one.theta, theta_rate=-one.theta_rate, psi=np.pi - one.psi)
    return one, two._replace(psi_rate=-one.psi_rate)


def crossing(rng):
    """Return a long arm that sweeps over another arm with the largest rates."""
    one, two = random_arm(rng, 0.0, 0.0), random_arm(rng, *rng.uniform(-14, 14, 2))
    one = one._replace(length=20.0, theta_rate=np.pi, psi_rate=np.pi * rng.choice([-2, -1, 1, 2]))
    return one, two


def grazing(rng):
    """Return a tip that moves along a straight line or a circle beside the end of an arm at rest."""
    one = random_arm(rng, 0.0, 0.0)
    psi, l1, length = rng.uniform(-np.pi, np.pi), one.l1 + 1, one.l1 + 1  # the tip moves along a line
    one = one._replace(l1=l1, length=length, theta=psi, psi=psi + np.pi, inner=0.0)
    one = one._replace(theta_rate=(rate := rng.uniform(0.5, 3)), psi_rate=-rate)
    tip = 2 * l1 * np.sin(rate * rng.random()) * np.array([-np.sin(psi), np.cos(psi)])
    two = random_arm(rng, 0.0, 0.0)
    end = np.array([np.cos(psi), np.sin(psi)]) * rng.uniform(0, 6) - tip
    return one, two._replace(x=end[0], y=end[1], l1=0.0, theta_rate=0.0, psi=psi, psi_rate=0.0)


def far_away(rng):
    one, two = KINDS[rng.integers(len(KINDS) - 1)](rng)
    x, y = rng.choice([-1, 1], 2) * rng.uniform(200, 500, 2)
    return one._replace(x=one.x + x, y=one.y + y), two._replace(x=two.x + x, y=two.y + y)


KINDS = (anything, in_step, translating, rigid, one_at_rest, at_rest, mirrored, crossing, grazing, far_away)


def close_to(rng, least):
    """Return a separation that is close to a distance, or to this distance minus the tolerance."""
    away = rng.choice([1e-9, 10.0 ** rng.uniform(-9, -2)]) * rng.choice([-1, 1])
    return max(least + away - rng.choice([0.0, TOLERANCE]), 0.0)


def check(found, least, separation, *details):
    """Check the distance that a kernel returned against the least distance at many times."""
    if np.isinf(found):
        assert least >= separation, details
    else:
        assert found <= separation + TOLERANCE, details
        assert least - 1e-9 <= found, details
        assert least <= separation + TOLERANCE + 1e-9, details


@pytest.mark.parametrize("block", blocks(4, N_BLOCKS))
def test_segments_that_come_near_do_so_at_some_time_and_others_at_no_time(block):
    rng, n_near, n = np.random.default_rng([11, block]), 0, 2500 if block >= 4 else 400
    for k in range(N_BLOCK):
        one, two = KINDS[k % len(KINDS)](rng)
        least = two_joint_distance(one, two, n=n, rounds=1)
        separation = close_to(rng, least) if k % 3 else rng.uniform(0, 6) * (rng.random() > 0.1)
        found = come_near(one, two, separation)
        if found < least - 1e-9:
            least = two_joint_distance(one, two, n=20_000, rounds=4)
        check(found, least, separation, one, two, separation)
        n_near += np.isfinite(found)
    assert 0.3 * N_BLOCK < n_near < 0.8 * N_BLOCK


def body_that_stops(rng):
    """Return an arm whose central arm is faster than its eccentric arm and stops before the tip of an arm at rest."""
    one, two = (random_arm(rng, 0.0, 0.0) for _ in (0, 1))
    rate = -rng.uniform(0.5, 3)  # the farthest vertex of the body is on this side
    angle, far = one.theta + rate - np.deg2rad(rng.uniform(42, 65)), rng.uniform(7.2, 8.2)
    two = two._replace(x=far * np.cos(angle) - 3, y=far * np.sin(angle), theta=0.0, theta_rate=0.0)
    two = two._replace(psi=angle + np.pi, psi_rate=0.0)
    return one._replace(theta_rate=rate, psi=angle + np.pi, psi_rate=0.0), two


def outlined(arm, t, own):
    """Return the arm at the times t in the form that `outline_distance` requires."""
    return MovingArm(*arm.elbow(t), arm.psi, arm.psi_rate, 0.0, arm.length, own)


def test_long_arms_without_a_separation_are_found():
    """The direction of a vector of 1e-6 mm between long arms is uncertain, so that gaps along it can be negative."""
    rng, times, n_crossing = np.random.default_rng(15), np.linspace(0, 1, 500), 0
    for _ in range(1000):
        psi, theta, away = rng.uniform(-3, 3), rng.uniform(-3, 3), 10 ** rng.uniform(-5.95, -5)
        one = TwoJoints(0.0, 0.0, 1000.0, rng.uniform(-3, 3), 0.0, psi, rng.uniform(-1e-3, 1e-3), 0.0, 1000.0)
        along, (x, y) = rng.uniform(-500, 500), one.elbow(0.0)
        x, y = x + along * np.cos(psi) - away * np.sin(psi), y + along * np.sin(psi) + away * np.cos(psi)
        two = one._replace(x=x - 1000 * np.cos(theta), y=y - 1000 * np.sin(theta), theta=theta)
        turn = rng.choice([0.0, 1e-9, -1e-9, np.pi])
        two = two._replace(psi=psi + turn, psi_rate=rng.choice([-1, 1]) * 10.0 ** rng.uniform(-6, 0))
        if segment_distance(one.segment(times), two.segment(times)).min() == 0:
            n_crossing += 1
            assert come_near(one, two, 0.0) < np.inf, (one, two)
    assert n_crossing > 200


@pytest.mark.parametrize("block", blocks(1, 20))
def test_outlines_that_come_near_do_so_at_some_time_and_others_at_no_time(block):
    rng, n_near, n_pairs = np.random.default_rng([12, block]), 0, 60 if block == 0 else 100
    shape, times = DESI_LIKE.outline, np.linspace(0, 1, 301 if block == 0 else 2001)
    reach, length = np.full(2, shape.reach[0]), shape.length.to_value(MM)
    for k in range(n_pairs):
        one, two = (body_that_stops if k % 3 == 0 else KINDS[k % 8])(rng)
        one, two = (arm._replace(l1=3.0, inner=0.0, length=length) for arm in (one, two))
        xy = np.array([[one.x, one.y], [two.x, two.y]])
        plane = SimpleNamespace(positioner=DESI_LIKE, xy=xy * MM)

        def at(t, plane=plane, one=one, two=two):
            angles = (arm.psi + t * arm.psi_rate for arm in (one, two))
            return outline_distance(plane, outlined(one, t, 0), outlined(two, t, 1), *angles)

        speed = sum(9 * abs(arm.theta_rate) + reach[0] * abs(arm.psi_rate) for arm in (one, two))
        least = refined(at, times, speed, 3)
        # the kernel moves in steps that are shorter than the gap, which takes long close to the tolerance
        away = rng.choice([0.1, 1e-2, 1e-3, 1e-4]) * rng.choice([-1, 1, 1])
        separation = max(least + away, 1e-3) if k % 2 or k % 3 == 0 else rng.uniform(0.01, 3)
        outline = make_outline(shape, xy, np.full(2, 3.0))
        limits = collisions.limits(separation + outline.offset, 3.0, 500.0, outline, 1e-9)
        found = come_near(one, two, separation + outline.offset, limits, reach, shape.reach[1]) - outline.offset
        if np.isinf(found):
            assert least >= separation, (one, two, separation)
        else:
            assert found <= separation + TOLERANCE + 1e-12
            assert least <= separation + TOLERANCE + 1e-6, (one, two, separation)
        n_near += np.isfinite(found)
    assert 0.2 * n_pairs < n_near < 0.9 * n_pairs


def test_absent_arms_come_near_to_nothing():
    """Angles or rates of absent arms are NaN; arms at rest do not move, however close they are."""
    one = TwoJoints(0.0, 0.0, 3.0, 0.0, 0.1, 0.2, 0.3, 0.0, 3.4)
    shape = DESI_LIKE.outline
    outline = make_outline(shape, np.zeros((2, 2)), np.full(2, 3.0))
    limits = collisions.limits(outline.offset + 1, 3.4, 500.0, outline, 1e-9)
    obstacles = np.array([[3.0, 0.0, 1.0]])
    for separation, kind, size in ((1.0, SEGMENTS, {}), (1.0 + outline.offset, limits, {"reach": np.full(2, 4.0)})):
        assert come_near(one, one, separation, kind, **size) < np.inf
        for name in ("x", "theta", "psi", "theta_rate", "psi_rate"):
            absent = one._replace(**{name: np.nan})
            if name in ("theta", "psi"):  # the rates of a path with NaN are also NaN
                absent = absent._replace(**{f"{name}_rate": np.nan})
            assert come_near(absent, one, separation, kind, **size) == np.inf
            assert come_near(one, absent, separation, kind, **size) == np.inf
            pose = absent.theta, absent.theta_rate, absent.psi, absent.psi_rate
            bodies = bodies_from((absent, one), **size)
            assert joint_motion.comes_near_obstacle(bodies, kind, 0, *pose, obstacles, 0, 1.0) == np.inf
    still = one._replace(theta_rate=0.0, psi=0.0, psi_rate=0.0)
    beside = still._replace(y=1 + 1e-5)
    assert come_near(still, beside, 1.0) == np.inf
    assert come_near(still, beside._replace(y=1.0), 1.0 - 1e-7) < np.inf


OBSTACLES = {
    "circles": {"obstacles": [[9, 3, 1.5], [-4, -8, 0.01], [2, 1, 3]] * MM},
    "polygons": {
        "obstacle_polygons": (
            [[-12, 6], [12, 6], [12, 6.5], [-12, 6.5]] * MM,
            [[5, -9], [8, -5], [4, -6]] * MM,
            [[-9, -1], [-4, -1], [-4, 2], [-9, 2]] * MM,
        )
    },
}
UNITS = {
    "segment": rs.Positioner(5 * MM, 6 * MM, 1 * MM),
    "fiber tip": rs.Positioner(5 * MM, 6 * MM, 1 * MM, arm_model="fiber_tip"),
    "capsule": rs.Positioner(5 * MM, 6 * MM, 1 * MM, arm_model="capsule", arm_length=5 * MM, arm_angle=3 * u.deg),
    "outline": DESI_LIKE,
}


@pytest.mark.parametrize("kind", OBSTACLES)
@pytest.mark.parametrize("name", UNITS)
@pytest.mark.parametrize("block", blocks(1, 8))
def test_arms_touch_obstacles_at_some_time_or_at_no_time(name, kind, block):
    rng, unit = np.random.default_rng([13, block, len(name)]), UNITS[name]
    n_near, n_tests = 0, 30 if block == 0 else 100
    plane = rs.FocalPlane([[0, 0]] * MM, unit, **OBSTACLES[kind])
    columns, times = plane.arrays, np.linspace(0, 1, 301 if block == 0 else 4001)
    bodies, _ = bodies_of(columns, np.zeros(1, int), columns.first_index)
    if kind == "circles":
        shapes = [(shapely.Point(x, y), r) for x, y, r in columns.obstacles]
    else:
        shapes = [(shapely.Polygon(polygon.value), 0.0) for polygon in plane.obstacle_polygons]
    for k in range(n_tests):
        j = k % len(shapes)
        angles, rates = rng.uniform(-np.pi, np.pi, 2), rng.uniform(-np.pi, np.pi, 2) * (rng.random(2) > 0.15)
        sizes = bodies.l1[0], angles[0], rates[0], angles[1], rates[1], bodies.inner[0], bodies.length[0]
        arm, (shape, radius) = TwoJoints(0.0, 0.0, *map(float, sizes)), shapes[j]

        def at(t, arm=arm, shape=shape, radius=radius):
            if unit.outline is None:
                return shapely.distance(shapely.linestrings(arm.segment(t)), shape) - radius
            parts = outline_parts(plane, outlined(arm, t, 0), arm.psi + t * arm.psi_rate)
            return np.min([shapely.distance(part, shape) - size for part, size, _ in parts], axis=0) - radius

        speed = joint_motion.speed_of(bodies, 0, *rates)
        least = refined(at, times, speed, 3)
        clearance = rng.uniform(0, 3)
        if k % 3 and least > 0:
            clearance = max(least + rng.choice([-1, 1]) * 10.0 ** rng.uniform(-4, -1), 0.0)
        pose = angles[0], rates[0], angles[1], rates[1]
        found = joint_motion.comes_near_obstacle(bodies, columns.limits, 0, *pose, columns.obstacles, j, clearance)
        assert least >= clearance if np.isinf(found) else found <= clearance + TOLERANCE
        assert np.isinf(found) or least <= clearance + TOLERANCE + 1e-6, (arm, j, clearance)
        n_near += np.isfinite(found)
    assert 0.2 * n_tests < n_near < 0.95 * n_tests


def random_paths(rng):
    """Return the knots of two arms: different times, common times, and times that differ by rounding."""
    common, columns = rng.uniform(0, 10, 2), []
    for k in (0, 1):
        times = [0.0, *rng.uniform(0, 10, rng.integers(0, 4)), common[0], common[1] * (1 + k * 2e-16), 10.0]
        times = np.unique(times)
        steps = rng.normal(0, 0.5, (2, len(times) - 1)) * (rng.random((2, len(times) - 1)) > 0.2)
        columns.append((times, *(rng.uniform(-3, 3) + np.append(0.0, np.cumsum(way)) for way in steps)))
    count = [len(column[0]) for column in columns]
    start = np.array([0, count[0]])
    return joint_motion.Knots(start, start + count, *(np.concatenate(v) for v in zip(*columns, strict=True))), columns


@pytest.mark.parametrize("block", blocks(1, 8))
def test_paths_come_near_if_their_pieces_do(block):
    rng, n_near, n_pairs = np.random.default_rng([14, block]), 0, 100 if block == 0 else 400
    out, pairs = np.empty(1), np.array([[0, 1]])
    for k in range(n_pairs):
        knots, columns = random_paths(rng)
        arms = [random_arm(rng, *rng.uniform(-12, 12, 2)) for _ in (0, 1)]

        def at(t, columns=columns, arms=arms):
            found = []
            for (times, *angles), arm in zip(columns, arms, strict=True):
                theta, psi = (np.interp(10 * t, times, angle) for angle in angles)
                arm = arm._replace(theta=theta, psi=psi, theta_rate=0.0, psi_rate=0.0)
                found.append(arm.segment(0.0))
            return segment_distance(*found)

        inner = [v / 10 for column in columns for v in column[0]]
        times = np.unique(np.concatenate([np.linspace(0, 1, 500 if block == 0 else 10_000), inner]))
        speed = 0.0
        for (when, *angles), arm in zip(columns, arms, strict=True):
            rates = [10 * np.abs(np.diff(angle) / np.diff(when)).max() for angle in angles]
            speed += arm.l1 * rates[0] + arm.length * rates[1]
        least = refined(at, times, min(speed, 1e4), 2)
        separation = close_to(rng, least) if k % 3 else rng.uniform(0, 6)
        joint_motion.find_near(knots, bodies_from(arms), SEGMENTS, pairs, separation, out)
        check(out[0], least, separation, knots, arms, separation)
        n_near += np.isfinite(out[0])
    assert 0.2 * n_pairs < n_near < 0.8 * n_pairs


def surroundings(bodies, separation):
    """Return two neighbors without limits and obstacles."""
    nothing, wide = np.zeros(0), np.full(2, 99.0)
    start, free = np.array([0, 1, 2]), np.ones(2, dtype=bool)
    pairs = start, np.array([1, 0]), np.full(2, separation), np.zeros(3, int), np.zeros(0, int), nothing
    return joint_motion.Surroundings(*pairs, np.zeros((0, 3)), 0.0, -wide, wide, -wide, wide, *np.zeros((2, 2)), free)


@pytest.mark.parametrize(("y", "angles"), [(30.0, [0, 0]), (-1.5, [0, 14, 0]), (-3.5, [0, 0])])
def test_paths_are_simplified_only_where_arms_remain_apart(y, angles):
    """An arm turns away from the tip of another arm and back; it keeps the part of this detour that is required."""
    times, limits = np.array([0.0, 1.0, 2.0, 3.0, 4.0]), SEGMENTS
    one = TwoJoints(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 10.0)
    # the tip of the second arm moves toward the first arm, along the y axis, and back
    two = one._replace(x=9.0, y=y, l1=1.0, psi=0.0, inner=1.0, length=1.0)
    theta = np.append(np.zeros(5), np.deg2rad([-90, 0, 90, 0, -90]))
    psi = np.append(np.deg2rad([0, 8, 14, 8, 0]), np.deg2rad([270, 180, 90, 180, 270]))
    start = np.array([0, 5])
    knots = joint_motion.Knots(start, start + 5, np.tile(times, 2), theta, psi)
    bodies = bodies_from((one, two))
    near, pairs = np.empty(1), np.array([[0, 1]])
    joint_motion.find_near(knots, bodies, limits, pairs, 1.0, near)
    assert near[0] == np.inf
    joint_motion.simplify(knots, bodies, limits, surroundings(bodies, 1.0), np.deg2rad([16.0, 5.0, 0.5]))
    rows = slice(knots.start[0], knots.stop[0])
    np.testing.assert_allclose(knots.psi[rows], np.deg2rad(angles))
    joint_motion.find_near(knots, bodies, limits, pairs, 1.0, near)
    assert near[0] == np.inf
