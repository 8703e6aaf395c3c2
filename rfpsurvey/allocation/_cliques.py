"""Cover the collisions of candidates with cliques; a plan uses at most one candidate of each clique."""

import numpy as np

from rfpsurvey._kernels import conflicts
from rfpsurvey.allocation._clock import OutOfTimeError, left

# Largest numbers between two readings of the clock: cliques, members of cliques, and comparisons of candidates.
N_CLIQUES, N_MEMBERS, WORK = 4096, 200_000, 50_000_000


def cover(options: conflicts.Options, rows: np.ndarray, edges: np.ndarray, deadline: float = np.inf):
    """Return maximal cliques, which are sets of candidates; a plan without collisions uses at most one of each set.

    If two of the candidates ``rows`` collide, or have the same target but different positioners, at least one clique
    contains both candidates.

    Parameters
    ----------
    options : Options
        All candidates.
    rows : ndarray of int, shape (n,)
        Indices of the candidates from which the cliques are formed.
    edges : ndarray of int, shape (2, m)
        Collisions between candidates of ``rows``.
    deadline : float, optional
        Value of `now` at which `OutOfTimeError` is raised.

    Returns
    -------
    indptr, column : ndarray of int
        The cliques as compressed rows: clique ``k`` is ``column[indptr[k]:indptr[k + 1]]``. Each clique is sorted.
    """
    n = len(options.own)
    both = np.concatenate([edges, _twins(options, rows)], axis=1)
    indptr, other = np.empty(n + 1, dtype=np.int64), np.empty(2 * both.shape[1], dtype=np.int64)
    conflicts.adjacency(both[0], both[1], indptr, other)
    covered, room = np.zeros(len(other), dtype=bool), np.empty(n + N_MEMBERS, dtype=np.int64)
    first, sizes, columns = 0, [np.zeros(1, dtype=np.int64)], []
    while first < n:
        if left(deadline) == 0:
            raise OutOfTimeError
        some = np.zeros(N_CLIQUES + 1, dtype=np.int64)
        first, k = conflicts.grow_cliques(options.own, indptr, other, first, covered, some, room, WORK)
        sizes.append(np.diff(some[: k + 1]))
        columns.append(room[: some[k]].copy())
    return np.cumsum(np.concatenate(sizes)), np.concatenate(columns)


def _twins(options, rows):
    """Return the pairs of candidates that have the same target but different positioners."""
    rows = rows[np.argsort(options.target[rows], kind="stable")]
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
