"""Why positioners have no target, against a search that moves one arm at a time and reports its collisions."""

from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from raising import refused

import rfpsurvey as rs
from rfpsurvey._assignment.allocation import IdleReason
from rfpsurvey.allocation import IDLE_REASONS, find_idle_reasons

EQUAL = rs.Positioner(8.25 * u.mm, 8.25 * u.mm, 2.25 * u.mm)
BOTH = replace(EQUAL, handedness="both")
UNEQUAL = rs.Positioner(7.4 * u.mm, 15 * u.mm, 1.5 * u.mm, handedness="both")
OBSTACLES = [[12, 3, 4], [-20, -8, 3]] * u.mm


def planes():
    """Return focal planes with all features that affect which target an arm can observe."""
    plain = rs.FocalPlane.hexagonal(EQUAL, rings=3, pitch=14 * u.mm)
    n = len(plain)
    disabled, stuck = np.zeros(n, dtype=bool), np.full((n, 2), np.nan)
    disabled[[3, 17]] = True
    stuck[[5, 20]] = [[40, 60], [170, 100]]
    xy = plain.arrays.xy * u.mm
    types = np.where(np.arange(n) % 3 == 0, "A", np.where(np.arange(n) % 3 == 1, "B", "A+B"))
    return {
        "plain": plain,
        "both elbows": rs.FocalPlane(xy, BOTH, obstacles=OBSTACLES),
        "not all usable": rs.FocalPlane(xy, EQUAL, disabled=disabled, stuck=stuck * u.deg),
        "fiber types": rs.FocalPlane(xy, EQUAL, fiber_type=types),
        "unequal arms": rs.FocalPlane(1.1 * xy, UNEQUAL, obstacles=OBSTACLES, disabled=disabled),
    }


def search(plane, plan, types):
    """Return reasons with numbers of targets, and the colliding arms of each attempt, from single moves."""
    found, attempts = {}, {}
    points = plan.xy[: plan.n_given].to_value(u.mm)
    elbows = ("right", "left") if plane.positioner.handedness == "both" else (plane.positioner.handedness,)
    inner, outer = plane.arrays.inner_radius, plane.arrays.outer_radius
    for i in np.flatnonzero(plan.target_of_positioner < 0).tolist():
        r = np.hypot(*(points - plane.arrays.xy[i]).T)
        fits = np.array([t in ("", *str(plane.fiber_type[i]).split("+")) for t in types])
        reach = np.flatnonzero((r >= inner[i]) & (r <= outer[i]) & fits)
        movable = not plane.disabled[i] and not plane.arrays.is_stuck[i]
        free = [t for t in reach.tolist() if t not in plan.target_of_positioner]
        for t in free if movable else ():
            for elbow in elbows:
                tips, sides, fibers = plan.tips.copy(), plan.handedness.copy(), plan.fiber_type.copy()
                tips[i], sides[i], fibers[i] = plan.xy[t], elbow, types[t]
                report = rs.find_collisions(
                    plane, tips, handedness=sides, fiber_type=fibers, parked_obstacles=plan.parked_obstacles
                )
                others = report.colliding_with[i] + [-1 - k for j, k in report.obstacle_pairs.tolist() if j == i]
                attempts.setdefault((i, t), []).append(sorted(others, reverse=True))
        own = [a for (j, _), each in attempts.items() if j == i for a in each]
        if not movable:
            reason = IdleReason.DISABLED if plane.disabled[i] else IdleReason.STUCK
        elif len(reach) == 0:
            reason = IdleReason.NO_TARGET_IN_REACH
        elif not free:
            reason = IdleReason.ALL_TARGETS_ARE_ASSIGNED
        else:
            reason = IdleReason.ALL_FREE_TARGETS_COLLIDE if all(own) else IdleReason.FREE_TARGET
        found[i] = (int(reason), len(reach) * movable, len(free) * movable)
    return found, {key: sorted(each) for key, each in attempts.items()}


@pytest.mark.parametrize("name", planes())
def test_reasons_are_those_of_a_search_over_single_moves(name):
    plane, seen = planes()[name], set()
    for seed in range(6):
        rng, n = np.random.default_rng(seed), (6, 40, 40, 70, 70, 40)[seed]
        points = rng.uniform(-55, 55, (n, 2))
        types = rng.choice(["", "A", "B"], n) if name == "fiber types" else np.full(n, "")
        options = rs.AllocationOptions(("optimal", "lamost_rule")[seed % 3 == 2], parked_obstacles=seed % 2 == 0)
        given = types if name == "fiber types" else None
        plan = rs.allocate(plane, points * u.mm, fiber_type=given, allocator=options)
        result = find_idle_reasons(plane, plan, plan.place_arms(plane))
        reasons, attempts = search(plane, plan, types)
        columns = (result.positioner, result.reason, result.n_in_reach, result.n_free)
        assert {i: tuple(rest) for i, *rest in np.transpose(columns).tolist()} == reasons
        made = {}
        for own, target, others in zip(result.owner.tolist(), result.target.tolist(), result.blocked_by, strict=True):
            made.setdefault((own, target), []).append(others)
        assert {key: sorted(each) for key, each in made.items()} == attempts
        seen |= set(result.reason.tolist())
    common = {IdleReason.NO_TARGET_IN_REACH, IdleReason.ALL_TARGETS_ARE_ASSIGNED, IdleReason.ALL_FREE_TARGETS_COLLIDE}
    assert common <= seen
    if name == "not all usable":
        assert {IdleReason.DISABLED, IdleReason.STUCK} <= seen


def test_a_free_target_that_does_not_collide_is_reported():
    plane, xy = rs.FocalPlane([[0, 0], [40, 0]] * u.mm, EQUAL), [[5, 0], [45, 0]] * u.mm
    plan = rs.allocate(plane, xy, allocator=lambda _: np.array([0, -1]))
    found = find_idle_reasons(plane, plan, plan.place_arms(plane))
    assert (found.positioner.tolist(), found.reason.tolist()) == ([1], [IdleReason.FREE_TARGET])
    assert (found.target.tolist(), found.blocked_by) == ([1], [[]])
    assert len(IDLE_REASONS) == len(IdleReason)
    full = rs.allocate(plane, xy, allocator="balanced")  # no positioner is idle
    assert [len(column) for column in find_idle_reasons(plane, full, full.place_arms(plane))] == [0] * 7
    other = rs.FocalPlane([[0, 0]] * u.mm, EQUAL)
    refused("allocation must have the 1 positioner", find_idle_reasons, other, full, full.place_arms(plane))
