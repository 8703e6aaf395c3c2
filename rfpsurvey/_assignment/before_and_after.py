"""Steps before and after an allocator: candidates to omit, plans that are given, and sky positions that are added."""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import scipy  # its subpackages are imported on first use

from rfpsurvey._assignment.answer import AllocationAnswer
from rfpsurvey._assignment.problem import AllocationProblem
from rfpsurvey._instruments.find_collisions import obstacle_tests, touching
from rfpsurvey._instruments.reach import Reach
from rfpsurvey._kernels import allocation as kernels
from rfpsurvey._kernels import arms as gaps
from rfpsurvey._sky.arrays import has_role
from rfpsurvey.errors import InputError, warn


def place_segments(
    problem: AllocationProblem, owner: np.ndarray, target: np.ndarray, side: np.ndarray, idle: np.ndarray | None = None
) -> np.ndarray:
    """Return the segments, shape (4, n), that represent the arms of positioners in tests for collisions.

    Each fiber is at its target. ``owner``, ``target`` and ``side`` contain the row of the positioner, the row of the
    target, and the elbow (+1: right, -1: left) for each segment. ``idle`` contains the indices of the segments of idle
    arms, one for each positioner of the focal plane; the targets of these segments are ignored.
    """
    columns = problem.focal_plane.arrays
    # the row -1 of idle arms is clipped to 0
    points = problem.xy.take(target, axis=0, mode="clip") if len(problem.xy) else np.full((len(owner), 2), np.nan)
    segments = columns.segments_of(owner, problem.fiber_of(owner, target), points, side)
    if idle is not None:
        segments[:, idle] = columns.idle_segments(problem.parked_obstacles)
    return segments


# Each positioner keeps at least its N_BEST best targets, and N_SPREAD further targets of the same class as the last of
# the best targets.
N_BEST, N_SPREAD = 64, 64
# Number of reachable pairs for which arm poses are computed at the same time.
BATCH = 1 << 18


class Preselection(NamedTuple):
    """The reachable pairs (positioner, target) that remain after the preselection."""

    reach: Reach
    code: np.ndarray  # code of each target; targets that count toward the same requirements have the same code
    shortened: np.ndarray  # whether targets were omitted, for each positioner and code, shape (n_positioners, n_codes)
    n_left_out: int


def preselect(problem: AllocationProblem, *, collide: bool, keep_target: np.ndarray | None = None) -> Preselection:
    """Return the reachable pairs (positioner, target) that contain the best targets of each positioner.

    Targets that count toward the same requirements have the same code. If k other positioners reach targets of a
    positioner, they can observe at most k of its targets. At least one of the positioner's best k + 1 targets of each
    code is therefore always free. If arms may collide, the best plan of the kept pairs is therefore as good as the best
    plan of all pairs. If arms must not collide, the best plan of the kept pairs may be worse; `replaceable` is used to
    find an upper limit of the difference.

    Parameters
    ----------
    problem : AllocationProblem
        The allocation problem.
    collide : bool
        Whether collisions are forbidden. If so, more targets are kept, and targets at which the arm touches an obstacle
        are omitted.
    keep_target : ndarray of int, shape (n_positioners,), optional
        For each positioner, the target that is always kept, or -1 if there is no such target.
    """
    plane, reach = problem.focal_plane, problem.pairs
    if collide and problem.motion is not None:
        reach = problem.motion.reachable(reach)
    n, n_rivals = reach.n_positioners, plane.arrays.n_sharing
    n_best, n_spread = (N_BEST, N_SPREAD) if collide else (0, 0)
    count = np.bincount(reach.owner, minlength=n)
    if not (count > np.maximum(n_rivals + 1, n_best + n_spread)).any():
        return Preselection(reach, np.zeros(len(problem.xy), dtype=np.int64), np.zeros((n, 1), dtype=bool), 0)
    code, n_codes = _codes(problem)
    most, n_spread = np.maximum(n_rivals + 1, n_best // n_codes), n_spread // n_codes
    if collide:
        reach = _without_obstacles(problem, reach, count > most + n_spread)
    return _select(problem, reach, most, code, n_codes, n_spread, keep_target)


def best_pairs(problem: AllocationProblem, most: int) -> Reach:
    """Return the reachable pairs of each positioner and its ``most`` best targets."""
    reach, code = problem.pairs, np.zeros(len(problem.xy), dtype=np.int64)
    return _select(problem, reach, np.full(reach.n_positioners, most), code, 1, 0, None).reach


def _select(problem, reach, most, code, n_codes, n_spread, keep_target) -> Preselection:
    """Return the ``most`` best targets of each positioner for each code, and ``n_spread`` further targets."""
    keep, shortened = np.empty(len(reach.owner), dtype=bool), np.empty(len(most) * n_codes, dtype=bool)
    start = np.concatenate([[0], np.cumsum(np.repeat(most, n_codes))])
    wanted = np.full(len(most), -1) if keep_target is None else keep_target
    n_kept = kernels.select_pairs(
        reach.indptr, reach.owner, reach.r2, problem.rank, code, n_codes, start, n_spread, wanted, keep, shortened
    )
    return Preselection(reach.where(keep), code, shortened.reshape(-1, n_codes), len(keep) - n_kept)


def replaceable(preselection: Preselection, owner, target, rank, n_rivals, n_elbows) -> np.ndarray:
    """Mark the kept candidates that can replace omitted candidates in every plan.

    An omitted target is no better than the kept targets of its positioner and code. At most ``n_rivals`` other
    positioners share targets with the positioner. Therefore, one of its last ``n_rivals + 1`` kept targets is always
    free. Suppose that arms at these last targets, and at all targets of the same or a later class, cannot collide.
    Replacing any omitted target in a plan by one of these kept targets then gives a plan that is at least as good.

    Parameters
    ----------
    preselection : Preselection
        The pairs that were kept.
    own, target, rank : ndarray of int, shape (n,)
        Positioner, target (-1 for idle arms) and class of each candidate.
    n_rivals : ndarray of int, shape (n_positioners,)
        Number of other positioners that can share a target with each positioner.
    n_elbows : int
        Number of candidates that one positioner can have for one target.

    Returns
    -------
    ndarray of bool, shape (n,)
        Whether each candidate can replace omitted candidates in every plan.
    """
    shortened = preselection.shortened
    n_codes = shortened.shape[1]
    real = np.flatnonzero(target >= 0)
    cell = owner[real] * n_codes + preselection.code[target[real]]
    real = real[shortened.ravel()[cell]]
    cell = owner[real] * n_codes + preselection.code[target[real]]
    order = np.lexsort((rank[real], cell))
    real, cell = real[order], cell[order]
    end = np.searchsorted(cell, np.arange(shortened.size), side="right")
    begin = np.searchsorted(cell, np.arange(shortened.size))
    first = np.maximum(end - n_elbows * (np.repeat(n_rivals, n_codes) + 1), begin)
    is_replaceable = np.zeros(len(owner), dtype=bool)
    is_replaceable[real] = rank[real] >= rank[real[np.minimum(first, len(real) - 1)]][cell]
    return is_replaceable


def _codes(problem):
    """Return the code of each target, and the number of codes.

    Targets that count toward the same requirements, and are neighbors for the same rules, have the same code.
    """
    columns = [column for group in problem.groups for column in (group.targets, group.untyped) if column is not None]
    columns = list({id(column): column for column in columns}.values())
    if problem.any_required:
        columns.append(problem.is_required)
    kinds = {kind for rule in problem.distributions for kind in ("science", rule.what)}
    columns += [has_role(problem.kind, kind) | (problem.category == kind) for kind in sorted(kinds)]
    plane = problem.focal_plane
    several = plane.spectrograph.ndim > 1 and any(need.per == "spectrograph" for need in problem.requirements)
    if problem.several_fiber_types and several:  # the spectrograph depends on the fiber type
        columns.append(np.unique(problem.fiber_type, return_inverse=True)[1].reshape(-1))
    code, n = np.zeros(len(problem.xy), dtype=np.int64), 1
    for column in columns:
        used, code = np.unique(code * (int(column.max(initial=0)) + 1) + column, return_inverse=True)
        code, n = code.reshape(-1).astype(np.int64), len(used)
    return code, n


def _without_obstacles(problem, reach, crowded):
    """Omit pairs whose arm touches an obstacle in each possible pose; only ``crowded`` positioners are tested."""
    plane = problem.focal_plane
    pairs = plane.arrays.obstacle_pairs
    pairs = pairs[crowded[pairs[:, 0]]]
    if len(pairs) == 0:
        return reach
    touched = np.zeros(len(reach.owner), dtype=bool)
    near = np.zeros(len(plane), dtype=bool)
    near[pairs[:, 0]] = True
    rows = np.flatnonzero(near[reach.owner])
    target = reach.target[rows]
    for begin in range(0, len(rows), BATCH):
        part, points = rows[begin : begin + BATCH], problem.xy[target[begin : begin + BATCH]]
        owner, free = reach.owner[part], np.zeros(len(part), dtype=bool)
        test = obstacle_tests(pairs, owner)
        both_elbows = plane.positioner.handedness == "both"
        fiber = problem.fiber_of(owner, target[begin : begin + BATCH])
        for side in (1.0, -1.0) if both_elbows else (plane.arrays.sides(points[:1], owner[:1])[0],):
            hit = np.zeros(len(part), dtype=bool)
            segments = place_segments(problem, owner, target[begin : begin + BATCH], np.full(len(part), side))
            hit[touching(plane, segments, test, owner)[0][:, 0]] = True
            free |= ~hit & (plane.arrays.poses_allowed(owner, points, side, fiber) if both_elbows else True)
        touched[part] = ~free
    return reach.where(~touched)


TOLERANCE_MM = 1e-6
"""Largest distance of a target from its position in the plan of a tile."""


def is_plan(start: object) -> bool:
    """Return whether ``start`` is a plan, and not the name of an allocator."""
    return hasattr(start, "target_of_positioner") or hasattr(start, "table")


LOST = -2
"""Target of a positioner whose target in a given plan is not in the problem, or not available to the positioner."""


def from_tile(table, problem, ids: np.ndarray | None) -> AllocationAnswer:
    """Return the plan of a tile for a problem; the target of a positioner can be ``LOST``.

    Targets are found by their identifiers ``ids``, or by their positions if there are none; sky positions that were
    added are always found by their positions.
    """
    plane, n = problem.focal_plane, len(problem.focal_plane)
    columns = ("id", "status", "target_id", "tip_x", "tip_y", "elbow_x", "elbow_y")
    lacking = [name for name in columns if name not in table.colnames]
    if lacking or len(table) != n or not np.array_equal(np.asarray(table["id"]).astype(str), plane.id.astype(str)):
        raise InputError("start must be a tile with the same positioners, got a tile with other positioners")
    tip, elbow = (
        np.column_stack([table[f"{part}_{axis}"].to_value("mm") for axis in "xy"]) for part in ("tip", "elbow")
    )
    had = (np.asarray(table["status"]) == "assigned") & np.isfinite(tip).all(axis=1)
    owner, target_of = np.flatnonzero(had), np.where(had, LOST, -1)
    target = _at(problem.xy, tip[owner])
    if ids is not None:
        order = np.argsort(ids.astype(str), kind="stable")
        names, wanted = ids.astype(str)[order], np.asarray(table["target_id"]).astype(str)[owner]
        place = np.minimum(np.searchsorted(names, wanted), max(len(names) - 1, 0))
        same = names[place] == wanted if len(names) else np.zeros(len(owner), dtype=bool)
        target = np.where(same, order[place] if len(names) else -1, np.where(target >= len(ids), target, -1))
    pairs = problem.pairs
    can = (target >= 0) & np.isin(target * n + owner, pairs.target * n + pairs.owner) & plane.arrays.usable[owner]
    target_of[owner[can]] = target[can]
    if owner.size and not can.any() and len(problem.xy):
        warn("no fiber of the tile in start has a target that it can keep; the tile has other targets or another field")
    (ax, ay), (bx, by) = (elbow - plane.arrays.xy).T, (tip - elbow).T
    return AllocationAnswer(target_of, np.where(ax * by - ay * bx < 0, "left", "right"))


def _at(xy: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return the row of the target at each point; -1 if there is none."""
    rows, known = np.full(len(points), -1), np.flatnonzero(np.isfinite(xy).all(axis=1))
    if len(points) and len(known):
        apart, place = scipy.spatial.cKDTree(xy[known]).query(points)
        rows = np.where(apart <= TOLERANCE_MM, known[place], -1)
    return rows


def changes_of(before: np.ndarray, owner: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Return the cost of each pair of a positioner and a target: 0 if the pair is in the given plan, otherwise 1 or 2.

    ``before`` is the target of each positioner in the given plan. For all plans with the same number of targets, the
    sum of the costs is the number of changed fibers plus the same constant.
    """
    return np.where(before[owner] == target, 0.0, np.where(before[owner] == -1, 2.0, 1.0))


def from_allocation(start, problem, n_given: int, in_reach: np.ndarray, order: np.ndarray | None) -> AllocationAnswer:
    """Return the plan of an allocation of the same targets; ``order`` is the catalog row of each target."""
    rows = slice(None) if order is None else order
    plane, points = problem.focal_plane, problem.xy[:n_given]
    same = (len(start.target_of_positioner), start.n_given) == (len(plane), n_given)
    same = same and np.array_equal(start.in_reach[rows], in_reach)
    same = same and np.array_equal(start.xy_mm[:n_given][rows], points, equal_nan=True)
    if same:
        owner = np.flatnonzero((start.target_of_positioner >= 0) & plane.arrays.usable)
        columns = plane.arrays.using(plane.arrays.index_of(start.fiber_type))
        r = np.hypot(*(start.tips_mm[owner] - columns.xy[owner]).T)
        slack, (inner, outer) = columns.reach_slack, columns.edges
        same = not ((r > outer[owner] + slack) | (r < inner[owner] - slack)).any()
        side = np.where(start.handedness[owner] == "left", -1.0, 1.0)
        tips = start.tips_mm[owner]
        same = same and (columns.poses_free or columns.poses_allowed(owner, tips, side).all())
    if not same:
        raise InputError("start must be an allocation of the same targets to the same focal plane")
    target_of = np.where(start.target_of_positioner < start.n_given, start.target_of_positioner, -1)
    if order is not None:
        target_of = np.append(np.argsort(order), -1)[target_of]
    return AllocationAnswer(target_of, start.handedness)


def with_changes(problem, answer: AllocationAnswer, before: np.ndarray) -> AllocationAnswer:
    """Return an answer with the number of positioners that have another target than in the given plan, or none."""
    after = answer.target_of_positioner
    counted = problem.focal_plane.arrays.usable | (before != -1)
    return answer._replace(meta={**(answer.meta or {}), "n_changed": int(((before != after) & counted).sum())})


# Number of points that are tested for each positioner, and largest number of blank points that are kept for each
# positioner.
N_TRIALS, N_KEPT = 64, 4


def find_sky(plane, points: np.ndarray, separation: float, fiber_types: list[str]) -> tuple[np.ndarray, ...]:
    """Return sky positions at least ``separation`` (mm) from all points, for each fiber type ("" means any type).

    These are the positioner, the position and the fiber type of each sky position, and whether a stuck fiber observes
    it.
    """
    x, y = np.ascontiguousarray(points.T)
    grid = _bin(plane, x, y, separation)
    cx, cy = plane.arrays.xy.T.copy()
    # A van der Corput sequence: for every k, the first k points are spread evenly.
    k = np.arange(N_TRIALS)
    fraction = (sum((k >> b & 1) / (2 << b) for b in range(6)) + 0.5 / N_TRIALS).astype(float)
    parts, taken = [], np.zeros(len(plane), dtype=bool)
    for name in fiber_types:
        able = np.array([name == "" or name in row.split("+") for row in plane.fiber_type.tolist()])
        owner = np.flatnonzero(able & plane.arrays.usable)
        room = len(owner) * N_KEPT
        out = np.empty(room, dtype=np.int64), np.empty(room), np.empty(room)
        fiber = None if name == "" else np.full(len(plane), plane.fiber_types.index(name))
        columns = plane.arrays.using(fiber)
        n = gaps.find_gaps(owner, cx, cy, *columns.edges, fraction, N_KEPT, separation, x, y, grid, *out)
        owner, px, py = (column[:n] for column in out)
        spots = np.column_stack([px, py])
        keep = ~columns.is_hidden(spots)
        if not columns.poses_free:
            keep &= columns.poses_allowed(owner, spots, columns.sides(spots, owner))
        owner, spots = owner[keep], spots[keep]
        # A stuck fiber observes one position, which is known only for its first fiber type. If it is also broken, it
        # observes nothing.
        seeing = plane.arrays.is_stuck & ~plane.disabled & ~taken
        fixed = np.flatnonzero(seeing & ((name == "") | (plane.arrays.first_type == name)))
        seen = plane.arrays.idle(False).segments[2:, fixed].T
        clear = np.array([gaps.is_clear(*p, separation, x, y, *grid) for p in seen], dtype=bool)
        taken[fixed[clear]] = True
        for rows, points_of, stuck in ((owner, spots, False), (fixed[clear], seen[clear], True)):
            parts.append((rows, points_of, np.full(len(rows), name), np.full(len(rows), stuck)))
    return tuple(np.concatenate(column) for column in zip(*parts, strict=True))


def with_sky(
    problem: AllocationProblem, separation: float, avoided: np.ndarray, excludes: Callable | None = None
) -> AllocationProblem:
    """Return the problem; if a requirement or rule counts sky positions, add sky positions between the targets.

    The added positions are at least ``separation`` (mm) from all targets and from the points ``avoided``. The function
    ``excludes`` returns which positions must not be added, from the positions (mm) and the fiber types.
    """
    fibers = list(dict.fromkeys(need.fiber_type for need in problem.options.needs if need.what == "sky"))
    if not fibers:
        return problem
    plane, n = problem.focal_plane, len(problem.xy)
    sky = find_sky(plane, np.vstack([problem.xy, avoided]), separation, fibers)
    if excludes is not None:
        allowed = ~excludes(sky[1], None if plane.fiber_types == ("",) else sky[2])
        sky = (column[allowed] for column in sky)
    owner, points, wanted, stuck = sky
    k, usable = len(owner), ~stuck
    added = {"xy": points, "rank": np.full(k, len(problem.classes)), "kind": np.full(k, "sky", dtype="U8")}
    if problem.category.strides != (0,):
        # The category of the positions is "sky" only if targets have this category; otherwise, only the kind is "sky".
        added["category"] = np.full(k, "sky" if np.any(problem.category == "sky") else "")
    if problem.any_required:
        added["is_required"] = np.zeros(k, dtype=bool)
    if problem.subpriority is not None:
        added["subpriority"] = np.full(k, problem.subpriority.min(initial=0.0))
    if plane.fiber_types != ("",):  # any fiber can observe a position without a type: the first one of its positioner
        added["fiber_type"] = np.where(wanted == "", plane.arrays.first_type[owner], wanted)
    columns = dict.fromkeys(("category", "is_required", "fiber_type"))
    columns |= {name: np.concatenate([getattr(problem, name), values]) for name, values in added.items()}
    reach, r2 = problem.pairs, ((points - plane.arrays.xy[owner]) ** 2).sum(axis=1)
    ends = reach.indptr[-1] + np.cumsum(usable)
    parts = (reach.indptr, ends), (reach.owner, owner[usable]), (reach.r2, r2[usable])
    pairs = Reach(*map(np.concatenate, parts), len(plane))
    watched = np.full(len(plane), -1)
    watched[owner[stuck]] = n + np.flatnonzero(stuck)
    return replace(problem, pairs=pairs, watched=watched if stuck.any() else None, **columns)


def _bin(plane, x, y, separation):
    """Sort targets into grid cells; return the grid as (x0, y0, size, nx, ny, start, order)."""
    margin = plane.arrays.largest_radius[:, None] + separation
    low, high = (plane.arrays.xy - margin).min(axis=0), (plane.arrays.xy + margin).max(axis=0)
    size = max(separation, float(np.sqrt(np.prod(high - low) / max(len(x), 1))), float((high - low).max()) / 4096)
    nx, ny = (int(n) for n in (high - low) // size + 1)
    start, order = np.zeros(nx * ny + 1, dtype=np.int64), np.empty(len(x), dtype=np.int64)
    grid = float(low[0]), float(low[1]), size, nx, ny, start, order
    gaps.bin_points(x, y, *grid)
    return grid
