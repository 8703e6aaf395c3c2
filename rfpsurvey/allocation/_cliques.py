"""Cover the collisions of candidates with cliques; a plan uses at most one candidate of each clique."""

import numpy as np

from rfpsurvey._kernels import conflicts, prices
from rfpsurvey.allocation._clock import OutOfTimeError, left

# Amount of work between two readings of the clock: number of collisions that are covered by cliques, number of cliques
# that are extended, and number of comparisons of candidates while cliques are extended.
BATCH, N_EXTENDED, WORK = 200_000, 4096, 50_000_000
# Time in seconds per collision for sorting the collisions.
EDGE_SECONDS = 2e-7


def cover_by_pairs(options: conflicts.Options, rows: np.ndarray, edges: np.ndarray, deadline: float = np.inf):
    """Return cliques, which are sets of candidates; a plan without collisions uses at most one candidate of each set.

    If two of the candidates ``rows`` collide or have the same target, at least one clique contains both candidates. If
    no candidates collide, the function returns no cliques.

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
        The cliques as compressed rows: clique ``k`` is ``column[indptr[k]:indptr[k + 1]]``.
    """
    if edges.shape[1] == 0:
        return np.zeros(1, dtype=np.int64), np.empty(0, dtype=np.int64)
    edges = np.concatenate([edges, _twins(options, rows)], axis=1)
    if left(deadline) < EDGE_SECONDS * edges.shape[1]:
        raise OutOfTimeError
    edges = np.sort(edges, axis=0)  # candidates are sorted by positioner
    both = options.own[edges[0]] * len(options.start) + options.own[edges[1]]
    order = np.lexsort((edges[0] * len(options.own) + edges[1], both))
    edges, both = edges[:, order], both[order]
    new = np.append(True, np.diff(both) != 0)
    starts = np.append(np.flatnonzero(new), edges.shape[1])
    edges = np.ascontiguousarray(edges)
    sizes, columns, begin = [np.zeros(1, dtype=np.int64)], [], 0
    while begin < len(starts) - 1:
        if left(deadline) == 0:
            raise OutOfTimeError
        end = max(int(np.searchsorted(starts, starts[begin] + BATCH, side="right")) - 1, begin + 1)
        part, some = starts[begin : end + 1], np.zeros(starts[end] - starts[begin] + 1, dtype=np.int64)
        n = conflicts.clique_rows(edges, len(part) - 1, part, some, np.empty(0, dtype=np.int64))
        column = np.empty(some[n], dtype=np.int64)
        conflicts.clique_rows(edges, len(part) - 1, part, some, column)
        sizes.append(np.diff(some[: n + 1]))
        columns.append(column)
        begin = end
    return np.cumsum(np.concatenate(sizes)), np.concatenate(columns)


def extend(options: conflicts.Options, indptr: np.ndarray, column: np.ndarray, alive: np.ndarray, deadline: float):
    """Extend cliques to maximal cliques until a deadline, and return the cliques without repetition.

    Parameters
    ----------
    options : Options
        All candidates.
    indptr, column : ndarray of int
        Cliques as compressed rows, in the format of the returned cliques.
    alive : ndarray of bool, shape (n_candidates,)
        Whether each candidate may be added to a clique.
    deadline : float
        Value of `now` after which the remaining cliques are not extended.

    Returns
    -------
    indptr, column : ndarray of int
        The cliques as compressed rows: clique ``k`` is ``column[indptr[k]:indptr[k + 1]]``. Each clique is sorted.
    """
    n = len(indptr) - 1
    sizes, columns, first = [], [], 0
    room = np.empty(max(4 * N_EXTENDED, int(np.diff(indptr).max(initial=0)) + prices.POOL), dtype=np.int64)
    while first < n and left(deadline) > 0:
        end = min(first + N_EXTENDED, n)
        part, row_start = indptr[first : end + 1], np.zeros(end - first + 1, dtype=np.int64)
        done = int(prices.extend_cliques(part, column, options, alive, row_start, room, WORK))
        sizes.append(np.diff(row_start[: done + 1]))
        columns.append(room[: row_start[done]].copy())
        first += done
    # The members of the remaining cliques are sorted, but no members are added.
    rest = column[indptr[first] :]
    row = np.repeat(np.arange(n - first), np.diff(indptr[first:]))
    columns.append(rest[np.lexsort((rest, row))])
    sizes.append(np.diff(indptr[first:]))
    size, column = np.concatenate(sizes), np.concatenate(columns)
    indptr = np.concatenate([[0], np.cumsum(size)])
    code = np.add.reduceat(_scramble(column), indptr[:-1]) if n else np.empty(0)
    order, repeated = np.lexsort((code, size)), np.zeros(n, dtype=bool)
    prices.mark_repeated(order, indptr, column, repeated)
    keep = np.repeat(~repeated, size)
    return np.concatenate([[0], np.cumsum(size[~repeated])]), column[keep]


def _scramble(values):
    """Return an integer hash of each value; the sums of the hashes of two different sets almost always differ."""
    mixed = (values.astype(np.uint64) + np.uint64(1)) * np.uint64(0x9E3779B97F4A7C15)
    mixed ^= mixed >> np.uint64(31)
    mixed *= np.uint64(0xBF58476D1CE4E5B9)
    return mixed ^ (mixed >> np.uint64(29))


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
