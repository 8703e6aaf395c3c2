"""Objectives of a search: their classes and upper limits, and their optimization in strict order.

Each optimum is proven before the next objective is optimized. Upper limits follow from the best plan that ignores
collisions.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from rfpsurvey._assignment.answer import SUBPRIORITIES, Level
from rfpsurvey._assignment.before_and_after import changes_of, is_plan
from rfpsurvey._assignment.candidates import Candidates
from rfpsurvey._assignment.clock import left
from rfpsurvey._assignment.local_search import match
from rfpsurvey._assignment.problem import AllocationProblem

if TYPE_CHECKING:  # it imports scipy.sparse
    from rfpsurvey._assignment.milp import Program
    from rfpsurvey._assignment.relaxed import Relaxed

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


# Successive objectives are combined into one as long as the product of their numbers of possible values is below this
# limit. Rounding errors then have no effect.
LARGEST = 1e6
# A program maximizes a goal, which is a weighted sum of objectives. In large programs, this sum also contains the last
# few proven objectives. STEEP is the ratio of successive weights; N_STEEP is the largest number of these objectives.
STEEP, N_STEEP = 8.0, 4
# Only the goals of programs with more than this number of variables contain proven objectives.
LARGE = 500
# Settings for objectives whose optimum cannot be proven in time: fraction of the time that is reserved for them,
# smallest weight, and allowed gap.
FOR_FILLING, FLATTEST, GOOD_ENOUGH = 0.2, 1e-3, 1e-3


class Solution(NamedTuple):
    """The plan of some positioners: the candidate of each positioner, and the value and bound of each objective."""

    chosen: np.ndarray | None  # candidates in use; None if no plan was found within the time limit
    values: np.ndarray
    bounds: np.ndarray
    n_programs: int
    integral: bool  # whether an integer program had to be solved
    least: float = 0.0  # lower bound of the cost of all plans that reach all bounds; costs are not negative


class _Pursuit:
    """The state of the search: the best plan found so far, and the proven values of the first objectives."""

    def __init__(self, program: "Program", first, limit, *, integral, upper=None, linear=None):
        self.program, self.limit, self.known = program, limit, upper
        self.integral, self.n_programs = integral, 0
        self.keeps = False  # whether the stored plan remains if another plan is equally good in all proven objectives
        self.classes = np.zeros(len(program.high), dtype=bool)
        if not program.problem.any_required:
            self.classes[offset_of(program.problem) :][: len(program.problem.classes)] = True
        x = program.variables(first)
        self.x = x if program.holds(x) else None
        self.values = program.reaches(x)
        self.spare = None  # a plan that was better than the stored plan in objectives that were not proven
        self.solved: list[float] = []  # proven values, beginning with the first objective
        self.linear = linear  # function that returns the values of the first objectives that linear programs prove
        self.proven: list[float] = []  # these values

    def upper(self, values):
        """Return the upper bound of each objective, given the values of all earlier objectives."""
        if self.known is not None:
            return np.minimum(self.program.high, self.known(values))
        if self.limit is None:
            return self.program.high
        # For every k, no plan has more targets of the first k classes than the best matching.
        before = np.cumsum(self.classes * values) - self.classes * values
        most = np.where(self.classes, np.cumsum(self.classes * self.limit) - before, self.limit)
        if self.program.problem.any_required:
            # The matching gives an upper limit of an objective only if the plan is as good as the matching in all
            # earlier objectives.
            known = np.append(True, np.cumprod(values >= self.limit)[:-1] > 0)
            most = np.where(known, most, np.inf)
        return np.minimum(self.program.high, most)

    def maximize(self, goal, keep, deadline, gap=0.0):
        """Return the variables that maximize a goal (a weighted sum of objectives), and an upper bound of the goal."""
        x, bound = self.program.maximize(goal, deadline, integral=self.integral, keep=keep, gap=gap)
        self.n_programs += 1
        if not self.integral and x is not None:
            if np.abs(x - np.round(x)).max() > 1e-6:
                self.integral = True
                return self.maximize(goal, keep, deadline, gap)
            x = np.round(x)
        return x, bound

    def take(self, x):
        """Store the variables if their plan is better than the stored plan."""
        values = self.program.reaches(x)
        if self.x is None or tuple(values) > tuple(self.values):
            self.x, self.values = x, values

    def next_pack(self, k, largest):
        """Return the number of objectives, beginning with k, that can form one weighted sum, and their weights."""
        sizes = (self.program.high - self.program.low + 1.0)[k:]
        # each weight exceeds the largest possible sum of all later terms, like the digits of a number
        n = max(int((np.cumprod(sizes) <= largest).sum()), 1)
        return n, np.cumprod([1.0, *sizes[1:n][::-1]])[::-1]

    def prove(self, k, deadline):
        """Optimize objective k, possibly together with later objectives.

        Return the number of objectives that this call has proven, and an upper bound of objective k.
        """
        program, n_solved = self.program, len(self.solved)
        if self.x is not None and self.is_kept(self.values):
            short = np.flatnonzero(self.values[k:] < self.upper(self.values)[k:])
            n = int(short[0]) if len(short) else len(program.high) - k
            if n:
                self.solved += self.values[k : k + n].tolist()
                return n, self.values[k]
        # Proven objectives become constraints. Such constraints would make large programs very slow. In large programs,
        # the last few proven objectives are therefore terms of the goal instead.
        in_goal = N_STEEP if n_solved and program.n > LARGE else 0
        n, weights = self.next_pack(k, LARGEST / STEEP**in_goal)
        if self.linear is not None:
            self.proven, self.linear = self.linear(deadline), None
        if n == 1 and k + 1 < len(self.proven) and self.proven[k + 1] < program.high[k + 1]:
            # the program of the next objective finds the same plan if this objective has no program
            self.solved.append(self.proven[k])
            return 1, self.proven[k]
        goal = program.goal(k, weights)
        lowest = weights[1:] @ program.low[k + 1 : k + n]
        for n_soft in dict.fromkeys([min(in_goal, n_solved), 0]):
            first = n_solved - n_soft
            slope = weights[0] * STEEP ** np.arange(n_soft, 0, -1)
            extra, worth = program.goal(first, slope), slope @ self.solved[first:]
            x, bound = self.maximize(goal + extra, self.solved[:first], deadline)
            if x is None:
                return 0, np.inf
            self.take(x)
            values = program.reaches(x)
            # all values of the goal are whole numbers
            done = (goal + extra) @ x >= bound - 0.5
            if done and self.is_kept(values):
                self.solved += values[k : k + n].tolist()
                if tuple(values) < tuple(self.values):
                    self.spare = self.x
                if not (self.keeps and self.is_kept(self.values)):
                    self.x, self.values = x, values
                return n, values[k]
            if not done:
                return 0, np.floor((bound - worth - lowest) / weights[0] + 1e-6)
        return 0, np.inf

    def fill(self, k, deadline):
        """Improve objective k and all later objectives, approximately in order, without proof of an optimum."""
        worth = np.maximum(STEEP ** -np.arange(len(self.program.high) - k, dtype=float), FLATTEST)
        x, _ = self.maximize(self.program.goal(k, worth), self.solved, deadline, gap=GOOD_ENOUGH)
        if x is not None:
            self.take(x)

    def is_kept(self, values):
        """Return whether a plan reaches the proven values of all objectives that are already proven."""
        return bool((values[: len(self.solved)] >= self.solved).all())


def pursue(
    program: "Program",
    first,
    deadline: float,
    limit,
    *,
    integral: bool,
    squared_cost: bool,
    tell=None,
    upper=None,
    relaxed: "Relaxed | None" = None,
    linear: Callable | None = None,
) -> Solution:
    """Return the best plan found before the deadline; the search starts from the plan ``first`` if that plan is valid.

    If ``limit`` is not None, it contains the values of the objectives for the best plan that ignores collisions.
    ``upper`` is a function that returns other upper bounds for the values of all earlier objectives. With
    ``squared_cost``, the plan with the lowest cost among all best plans is returned. If ``tell`` is not None, it is
    called with the number of proven objectives and the total number of objectives. ``relaxed`` contains bounds and a
    plan that are already known; ``linear`` is a function of the deadline that returns values of the first objectives
    that are proven to be the largest ones, in strict order.
    """
    upper = upper if relaxed is None else relaxed.upper
    now = _Pursuit(program, first, limit, integral=integral, upper=upper, linear=linear)
    if relaxed is not None:
        now.n_programs, now.integral, now.keeps = relaxed.n_programs, relaxed.integral, True
        if relaxed.x is not None and program.holds(relaxed.x):
            values = program.reaches(relaxed.x)
            if now.x is None or tuple(values) >= tuple(now.values):
                now.x, now.values = relaxed.x, values
            now.solved = values.tolist() if relaxed.is_best else []
    n_objectives, k = len(program.high), len(now.solved)
    time_left = left(deadline)
    halt = deadline - FOR_FILLING * time_left if np.isfinite(time_left) and n_objectives > 1 else deadline
    bounds, least = program.high.copy(), 0.0
    bounds[:k] = now.solved
    while k < n_objectives:
        if tell is not None:
            tell(k, n_objectives)
        n, bound = now.prove(k, halt)
        if n == 0:
            if k < n_objectives - 1:
                now.fill(k, deadline)
            if now.spare is not None:
                now.take(now.spare)
            bounds[k:] = now.upper(now.values)[k:]
            bounds[k] = min(bound, bounds[k])
            break
        bounds[k : k + n] = now.solved[k:]
        k += n
    if relaxed is not None and k == n_objectives:
        least = max(relaxed.least(program.reaches(now.x)), 0.0)
    if squared_cost and k == n_objectives and not (relaxed is not None and now.x is relaxed.x):
        x, bound = now.maximize(-program.costs, now.solved, deadline, gap=1e-9)
        least = max(-bound, least)
        # the best plan that was found before the deadline can be worse than the plan from which the search started
        if x is not None and (now.x is None or program.costs @ x <= program.costs @ now.x):
            now.x = x
    if now.x is None:
        return Solution(None, now.values, bounds, now.n_programs, now.integral)
    values = program.reaches(now.x)
    bounds = np.maximum(bounds, values)
    return Solution(program.chosen(now.x), values, bounds, now.n_programs, now.integral, least)
