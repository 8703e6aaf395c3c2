"""Where a survey takes the targets of a field from. What a survey knows of a target is kept by its *slot*."""

import hashlib
from typing import NamedTuple

import numpy as np

from rfpsurvey.catalog import Catalog, SkyIndex

__all__ = ["Field", "InMemory", "digest"]


class Field(NamedTuple):
    """The targets of a field, in the order of their rows; columns that a catalog does not carry are None."""

    slot: np.ndarray
    row: np.ndarray
    vectors: np.ndarray
    id: np.ndarray
    priority: np.ndarray | None
    kind: np.ndarray | None
    category: np.ndarray | None
    fiber_type: np.ndarray | None


class InMemory:
    """A catalog that fits into memory; slots are positions in the index of the sky."""

    def __init__(self, catalog: Catalog):
        self._catalog = catalog
        self._index = SkyIndex(catalog._vectors)
        catalog.__dict__.pop("_vectors", None)  # the index has them, sorted: a large catalog is not kept twice
        self.meta = catalog.meta

    def __len__(self):
        return len(self._index)

    def field(self, center: np.ndarray, radius_rad: float, left: np.ndarray) -> Field:
        """Return the targets inside a circle with something ``left`` (by slot)."""
        slot = self._index.near(center, radius_rad, left)
        row = self._index.order[slot]
        columns = (getattr(self._catalog, name) for name in Field._fields[3:])
        columns = [None if column is None else column[row] for column in columns]
        return Field(slot, row, self._index.vectors[slot], *columns)

    def by_slot(self, name: str) -> np.ndarray | None:
        """Return a column of the catalog, a value for each slot."""
        column = getattr(self._catalog, name)
        return None if column is None else self.to_slots(column)

    def to_slots(self, values: np.ndarray) -> np.ndarray:
        """Return values by row in the order of slots."""
        return values[self._index.order]

    def ids(self) -> np.ndarray:
        """Return the ids of all targets, in the order of rows."""
        return self._catalog.id

    def by_row(self, values: np.ndarray) -> np.ndarray:
        """Return values by slot in the order of rows."""
        out = np.empty_like(values)
        out[self._index.order] = values
        return out

    def digest(self) -> str:
        """Return what tells one catalog from another."""
        columns = (getattr(self._catalog, name) for name in Field._fields[3:])
        return digest(self._index.vectors, self._index.order, *columns)


def digest(*columns: np.ndarray | None) -> str:
    """Return a short digest of columns, some of which may not be there."""
    found = hashlib.sha256()
    for column in columns:
        found.update(b"" if column is None else np.ascontiguousarray(column).view(np.uint8))
        found.update(b";")
    return found.hexdigest()[:16]
