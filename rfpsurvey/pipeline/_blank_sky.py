"""Identifiers of blank sky positions that an allocation found between the targets."""

from typing import NamedTuple

import numpy as np

__all__ = ["BlankIds", "blank_ids"]

PREFIX = "blank-sky-"
# Digits behind the prefix, and the least number of integers that must be free.
DIGITS, ROOM = 6, 1_000_000


class BlankIds(NamedTuple):
    """Identifiers that no target of a catalog has."""

    first: int | str
    """The first of descending integers, or the prefix of a number."""
    dtype: np.dtype
    """Type of a column that holds identifiers of both targets and blank positions."""

    def take(self, n: int) -> np.ndarray:
        """Return n identifiers."""
        if isinstance(self.first, str):
            return np.array([f"{self.first}{k}" for k in range(n)], dtype=self.dtype)
        return self.first - np.arange(n)


def blank_ids(ids: np.ndarray) -> BlankIds:
    """Return identifiers for blank sky that differ from the given ones.

    Integers are below -1 and all others, or in the widest gap where the others leave no room below; text begins with
    ``blank-sky-``, or with that after as many underscores as no other identifier begins with.
    """
    if ids.dtype.kind == "i":
        lowest = min(-1, int(ids.min(initial=0)))
        if lowest - ROOM >= np.iinfo(np.int64).min:
            return BlankIds(lowest - 1, ids.dtype)
        edges = np.unique(np.append(ids, [np.iinfo(np.int64).max, -1]))
        widest = int(np.argmax(np.diff(edges.astype(float))))
        return BlankIds(int(edges[widest + 1]) - 1, ids.dtype)
    prefix = PREFIX
    while np.char.startswith(ids, prefix).any():
        prefix = f"_{prefix}"
    return BlankIds(prefix, np.result_type(ids.dtype, np.dtype(f"U{len(prefix) + DIGITS}")))
