"""The class `~rfpsurvey.allocation.Allocation`, and reasons why positioners have no target."""

from dataclasses import dataclass, field
from enum import IntEnum
from typing import TYPE_CHECKING, NamedTuple

import astropy.units as u
import numpy as np

from rfpsurvey._assignment.answer import SUBPRIORITIES, Level
from rfpsurvey._assignment.before_and_after import place_segments
from rfpsurvey._assignment.candidates import find_conflicts, list_candidates, obstacle_hits
from rfpsurvey._assignment.constraints.counts import Shortfall
from rfpsurvey._assignment.constraints.field import Verdict
from rfpsurvey._assignment.constraints.motion import Motion as MotionConstraint
from rfpsurvey._assignment.distribution import Motion
from rfpsurvey._assignment.options import AllocationOptions
from rfpsurvey._assignment.problem import AllocationProblem
from rfpsurvey._common.descriptions import to_html
from rfpsurvey._instruments.arms import Arms, place_arms
from rfpsurvey._instruments.focal_plane import FocalPlane
from rfpsurvey._instruments.motion import plan_moves
from rfpsurvey._instruments.moves import joined
from rfpsurvey.errors import InputError, number_of

if TYPE_CHECKING:
    from rfpsurvey._instruments.path_report import PathReport


@dataclass(frozen=True, eq=False)
class Allocation:
    """An allocation: the target that each positioner observes.

    Parameters
    ----------
    allocator : str
        Name of the allocator that made the allocation.
    target_of_positioner : ndarray of int, shape (n_positioners,)
        Row of the target of each positioner, -1 if the positioner has no target. Rows from ``n_given`` on are sky
        positions that were found in gaps between the targets.
    positioner_of_target : ndarray of int, shape (n_targets,)
        Row of the positioner of each target, -1 if no positioner observes the target.
    handedness : ndarray of str, shape (n_positioners,)
        Handedness of each arm, "right" or "left".
    tips_mm : ndarray of float, shape (n_positioners, 2)
        Position of each fiber in mm; NaN for positioners without a target. The property ``tips`` has units.
    fiber_type : ndarray of str, shape (n_positioners,)
        Fiber type that each positioner uses.
    in_reach : ndarray of bool, shape (n_given,)
        Whether each target is in reach of at least one positioner.
    parked_obstacles : bool
        Whether idle positioners are obstacles; only positioners with two arms of equal length can be obstacles.
    seconds : dict of str to float
        Computing times in seconds: ``reach`` (finding the targets in reach) and ``allocation`` (all later steps).
    xy_mm : ndarray of float, shape (n_targets, 2)
        Positions on the focal plane in mm: first all given targets, then the observed sky positions in gaps between the
        targets. The property ``xy`` has units.
    n_given : int
        Number of given targets.
    target_fiber_type : ndarray of str, shape (n_targets,), or None
        Fiber type that each target requires; ``""`` means any type.
    queues : tuple of ndarray or None
        For ``balanced``: the queues from which the configuration was drawn, as two arrays ``indptr`` and ``targets``.
        The queue of positioner ``i`` is ``targets[indptr[i]:indptr[i + 1]]``.
    levels : tuple of Level
        Name, value and bound of each objective, in strict order of precedence. The bound is an upper limit of the value
        for all plans with the same values of the earlier objectives; it is NaN if no upper limit is known.
    unmet : tuple of Shortfall
        Requirements that are not met; ``str`` converts each element to a sentence.
    meta : dict
        Information from the allocator about its search, such as the number of moved positioners; may be empty.
    excluded : ndarray of bool, shape (n_given,), or None
        Whether constraints exclude each given target; None if no target is excluded.
    counts : tuple of Verdict
        The verdict on each requirement, in the tile or in each spectrograph.
    added : ndarray of int, shape (n_targets - n_given,)
        For each observed sky position in a gap, its number among all positions that were found.
    paths : PathReport or None
        The paths of the arms, if a constraint required them.

    Examples
    --------
    >>> import astropy.units as u
    >>> import rfpsurvey as rs
    >>> robot = rs.Positioner(8.25 * u.mm, 8.25 * u.mm, 2.25 * u.mm)
    >>> plane = rs.FocalPlane([[0, 0], [25.6, 0]] * u.mm, robot)
    >>> plan = rs.allocate(plane, [[12, 0], [14, 0], [2, 5]] * u.mm, allocator="nearest")
    >>> plan.target_of_positioner, plan.positioner_of_target, plan.n_assigned
    (array([2, 1]), array([-1,  1,  0]), 2)
    """

    allocator: str
    target_of_positioner: np.ndarray
    positioner_of_target: np.ndarray
    handedness: np.ndarray
    tips_mm: np.ndarray
    fiber_type: np.ndarray
    in_reach: np.ndarray
    parked_obstacles: bool
    seconds: dict
    xy_mm: np.ndarray
    n_given: int
    target_fiber_type: np.ndarray | None
    queues: tuple[np.ndarray, np.ndarray] | None
    levels: tuple[Level, ...]
    unmet: tuple[Shortfall, ...]
    meta: dict
    excluded: np.ndarray | None = None
    counts: tuple[Verdict, ...] = ()
    added: np.ndarray = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    paths: "PathReport | None" = None

    @property
    def tips(self) -> u.Quantity:
        """Position of each fiber; NaN for positioners without a target."""
        return self.tips_mm << u.mm

    @property
    def xy(self) -> u.Quantity:
        """Positions of the targets on the focal plane."""
        return self.xy_mm << u.mm

    @property
    def n_reachable(self) -> int:
        """Number of targets that at least one positioner reaches."""
        return int(np.count_nonzero(self.in_reach))

    @property
    def n_assigned(self) -> int:
        """Number of positioners that have a target."""
        return int(np.count_nonzero(self.target_of_positioner >= 0))

    @property
    def objective(self) -> float:
        """Number of assigned targets minus the number of fibers missing for requirements."""
        lack = sum(level.value for level in self.levels if level.name == "requirements")
        return float(self.n_assigned + lack)

    @property
    def bound(self) -> float:
        """Upper bound of `objective`, a number of targets; NaN if it is unknown.

        Some objectives in ``levels`` have a proven optimum. The bound is valid for all plans that have the same values
        of these objectives.
        """
        # The bound of a class whose optimum is not proven also includes all earlier classes. The largest difference
        # between a bound and its value is therefore used, not the sum of the differences.
        slack = [level.bound - level.value for level in self.levels if level.name != SUBPRIORITIES]
        return self.objective + float(np.max(slack, initial=0.0))

    @property
    def gap(self) -> float:
        """Relative difference between `bound` and `objective`, at most 1: 0 for a proven optimum, NaN if unknown.

        If the sum of the subpriorities is an objective, the gap is at least the relative difference between the bound
        and the value of this sum. The upper bounds that ``repair`` uses ignore collisions. Without subpriorities, the
        gap of ``repair`` is therefore an upper limit of the fraction of targets that are lost to collisions.
        """
        missing = self.bound - self.objective
        gap = missing / max(abs(self.bound), missing, 1.0) if missing else 0.0
        sums = [level for level in self.levels if level.name == SUBPRIORITIES and level.bound > level.value]
        return max([gap, *((bound - value) / max(abs(bound), bound - value) for _, value, bound in sums)])

    def place_arms(self, focal_plane: FocalPlane) -> Arms:
        """Return the poses of the arms for this allocation.

        Parameters
        ----------
        focal_plane : FocalPlane
            The focal plane for which the allocation was made.

        Returns
        -------
        Arms
            Poses of all positioners.

        Raises
        ------
        InputError
            If ``focal_plane`` is not the focal plane for which the allocation was made.
        """
        options = {name: getattr(self, name) for name in ("handedness", "fiber_type", "parked_obstacles")}
        return place_arms(focal_plane, self, **options)

    def _repr_html_(self) -> str:
        facts = {level.name: f"{level.value:g} (upper bound {level.bound:g})" for level in self.levels}
        return to_html(self, {**facts, "relative gap to bound": self.gap, "unmet requirements": len(self.unmet)})

    def __repr__(self):
        n, m = len(self.target_of_positioner), len(self.positioner_of_target)
        return f"<Allocation by {self.allocator!r}: {self.n_assigned} of {n} positioners, {number_of(m, 'target')}>"


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
    xy, parked = allocation.xy_mm[:given], allocation.parked_obstacles
    owner, target, _, blocked_by = find_attempts(focal_plane, xy, arms, reach, types, law, parked_obstacles=parked)
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


def find_attempts(plane, xy, arms, reach, types, law, *, parked_obstacles):
    """Return the positioner, the target, the elbow, and the colliding arms and obstacles of each attempt.

    The attempts move one arm to a target in ``reach``, with a right (+1) or a left (-1) elbow; ``types`` are the fiber
    types that the targets at the positions ``xy`` (mm) require. The other parameters are as in `find_idle_reasons`.
    """
    constraints = [MotionConstraint("fold", law)] if law else ()
    options = AllocationOptions(parked_obstacles=parked_obstacles, constraints=constraints)
    one_class = np.zeros(len(xy), dtype=np.int64), (0.0,)
    problem = AllocationProblem(plane, xy, reach, *one_class, fiber_type=types, options=options)
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
        planned = plan_moves(plane, arms, law, parked_obstacles)
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
    return owner[rows], target[rows], side[rows], [sorted(blocked_by[k], reverse=True) for k in rows.tolist()]
