"""Find the reasons why positioners have no target, after the allocation."""

from enum import IntEnum
from typing import NamedTuple

import numpy as np

from rfpsurvey.allocation._allocation import Allocation
from rfpsurvey.allocation._candidates import find_conflicts, list_candidates, obstacle_hits
from rfpsurvey.allocation._motion import Motion
from rfpsurvey.allocation._options import AllocationOptions
from rfpsurvey.allocation._preselect import place_segments
from rfpsurvey.allocation._problem import AllocationProblem
from rfpsurvey.collision import Arms, joined, plan_moves
from rfpsurvey.constraints import Motion as MotionConstraint
from rfpsurvey.errors import InputError
from rfpsurvey.focal_plane import FocalPlane


class IdleReason(IntEnum):
    """Reason why a positioner has no target."""

    DISABLED = 0
    STUCK = 1
    NO_TARGET_IN_REACH = 2
    ALL_TARGETS_ARE_ASSIGNED = 3
    ALL_FREE_TARGETS_COLLIDE = 4
    FREE_TARGET = 5


IDLE_REASONS = (
    "disabled",
    "stuck",
    "no target in reach",
    "all targets in reach are assigned to other positioners",
    "at every free target in reach the arm would collide",
    "a free target in reach was not assigned",
)
"""Text for each `IdleReason`, in the same order."""


class IdleReasons(NamedTuple):
    """Reasons why positioners have no target, and the attempts to move each of these positioners to a free target.

    An attempt moves one arm, with a right or a left elbow, to a target that no positioner observes; all other arms
    remain as in the plan.

    Parameters
    ----------
    positioner : ndarray of int, shape (n_idle,)
        Rows of the positioners without a target.
    reason : ndarray of int, shape (n_idle,)
        Index of the reason in ``IDLE_REASONS`` for each idle positioner.
    n_in_reach : ndarray of int, shape (n_idle,)
        Number of targets that each idle positioner can observe, regardless of all other positioners; 0 if it cannot
        move.
    n_free : ndarray of int, shape (n_idle,)
        Number of these targets that no positioner observes in the plan.
    owner : ndarray of int, shape (n_attempts,)
        Row of the positioner of each attempt.
    target : ndarray of int, shape (n_attempts,)
        Row of the target of each attempt.
    blocked_by : list of list of int
        Rows of the positioners with which the arm of each attempt collides; obstacle ``k`` has the number ``-1 - k``.

    Examples
    --------
    >>> import astropy.units as u
    >>> import rfpsurvey as rs
    >>> robot = rs.Positioner(8.25 * u.mm, 8.25 * u.mm, 2.25 * u.mm)
    >>> plane = rs.FocalPlane([[0, 0], [99, 0]] * u.mm, robot)
    >>> plan = rs.allocate(plane, [[12, 0]] * u.mm)
    >>> found = rs.allocation.find_idle_reasons(plane, plan, plan.place_arms(plane))
    >>> found.positioner, found.n_in_reach, rs.allocation.IDLE_REASONS[found.reason[0]]
    (array([1]), array([0]), 'no target in reach')
    """

    positioner: np.ndarray
    reason: np.ndarray
    n_in_reach: np.ndarray
    n_free: np.ndarray
    owner: np.ndarray
    target: np.ndarray
    blocked_by: list[list[int]]


def find_idle_reasons(focal_plane: FocalPlane, allocation: Allocation, arms: Arms, law: str = "") -> IdleReasons:
    """Return the reason why each idle positioner has no target, and the attempts to move it to free targets.

    The function considers only the given targets, and ignores sky positions that were added in gaps between targets.

    Parameters
    ----------
    focal_plane : FocalPlane
        The focal plane with all obstacles of the plan.
    allocation : Allocation
        The plan.
    arms : Arms
        The poses of all arms in the plan.
    law : str, optional
        Law of time by which arms must unfold without collisions, as in `~rfpsurvey.constraints.Motion`. By default, the
        motion of the arms is ignored.

    Returns
    -------
    IdleReasons
        The reasons, and all attempts from which the reasons follow.

    Raises
    ------
    InputError
        If the plan or the arms belong to a focal plane with a different number of positioners.

    Examples
    --------
    >>> import astropy.units as u
    >>> import rfpsurvey as rs
    >>> robot = rs.Positioner(8.25 * u.mm, 8.25 * u.mm, 2.25 * u.mm)
    >>> plane = rs.FocalPlane([[0, 0], [25.6, 0]] * u.mm, robot)
    >>> plan = rs.allocate(plane, [[12, 0], [14, 0]] * u.mm, allocator="optimal")
    >>> found = rs.allocation.find_idle_reasons(plane, plan, plan.place_arms(plane))
    >>> rs.allocation.IDLE_REASONS[found.reason[0]], found.blocked_by
    ('at every free target in reach the arm would collide', [[0]])
    """
    n, given = len(focal_plane), allocation.n_given
    for name, number in (("allocation", len(allocation.target_of_positioner)), ("arms", len(arms.segments))):
        if number != n:
            raise InputError(f"{name} must have the {n} positioners of the focal plane, got {number} positioners")
    is_idle = allocation.target_of_positioner < 0
    types = None if allocation.target_fiber_type is None else allocation.target_fiber_type[:given]
    reach = focal_plane.arrays.reach(allocation.xy_mm[:given], types)
    reach = reach.where(is_idle[reach.owner])
    if allocation.excluded is not None:
        reach = reach.where(~allocation.excluded[reach.target])
    n_in_reach = np.bincount(reach.owner, minlength=n)
    reach = reach.where(allocation.positioner_of_target[reach.target] < 0)
    n_free = np.bincount(reach.owner, minlength=n)
    owner, target, blocked_by = _attempts(focal_plane, allocation, arms, reach, types, law)
    possible = np.zeros(n, dtype=bool)
    possible[owner[[not blockers for blockers in blocked_by]]] = True
    reason = np.full(n, IdleReason.ALL_FREE_TARGETS_COLLIDE)
    reason[n_free == 0] = IdleReason.ALL_TARGETS_ARE_ASSIGNED
    reason[n_in_reach == 0] = IdleReason.NO_TARGET_IN_REACH
    reason[possible] = IdleReason.FREE_TARGET
    reason[focal_plane.arrays.is_stuck] = IdleReason.STUCK
    reason[focal_plane.disabled] = IdleReason.DISABLED
    return IdleReasons(
        np.flatnonzero(is_idle), reason[is_idle], n_in_reach[is_idle], n_free[is_idle], owner, target, blocked_by
    )


def _attempts(plane, allocation, arms, reach, types, law):
    """Return the positioner, the target, and the colliding arms and obstacles of each attempt."""
    problem = AllocationProblem(
        plane,
        allocation.xy_mm[: allocation.n_given],
        reach,
        np.zeros(allocation.n_given, dtype=np.int64),
        (0.0,),
        fiber_type=types,
        options=AllocationOptions(
            parked_obstacles=allocation.parked_obstacles, constraints=[MotionConstraint("fold", law)] if law else ()
        ),
    )
    start, owner, target, side, _ = list_candidates(problem, reach, both_elbows=True)
    now = start[1:] - 1  # the last candidate of each positioner stands for its arm in the plan
    segments = place_segments(problem, owner, target, side, now)
    segments[:, now] = arms.segments.T
    is_moved = np.ones(len(owner), dtype=bool)
    is_moved[now] = False
    blocked_by: list[list[int]] = [[] for _ in owner]
    moves, hits = None, obstacle_hits(plane, start, segments)
    if law:
        motion, same = Motion(problem), law == "same_speed"
        planned = plan_moves(plane, arms, law, allocation.parked_obstacles)
        moves = joined(motion.moves(owner, target, side, now), now, planned, np.arange(len(plane)))
        hits = np.concatenate([hits, motion.obstacle_hits(owner, moves)])
        for k in np.flatnonzero(~motion.turns(owner, moves) & is_moved):
            near = plane.arrays.neighbors[(plane.arrays.neighbors == owner[k]).any(axis=1)].ravel()
            blocked_by[k] += near[~plane.arrays.usable[near]].tolist()
        moves = moves, same
    for first, second in find_conflicts(plane, start, segments, moves=moves).T.tolist():
        if is_moved[first] != is_moved[second]:
            moved, blocker = (first, second) if is_moved[first] else (second, first)
            blocked_by[moved].append(int(owner[blocker]))
    for moved, obstacle in np.unique(hits, axis=0).tolist():
        blocked_by[moved].append(-1 - obstacle)
    rows = np.flatnonzero(is_moved)
    return owner[rows], target[rows], [sorted(blocked_by[k], reverse=True) for k in rows.tolist()]
