"""Objectives of a search: classes without candidates, and upper limits from the best plan that ignores collisions."""

from dataclasses import replace

import numpy as np

from rfpsurvey._assignment.answer import SUBPRIORITIES, Level
from rfpsurvey._assignment.before_and_after import changes_of, is_plan
from rfpsurvey._assignment.candidates import Candidates
from rfpsurvey._assignment.local_search import match
from rfpsurvey._assignment.problem import AllocationProblem

# Decimal digits of costs, which are differences of subpriorities in units of the range of all subpriorities.
DIGITS = 6
# Relative error of sums of subpriorities.
ROUNDING = 1e-12


def with_used_classes(
    problem: AllocationProblem, candidates: Candidates
) -> tuple[AllocationProblem, Candidates, np.ndarray]:
    """Remove the classes without candidates; return the problem, the candidates, and the numbers of the other classes.

    Two classes always remain, because the objectives of a problem with one class have other names.
    """
    n, rank = len(problem.classes), candidates.options.rank
    kept = np.unique(rank[rank < n])
    if len(kept) < 2:
        kept = np.union1d(kept, np.arange(min(n, 2)))
    if len(kept) < n:
        new = np.append(np.minimum(np.searchsorted(kept, np.arange(n)), len(kept) - 1), len(kept))
        columns = {"classes": tuple(problem.classes[k] for k in kept), "rank": new[problem.rank]}
        problem, few = replace(problem, **columns), replace(candidates.problem, **columns)
        options = candidates.options._replace(rank=few.rank_of(candidates.options.target))
        candidates = replace(candidates, problem=few, options=options)
    return problem, candidates, kept


def levels_of(
    problem: AllocationProblem, offset: int, kept: np.ndarray, values: np.ndarray, bounds: np.ndarray
) -> list[Level]:
    """Return the objectives of all classes from the values and bounds of the classes ``kept``.

    ``offset`` is the index of the objective of the first class. A plan that is as good as the given plan in the earlier
    classes contains no more targets of a class without candidates than the bound of these classes allows.
    """
    names, n = problem.level_names, len(kept)
    if len(kept) < len(problem.classes):
        slack = np.concatenate([[0.0], np.maximum(bounds - values, 0.0)[offset : offset + n]])
        columns = np.zeros(len(problem.classes)), slack[np.searchsorted(kept, np.arange(len(problem.classes)))]
        for column, some in zip(columns, (values, bounds), strict=True):
            column[kept] = some[offset : offset + n]
        values, bounds = (
            np.concatenate([some[:offset], column, some[offset + n :]])
            for some, column in zip((values, bounds), columns, strict=True)
        )
    return [Level(*row) for row in zip(names, values.tolist(), bounds.tolist(), strict=True)]


def offset_of(problem: AllocationProblem) -> int:
    """Return the index of the objective of the most important class in the list of all objectives."""
    return len(problem.level_names) - len(problem.classes) - (not problem.science.all())


def matching_limits(problem: AllocationProblem, candidates: Candidates | None) -> np.ndarray:
    """Return upper limits of the objectives from the best matching, in which arms may collide.

    The limit of a class applies to the number of targets of this class and of all earlier classes: no plan contains
    more of these targets than the matching. If ``candidates`` is None, or if there are required targets, the limits are
    the numbers of targets in reach.
    """
    n, n_classes = problem.pairs.n_positioners, len(problem.classes)
    if candidates is None or problem.any_required:  # the matching did not assign targets by their class alone
        target = np.flatnonzero(np.diff(problem.pairs.indptr) > 0)
        if problem.watched is not None:
            target = np.union1d(target, problem.watched[problem.watched >= 0])
    else:
        target = match(candidates)
        target = target[target >= 0]
    most = np.minimum(np.cumsum(np.bincount(problem.rank[target], minlength=n_classes + 1)), n).astype(float)
    limits = most[problem._objectives.stop - 1]
    if problem.any_required:
        limits[0] = min(problem.is_required.sum(), n)
    if problem.any_goals:
        limits[int(problem.any_required)] = 0.0
    return limits


def conditional_bounds(problem: AllocationProblem, values: np.ndarray, limits: np.ndarray, first: int) -> np.ndarray:
    """Return an upper bound of each objective, given the values of all earlier objectives.

    The bounds of objectives before ``first`` are infinite.
    """
    offset, bounds = offset_of(problem), limits.copy()
    last = offset + len(problem.classes)
    bounds[offset:last] -= np.cumsum(values[offset:last]) - values[offset:last]
    bounds[:first] = np.inf
    return bounds


def scale_of(problem: AllocationProblem) -> tuple[float, float]:
    """Return the largest subpriority of the science targets, and the range of their subpriorities."""
    values = problem.subpriority[problem.science] if problem.science.any() else np.zeros(1)
    return values.max(), np.ptp(values)


def sum_of_subpriorities(problem: AllocationProblem, target_of: np.ndarray) -> float:
    """Return the sum of the subpriorities of the science targets of a plan."""
    used = target_of[target_of >= 0]
    return float(problem.subpriority[used[problem.science[used]]].sum())


def is_sum_maximized(problem: AllocationProblem) -> bool:
    """Return whether the sum of the subpriorities is an objective; if not, a given plan may be kept instead."""
    return problem.subpriority is not None and not (
        problem.options.method.keeps_plan and is_plan(problem.options.start)
    )


def with_subpriorities(
    problem: AllocationProblem, levels: list[Level], target_of: np.ndarray, least: float = 0.0
) -> list[Level]:
    """Add the sum of the subpriorities of the science targets to the objectives of a plan, if it is an objective.

    ``least`` is a lower bound of the cost (see `with_cost`) of all plans with the same values of all other objectives.
    """
    if not is_sum_maximized(problem):
        return levels
    rank, worth, value = problem.rank, problem.subpriority, sum_of_subpriorities(problem, target_of)
    n = np.bincount(rank[target_of[target_of >= 0]], minlength=len(problem.classes) + 1)[: len(problem.classes)]
    # no plan has a larger sum than the best targets in reach of each class
    best = np.flatnonzero(problem.science & (np.diff(problem.pairs.indptr) > 0))
    best = best[np.lexsort((-worth[best], rank[best]))]
    place = np.arange(len(best)) - np.searchsorted(rank[best], rank[best])
    bound = worth[best[place < n[rank[best]]]].sum()
    most, size = scale_of(problem)
    error = len(target_of) * (10.0**-DIGITS * size + ROUNDING * (abs(most) + size))
    bound = float(min(bound, n.sum() * most - size * least + error))
    # costs are rounded, and the solver ignores differences of this size
    return [*levels, Level(SUBPRIORITIES, value, value if bound <= value + 3 * error else bound)]


def with_cost(problem: AllocationProblem) -> AllocationProblem:
    """Return the problem; if the targets have subpriorities, replace the squared distance of each pair by a cost.

    The larger the subpriority of a science target, the lower the cost of its pairs. With ``optimal`` and a given plan,
    the sum of the costs is smallest for the plan that changes the fewest fibers (see `changes_of`).
    """
    if problem.options.method.keeps_plan and is_plan(problem.options.start):
        pairs, before = problem.pairs, problem.start(with_lost=True).target_of_positioner
        return replace(problem, pairs=replace(pairs, r2=changes_of(before, pairs.owner, pairs.target)))
    if problem.subpriority is None:
        return problem
    order = np.arange(len(problem.rank))  # the rows make the costs different if subpriorities are equal
    most, size = scale_of(problem)
    cost = np.where(problem.science, most - problem.subpriority, 0.0) / max(size, 1e-300)
    cost = np.round(cost, DIGITS) + order * (10.0 ** -(DIGITS + 1) / max(len(order), 1))
    return replace(problem, pairs=replace(problem.pairs, r2=cost[problem.pairs.target]))
