"""Rules that assign targets in a given order: the same functions make one plan, or one plan for each realization."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from rfpsurvey._kernels import allocation as kernels
from rfpsurvey.allocation._answer import AllocationAnswer
from rfpsurvey.allocation._problem import AllocationProblem, with_watched
from rfpsurvey.allocation._subpriority import service_order
from rfpsurvey.focal_plane import Reach


@dataclass(frozen=True, eq=False)
class RuleProblem:
    """The pairs of a positioner and a target that a rule may assign; all realizations of a tile share these data."""

    pairs: Reach
    rank: np.ndarray  # class of each target; class 0 is the most important
    number: np.ndarray  # integer that represents the identifier of each target
    n_sharing: np.ndarray  # upper limit of the number of other positioners that reach a target of each positioner
    by_distance: bool = False  # whether targets of a class are assigned in the order of their distances

    @classmethod
    def of(cls, pairs: Reach, rank, science, is_required, number, n_sharing, *, by_distance=False) -> "RuleProblem":
        """Return the problem of science targets and required targets; required targets are the most important class.

        ``is_required`` is None if no target is required.
        """
        if is_required is not None:
            rank, science = np.where(is_required, 0, rank + 1), science | is_required
        pairs = pairs if science.all() else pairs.where(science[pairs.target])
        return cls(pairs, rank, number, n_sharing, by_distance)

    @cached_property
    def closest(self) -> np.ndarray:
        """Indices of the pairs of each target, sorted by distance."""
        closest = np.arange(len(self.pairs.owner))
        kernels.sort_by_distance(self.pairs.indptr, self.pairs.r2, closest)
        return closest

    @cached_property
    def start(self) -> np.ndarray:
        """Index at which the list of the first targets of each positioner begins, followed by the length of all lists.

        If k other positioners share targets with a positioner, they can observe at most k of its targets. One of the
        first k + 1 targets of the positioner is therefore always available, and its further targets are omitted.
        """
        in_reach = np.bincount(self.pairs.owner, minlength=self.pairs.n_positioners)
        return np.concatenate([[0], np.cumsum(np.minimum(in_reach, self.n_sharing + 1))])

    def first_targets(self, start: np.ndarray, subpriority: np.ndarray, is_open: np.ndarray) -> tuple:
        """Return lists of the first open targets of each positioner, in the order of the rule.

        The list of positioner i begins at the index ``start[i]`` and has at most ``start[i + 1] - start[i]`` targets.
        The result contains the length of each list, the targets, their squared distances, and the number of open
        targets in reach of each positioner.
        """
        n, size, pairs = self.pairs.n_positioners, start[-1], self.pairs
        best = np.empty(n, np.int64), np.empty(size, np.int64), np.empty(size), np.empty(n, np.int64)
        order = self.rank, subpriority, self.number, self.by_distance, is_open
        kernels.list_best(pairs.indptr, pairs.owner, pairs.r2, *order, start, *best)
        return best


def balanced(problem: RuleProblem, subpriority: np.ndarray, is_open: np.ndarray, rng) -> AllocationAnswer:
    """Add the targets that are open, in order of subpriority, to queues, and draw one target from each queue."""
    pairs, targets = problem.pairs, np.flatnonzero(is_open)
    targets = targets[service_order(subpriority[targets], problem.number[targets])]
    count, place = np.empty(pairs.n_positioners, np.int64), np.empty((1, pairs.n_positioners), np.int64)
    owner_of, indptr = np.empty(len(is_open), dtype=np.int64), np.empty(len(count) + 1, dtype=np.int64)
    kernels.balanced(pairs.indptr, pairs.owner, pairs.r2, targets, count, owner_of)
    queue = np.empty(int(count.sum()), dtype=np.int64)
    kernels.fill_queues(owner_of, targets, count, indptr, queue)
    kernels.draw_places(indptr, rng.random((1, len(count))), place)
    return AllocationAnswer(np.where(place[0] >= 0, np.append(queue, -1)[place[0]], -1), queues=(indptr, queue))


def nearest(problem: RuleProblem, subpriority: np.ndarray, is_open: np.ndarray, rng) -> AllocationAnswer:
    """Assign each open target, in the order of the rule, to its closest free positioner."""
    pairs = problem.pairs
    target_of, pair = np.empty((2, pairs.n_positioners), dtype=np.int64)
    order = problem.rank, subpriority, problem.number, problem.by_distance
    kernels.nearest(pairs.indptr, pairs.owner, pairs.r2, problem.closest, *order, is_open, target_of, pair)
    return AllocationAnswer(target_of)


def lamost_rule(problem: RuleProblem, subpriority: np.ndarray, is_open: np.ndarray, rng) -> AllocationAnswer:
    """Let each free positioner nominate its first open target, class by class, until there are no nominations."""
    pairs, n = problem.pairs, len(problem.rank)
    count, target, r2, in_reach = problem.first_targets(problem.start, subpriority, is_open)
    cursor, target_of = np.empty((2, pairs.n_positioners), dtype=np.int64)
    nominee_of, owner_of = np.empty((2, n), dtype=np.int64)
    lists = problem.start, count, target, r2, problem.rank, pairs.indptr, pairs.owner, in_reach
    kernels.nominate(*lists, nominee_of, np.empty(n), cursor, target_of, owner_of)
    return AllocationAnswer(target_of)


def plan_balanced(problem: AllocationProblem) -> AllocationAnswer:
    """Distribute targets to queues of nearly equal length, and draw one target from each queue.

    Each science target, in catalog order, is added to the shortest queue among the positioners that reach it; ties are
    decided by the distance, then by the row of the positioner. One target of each queue is drawn uniformly and
    observed. Priorities and requirements are ignored.
    """
    return _by_rule(problem, balanced, by_priority=False)


def plan_nearest(problem: AllocationProblem) -> AllocationAnswer:
    """Assign the targets of one class after the other; in each class, assign the closest pairs first.

    If subpriorities are given, assign each target of a class, in order of subpriority, to the closest free positioner.
    Requirements are ignored.
    """
    return _by_rule(problem, nearest)


def plan_lamost_rule(problem: AllocationProblem) -> AllocationAnswer:
    """Assign the targets of one class after the other; in each round, every free positioner nominates one target.

    In each class, every free positioner nominates its nearest unassigned target, until no nominations are possible. If
    several positioners nominate a target, the target is assigned to the positioner with the fewest unassigned targets
    (of any class) in reach; ties are decided by the distance, then by the row of the positioner. The requirements are
    then met one after the other: first by idle positioners, then by positioners that give up the least important
    targets.
    """
    answer = _by_rule(problem, lamost_rule)
    _fill_quotas(problem, answer.target_of_positioner)
    return answer


def _by_rule(problem, rule, *, by_priority=True):
    """Return the plan of a rule; the rows of the targets are already in order of subpriority."""
    n, n_sharing = len(problem.rank), problem.focal_plane.arrays.n_sharing
    is_required = problem.is_required if by_priority and problem.any_required else None
    rank, number = problem.rank if by_priority else np.zeros(n, np.int64), np.zeros(n, np.uint64)
    given = problem.pairs, rank, problem.science, is_required, number, n_sharing
    by_distance = problem.subpriority is None
    answer = rule(RuleProblem.of(*given, by_distance=by_distance), np.zeros(n), np.ones(n, np.bool_), problem.rng)
    return answer._replace(target_of_positioner=with_watched(problem, answer.target_of_positioner))


def _fill_quotas(problem, target_of):
    """Change a plan in place such that it meets the requirements as far as possible.

    The function uses idle positioners first, then the positioners of the least important targets.
    """
    plane, reach = problem.focal_plane, problem.pairs
    used, owner_of = np.flatnonzero(target_of >= 0), np.full(len(problem.rank), -1)
    owner_of[target_of[used]] = used
    locked = ~plane.arrays.usable
    locked[used] |= problem.is_required[target_of[used]]
    for requirement in problem.requirements:
        groups = [group for group in problem.groups if group.requirement is requirement and requirement.minimum > 0]
        if not groups:
            continue
        by_fiber, counting = plane.spectrograph.ndim > 1 and requirement.per == "spectrograph", None
        for group in groups:
            if group.targets is not counting:
                counting, rows = group.targets, reach.where(group.holds_target(reach.target, reach.owner))
            part = rows
            if by_fiber:
                part = rows.where(problem.spectrograph_of(rows.owner, rows.target) == group.spectrograph)
            indptr, target, r2 = part.by_positioner
            inside = np.diff(indptr) > 0
            if not by_fiber and group.spectrograph is not None:
                inside &= plane.spectrograph == group.spectrograph
            if group.fibers is not None:
                inside &= group.fibers
            used = np.flatnonzero(target_of >= 0)
            counted = used[group.holds(target_of[used], problem.spectrograph_of(used, target_of[used]), used)]
            locked[counted] = True
            rank = problem.rank_of(target_of)
            able = np.flatnonzero(~locked & inside)
            order = able[np.argsort(-rank[able], kind="stable")]
            need = requirement.minimum - len(counted)
            kernels.fill_quota(order, need, indptr, target, r2, group.targets, locked, target_of, owner_of)
