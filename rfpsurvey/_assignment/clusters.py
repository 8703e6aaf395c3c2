"""Find plans and upper bounds for many positioners by integer programs for clusters of neighboring positioners.

Upper bounds from prices (Lagrange multipliers) of cliques are valid even if the search for better prices ends early.

A clique is a set of candidates; a plan uses at most one candidate of each clique.
"""

from collections.abc import Callable, Iterable

import numpy as np
from scipy.sparse import csr_array

from rfpsurvey._assignment.candidates import Candidates, cover
from rfpsurvey._assignment.clock import OutOfTimeError, left, share
from rfpsurvey._assignment.local_search import stand
from rfpsurvey._assignment.milp import Program
from rfpsurvey._assignment.objectives import pursue
from rfpsurvey._assignment.problem import AllocationProblem
from rfpsurvey._assignment.solver import choose_one_each
from rfpsurvey._kernels import conflicts
from rfpsurvey._kernels import paths as kernels
from rfpsurvey._kernels import repair as moves

# The value of a candidate is its weight minus the prices of its cliques. To adjust the prices, the largest value among
# the candidates of a positioner is replaced by a smooth maximum: width * log(sum(exp(value / width))). WIDTHS contains
# the successive widths; N_SWEEPS is the largest number of sweeps for each width. A sweep adjusts all prices once.
WIDTHS, N_SWEEPS = (0.2, 0.1, 0.05, 0.03, 0.02, 0.01, 0.005), 30
# The search continues with the next width if the bound decreases by less than this fraction in one sweep.
SLOW = 2e-5
# Number of cliques whose prices are adjusted before the clock is read again.
BATCH = 1 << 15
# Relative rounding error of the sums of prices; this error is added to each bound.
ROUNDING = 1e-9


class Prices:
    """Cliques that cover collisions and shared targets of candidates, and prices of these cliques for one objective."""

    def __init__(self, candidates: Candidates, deadline: float):
        options = candidates.options
        self.indptr, self.column = cover(options, np.arange(len(candidates)), candidates.pairs, deadline)
        self.start, self.owner = options.start, options.owner
        shape = len(self.indptr) - 1, len(candidates)
        self.matrix = csr_array((np.ones(len(self.column)), self.column, self.indptr), shape=shape)
        self.price, self.most = np.zeros(shape[0]), np.ones(shape[0])
        self.lowest, self.highest = np.zeros(shape[0]), np.full(shape[0], np.inf)

    def values(self, weights: np.ndarray) -> np.ndarray:
        """Return the weight of each candidate minus the prices of its cliques."""
        return weights - self.matrix.T @ self.price

    def bound(self, weights: np.ndarray) -> float:
        """Return an upper bound of the total weight of any plan."""
        bound = float(kernels.bound_of(self.start, self.values(weights), self.price))
        return bound + ROUNDING * (len(self.start) + float(self.price.sum()))

    def improve(self, weights: np.ndarray, deadline: float) -> float:
        """Adjust the prices for an objective until a deadline, and return the upper bound of the objective."""
        sweeps = [(width, N_SWEEPS) for width in WIDTHS]
        return self.adjust(weights, sweeps, lambda: left(deadline) == 0, slow=SLOW, n_least=3)

    def adjust(self, weights: np.ndarray, sweeps: Iterable, is_over: Callable, *, slow: float, n_least: int) -> float:
        """Adjust the prices for an objective, and return the upper bound of the objective.

        ``sweeps`` contains the width and the number of sweeps of each stage. A stage also ends if the bound decreases
        by less than the fraction ``slow`` in a sweep, but not before ``n_least`` sweeps.
        """
        n, limits = len(self.price), (self.most, self.lowest, self.highest)
        best, best_price = self.bound(weights), self.price.copy()
        for width, number in sweeps:
            before = np.inf
            for sweep in range(number):
                value = self.values(weights)
                for begin in range(0, n, BATCH):
                    if is_over():
                        break
                    end = min(begin + BATCH, n)
                    ends = (begin, end, 1) if sweep % 2 == 0 else (n - begin - 1, n - end - 1, -1)
                    kernels.adjust_prices(
                        self.start, self.owner, self.indptr, self.column, value, self.price, limits, width, *ends
                    )
                now = self.bound(weights)
                if now < best:
                    best, best_price = now, self.price.copy()
                if is_over() or (before - now < slow * abs(now) and sweep + 1 >= n_least):
                    break
                before = now
        self.price = best_price
        return best


def weights_of(problem: AllocationProblem, options) -> list:
    """Return the weights of all candidates for each objective, or None for the objective of the requirements.

    The weights for a class include the targets of this class and of all earlier classes.

    Parameters
    ----------
    problem : AllocationProblem
        The allocation problem.
    options : Options
        The candidates.

    Returns
    -------
    list of (ndarray of float or None)
        Weights of the candidates: one array, or None, for each objective.
    """
    weights = [(options.rank < stop).astype(float) for stop in problem._objectives.stop]
    if problem.any_required:
        weights[0] = np.append(problem.is_required, False)[options.target].astype(float)
    if problem.groups:
        weights[int(problem.any_required)] = None
    return weights


# Number of variables in the integer program of a cluster: initial value, smallest value, and largest value.
SIZE, SMALLEST, LARGEST = 2000, 100, 8000
# Allowed relative error of the integer programs that give upper bounds.
GAP = 2e-4
# Fraction of the remaining time that the integer program of one cluster may take.
FOR_ONE = 0.25
# Each division of the positioners into clusters is rotated by this angle (the golden angle, in radians) relative to the
# previous division.
ANGLE = 2.399963


def bound_by_clusters(candidates: Candidates, prices: Prices, weights: np.ndarray, deadline: float):
    """Return an upper bound of the total weight of a plan, and a plan in which arms of different clusters may collide.

    The constraints of cliques with members in several clusters are replaced by the prices (Lagrange multipliers) of
    these cliques. Each cluster is then an independent integer program. If a program is not solved before the deadline,
    the bound from the prices is used for its cluster.

    Parameters
    ----------
    candidates : Candidates
        The candidates.
    prices : Prices
        Prices of the cliques of these candidates.
    weights : ndarray of float, shape (n_candidates,)
        Weight of each candidate.
    deadline : float
        Value of `now` at which the search ends.

    Returns
    -------
    bound : float
        Upper bound of the total weight of any plan.
    chosen : ndarray of int, shape (n_positioners,)
        Candidate of each positioner, or -1 if its cluster was not solved.
    """
    options = candidates.options
    n = len(options.start) - 1
    chosen = np.where(np.diff(options.start) == 1, options.start[:-1], -1)
    label = _partition(candidates, np.arange(n), LARGEST, 0.0)
    of_candidate = label[options.owner]
    row = np.repeat(np.arange(len(prices.price)), np.diff(prices.indptr))
    cluster = of_candidate[prices.column]
    low, high = np.full(len(prices.price), len(label)), np.full(len(prices.price), -1)
    np.minimum.at(low, row, cluster)
    np.maximum.at(high, row, cluster)
    # the prices of cliques within one cluster are replaced by constraints of its integer program
    cross = low != high
    total = float(prices.price[cross].sum())
    value = weights - prices.matrix.T @ np.where(cross, prices.price, 0.0)
    reduced = prices.values(weights)
    # The candidates are sorted by cluster, and the matrix is stored by columns. The candidates and cliques of one
    # cluster are then found without a search through all candidates.
    order = np.argsort(of_candidate, kind="stable")
    ends = np.searchsorted(of_candidate[order], np.arange(label.max(initial=-1) + 2))
    by_column = prices.matrix.tocsc()
    inner = np.bincount(low[~cross], weights=prices.price[~cross], minlength=len(ends))
    for k in range(len(ends) - 1):
        rows = order[ends[k] : ends[k + 1]]
        owners = np.unique(options.owner[rows])
        start = np.searchsorted(options.owner[rows], np.append(owners, n))
        fallback = float(inner[k]) + float(kernels.bound_of(start, reduced[rows], np.zeros(0)))
        bound, x = _solve_cluster(by_column, rows, start, value[rows], deadline)
        total += min(bound, fallback)
        if x is not None:
            used = rows[x > 0.5]
            chosen[options.owner[used]] = used
    return total + 1e-9 * (n + float(prices.price.sum())), chosen


def _solve_cluster(matrix, rows, start, value, deadline):
    """Solve the integer program of one cluster; return an upper bound of its weight, and its variables' values."""
    if left(deadline) == 0:
        return np.inf, None
    part = csr_array(matrix[:, rows])
    part = part[np.flatnonzero(np.diff(part.indptr) > 1)]
    x, bound = choose_one_each(start, value, part, np.ones(part.shape[0]), share(deadline, FOR_ONE), gap=GAP)
    return bound, x


def improve_by_clusters(
    candidates: Candidates, chosen: np.ndarray, deadline: float, is_best=None, upper=None, size: int = SIZE
) -> np.ndarray:
    """Improve a plan with an integer program for each cluster of positioners, while all other arms are fixed.

    The positioners are divided into clusters several times, each time with a different orientation of the clusters. The
    search ends at the deadline, when ``is_best`` returns true for the present plan, or when the largest programs find
    no better plan.

    Parameters
    ----------
    candidates : Candidates
        The candidates.
    chosen : ndarray of int, shape (n_positioners,)
        Candidate of each positioner in a plan without collisions.
    deadline : float
        Value of `now` at which the search ends.
    is_best : callable, optional
        Function that takes a plan in the form of ``chosen``, and returns whether this plan is known to be optimal.
    upper : callable, optional
        Function that returns an upper bound of each objective from the values of all earlier objectives.
    size : int, optional
        Number of candidates of the first clusters.

    Returns
    -------
    ndarray of int, shape (n_positioners,)
        Candidate of each positioner.
    """
    options = candidates.options
    now, blocked, holder = stand(candidates, chosen)
    open_ones = np.flatnonzero(np.diff(options.start) > 1)
    best_rank = np.minimum.reduceat(options.rank, options.start[:-1]) if len(now) else options.rank
    quiet, turn = 0, 0
    while len(open_ones) and left(deadline) > 0 and not (is_best is not None and is_best(now)):
        label = _partition(candidates, open_ones, size, turn * ANGLE)
        turn += 1
        improved, in_time = False, True
        order = np.argsort(label[open_ones], kind="stable")
        for members in np.split(open_ones[order], np.flatnonzero(np.diff(label[open_ones][order])) + 1):
            at_best = (options.rank[now[members]] == best_rank[members]).all()
            if at_best and not candidates.problem.any_goals:
                continue
            if left(deadline) == 0:
                break
            better, solved = _improve_cluster(candidates, members, now, blocked, holder, deadline, upper)
            improved |= better
            in_time &= solved
        # clusters grow after two divisions in a row without a better plan, and shrink if a program takes too long
        if not in_time:
            size = max(size // 2, SMALLEST)
        elif improved:
            quiet = 0
        elif (quiet := quiet + 1) > 1:
            if size >= LARGEST or size >= len(options.owner):
                break
            size, quiet = 2 * size, 0
        if not in_time and size == SMALLEST and not improved and (quiet := quiet + 1) > 2:
            break
    return now


def improve_members(
    candidates: Candidates, chosen: np.ndarray, members: np.ndarray, deadline: float, upper
) -> np.ndarray:
    """Improve a plan with one integer program for the positioners ``members``, as in `improve_by_clusters`."""
    now, blocked, holder = stand(candidates, chosen)
    _improve_cluster(candidates, members, now, blocked, holder, deadline, upper)
    return now


def _improve_cluster(candidates, members, now, blocked, holder, deadline, upper=None):
    """Optimize one cluster in place; return whether its plan improved, and whether the program was solved in time."""
    options, before, solution = candidates.options, now[members].copy(), None
    limit = share(deadline, FOR_ONE)
    try:
        program = program_of(candidates, members, now, blocked, holder, limit)
        part = None if upper is None else upper_of_part(candidates, now, upper)[0]
        solution = pursue(program, before, limit, None, integral=True, squared_cost=False, upper=part)
    except OutOfTimeError:
        pass
    better = False
    after = before
    if solution is not None and solution.chosen is not None and len(solution.chosen) == len(members):
        x = program.variables(before)
        better = not program.holds(x) or tuple(solution.values) > tuple(program.reaches(x))
        after = solution.chosen
    for c in after:
        moves.put(options.owner[c], c, options, now, blocked, holder)
    return better, solution is not None and bool((solution.values >= solution.bounds).all())


def upper_of_part(candidates: Candidates, now: np.ndarray, upper: Callable) -> tuple[Callable, np.ndarray]:
    """Return the function ``upper`` for a program, and the values that positioners outside of the program add.

    ``now`` is -1 for the positioners of the program. The objective of the requirements of the program already contains
    the contributions of all positioners.
    """
    base = candidates.problem.level_values(np.where(now < 0, -1, candidates.options.target[now]))
    base[int(candidates.problem.any_required)] = 0.0
    return lambda values: upper(values + base) - base, base


def program_of(candidates: Candidates, members: np.ndarray, now, blocked, holder, deadline: float) -> Program:
    """Take the candidates from some positioners, in place, and return the program that finds new candidates for them.

    ``now``, ``blocked`` and ``holder`` are the state of the plan (`stand`); all other arms are fixed.
    """
    options = candidates.options
    for i in members:
        moves.put(i, -1, options, now, blocked, holder)
    rows = _ranges(options.start[members], options.start[members + 1])
    target = options.target[rows]
    rows = rows[(blocked[rows] == 0) & ((target < 0) | (holder[target] < 0))]
    outside = now[now >= 0] if candidates.problem.any_goals else np.empty(0, dtype=np.int64)
    return Program(candidates, rows, outside, edges_within(options, rows), deadline)


def edges_within(options: conflicts.Options, rows: np.ndarray) -> np.ndarray:
    """Return the collisions among the candidates ``rows``.

    Parameters
    ----------
    options : Options
        All candidates.
    rows : ndarray of int, shape (n,)
        Indices of candidates.

    Returns
    -------
    ndarray of int, shape (2, m)
        Pairs of candidates that collide.
    """
    begin, end = options.indptr[rows], options.indptr[rows + 1]
    first, second = np.repeat(rows, end - begin), options.excluded[_ranges(begin, end)]
    sorted_rows = np.sort(rows)
    place = np.minimum(np.searchsorted(sorted_rows, second), len(rows) - 1)
    keep = (sorted_rows[place] == second) & (first < second) if len(rows) else np.zeros(0, dtype=bool)
    return np.array([first[keep], second[keep]])


def _ranges(begin, end):
    """Return the whole numbers from ``begin[k]`` to ``end[k] - 1``, for each k in turn."""
    size = end - begin
    return np.repeat(begin - np.cumsum(size) + size, size) + np.arange(size.sum())


def _partition(candidates, members, size, angle):
    """Divide positioners into clusters of about ``size`` candidates, and return the cluster of each positioner.

    The clusters are rectangles in a coordinate system that is rotated by ``angle``. Positioners that are not in
    ``members`` have the cluster -1.
    """
    options = candidates.options
    xy = candidates.problem.focal_plane.arrays.xy[members]
    load = np.diff(options.start)[members]
    n_strips = max(round(np.sqrt(load.sum() / size)), 1)
    # strips along v and then cells of each strip, with about equal numbers of candidates
    u, v = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]]) @ xy.T
    order = np.lexsort((v, u))
    before = np.cumsum(load[order]) - load[order]
    strip = np.empty(len(members), dtype=np.int64)
    strip[order] = before * n_strips // max(load.sum(), 1)
    order = np.lexsort((v, strip))
    before = np.cumsum(load[order]) - load[order]
    first = before[np.searchsorted(strip[order], np.arange(n_strips))]
    in_strip = np.bincount(strip, weights=load, minlength=n_strips)
    n_cells = np.maximum(np.round(in_strip / size), 1).astype(np.int64)
    cell = ((before - first[strip[order]]) * n_cells[strip[order]] // np.maximum(in_strip[strip[order]], 1)).astype(int)
    label = np.full(len(options.start) - 1, -1)
    label[members[order]] = (np.cumsum(n_cells) - n_cells)[strip[order]] + cell
    return label
