"""Identifiers of the blank sky positions that an allocation finds between the targets."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from rfpsurvey.errors import InputError

PREFIX = "blank-sky-"
# DIGITS is the largest number of digits after the prefix of identifiers that are text. ROOM is the number of integers
# that are reserved for blank sky positions if identifiers are integers.
DIGITS, ROOM = 6, 1_000_000


class BlankIds(NamedTuple):
    """Identifiers for blank sky positions; no target of the catalog has one of these identifiers."""

    first: int | str
    """The first identifier, if the identifiers are integers; each further identifier is smaller by 1.

    If the identifiers are text, this is the text before the number in each identifier.
    """
    dtype: np.dtype
    """Type of a column that contains the identifiers of targets and of blank positions."""

    def take(self, n: int) -> np.ndarray:
        """Return the first n identifiers."""
        if isinstance(self.first, str):
            return np.array([f"{self.first}{k}" for k in range(n)], dtype=self.dtype)
        return self.first - np.arange(n)


def blank_ids(parts: Iterable[np.ndarray]) -> BlankIds:
    """Return identifiers for blank sky that differ from all identifiers of a catalog.

    The catalog may consist of several parts; ``parts`` contains an array with the identifiers of each part.

    If the identifiers of the catalog are integers, the identifiers of blank sky are less than -1 and less than all
    identifiers of the catalog. If there are too few such integers, the identifiers of blank sky are greater than all
    identifiers of the catalog.

    If the identifiers of the catalog are text, the identifiers of blank sky begin with ``blank-sky-``. If identifiers
    of the catalog begin in this way, with or without underscores before ``blank-sky-``, the identifiers of blank sky
    begin with one underscore more than any of these identifiers.
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
