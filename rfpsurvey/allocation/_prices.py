"""Upper bounds from prices (Lagrange multipliers) of cliques, valid even if the search for better prices ends early.

A clique is a set of candidates; a plan uses at most one candidate of each clique.
"""

from collections.abc import Callable, Iterable

import numpy as np
from scipy.sparse import csr_array

from rfpsurvey._kernels import prices as kernels
from rfpsurvey.allocation._candidates import Candidates, cover
from rfpsurvey.allocation._clock import left
from rfpsurvey.allocation._problem import AllocationProblem

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
