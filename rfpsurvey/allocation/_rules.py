"""The classic rules."""

import numpy as np

from rfpsurvey._kernels import allocation as kernels
from rfpsurvey.focal_plane import Reach

__all__ = ["balanced", "lamost"]


def balanced(reach: Reach, classes: np.ndarray, rng: np.random.Generator):
    """Queues of equal length, one entry drawn from each."""
    count = np.empty(reach.n_positioners, dtype=np.int64)
    owner_of = np.empty(len(classes), dtype=np.int64)
    kernels.balanced(reach.indptr, reach.owner, reach.r2, count, owner_of)
    indptr = np.empty(len(count) + 1, dtype=np.int64)
    queue = np.empty(int(count.sum()), dtype=np.int64)
    kernels.fill_queues(owner_of, count, indptr, queue)
    target_of = np.empty(len(count), dtype=np.int64)
    kernels.draw_configuration(indptr, queue, rng.random(len(count)), target_of)
    return target_of, (indptr, queue)


def lamost(reach: Reach, classes: np.ndarray, rng: np.random.Generator):
    """Nomination of the nearest target, class after class."""
    indptr, target, r2 = reach.by_positioner
    target, r2 = target.copy(), r2.copy()
    kernels.sort_candidates(indptr, target, r2, classes)
    n, m = reach.n_positioners, len(classes)
    target_of, owner_of = np.empty(n, dtype=np.int64), np.empty(m, dtype=np.int64)
    scratch = (np.empty(n, np.int64), np.empty(m, np.int64), np.empty(m), np.empty(n, np.int64))
    n_classes = int(classes.max(initial=-1)) + 1
    kernels.nominate(indptr, target, r2, classes, n_classes, reach.indptr, reach.owner, *scratch, target_of, owner_of)
    return target_of, None
