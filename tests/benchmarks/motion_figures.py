"""Collisions of arms at their targets and while they unfold, and what safe motion costs (page on motion).

Run ``python tests/benchmarks/motion_figures.py``, which takes about five minutes. The argument ``speed`` prints only
the times of the tests of pairs.
"""

import sys
import warnings
from functools import partial

import astropy.units as u
import numpy as np
from measure import timed
from tie_figures import scene

import rfpsurvey as rs
from rfpsurvey._instruments.moves import solve_moves
from rfpsurvey._kernels import conflicts, motion
from rfpsurvey._kernels.collisions import halve
from rfpsurvey.collision import find_motion

PRESETS = ("lamost", "desi", "pfs", "sdss_apo", "moons")
DENSITIES = (1, 2, 5)
SEEDS = range(3)
LIMIT = 100 * u.s


def plan(plane, xy, allocator, constraint=None, **options):
    """Return a plan, and the processor time that it takes."""
    options |= {"time_limit": LIMIT} if allocator == "optimal" else {}
    options = rs.AllocationOptions(allocator, constraints=constraint, **options)
    return timed(rs.allocate, plane, xy, allocator=options)


def collisions(plane, found):
    """Return the positioners per 1000 targets that collide: at their targets, unfolding, and also with idle arms."""
    static, moving = rs.find_collisions(plane, found), find_motion(plane, found)
    alone = find_motion(plane, found, parked_obstacles=False)
    counts = static.in_collision.sum(), alone.n_planner, moving.n_planner
    return [1000 * n / found.n_assigned for n in counts]


def rates():
    """Print the collisions of plans that ignore the motion."""
    print("positioners per 1000 targets that collide at their targets, while they unfold (idle arms ignored), and")
    print("while they unfold (with folded idle arms); for lamost_rule, repair and optimal")
    for name in PRESETS:
        for density in DENSITIES:
            rows = []
            for seed in SEEDS:
                plane, xy = scene(name, density, seed)
                plans = (plan(plane, xy, allocator)[0] for allocator in ("lamost_rule", "repair", "optimal"))
                rows.append(np.concatenate([collisions(plane, found) for found in plans]))
            values = "  ".join(f"{value:6.1f}" for value in np.mean(rows, axis=0))
            print(f"  {name:<9} {density} targets per positioner: {values}", flush=True)


def costs():
    """Print the targets of plans without and with safe motion, and the processor time."""
    print(
        "mean number of targets of optimal: static, same duration, same speed; the same without idle arms as obstacles"
    )
    print("(static, same duration); seconds of these plans; number of gaps above 0; targets of repair: static, same")
    print("duration; seconds; number of positioners that need a planner in any safe plan")
    laws = (None, "motion fold", "motion fold same_speed")
    for name in PRESETS:
        for density in DENSITIES:
            best, local, open_, planner = [], [], 0, 0
            for seed in SEEDS:
                plane, xy = scene(name, density, seed)
                found = [plan(plane, xy, "optimal", law) for law in laws]
                found += [plan(plane, xy, "optimal", law, parked_obstacles=False) for law in laws[:2]]
                repaired = [plan(plane, xy, "repair", law) for law in laws[:2]]
                open_ += sum(one.gap > 0 for one, _ in found)
                safe = [
                    find_motion(plane, one, law=law)
                    for (one, _), law in zip(found[1:3], rs.collision.LAWS, strict=True)
                ]
                planner += sum(one.n_planner for one in [*safe, find_motion(plane, repaired[1][0])])
                best.append([(one.n_assigned, seconds) for one, seconds in found])
                local.append([(one.n_assigned, seconds) for one, seconds in repaired])
            best, local = np.mean(best, axis=0).T, np.mean(local, axis=0).T
            numbers = [" ".join(f"{value:7.1f}" for value in row) for row in (best[0], local[0])]
            seconds = [" ".join(f"{value:6.2f}" for value in row) for row in (best[1], local[1])]
            parts = numbers[0], seconds[0], open_, numbers[1], seconds[1], planner
            print(f"  {name:<9} {density}: {' | '.join(map(str, parts))}", flush=True)


def speed():
    """Print the least processor time of the tests of all pairs of arms that can be near, of several runs."""
    print("nanoseconds per pair of candidates that is near enough: moving, static, ratio; number of pairs")
    for name in PRESETS:
        plane, xy = scene(name, 5, 0)
        columns, reach = plane.arrays, plane.arrays.reach(xy.to_value(u.mm))
        indptr, target, _ = reach.by_positioner
        own = np.repeat(np.arange(len(plane)), np.diff(indptr))
        points, fiber = xy.to_value(u.mm)[target], columns.first_index[own]
        side = columns.sides(points, own, fiber)
        moves, segments = solve_moves(columns, own, fiber, points, side), columns.segments_of(own, fiber, points, side)
        halves = np.empty_like(segments)
        halve(segments, halves)
        size, pairs = np.diff(indptr), columns.neighbors
        room = int((size[pairs[:, 0]] * size[pairs[:, 1]]).sum())
        first, second = np.empty((2, room), dtype=np.int64)
        borderline = np.empty(room, dtype=bool)

        lists = first, second, borderline
        static = partial(_static, columns, own, indptr, segments, halves, lists)
        moving = partial(motion.list_meeting, pairs, 0, indptr, moves, False, columns.limits, first, second)
        limit = columns.separation + motion.TOLERANCE
        rows = [np.arange(indptr[i], indptr[i + 1]) for i in range(len(plane))]
        x, y, radius = moves.circle
        n_moving = n_static = 0
        for i, j in pairs.tolist():
            a, b = rows[i][:, None], rows[j][None]
            n_moving += (np.hypot(x[a] - x[b], y[a] - y[b]) <= radius[a] + radius[b] + limit).sum()
            n_static += (
                np.hypot(halves[0, a] - halves[0, b], halves[1, a] - halves[1, b]) <= columns.limits.near
            ).sum()
        times = [min(timed(function)[1] for _ in range(5)) for function in (moving, static)]
        each = 1e9 * times[0] / n_moving, 1e9 * times[1] / n_static
        print(f"  {name:<9} {each[0]:6.0f} {each[1]:6.0f} {each[0] / each[1]:5.1f}; {n_moving}, {n_static}", flush=True)


def _static(columns, own, start, segments, halves, lists):
    n, _ = conflicts.list_conflicts(
        columns.neighbors, 0, columns.geometry, start, segments, halves, columns.limits, *lists
    )
    if columns.limits.outline.start.size > 1:
        conflicts.keep_outlined(n, own, segments, columns.limits, *lists)


if __name__ == "__main__":
    warnings.simplefilter("ignore", rs.errors.RfpsurveyWarning)  # some instruments have no parked arms
    speed()
    if "speed" not in sys.argv[1:]:
        rates()
        costs()
