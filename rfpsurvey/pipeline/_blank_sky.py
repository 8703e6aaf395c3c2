"""Identifiers of the blank sky positions that an allocation finds between the targets."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from rfpsurvey.errors import InputError

__all__ = ["BlankIds", "blank_ids"]

PREFIX = "blank-sky-"
# Largest number of digits after the prefix of an identifier that is text, and number of integers that no identifier of
# the catalog may use.
DIGITS, ROOM = 6, 1_000_000


class BlankIds(NamedTuple):
    """Identifiers for blank sky positions; no target of the catalog has one of these identifiers."""

    first: int | str
    """The first identifier (an integer, from which the identifiers decrease by 1), or the text before each number."""
    dtype: np.dtype
    """Type of a column that contains the identifiers of targets and of blank positions."""

    def take(self, n: int) -> np.ndarray:
        """Return the first n identifiers."""
        if isinstance(self.first, str):
            return np.array([f"{self.first}{k}" for k in range(n)], dtype=self.dtype)
        return self.first - np.arange(n)


def blank_ids(parts: Iterable[np.ndarray]) -> BlankIds:
    """Return identifiers for blank sky that differ from all identifiers of a catalog.

    ``parts`` contains one array of identifiers for each part of the catalog.

    If the identifiers of the catalog are integers, the identifiers of blank sky are less than -1 and less than all
    identifiers of the catalog. If there are too few such integers, the identifiers of blank sky are greater than all
    identifiers of the catalog. If the identifiers are text, the identifiers of blank sky begin with ``blank-sky-``. If
    the catalog already has identifiers of this form, underscores precede ``blank-sky-``, one more than in any
    identifier of the catalog.
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
            raise InputError(
                f"ids must leave unused integers for blank sky positions, got ids from {lowest} to {highest}"
            )
        return BlankIds(highest + ROOM, dtype)
    prefix = "_" * (most + 1) + PREFIX
    return BlankIds(prefix, np.result_type(dtype, np.dtype(f"U{len(prefix) + DIGITS}")))
