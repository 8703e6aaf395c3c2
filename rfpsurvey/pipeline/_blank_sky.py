"""Identifiers of blank sky positions that an allocation found between the targets."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from rfpsurvey.errors import InputError

__all__ = ["BlankIds", "blank_ids"]

PREFIX = "blank-sky-"
# Number of digits after the prefix, and number of unused integers that must be available.
DIGITS, ROOM = 6, 1_000_000


class BlankIds(NamedTuple):
    """Identifiers that no target of a catalog has."""

    first: int | str
    """The first of descending integers, or text that precedes a number."""
    dtype: np.dtype
    """Type of a column that holds identifiers of both targets and blank positions."""

    def take(self, n: int) -> np.ndarray:
        """Return n identifiers."""
        if isinstance(self.first, str):
            return np.array([f"{self.first}{k}" for k in range(n)], dtype=self.dtype)
        return self.first - np.arange(n)


def blank_ids(parts: Iterable[np.ndarray]) -> BlankIds:
    """Return identifiers for blank sky that differ from all identifiers of a catalog, which are given in parts.

    Integers are below -1 and below all identifiers of the catalog or, if too few such integers exist, above them. Text
    begins with ``blank-sky-``, preceded by one underscore more than in any other identifier of this form.
    """
    lowest, highest, most, dtype = -1, -1, -1, None
    for ids in parts:
        dtype = ids.dtype if dtype is None else np.result_type(dtype, ids.dtype)
        if ids.dtype.kind == "i":
            lowest, highest = min(lowest, int(ids.min(initial=0))), max(highest, int(ids.max(initial=0)))
        else:
            plain = np.char.lstrip(ids, "_")
            alike = np.flatnonzero(np.char.startswith(plain, PREFIX))
            most = max(most, int((np.char.str_len(ids) - np.char.str_len(plain))[alike].max(initial=-1)))
    if dtype.kind == "i":
        if lowest - ROOM >= np.iinfo(np.int64).min:
            return BlankIds(lowest - 1, dtype)
        if highest + ROOM > np.iinfo(np.int64).max:
            raise InputError(f"ids must leave room for those of blank sky, got ids from {lowest} to {highest}")
        return BlankIds(highest + ROOM, dtype)
    prefix = "_" * (most + 1) + PREFIX
    return BlankIds(prefix, np.result_type(dtype, np.dtype(f"U{len(prefix) + DIGITS}")))
