"""Omit candidates of positioners that reach far more targets than a plan can use."""

from typing import NamedTuple

import numpy as np

from rfpsurvey._kernels import allocation as kernels
from rfpsurvey._roles import has_role
from rfpsurvey.allocation._problem import AllocationProblem
from rfpsurvey.collision import obstacle_tests, touching
from rfpsurvey.focal_plane import Reach


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
