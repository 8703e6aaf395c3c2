"""Find the candidates that an optimal plan does not need."""

import numpy as np

from rfpsurvey._kernels import conflicts, reduce
from rfpsurvey.allocation._clock import left

# Number of comparisons of candidates before the clock is read again.
BATCH = 10_000_000


def reduced(options: conflicts.Options, deadline: float = np.inf) -> np.ndarray:
    """Mark the candidates that remain after removing candidates that an optimal plan does not need.

    Parameters
    ----------
    options : Options
        All candidates.
    deadline : float, optional
        Value of `now` at which the removal stops.

    Returns
    -------
    ndarray of bool, shape (n_candidates,)
        Whether each candidate remains.
    """
    n = len(options.start) - 1
    alive, queue, waiting = np.ones(len(options.own), dtype=bool), np.arange(n), np.ones(n, dtype=bool)
    ends, mark, removed = np.array([0, n]), np.full(len(options.own), -1), np.empty(len(options.own), dtype=np.int64)
    while ends[0] < ends[1] and left(deadline) > 0:
        reduce.reduce_some(options, alive, queue, waiting, ends, mark, removed, BATCH)
    return alive
