"""The best plan by linear programming: aims in strict order, each proven before the next one is looked at."""

from dataclasses import dataclass
from time import perf_counter

import numpy as np
from scipy.sparse import csr_array, vstack

from rfpsurvey._kernels import conflicts
from rfpsurvey.allocation._candidates import Candidates
from rfpsurvey.allocation._problem import Problem

__all__ = ["Program", "Solution"]

# Aims are put into one objective while the product of their sizes stays below this, so that rounding is harmless.
LARGEST = 1e6


@dataclass
class Solution:
    """One candidate of each positioner of a part, and what each aim reaches."""

    chosen: np.ndarray | None
    """Candidates in use; None where time did not suffice to find any plan."""
    values: np.ndarray
    bounds: np.ndarray
    n_programs: int = 0
    integral: bool = False


class Program:
    """Variables and constraints of some positioners whose candidates are not decided.

    ``rows`` are their candidates, sorted by positioner; ``others`` are those in use elsewhere, which count for the
    requirements. ``edges`` are the conflicts among ``rows``, shape (2, m).
    """

    def __init__(self, problem: Problem, candidates: Candidates, rows, others, edges):
        self.problem, self.candidates, self.rows = problem, candidates, rows
        options = candidates.options
        self.target, self.own = options.target[rows], options.own[rows]
        self.index = np.full(len(options.own), -1)
        self.index[rows] = np.arange(len(rows))
        n_short = len(problem.groups)
        self.n = len(rows) + n_short
        self.short = np.arange(len(rows), self.n)
        self._parts, self._low, self._high = [], [], []
        self._positioners()
        self._cliques(edges)
        self._targets()
        self._requirements(others)
        self.aims = self._aims()

    def _add(self, row, column, low, high):
        """Add rows of ones; ``row`` counts from 0."""
        n = len(high)
        self._parts.append(csr_array((np.ones(len(column)), (row, column)), shape=(n, self.n)))
        self._low.append(np.broadcast_to(low, n))
        self._high.append(np.broadcast_to(high, n))

    def _positioners(self):
        """One candidate of each positioner is in use."""
        _, row = np.unique(self.own, return_inverse=True)
        self._add(row, np.arange(len(self.rows)), 1.0, np.ones(int(row.max(initial=-1)) + 1))

    def _targets(self):
        """No target is observed twice."""
        real = np.flatnonzero(self.target >= 0)
        _, row, count = np.unique(self.target[real], return_inverse=True, return_counts=True)
        shared = count[row] > 1
        _, row = np.unique(row[shared], return_inverse=True)
        self._add(row, real[shared], -np.inf, np.ones(int(row.max(initial=-1)) + 1))

    def _cliques(self, edges):
        """No two arms collide; two arms on the same target are a conflict like any other."""
        if edges.shape[1] == 0:
            return
        options = self.candidates.options
        edges = np.concatenate([edges, self._twins()], axis=1)
        own = options.own[edges]
        edges = np.where(own[0] < own[1], edges, edges[::-1])
        own = np.sort(own, axis=0)
        order = np.lexsort((edges[1], edges[0], own[1], own[0]))
        edges, own = edges[:, order], own[:, order]
        new = np.append(True, (np.diff(own, axis=1) != 0).any(axis=0))
        starts = np.append(np.flatnonzero(new), edges.shape[1])
        edges = np.ascontiguousarray(edges)
        sizes = np.zeros(edges.shape[1] + 1, dtype=np.int64)
        n = conflicts.clique_rows(edges, len(starts) - 1, starts, sizes, np.empty(0, dtype=np.int64))
        column = np.empty(sizes[n], dtype=np.int64)
        conflicts.clique_rows(edges, len(starts) - 1, starts, sizes, column)
        row = np.repeat(np.arange(n), np.diff(sizes[: n + 1]))
        self._add(row, self.index[column], -np.inf, np.ones(n))

    def _twins(self):
        """Pairs of candidates of different positioners for the same target."""
        options = self.candidates.options
        rows = self.rows[np.argsort(self.target, kind="stable")]
        rows = rows[options.target[rows] >= 0]
        found, step = [np.empty((2, 0), dtype=np.int64)], 1
        while True:
            pair = np.array([rows[:-step], rows[step:]])
            same = options.target[pair[0]] == options.target[pair[1]]
            if not same.any():
                return np.concatenate(found, axis=1)
            apart = options.own[pair[0]] != options.own[pair[1]]
            found.append(pair[:, same & apart])
            step += 1

    def _requirements(self, others):
        """Minima may be missed, maxima may not."""
        held = self.candidates.held
        for g, group in enumerate(self.problem.groups):
            column = np.flatnonzero(held[g, self.rows])
            already, one = int(held[g, others].sum()), group.requirement
            if one.minimum > 0:
                column_of = np.append(column, self.short[g])
                self._add(np.zeros(len(column_of), int), column_of, max(one.minimum - already, 0), np.array([np.inf]))
            if one.maximum is not None:
                self._add(np.zeros(len(column), int), column, -np.inf, np.array([max(one.maximum - already, 0.0)]))

    def _aims(self):
        """Coefficients of each aim, and the most that it can reach."""
        problem, n = self.problem, len(self.rows)
        rank = self.candidates.options.rank[self.rows]
        aims = []

        def add(flags):
            flags = np.append(flags.astype(float), np.zeros(len(self.short)))
            used = np.flatnonzero(flags)
            most = min(len(np.unique(self.own[used])), len(np.unique(self.target[used])))
            aims.append((flags, 0.0, float(most)))

        if problem.required is not None:
            add(np.append(problem.required, False)[self.target])
        if problem.groups:
            wanted = sum(g.requirement.minimum for g in problem.groups)
            aims.append((np.append(np.zeros(n), -np.ones(len(self.short))), -float(wanted), 0.0))
        if problem.objective == "count" and len(problem.classes) > 1:
            add(rank < len(problem.classes))
        for k in range(len(problem.classes)):
            add(rank == k)
        if not problem.science.all():
            add(self.target >= 0)
        return aims

    def value_of(self, picked):
        """Return what each aim reaches with the variables ``picked`` (0 or 1, and shortfalls)."""
        return np.array([flags @ picked for flags, _, _ in self.aims])

    def picked(self, chosen):
        """Return the variables of a plan; the shortfalls of requirements are those that it has."""
        x = np.zeros(self.n)
        x[self.index[chosen[self.index[chosen] >= 0]]] = 1.0
        matrix, low, _ = self._constraints()
        lack = np.maximum(low - matrix @ x, 0.0)
        x[self.short] = matrix[:, self.short].T @ np.where(np.isfinite(lack), lack, 0.0)
        return x

    def _constraints(self):
        return vstack(self._parts, format="csr"), np.concatenate(self._low), np.concatenate(self._high)

    def solve(self, first: np.ndarray, deadline: float, limit, *, integral: bool, squared_cost: bool) -> Solution:
        """Return the best plan, or the best one found before the deadline, beginning with ``first`` if that may be.

        ``limit``, where there is one, is what the aims reach at most, in strict order.
        """
        self._rows = self._constraints()
        x = self.picked(first)
        values, bounds = self.value_of(x), np.array([most for _, _, most in self.aims])
        if not self._holds(x):
            x = None
        solution = Solution(None, values, bounds, 0, integral)
        todo = list(range(len(self.aims)))
        if limit is not None and (values == limit).all():
            todo, bounds = [], values.copy()
            for (flags, _, _), value in zip(self.aims, values, strict=True):
                self._fix(flags, value)
        elif limit is not None:
            bounds[0] = min(bounds[0], limit[0])
        while todo:
            pack, size = [], 1.0
            while todo and (not pack or size * (self._span(todo[0]) + 1.0) <= LARGEST):
                size *= self._span(todo[0]) + 1.0
                pack.append(todo.pop(0))
            weights = np.cumprod([1.0] + [self._span(k) + 1.0 for k in pack[:0:-1]])[::-1]
            goal = sum(w * self.aims[k][0] for w, k in zip(weights, pack, strict=True))
            x, best, solution.integral = self._maximize(goal, x, deadline, solution.integral)
            solution.n_programs += 1
            values = None if x is None else self.value_of(x)
            lowest = sum(w * self.aims[k][1] for w, k in zip(weights[1:], pack[1:], strict=True))
            if x is None or goal @ x < best - 0.5:  # out of time
                if np.isfinite(best):
                    bounds[pack[0]] = min(bounds[pack[0]], np.floor((best - lowest) / weights[0] + 1e-6))
                break
            bounds[pack] = values[pack]
            for k in pack:
                self._fix(self.aims[k][0], values[k])
        else:
            if squared_cost:
                cost = np.append(self.candidates.options.cost[self.rows], np.zeros(len(self.short)))
                x, _, solution.integral = self._maximize(-cost, x, deadline, solution.integral, exact=False)
                solution.n_programs += 1
        if x is None:
            solution.bounds = bounds
            return solution
        solution.chosen = self.rows[np.flatnonzero(x[: len(self.rows)] > 0.5)]
        solution.values = np.round(self.value_of(x))
        solution.bounds = np.maximum(bounds, solution.values)
        return solution

    def _holds(self, x):
        """Say whether variables keep all constraints."""
        matrix, low, high = self._rows
        total = matrix @ x
        return bool((total >= low - 1e-6).all() and (total <= high + 1e-6).all())

    def _span(self, k):
        return self.aims[k][2] - self.aims[k][1]

    def _fix(self, flags, value):
        """Keep what an aim has reached."""
        matrix, low, high = self._rows
        used = csr_array(flags[None])
        self._rows = vstack([matrix, used], format="csr"), np.append(low, value), np.append(high, np.inf)

    def _maximize(self, goal, x, deadline, integral, exact=True):
        """Return variables, what the goal cannot exceed, and whether integers had to be asked for."""
        from scipy.optimize import Bounds, LinearConstraint, milp

        left = deadline - perf_counter()
        most = np.append(np.ones(len(self.rows)), np.full(len(self.short), np.inf))
        if left <= 0:
            return x, np.inf, integral
        matrix, low, high = self._rows
        found = milp(
            -goal, constraints=LinearConstraint(matrix, low, high), bounds=Bounds(0, most),
            integrality=np.full(self.n, int(integral)),
            options={"time_limit": min(left, 1e9), "mip_rel_gap": 0.0 if exact else 1e-9},
        )  # fmt: skip
        bound = -found.mip_dual_bound if integral and found.mip_dual_bound is not None else np.inf
        if found.x is None:
            return x, bound, integral
        new = np.round(found.x)
        if not integral:
            if found.status != 0:
                return x, np.inf, integral
            if np.abs(found.x - new).max() > 1e-6:  # no network after all
                return self._maximize(goal, x, deadline, True, exact)
            bound = -found.fun
        return (new if x is None or goal @ new >= goal @ x - 1e-9 else x), bound, integral
