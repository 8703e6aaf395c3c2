"""Rules that assign targets in a given order: the same functions make one plan, or one plan for each realization."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from rfpsurvey._kernels import allocation as kernels
from rfpsurvey.allocation._answer import AllocationAnswer
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
