"""Plans with safe motion, replayed as motions of all arms: unfold, fold, and turn, with plain numpy and shapely."""

from itertools import pairwise

import astropy.units as u
import numpy as np
import pytest
from moving import MovingArm, angle_at, ends, outline_distance, segment_distance

import rfpsurvey as rs

MM = u.mm
N_STEPS = 1000
PRESETS = ("lamost", "desi", "pfs", "sdss_apo", "moons")


def patch(presets, name, rings):
    """Return a hexagon of positioners of an instrument, at the distance of its nearest positioners."""
    plane = presets[name].focal_plane
    xy = plane.xy.to_value(MM)
    pitch = np.sort(np.hypot(*(xy - xy[len(xy) // 2]).T))[1]
    types = (
        {}
        if plane.fiber_types == ("",)
        else {"fiber_type": ["+".join(plane.fiber_types)] * (1 + 3 * rings * (rings + 1))}
    )
    return rs.FocalPlane.hexagonal(plane.positioner, rings=rings, pitch=pitch * MM, **types)


def folded_direction(unit):
    return -np.pi if unit.handedness == "left" else np.pi


def motion_of(plane, found, law):
    """Return the direction theta of each arm, and its motion as a `MovingArm`."""
    unit, poses = plane.positioner, found.place_arms(plane)
    fold, arms, directions = folded_direction(unit), [], []
    l1, turned = unit.central_arm.to_value(MM), rs.collision.find_motion(plane, found, law=law).theta.to_value(u.rad)
    for i in range(len(plane)):
        has_target = poses.assigned[i]
        theta, phi = (poses.theta[i], poses.phi[i]) if has_target else (turned[i], fold)
        offset, length, inner = 0.0, unit.eccentric_arm.to_value(MM), 0.0
        if unit.arm_model in ("capsule", "outline"):
            kind = found.fiber_type[i] or plane.fiber_type[i].split("+")[0]
            offset = unit.numbers.arm_angles(plane.fiber_types)[plane.fiber_types.index(kind)]
            length = unit.numbers.arm_length
        x, y = plane.xy[i].to_value(MM)
        angle, turn = theta + phi + offset, fold - offset - phi if has_target else 0.0
        angle = angle if has_target else theta + fold
        arms.append(MovingArm(x + l1 * np.cos(theta), y + l1 * np.sin(theta), angle, turn, inner, length, i))
        directions.append(theta)
    return np.array(directions), arms


def count_unfolding(plane, arms, law):
    """Return the number of pairs of arms that are too close at one of the times while all arms unfold."""
    t, n, limit = np.linspace(0, 1, N_STEPS), 0, plane.positioner.numbers.separation
    longest = max(abs(arm.turn) for arm in arms)
    angles = np.array([angle_at(arm.angle, arm.turn, t, law == "same_speed", longest) for arm in arms])
    outline = plane.positioner.outline
    for i, j in plane.arrays.neighbors.tolist():
        one, two = arms[i], arms[j]
        if outline is None:
            shapes = (ends(arm.x, arm.y, angles[arm.own], arm.inner, arm.length) for arm in (one, two))
            n += segment_distance(*shapes).min() < limit
            continue
        some = slice(None, None, 50)  # between these times, a part of an arm moves by at most 50 steps
        slack = 50 / N_STEPS * 2 * longest * outline.reach[0]
        if outline_distance(plane, one, two, angles[i][some], angles[j][some]).min() < limit + slack:
            n += outline_distance(plane, one, two, angles[i], angles[j]).min() <= limit
    return n


def count_turning(plane, before, after):
    """Return the number of pairs of folded arms that are too close while all arms turn to new directions."""
    unit, n = plane.positioner, 0
    theta = (
        before[:, None] + np.linspace(0, 1, N_STEPS)[:: 1 if unit.outline is None else 20] * (after - before)[:, None]
    )
    l1, fold = unit.central_arm.to_value(MM), folded_direction(unit)
    length = unit.eccentric_arm.to_value(MM) if unit.numbers.arm_length is None else unit.numbers.arm_length
    for i, j in plane.arrays.neighbors.tolist():
        arms = []
        for k in (i, j):
            x, y = plane.xy[k].to_value(MM)
            elbow = x + l1 * np.cos(theta[k]), y + l1 * np.sin(theta[k])
            arms.append(MovingArm(*elbow, theta[k] + fold, 0.0, 0.0, length, k))
        if unit.outline is not None:
            n += outline_distance(plane, *arms, *(arm.angle for arm in arms)).min() <= unit.numbers.separation
        else:
            shapes = (ends(arm.x, arm.y, arm.angle, arm.inner, arm.length) for arm in arms)
            n += segment_distance(*shapes).min() < unit.numbers.separation
    return n


@pytest.mark.parametrize("n_plans", [2, pytest.param(5, marks=pytest.mark.exhaustive)])
@pytest.mark.parametrize("name", PRESETS)
def test_no_arms_collide_between_plans_with_safe_motion(presets, name, n_plans):
    plane, law = patch(presets, name, {2: 3, 5: 4}[n_plans]), rs.collision.LAWS[len(name) % 2]
    half = np.abs(plane.xy.value).max()
    states, n_without = [], 0
    for seed in range(n_plans):
        points = np.random.default_rng([seed, len(name)]).uniform(-half, half, (3 * len(plane), 2)) * MM
        allocator = ("optimal", "repair")[seed % 2]
        options = rs.AllocationOptions(allocator, constraints=rs.constraints.Motion("fold", law))
        found = rs.allocate(plane, points, allocator=options)
        assert found.n_assigned > 0.8 * len(plane)
        states.append(motion_of(plane, found, law))
        assert count_unfolding(plane, states[-1][1], law) == 0  # folding is the same motion backward
        if n_plans == 2 and seed == 0:
            plain = rs.allocate(plane, points, allocator="optimal")
            pairs = rs.collision.find_motion(plane, plain, law=law).pairs
            n_without = count_unfolding(plane, motion_of(plane, plain, law)[1], law)
            assert n_without == len(pairs)
    for (before, _), (after, _) in pairwise(states):
        assert count_turning(plane, before, after) == 0
