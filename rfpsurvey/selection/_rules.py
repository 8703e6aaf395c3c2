"""The rules of allocators for all realizations of a block.

A rule is a function of a `Field` and of an array ``chosen``, to which it writes the index of the pair that each
positioner uses in each realization, or -1.
"""

from typing import NamedTuple

import numpy as np

from rfpsurvey._kernels import realizations as kernels
from rfpsurvey.allocation import TargetColumns
from rfpsurvey.focal_plane import Reach

__all__ = ["RULES", "Field"]


class Field(NamedTuple):
    """The targets of a field and the pairs that may be assigned to each other."""

    pairs: Reach
    rank: np.ndarray
    """Class of each target; 0 is the most important."""
    n_ranks: int
    key: np.ndarray
    """Number that stands for the identifier of each target."""
    left: np.ndarray
    """Remaining visits, shape (n_targets, n_realizations)."""
    seeds: np.ndarray
    tile: int

    @classmethod
    def of(cls, pairs: Reach, columns: TargetColumns, ids: np.ndarray, given) -> "Field":
        """Return the field of a tile."""
        n = len(ids)
        science = np.ones(n, dtype=bool) if columns.kind is None else columns.kind == "science"
        rank = np.zeros(n, dtype=np.int64)
        if columns.priority is not None:
            rank = np.unique(-columns.priority, return_inverse=True)[1].reshape(-1).astype(np.int64)
        allowed = science
        if columns.is_required is not None:
            rank = np.where(columns.is_required, 0, rank + 1)
            allowed = science | columns.is_required
        if not allowed.all():
            pairs = pairs.where(allowed[pairs.target])
        seeds = np.array(given.seeds, dtype=np.uint64)
        n_ranks = int(rank.max(initial=0)) + 1
        return cls(pairs, rank, n_ranks, id_keys(ids), given.left, seeds, given.tile)


def id_keys(ids):
    return ids.astype(np.uint64)


def nearest(field: Field, chosen: np.ndarray) -> None:
    """Serve targets by class, then by subpriority; each is assigned to its closest free positioner."""
    order = np.arange(len(field.pairs.owner))
    kernels.sort_by_distance(field.pairs.indptr, field.pairs.r2, order)
    kernels.nearest(
        field.pairs.indptr, field.pairs.owner, order, field.rank, field.key, field.seeds, field.left, chosen
    )


RULES = {"nearest": nearest}
