"""Upper bounds of the objectives of a large program, and often its best plan, from a sequence of linear programs.

The optimum of a linear program can contain fractions of candidates. Constraints that every plan satisfies, and that the
fractions violate, are then added, until there are no fractions or no more such constraints.
"""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from rfpsurvey._assignment.clock import count_program
from rfpsurvey._assignment.objectives import STEEP, scale_of, sum_of_subpriorities
from rfpsurvey._assignment.solver import LinearProgram, maximize

if TYPE_CHECKING:
    from rfpsurvey._assignment.milp import Program

# Rounding error of variables, smallest violation of an added constraint, and rounding error of bounds.
WHOLE, VIOLATED, ROUNDING = 1e-6, 1e-3, 1e-4
# Largest number of linear programs for one goal, and number of fractions from which the bounds are not close.
MOST_ROUNDS, MANY = 20, 30
# Largest weight of an objective for which the rounding errors of the solver have no effect.
STEEPEST = 8.0**6
# Allowed difference between the sum of the subpriorities and its upper bound, as a fraction of this sum.
GAP = 1e-4


class Relaxed(NamedTuple):
    """Upper bounds of weighted sums of objectives, and a plan.

    The sum k is that of the objectives 0 to k. The weight of each objective is ``ratio`` times the weight of the next
    one, and the weight of objective k is 1. The last goal is the last sum times ``ratio`` minus the cost.
    """

    ratio: float
    sums: np.ndarray
    last: float
    x: np.ndarray | None  # variables of a plan; None if none was found
    is_best: bool  # whether it is proven that no plan is better in the objectives, apart from the cost
    n_programs: int
    integral: bool  # whether an integer program was solved

    def weights(self, k: int) -> np.ndarray:
        """Return the weights of the objectives 0 to k in sum k."""
        return self.ratio ** np.arange(k, -1, -1)

    def upper(self, values: np.ndarray) -> np.ndarray:
        """Return the upper bound of each objective, given the values of all earlier objectives."""
        return self.sums - np.array([self.weights(k) @ values[: k + 1] for k in range(len(values))]) + values

    def least(self, values: np.ndarray) -> float:
        """Return a lower bound of the cost of all plans in which the objectives have these values."""
        return float(self.ratio * self.weights(len(values) - 1) @ values - self.last)


def ratio_of(n: int) -> float:
    """Return the ratio of the weights of successive objectives in sums of n objectives, a whole number."""
    return float(np.floor(min(STEEP, STEEPEST ** (1.0 / n) + WHOLE)))


def relax(program: "Program", deadline: float) -> Relaxed | None:
    """Return bounds of all objectives and of the cost, and a plan; None if there are too many objectives."""
    n = len(program.high)
    if (ratio := ratio_of(n)) < 2.0:
        return None
    count_program()
    found = Relaxed(ratio, np.full(n, np.inf), np.inf, None, False, 0, False)
    relaxation, goals = Relaxation(program), [program.goal(0, found.weights(k)) for k in range(n)]
    for k, goal in enumerate(goals):
        x, found.sums[k], is_whole = relaxation.maximize(goal, deadline, whole=True)
        if x is None or (np.abs(x - np.round(x)) > WHOLE).sum() > MANY:
            break
    else:
        goal = ratio * goals[-1] - program.costs
        x, last, is_whole = relaxation.maximize(goal, deadline, whole=False)
        found = found._replace(last=last)
    found = found._replace(x=x if is_whole else None, n_programs=relaxation.linear.n_programs)
    return found if x is None or is_whole else _with_whole(program, found, relaxation, x, deadline)


def proven_values(program: "Program", deadline: float) -> list[float]:
    """Return the largest values of the first objectives, in strict order, as far as linear programs prove them."""
    values: list[float] = []
    n = len(program.high)
    if (ratio := ratio_of(n)) < 2.0:
        return values
    relaxation = Relaxation(program)
    for k in range(n):
        weights = ratio ** np.arange(k, -1, -1)
        x, bound, is_whole = relaxation.maximize(program.goal(0, weights), deadline, whole=True)
        if not is_whole:
            break
        reached = program.reaches(x)[: k + 1]
        if weights @ reached < bound or reached[:k].tolist() != values:
            break
        values = reached.tolist()
    return values


def _with_whole(program, found, relaxation, x, deadline):
    """Return bounds and a plan that integer programs improve; ``x`` contains fractions of candidates."""
    goal, gap, problem = found.ratio * program.goal(0, found.weights(len(program.high) - 1)), 0.0, program.problem
    goal -= program.costs
    x = relaxation.complete(x, goal, deadline) if np.isfinite(found.last) else None
    if x is not None:
        values = program.reaches(x)
        total = sum_of_subpriorities(problem, program.target[x[: len(program.target)] > 0.5])
        # differences below 1 do not change the objectives
        gap = min(GAP * abs(total) / max(scale_of(problem)[1], 1e-300), 1.0)
        found = found._replace(x=x, n_programs=found.n_programs + 1, integral=True)
        if (values >= found.upper(values)).all() and program.costs @ x <= found.least(values) + gap:
            return found
    x, bound = program.maximize(goal, deadline, integral=True, gap=gap / max(abs(found.last), 1.0) if gap else 0.0)
    found = found._replace(last=min(found.last, bound), n_programs=found.n_programs + 1, integral=True)
    return found if x is None else certify(program, found._replace(x=x), deadline)


def certify(program: "Program", found: Relaxed, deadline: float) -> Relaxed:
    """Prove with one integer program, if its numbers are small enough, that no plan is better in the objectives."""
    values = program.reaches(found.x)
    short = np.flatnonzero(values < np.minimum(found.upper(values), program.high))
    if len(short) == 0:
        return found._replace(is_best=True)
    first, n = int(short[0]), len(values)
    # the weights exceed what a plan with a larger value of an objective can lose in all later objectives
    worth = np.ones(n - first)
    for k in range(n - 2, first - 1, -1):
        worth[k - first] = 1.0 + worth[k + 1 - first :] @ (values - program.low)[k + 1 : n]
    if worth[0] > STEEPEST:
        return found
    goal = program.goal(first, worth)
    x, bound = program.maximize(goal, deadline, integral=True, gap=0.0, keep=values[: first + 1])
    is_best = x is not None and bound < goal @ found.x + 0.5
    return found._replace(is_best=is_best, n_programs=found.n_programs + 1)


class Relaxation:
    """The linear program of a program without whole numbers, with constraints that are added to it."""

    def __init__(self, program: "Program"):
        self.program = program
        # no plan lacks more fibers for a requirement than its minimum, nor for a rule than there are fibers
        most = np.where(np.isfinite(program.most), program.most, -program.low.min(initial=0.0))
        self.linear = LinearProgram(program.rows, most, presolve=program.may_presolve(program.rows[0]))

    def maximize(self, goal: np.ndarray, deadline: float, *, whole: bool) -> tuple[np.ndarray | None, float, bool]:
        """Return the variables that maximize a goal, an upper bound of the goal, and whether the variables are whole.

        The variables are None if the solver fails or the deadline passes. With ``whole``, the coefficients of the goal
        are whole numbers.
        """
        x, best = None, np.inf
        for _ in range(MOST_ROUNDS):
            x, bound = self.linear.maximize(goal, deadline)
            best = min(best, np.floor(bound + ROUNDING) if whole else bound)
            if x is None:
                break
            fractions = np.flatnonzero(np.abs(x - np.round(x)) > WHOLE)
            if len(fractions) == 0:
                return np.round(x), best, True
            if len(fractions) > MANY:
                break
            cuts = self.cliques(x, fractions[fractions < len(self.program.candidate)])
            for members in cuts:
                self.linear.add(members, np.ones(len(members)), 1.0)
            if not cuts:
                if not whole or bound < best + VIOLATED:
                    break
                used = np.flatnonzero(goal)
                self.linear.add(used, goal[used], best)
        return x, best, False

    def complete(self, x: np.ndarray, goal: np.ndarray, deadline: float) -> np.ndarray | None:
        """Return the best plan in which positioners have the same candidates as in x, except near fractions of x."""
        matrix, low, high = self.program.rows
        fractions = np.flatnonzero(np.abs(x - np.round(x)) > WHOLE)
        rows = np.unique(matrix[:, fractions].nonzero()[0])
        free = np.append(fractions, matrix[rows[high[rows] == 1.0]].indices)
        free = self.program.owner[free[free < len(self.program.owner)]]
        most = self.program.most.copy()
        is_fixed = ~np.isin(self.program.owner, free)
        most[: len(is_fixed)][is_fixed] = np.round(x[: len(is_fixed)][is_fixed])
        return maximize((matrix, low, high), goal, most, deadline, integral=True, gap=0.0)[0]

    def excluded(self, v: int) -> np.ndarray:
        """Return the variables of the candidates that a plan does not use if it uses the candidate of variable v."""
        options, c = self.program.candidates.options, self.program.candidate[v]
        t, i = options.target[c], options.owner[c]
        same = options.t_candidate[options.t_indptr[t] : options.t_indptr[t + 1]] if t >= 0 else np.empty(0, dtype=int)
        mine = np.arange(options.start[i], options.start[i + 1])
        others = np.concatenate([options.excluded[options.indptr[c] : options.indptr[c + 1]], same, mine])
        others = self.program.index[others]
        return np.unique(others[(others >= 0) & (others != v)])

    def cliques(self, x: np.ndarray, used: np.ndarray) -> list[np.ndarray]:
        """Return sets of variables of which a plan uses at most one, and whose sum is larger than 1."""
        used = used[np.argsort(-x[used], kind="stable")]
        place = np.full(self.program.n, -1)
        place[used] = np.arange(len(used))
        apart = np.zeros((len(used), len(used)), dtype=bool)
        every = [self.excluded(v) for v in used]
        for k, others in enumerate(every):
            apart[k, place[others][place[others] >= 0]] = True
        found = {}
        for k in range(len(used)):
            members, able = [k], apart[k].copy()
            while able.any():
                members.append(int(able.argmax()))
                able &= apart[members[-1]]
            if x[used[members]].sum() > 1.0 + VIOLATED:
                found[frozenset(members)] = members
        cuts = []
        for members in found.values():
            row = used[members].tolist()
            able = every[members[0]]
            for k in members[1:]:
                able = np.intersect1d(able, every[k], assume_unique=True)
            while len(able):  # other candidates that exclude all members
                row.append(int(able[0]))
                able = np.intersect1d(able[1:], self.excluded(able[0]), assume_unique=True)
            cuts.append(np.array(sorted(row)))
        return cuts
