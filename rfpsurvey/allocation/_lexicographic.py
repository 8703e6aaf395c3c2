"""Aims in strict order, each proven before the next one is looked at."""

from time import perf_counter
from typing import NamedTuple

import numpy as np

from rfpsurvey.allocation._milp import Program

__all__ = ["Solution", "pursue"]

# Aims are put into one objective while the product of their sizes stays below this, so that rounding is harmless.
LARGEST = 1e6
# Otherwise aims that are proven enter the objective of the next with weights that fall by this, and so many of them.
STEEP, N_STEEP = 8.0, 4
# Programs with so many variables.
LARGE = 500
# Part of the time that is kept for aims that cannot be proven in time, the least weight of one of them, and a gap.
FOR_FILLING, FLATTEST, GOOD_ENOUGH = 0.2, 1e-3, 1e-3


class Solution(NamedTuple):
    """One candidate of each positioner of a part, and what each aim reaches."""

    chosen: np.ndarray | None
    """Candidates in use; None where time did not suffice to find any plan."""
    values: np.ndarray
    bounds: np.ndarray
    n_programs: int
    integral: bool
    """Had integers to be asked for?"""


class _Pursuit:
    """What is known so far."""

    def __init__(self, program: Program, first, limit, *, integral):
        self.program, self.limit = program, limit
        self.integral, self.n_programs = integral, 0
        self.high = np.array([aim.high for aim in program.aims])
        self.classes = np.array([aim.is_class for aim in program.aims])
        x = program.variables(first)
        self.x = x if program.holds(x) else None
        self.values = program.reaches(x)
        self.solved: list[float] = []  # values of the first aims

    def upper(self, values):
        """Return what each aim cannot exceed, given the values of those before it."""
        if self.limit is None:
            return self.high
        # no plan has more targets of the first classes than the best matching has
        before = np.cumsum(self.classes * values) - self.classes * values
        most = np.where(self.classes, np.cumsum(self.classes * self.limit) - before, self.limit)
        if self.program.problem.any_required:
            # the matching is the best one if all that comes before is as good as in it
            known = np.append(True, np.cumprod(values >= self.limit)[:-1] > 0)
            most = np.where(known, most, np.inf)
        return np.minimum(self.high, most)

    def maximize(self, goal, keep, deadline, gap=0.0):
        """Return the best variables for a goal and its bound; a linear program first, if that may do."""
        x, bound = self.program.maximize(goal, deadline, integral=self.integral, keep=keep, gap=gap)
        self.n_programs += 1
        if not self.integral and x is not None:
            if np.abs(x - np.round(x)).max() > 1e-6:
                self.integral = True
                return self.maximize(goal, keep, deadline, gap)
            x = np.round(x)
        return x, bound

    def take(self, x):
        """Keep the variables if they are better than those there are."""
        values = self.program.reaches(x)
        if self.x is None or tuple(values) > tuple(self.values):
            self.x, self.values = x, values

    def next_pack(self, k, largest):
        """Return how many aims from k on fit into one objective, and their weights."""
        sizes, product = [], 1.0
        for aim in self.program.aims[k:]:
            product *= aim.high - aim.low + 1.0
            if sizes and product > largest:
                break
            sizes.append(aim.high - aim.low + 1.0)
        return len(sizes), np.cumprod([1.0, *sizes[:0:-1]])[::-1]

    def prove(self, k, deadline):
        """Solve aim k, and those that fit in with it; return how many are proven then, and a bound of the first."""
        program, n_solved = self.program, len(self.solved)
        if self.x is not None and self.is_kept(self.values):
            short = np.flatnonzero(self.values[k:] < self.upper(self.values)[k:])
            n = int(short[0]) if len(short) else len(program.aims) - k
            if n:
                self.solved += self.values[k : k + n].tolist()
                return n, self.values[k]
        # aims that are proven: as constraints, or (without these a large program is far easier) in the objective
        in_goal = N_STEEP if n_solved and program.n > LARGE else 0
        n, weights = self.next_pack(k, LARGEST / STEEP**in_goal)
        goal = program.goal(k, weights)
        lowest = sum(w * aim.low for w, aim in zip(weights[1:], program.aims[k + 1 : k + n], strict=True))
        for n_soft in dict.fromkeys([min(in_goal, n_solved), 0]):
            first = n_solved - n_soft
            slope = weights[0] * STEEP ** np.arange(n_soft, 0, -1)
            extra, worth = program.goal(first, slope), slope @ self.solved[first:]
            x, bound = self.maximize(goal + extra, self.solved[:first], deadline)
            if x is None:
                return 0, np.inf
            self.take(x)
            values = program.reaches(x)
            done = (goal + extra) @ x >= bound - 0.5
            if done and self.is_kept(values):
                self.solved += values[k : k + n].tolist()
                self.x, self.values = x, values
                return n, values[k]
            if not done:
                return 0, np.floor((bound - worth - lowest) / weights[0] + 1e-6)
        return 0, np.inf

    def fill(self, k, deadline):
        """Make the best of the aims from k on, which could not be proven, about in their order."""
        worth = np.maximum(STEEP ** -np.arange(len(self.program.aims) - k, dtype=float), FLATTEST)
        x, _ = self.maximize(self.program.goal(k, worth), self.solved, deadline, gap=GOOD_ENOUGH)
        if x is not None:
            self.take(x)

    def is_kept(self, values):
        """Say whether nothing that is proven is lost."""
        return bool((values[: len(self.solved)] >= self.solved).all())


def pursue(program: Program, first, deadline: float, limit, *, integral: bool, squared_cost: bool) -> Solution:
    """Return the best plan, or the best one found before the deadline, beginning with ``first`` if that may be.

    ``limit``, where there is one, is what the aims of a matching reach whose arms may collide. With
    ``squared_cost`` the least cost of all best plans comes last.
    """
    now = _Pursuit(program, first, limit, integral=integral)
    aims, k = program.aims, 0
    left = deadline - perf_counter()
    halt = deadline - FOR_FILLING * left if np.isfinite(left) and len(aims) > 1 else deadline
    bounds = now.high.copy()
    while k < len(aims):
        n, bound = now.prove(k, halt)
        if n == 0:
            if k < len(aims) - 1:
                now.fill(k, deadline)
            bounds[k:] = now.upper(now.values)[k:]
            bounds[k] = min(bound, bounds[k])
            break
        bounds[k : k + n] = now.solved[k:]
        k += n
    if squared_cost and k == len(aims):
        cost = np.append(program.candidates.options.cost[program.candidate], np.zeros(len(program.short)))
        x, _ = now.maximize(-cost, now.solved, deadline, gap=1e-9)
        if x is not None:
            now.x = x
    if now.x is None:
        return Solution(None, now.values, bounds, now.n_programs, now.integral)
    values = program.reaches(now.x)
    return Solution(program.chosen(now.x), values, np.maximum(bounds, values), now.n_programs, now.integral)
