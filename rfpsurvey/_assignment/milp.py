"""The integer program for positioners that have several candidates, with variables, constraints and objectives."""

import numpy as np
from scipy.sparse import csr_array, vstack

from rfpsurvey._assignment.candidates import Candidates, cover
from rfpsurvey._assignment.distribution import Spread, pairs_within
from rfpsurvey._assignment.solver import maximize

# The presolve of HiGHS ignores the time limit. It takes about PRESOLVE_SECONDS * (nonzero elements)^2 / variables, as
# measured on dense programs. It is skipped if this time exceeds the fraction PRESOLVE_PART of the time limit.
PRESOLVE_SECONDS, PRESOLVE_PART = 1.5e-6, 0.5
# Rounding error of sums of percentages.
ROUNDING = 1e-9


class SpreadRows:
    """The part of an integer program that describes a rule, with a variable for each science fiber.

    A science fiber is a pair of a positioner and a science target, or a fixed fiber outside of the program. Its
    variable is 1 if the fiber is in use and has enough neighbors. The variable is not necessary for fibers that have
    enough neighbors, or too few, in every plan of the program.

    The program uses the candidates ``rows``; the candidates ``outside`` are in use in every plan.
    """

    def __init__(self, candidates: Candidates, spread: Spread, rows: np.ndarray, outside: np.ndarray):
        problem, options, (rule, science, near) = candidates.problem, candidates.options, spread
        xy, target = problem.xy, options.target
        self.k, self.fraction = rule.k, rule.percent / 100
        # columns of the candidates that are science fibers
        self.science, neighbors = np.flatnonzero(science[rows]), np.flatnonzero(near[rows])
        fixed, n = target[outside[science[outside]]], len(self.science)
        targets, row = np.unique(np.append(target[rows[self.science]], fixed), return_inverse=True)
        place, at = np.unique(target[rows[neighbors]], return_inverse=True)
        pairs = pairs_within(xy[targets], xy[place], rule.distance_mm)
        close = csr_array((np.ones(len(pairs[0])), pairs), shape=(len(targets), len(place)))
        # columns of the candidates that are neighbors of each target, as ones, and number of fixed neighbors of each
        self.near = close @ csr_array((np.ones(len(at)), (at, neighbors)), shape=(len(place), len(rows)))
        pairs = pairs_within(xy[targets], xy[target[outside[near[outside]]]], rule.distance_mm)
        self.n_near = np.bincount(pairs[0], minlength=len(targets))
        enough = self.n_near >= rule.k
        is_open = ~enough & (self.n_near + self.near.sum(axis=1) >= rule.k)
        # columns of the candidates that are science fibers and have enough neighbors in every plan
        self.always = self.science[enough[row[:n]]]
        # number of science fibers outside the program, and how many of them have enough neighbors in every plan
        self.n_fixed, self.n_served = len(fixed), int(enough[row[n:]].sum())
        # the key of a science fiber is its positioner and its target; fixed fibers have a positioner after all others
        after = len(options.start) - 1
        key = row + len(targets) * np.append(options.owner[rows[self.science]], np.full(len(fixed), after))
        fibers, of_fiber = np.unique(key[is_open[row]], return_inverse=True)
        of_column = np.flatnonzero(is_open[row])
        free = of_column < n
        cells = of_fiber[free], self.science[of_column[free]]
        # columns of the candidates of each science fiber, as ones; empty for fixed fibers
        self.owner = csr_array((np.ones(len(cells[0])), cells), shape=(len(fibers), len(rows)))
        positioner, self.row = np.divmod(fibers, max(len(targets), 1))  # the row of ``near`` for each science fiber
        self.is_fixed = positioner == after
        _, place = np.unique(positioner[~self.is_fixed], return_inverse=True)
        cells = place, np.flatnonzero(~self.is_fixed)
        # science fibers of each positioner, as ones
        self.group = csr_array((np.ones(len(place)), cells), shape=(int(place.max(initial=-1)) + 1, len(fibers)))

    def __len__(self):
        return len(self.row)

    def values(self, x: np.ndarray) -> np.ndarray:
        """Return the variables of the science fibers for a plan, from the variables of the candidates."""
        x = x[: self.owner.shape[1]]
        return (self.is_fixed | (self.owner @ x > 0.5)) & (self.near @ x + self.n_near > self.k - 0.5)[self.row]

    def limits(self, owner: np.ndarray) -> list[tuple[csr_array, csr_array, np.ndarray]]:
        """Return constraints: one matrix times the fibers is at most another times the candidates plus a number.

        A fiber has neighbors only if it is in use, and if enough neighbors of its target are in use. The last
        constraints follow from these for whole numbers, because a positioner has one target, and they are much stronger
        for fractions. ``owner`` is the positioner of each candidate.
        """
        n, used = len(self), np.unique(self.row)
        unit = csr_array((np.ones(n), (np.searchsorted(used, self.row), np.arange(n))), shape=(len(used), n))
        every = csr_array(self.group @ unit.T)  # the targets of each positioner
        union = csr_array(every @ self.near[used]).tocoo()
        first = self.owner[self.group.indices[self.group.indptr[:-1]]]  # a candidate of each positioner
        mine = owner[first.indices[first.indptr[:-1]]]
        # the other candidates of a positioner are not in use if one of its science fibers is in use
        kept = (owner[union.col] != mine[union.row]) | np.isin(union.col, self.science)
        union = csr_array((np.ones(kept.sum()), (union.row[kept], union.col[kept])), shape=union.shape)
        most = csr_array(every.multiply(self.n_near[used])).max(axis=1).toarray().ravel()
        alone = np.flatnonzero(~self.is_fixed)
        pick = csr_array((np.ones(len(alone)), (np.arange(len(alone)), alone)), shape=(len(alone), n))
        return [
            (pick, self.owner[alone], np.zeros(len(alone))),
            (self.k * unit, self.near[used], self.n_near[used]),
            (self.k * self.group, union, most),
        ]


class Program:
    """An integer program whose solutions are plans that use candidates from ``rows``, which are sorted by positioner.

    ``outside`` are the candidates that positioners outside the program use; these candidates also count toward the
    requirements. ``edges`` are the pairs of candidates in ``rows`` that collide, shape (2, m). The variable of a
    candidate is 1 if the candidate is in use, and 0 otherwise. The variable of a requirement is the number of fibers
    that are missing for its minimum, and that of a rule on the distribution of fibers is the number of science fibers
    that lack neighbors. Further variables belong to the science targets of these rules (`SpreadRows`). The rows of
    ``matrix`` are the coefficients of the objectives, whose smallest and largest possible values are ``low`` and
    ``high``.
    """

    def __init__(
        self, candidates: Candidates, rows: np.ndarray, outside: np.ndarray, edges: np.ndarray, deadline: float = np.inf
    ):
        self.problem, self.candidates, self.candidate = candidates.problem, candidates, rows
        options = candidates.options
        self.target, self.owner = options.target[rows], options.owner[rows]
        self.index = np.full(len(options.owner), -1)
        self.index[rows] = np.arange(len(rows))
        self.spreads = [SpreadRows(candidates, spread, rows, outside) for spread in candidates.spreads]
        self.short = len(rows) + np.arange(len(self.problem.groups) + len(self.spreads))
        self.first = len(rows) + len(self.short) + np.cumsum([0, *map(len, self.spreads)])
        self.n = int(self.first[-1])
        self.most = np.ones(self.n)
        self.most[self.short] = np.inf
        self._parts, self._low, self._high = [], [], []
        self._positioners()
        self._cliques(edges, deadline)
        self._targets()
        self._requirements(outside)
        self._distributions()
        self.rows = vstack(self._parts, format="csr"), np.concatenate(self._low), np.concatenate(self._high)
        self.matrix, self.low, self.high = self._objectives()

    def variables(self, chosen: np.ndarray) -> np.ndarray:
        """Return the variables of a plan, including the number of missing fibers for each requirement."""
        x = np.zeros(self.n)
        x[self.index[chosen]] = 1.0
        for first, spread in zip(self.first, self.spreads, strict=False):
            x[first : first + len(spread)] = spread.values(x)
        matrix, low, _ = self.rows
        lack = np.maximum(low - matrix @ x, 0.0)
        x[self.short] = np.ceil(matrix[:, self.short].T @ np.where(np.isfinite(lack), lack, 0.0) - ROUNDING)
        return x

    @property
    def costs(self) -> np.ndarray:
        """Cost of each variable; the lowest total cost decides between plans that are equally good."""
        return np.append(self.candidates.options.cost[self.candidate], np.zeros(self.n - len(self.candidate)))

    def chosen(self, x: np.ndarray) -> np.ndarray:
        """Return the candidates that are in use if the variables have the given values."""
        return self.candidate[np.flatnonzero(x[: len(self.candidate)] > 0.5)]

    def reaches(self, x: np.ndarray) -> np.ndarray:
        """Return the value of each objective for the plan with the variables ``x``."""
        return np.round(self.matrix @ x)

    def goal(self, first: int, weights: np.ndarray) -> np.ndarray:
        """Return the coefficients of a weighted sum of successive objectives, beginning with objective ``first``."""
        return self.matrix[first : first + len(weights)].T @ weights

    def holds(self, x: np.ndarray) -> bool:
        """Return whether the variables satisfy all constraints."""
        matrix, low, high = self.rows
        total = matrix @ x
        return bool((total >= low - 1e-6).all() and (total <= high + 1e-6).all())

    def maximize(self, goal: np.ndarray, deadline: float, *, integral: bool, gap: float, keep=()):
        """Return the variables that maximize an objective, and the upper bound of this objective.

        The variables are None if no solution is found before the deadline. ``keep`` contains minimum values of the
        first objectives; ``gap`` is the allowed relative error of the maximum.
        """
        matrix, low, high = self.rows
        if len(keep):
            matrix = vstack([matrix, self.matrix[: len(keep)]], format="csr")
            low, high = np.append(low, keep), np.append(high, np.full(len(keep), np.inf))
        presolve = self.may_presolve(matrix)
        return maximize((matrix, low, high), goal, self.most, deadline, integral=integral, gap=gap, presolve=presolve)

    def may_presolve(self, matrix) -> bool:
        """Return whether the presolve of the solver is fast enough; the estimated time is the same on all computers."""
        seconds = PRESOLVE_SECONDS * matrix.nnz**2 / self.n
        return seconds <= PRESOLVE_PART * self.problem.time_limit

    def _add(self, row, column, low, high, value=1.0):
        """Add constraints, by default with the coefficients 1; ``low`` and ``high`` are the bounds of the constraints.

        For each coefficient, ``row`` contains the index of the constraint, counted from the first added constraint, and
        ``column`` contains the index of the variable.
        """
        n = len(high)
        self._parts.append(csr_array((np.broadcast_to(value, len(column)), (row, column)), shape=(n, self.n)))
        self._low.append(np.broadcast_to(low, n))
        self._high.append(np.broadcast_to(high, n))

    def _positioners(self):
        """Add constraints: exactly one candidate of each positioner is used."""
        _, row = np.unique(self.owner, return_inverse=True)
        self._add(row, np.arange(len(self.candidate)), 1.0, np.ones(int(row.max(initial=-1)) + 1))

    def _targets(self):
        """Add constraints: each target is observed at most once."""
        real = np.flatnonzero(self.target >= 0)
        _, row, count = np.unique(self.target[real], return_inverse=True, return_counts=True)
        shared = count[row] > 1
        _, row = np.unique(row[shared], return_inverse=True)
        self._add(row, real[shared], -np.inf, np.ones(int(row.max(initial=-1)) + 1))

    def _cliques(self, edges, deadline):
        """Add constraints: no two arms collide, and no two positioners have the same target."""
        if edges.shape[1]:  # otherwise, `_targets` is sufficient
            indptr, column = cover(self.candidates.options, self.candidate, edges, deadline)
            n = len(indptr) - 1
            self._add(np.repeat(np.arange(n), np.diff(indptr)), self.index[column], -np.inf, np.ones(n))

    def _requirements(self, outside):
        """Add constraints for the requirements: the plan may miss a minimum, but must not exceed a maximum."""
        held = self.candidates.held[:, self.candidate]
        already = self.candidates.held_sparse @ np.bincount(outside, minlength=len(self.candidates))
        columns, low, high = [np.empty(0, dtype=np.int64)], [], []
        for g, group in enumerate(self.problem.groups):
            column, requirement = np.flatnonzero(held[g]), group.requirement
            if requirement.minimum > 0:
                columns.append(np.append(column, self.short[g]))
                low.append(max(requirement.minimum - already[g], 0))
                high.append(np.inf)
            if requirement.maximum is not None:
                columns.append(column)
                low.append(-np.inf)
                high.append(max(requirement.maximum - already[g], 0))
        row = np.repeat(np.arange(len(columns)) - 1, [len(column) for column in columns])
        self._add(row, np.concatenate(columns), np.array(low), np.array(high, dtype=float))

    def _distributions(self):
        """Add constraints: science fibers have neighbors only if they are in use and enough neighbors are in use."""
        for short, first, spread in zip(self.short[len(self.problem.groups) :], self.first, self.spreads, strict=False):
            z = first + np.arange(len(spread))
            for fibers, candidates, most in spread.limits(self.owner) if len(spread) else []:
                fibers, candidates = fibers.tocoo(), candidates.tocoo()
                row, column = np.append(fibers.row, candidates.row), np.append(z[fibers.col], candidates.col)
                self._add(row, column, -np.inf, most.astype(float), np.append(fibers.data, -candidates.data))
            column = np.concatenate([z, spread.always, spread.science, [short]])
            value = np.repeat([1.0, 1.0, -spread.fraction, 1.0], [len(z), len(spread.always), len(spread.science), 1])
            low = spread.fraction * spread.n_fixed - spread.n_served - ROUNDING
            self._add(np.zeros(len(column), int), column, low, np.array([np.inf]), value)

    def _objectives(self):
        """Return the coefficients and the smallest and largest values of the objectives, in order of precedence."""
        problem, rank = self.problem, self.candidates.options.rank[self.candidate]
        first, stop = problem._objectives.first, problem._objectives.stop
        order = np.argsort(rank, kind="stable")
        ends = np.searchsorted(rank[order], np.arange(len(problem.classes) + 2))
        columns = [order[a:b] for a, b in zip(ends[first], ends[stop], strict=True)]
        if problem.any_required:
            columns[0] = np.flatnonzero(np.append(problem.is_required, False)[self.target])
        low, worth = np.zeros(len(columns)), np.ones(len(columns))
        high = [min(len(np.unique(self.owner[used])), len(np.unique(self.target[used]))) for used in columns]
        if problem.any_goals:
            k = int(problem.any_required)
            columns[k], worth[k], high[k] = self.short, -1.0, 0
            low[k] = -sum(g.requirement.minimum for g in problem.groups)
            low[k] -= len(self.spreads) * (len(self.candidates.options.start) - 1)
        sizes, no_columns = [len(used) for used in columns], np.empty(0, dtype=np.int64)  # there may be no classes
        row, column = np.repeat(np.arange(len(columns)), sizes), np.concatenate([*columns, no_columns])
        matrix = csr_array((np.repeat(worth, sizes), (row, column)), shape=(len(columns), self.n))
        return matrix, low, np.array(high, dtype=float)
