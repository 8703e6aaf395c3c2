"""Convert pairs of neighbors to the forms that the kernels read."""

import numpy as np

__all__ = ["both_ways", "find_runs"]


def find_runs(pairs: np.ndarray) -> np.ndarray:
    """Return neighbors as sorted rows (i, j, n); each row stands for n pairs: (i, j), (i + 1, j + 1), and so on.

    If the positioners of a lattice are numbered row by row, a few rows (i, j, n) contain thousands of pairs.
    """
    if len(pairs) == 0:
        return np.empty((0, 3), dtype=np.int64)
    pairs = pairs[np.lexsort((pairs[:, 0], pairs[:, 1] - pairs[:, 0]))]
    first = np.append(True, (np.diff(pairs, axis=0) != 1).any(axis=1))
    rows = np.flatnonzero(first)
    runs = np.column_stack([pairs[rows], np.diff(np.append(rows, len(pairs)))])
    return runs[np.lexsort((runs[:, 1], runs[:, 0]))]


def both_ways(pairs: np.ndarray, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the neighbors of each of n positioners in compressed rows: start of each row, and all neighbors.

    The array of neighbors is never empty, because arrays on a GPU must not be empty.
    """
    both = np.vstack([pairs, pairs[:, ::-1]])
    both = both[np.lexsort((both[:, 1], both[:, 0]))]
    return np.searchsorted(both[:, 0], np.arange(n + 1)), np.append(both[:, 1], 0)
