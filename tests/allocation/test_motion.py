from dataclasses import replace
from itertools import combinations, product

import astropy.units as u
import numpy as np
import pytest
from moving import arms_distance, circle_distance, moving_arm
from outlined import DESI_LIKE
from scipy.optimize import Bounds, LinearConstraint, milp

import rfpsurvey as rs

MM = u.mm
CAPSULE = {"arm_model": "capsule", "arm_length": 14.5 * MM, "arm_angle": {"B": 2 * u.deg, "A": -3 * u.deg}}


def hexagon(pitch, l1, l2, d, positioner=None, **options):
    names = [name for name in ("stuck", "disabled", "obstacles", "fiber_type") if name in options]
    columns = {name: options.pop(name) for name in names}
    unit = positioner or rs.Positioner(l1 * MM, l2 * MM, d * MM, **options)
    return rs.FocalPlane.hexagonal(unit, rings=1, pitch=pitch * MM, **columns)


STUCK = np.full((7, 2), np.nan)
STUCK[3] = 60, 120  # the folded arms of its neighbors can turn to all directions
SCENES = {
    "equal arms": (lambda: hexagon(18, 8.25, 8.25, 2.25), "same_duration"),
    "long arms": (lambda: hexagon(25, 8, 17, 2), "same_duration"),
    "same speed": (lambda: hexagon(25, 8, 17, 2), "same_speed"),
    "capsules": (lambda: hexagon(22.4, 7.4, 15, 2, fiber_type=["B+A"] * 4 + ["A+B"] * 3, **CAPSULE), "same_duration"),
    "fiber tips": (lambda: hexagon(11, 7, 7, 2, arm_model="fiber_tip"), "same_speed"),
    "left": (lambda: hexagon(22, 8, 14, 2, handedness="left"), "same_duration"),
    "limited": (lambda: hexagon(26, 8, 17, 2, phi_range=[-5, 165] * u.deg), "same_duration"),
    "broken": (lambda: hexagon(25, 8, 17, 2, stuck=STUCK * u.deg, disabled=np.arange(7) == 5), "same_duration"),
    "obstacles": (lambda: hexagon(25, 8, 17, 2, obstacles=[[12.5, 7.2, 1], [0, -14.4, 1.5]] * MM), "same_speed"),
    "outlines": (lambda: hexagon(8.5, 3, 3, 0.1, positioner=DESI_LIKE), "same_duration"),
}


def angles_of(plane, i, point, fiber=""):
    """Return theta and phi (radians) with which a positioner reaches a point, by the law of cosines."""
    unit = plane.positioner
    l1, l2 = unit.central_arm.to_value(MM), unit.eccentric_arm.to_value(MM)
    dx, dy = point - plane.xy[i].to_value(MM)
    phi = np.arccos(np.clip((dx**2 + dy**2 - l1**2 - l2**2) / (2 * l1 * l2), -1, 1))
    phi = -phi if unit.handedness == "left" else phi
    return np.arctan2(dy, dx) - np.arctan2(l2 * np.sin(phi), l1 + l2 * np.cos(phi)), phi


def arms_of(plane, i, points, reachable, directions):
    """Return the possible arms of a positioner: target and motion, beginning with the idle arm."""
    unit, types = plane.positioner, plane.fiber_type[i].split("+")
    sign = -1 if unit.handedness == "left" else 1
    if plane.stuck is not None and np.isfinite(plane.stuck[i]).all():
        return [(-1, moving_arm(plane, i, *plane.stuck[i].to_value(u.rad), fiber=types[0], moves=False))]
    idle = moving_arm(plane, i, 0.0, sign * np.pi, fiber=types[0], moves=False)
    if unit.central_arm != unit.eccentric_arm and not plane.disabled[i]:  # folded; otherwise, the parked pose
        away = moving_arm(plane, i, directions[i], sign * np.pi, fiber=types[0])
        idle = away._replace(angle=away.angle + away.turn, turn=0.0)
    elif not plane.disabled[i]:
        idle = moving_arm(plane, i, 0.0, sign * np.pi, fiber=types[0])
    found = [(-1, idle)]
    if not plane.disabled[i]:
        for t in np.flatnonzero(reachable[i]):
            found.append((int(t), moving_arm(plane, i, *angles_of(plane, i, points[t]), fiber=types[0])))
    return found


def best_number(plane, points, law, directions):
    """Return the largest number of targets without sampled collisions, and a function that counts collisions.

    Folded arms without a target have the given directions theta (radians).
    """
    reachable = plane.reachable(points * MM).toarray()
    arms = [arms_of(plane, i, points, reachable, directions) for i in range(len(plane))]
    keys = [(i, k) for i, mine in enumerate(arms) for k in range(len(mine))]
    column = {key: c for c, key in enumerate(keys)}
    limit, clearance = plane.positioner.numbers.separation, plane.positioner.numbers.clearance
    rows, n_ambiguous = [], 0
    options = {"same_speed": law == "same_speed", "n": 201 if plane.positioner.outline is None else 41}
    colliding = set()
    for i, j in combinations(range(len(plane)), 2):
        if np.hypot(*(plane.xy[i] - plane.xy[j]).value) > 2 * plane.arrays.arm_reach.max() + limit:
            continue
        for a, b in product(range(len(arms[i])), range(len(arms[j]))):
            one, two = arms[i][a], arms[j][b]
            if one[0] < 0 and two[0] < 0:
                continue
            least = arms_distance(plane, one[1], two[1], **options)
            n_ambiguous += limit - 1e-9 < least < limit + 1.1e-6
            if least < limit + 1e-6 or (one[0] >= 0 and one[0] == two[0]):
                rows.append([column[i, a], column[j, b]])
                colliding.add((column[i, a], column[j, b]))
    assert n_ambiguous == 0
    barred = []
    for (i, k), c in column.items():
        if arms[i][k][0] >= 0 and plane.obstacles is not None:
            gaps = [circle_distance(arms[i][k][1], one) for one in plane.obstacles.to_value(MM)]
            if min(gaps) < clearance:
                barred.append(c)
    matrix = np.zeros((len(rows) + len(plane), len(keys)))
    for r, pair in enumerate(rows):
        matrix[r, pair] = 1
    for (i, _), c in column.items():
        matrix[len(rows) + i, c] = 1
    low, most = np.append(np.full(len(rows), -np.inf), np.ones(len(plane))), np.ones(len(keys))
    most[barred] = 0
    goal = np.array([arms[i][k][0] >= 0 for i, k in keys], dtype=float)
    found = milp(
        -goal, constraints=LinearConstraint(matrix, low, 1), bounds=Bounds(0, most), integrality=np.ones_like(goal)
    )

    def collisions(target_of):
        used = [column[i, [t for t, _ in arms[i]].index(target_of[i])] for i in range(len(plane))]
        return [pair for pair in combinations(used, 2) if pair in colliding] + [c for c in used if c in barred]

    return round(-found.fun), collisions


def idle_directions(plane, points, law):
    """Return the directions of folded arms without a target, which are the same in all plans of a scene."""
    found = []

    def assign_nothing(problem):
        moves = problem.motion.moves(*np.full((2, len(plane)), -1), np.ones(len(plane)), np.arange(len(plane)))
        center = plane.xy.to_value(MM)
        found.append(np.arctan2(moves.y - center[:, 1], moves.x - center[:, 0]))
        return np.full(len(plane), -1)

    options = rs.AllocationOptions(assign_nothing, constraints=[rs.constraints.Motion("fold", law)])
    rs.allocate(plane, points * MM, allocator=options)
    return found[0]


@pytest.mark.parametrize("seed", [0, *(pytest.param(k, marks=pytest.mark.exhaustive) for k in range(1, 6))])
@pytest.mark.parametrize("scene", SCENES)
def test_the_optimum_is_that_of_an_integer_program_with_sampled_conflicts(scene, seed):
    make, law = SCENES[scene]
    plane, rng = make(), np.random.default_rng([seed, len(scene)])
    half = np.abs(plane.xy.value).max()
    points = rng.uniform(-half, half, (rng.integers(8, 16), 2))
    best, collisions = best_number(plane, points, law, idle_directions(plane, points, law))
    answers = {}
    for allocator in ("optimal", "repair"):
        options = rs.AllocationOptions(allocator, constraints=[rs.constraints.Motion("fold", law)])
        answers[allocator] = found = rs.allocate(plane, points * MM, allocator=options)
        assert collisions(found.target_of_positioner) == []
        assert found.n_assigned <= best <= found.levels[0].bound
        report = rs.collision.find_motion(plane, found, law=law)
        targets = found.target_of_positioner >= 0
        assert not targets[report.pairs].any(axis=1).any()
        assert not targets[report.obstacle_pairs[:, 0]].any()
    assert answers["optimal"].n_assigned == best == answers["optimal"].levels[0].bound


def test_ignored_idle_arms_beside_obstacles():
    """Regression: an idle arm that is ignored, and that could touch an obstacle, raised an IndexError."""
    unit = rs.Positioner(8 * u.mm, 17 * u.mm, 2 * u.mm)
    plane = rs.FocalPlane([[0, 0]] * u.mm, unit, obstacles=[[9, 0, 1]] * u.mm)
    assert rs.collision.find_motion(plane, [[np.nan] * 2] * u.mm, parked_obstacles=False).n_planner == 0


def test_idle_arms_turn_within_their_joint_limits():
    """Regression: a folded idle arm was turned to a direction outside of its range of theta."""
    unit = rs.Positioner(8 * u.mm, 17 * u.mm, 2 * u.mm)
    plane = rs.FocalPlane([[0, 0], [25, 0]] * u.mm, unit, theta_range=[[np.nan] * 2, [-10, 10]] * u.deg)
    options = rs.AllocationOptions("optimal", constraints="motion fold")
    assert (rs.allocate(plane, [[20, 0]] * u.mm, allocator=options).target_of_positioner < 0).all()
    free = rs.FocalPlane([[0, 0], [25, 0]] * u.mm, unit)
    assert rs.allocate(free, [[20, 0]] * u.mm, allocator=options).target_of_positioner.tolist() == [0, -1]


def test_a_change_of_the_elbow_with_a_limited_range_of_phi():
    """Regression: the arm would have to pass its stretched pose, which was not reported."""
    unit = rs.Positioner(
        8 * u.mm, 17 * u.mm, 2 * u.mm, theta_range=[-170, 170] * u.deg, phi_range=[-180, 180] * u.deg, handedness="both"
    )
    for robot, expected in ((unit, True), (replace(unit, phi_range=None), False)):
        plane = rs.FocalPlane([[0, 0]] * u.mm, robot)
        right, same, left = (
            rs.collision.place_arms(plane, theta=[theta] * u.deg, phi=[phi] * u.deg)
            for theta, phi in ((100, 140), (50, 60), (-100, -140))
        )
        for one, other, blocked in ((right, same, False), (left, right, expected), (right, left, expected)):
            assert rs.collision.find_motion(plane, one, before=other).blocked.tolist() == [blocked]


def test_constraints_with_different_laws_are_refused():
    """Regression: only the first of them was honored, but both were reported as met."""
    options = rs.AllocationOptions("optimal", constraints=["motion fold", "motion fold same_speed"])
    with pytest.raises(rs.InputError, match="all constraints on the motion must have the same kind and law of time"):
        rs.plan_tile(rs.example_catalog("anticenter"), "sdss_apo", "06h20m +23d", allocator=options)
    with pytest.raises(rs.InputError, match="the constraint must have the form 'motion MOTION LAW', got ''"):
        rs.AllocationOptions("optimal", constraints="motion")
