"""Upper bounds from prices (Lagrange multipliers) of cliques, valid even if the search for better prices ends early.

A clique is a set of candidates; a plan uses at most one candidate of each clique.
"""

import numpy as np
from scipy.sparse import csr_array

from rfpsurvey._kernels import prices as kernels
from rfpsurvey.allocation._candidates import Candidates
from rfpsurvey.allocation._cliques import cover_by_pairs, extend
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
        indptr, column = cover_by_pairs(options, np.arange(len(candidates)), candidates.pairs, deadline)
        real = options.t_candidate
        several = np.flatnonzero(np.diff(options.t_indptr) > 1)
        size = np.diff(options.t_indptr)[several]
        of_target = np.isin(options.target[real], several)
        indptr = np.concatenate([indptr, indptr[-1] + np.cumsum(size)])
        column = np.concatenate([column, real[of_target]])
        alive = np.ones(len(candidates), dtype=bool)
        self.indptr, self.column = extend(options, indptr, column, alive, deadline)
        self.options = options
        shape = len(self.indptr) - 1, len(candidates)
        self.matrix = csr_array((np.ones(len(self.column)), self.column, self.indptr), shape=shape)
        self.price, self.most = np.zeros(shape[0]), np.ones(shape[0])

    def values(self, weights: np.ndarray) -> np.ndarray:
        """Return the weight of each candidate minus the prices of its cliques."""
        return weights - self.matrix.T @ self.price

    def bound(self, weights: np.ndarray) -> float:
        """Return an upper bound of the total weight of any plan."""
        bound = float(kernels.bound_of(self.options.start, self.values(weights), self.price))
        return bound + ROUNDING * (len(self.options.start) + float(self.price.sum()))

    def improve(self, weights: np.ndarray, deadline: float) -> float:
        """Adjust the prices for an objective until a deadline, and return the upper bound of the objective."""
        start, own = self.options.start, self.options.own
        value, n = self.values(weights), len(self.price)
        best, best_price = self.bound(weights), self.price.copy()
        for width in WIDTHS:
            before = np.inf
            for sweep in range(N_SWEEPS):
                for begin in range(0, n, BATCH):
                    if left(deadline) == 0:
                        break
                    end = min(begin + BATCH, n)
                    ends = (begin, end, 1) if sweep % 2 == 0 else (n - begin - 1, n - end - 1, -1)
                    kernels.adjust_prices(
                        start, own, self.indptr, self.column, value, self.price, self.most, width, *ends
                    )
                now = float(kernels.bound_of(start, value, self.price))
                if now < best:
                    best, best_price = now, self.price.copy()
                if left(deadline) == 0 or (before - now < SLOW * abs(now) and sweep > 1):
                    break
                before = now
        self.price = best_price
        return self.bound(weights)


def weights_of(problem: AllocationProblem, options, names: list[str]) -> list:
    """Return the weights of all candidates for each objective, or None for the objective of the requirements.

    The weights for a class include the targets of this class and of all earlier classes.

    Parameters
    ----------
    problem : AllocationProblem
        The allocation problem.
    options : Options
        The candidates.
    names : list of str
        Names of the objectives.

    Returns
    -------
    list of (ndarray of float or None)
        Weights of the candidates: one array, or None, for each objective.
    """
    n_classes, found = len(problem.classes), []
    offset = len(names) - n_classes - (not problem.science.all())
    for k, name in enumerate(names):
        if name == "required targets":
            found.append(np.append(problem.is_required, False)[options.target].astype(float))
        elif name == "requirements":
            found.append(None)
        elif k < offset:
            found.append((options.rank < n_classes).astype(float))
        elif k < offset + n_classes:
            found.append((options.rank <= k - offset).astype(float))
        else:
            found.append((options.target >= 0).astype(float))
    return found
