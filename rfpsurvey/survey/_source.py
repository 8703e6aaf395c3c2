"""The catalog of a survey, which is completely in memory or in partitions on disk."""

import hashlib
from collections import OrderedDict
from collections.abc import Iterator
from functools import cached_property
from typing import ClassVar

import numpy as np

from rfpsurvey.allocation import TargetColumns
from rfpsurvey.catalog import Catalog, PartitionedCatalog, SkyIndex
from rfpsurvey.pipeline import PLANNED_COLUMNS, CatalogTargets, FieldRows, FieldTargets


class InMemory(CatalogTargets):
    """A catalog that fits into memory; the slot of a target is its position in the spatial index."""

    def __init__(self, catalog: Catalog):
        super().__init__(catalog, SkyIndex(catalog.arrays.vectors))
        catalog.arrays.__dict__.pop("vectors", None)  # keep only the copy in the index
        self.meta = catalog.meta

    def sum_near(self, centers: np.ndarray, radius_rad: float, values: np.ndarray) -> np.ndarray:
        """Return, for each circle, the sum of the values of the targets inside; ``values`` is in the order of slots."""
        return self.index.sum_near(centers, radius_rad, values)

    @property
    def has_repeated_ids(self) -> bool:
        """Whether two targets have the same id."""
        return self.catalog.arrays.repeated_ids

    def ids(self) -> np.ndarray:
        """Return the ids of all targets, in the order of rows."""
        return self.catalog.id

    @property
    def kinds(self) -> dict[str, str]:
        """Kinds of the data types of the optional columns of the catalog, by name."""
        columns = {name: getattr(self.catalog, name) for name in PLANNED_COLUMNS} | self.catalog.arrays.extra
        return {name: column.dtype.kind for name, column in columns.items() if column is not None}

    def by_row(self, values: np.ndarray) -> np.ndarray:
        """Reorder values from the order of slots to the order of the rows of the catalog."""
        out = np.empty_like(values)
        out[self.index.order] = values
        return out

    def digest(self) -> str:
        """Return a digest that identifies the catalog."""
        columns = (getattr(self.catalog, name) for name in ("id", *PLANNED_COLUMNS))
        return digest(self.index.vectors, self.index.order, *columns, *self.catalog.arrays.extra.values())

    def text_columns(self) -> dict:
        """Return the text columns of the catalog that are copied to the visits; the keys are used in error messages."""
        columns = {"category": self.catalog.category, **self.catalog.arrays.extra}
        return {f"values of {k!r}": v for k, v in columns.items() if v is not None and v.dtype.kind == "U"}


class Partitioned:
    """A catalog in partitions; recently used partitions remain in memory, and the slot of a target is its row."""

    def __init__(self, catalog: PartitionedCatalog, epoch=None):
        self._catalog, self._parts, self._epoch = catalog, catalog.parts, epoch
        self._kept: OrderedDict[int, InMemory] = OrderedDict()
        self._first = catalog.parts.rows
        self.meta = catalog.meta

    def __len__(self):
        return len(self._catalog)

    @cached_property
    def _margin_rad(self) -> float:
        """Upper limit of the angle (radians) by which any target moves until the epoch of the survey."""
        if self._epoch is None or not self._parts.part(0).has_proper_motion:
            return 0.0
        parts = range(len(self._parts.files))
        return (1 + 1e-9) * max(self._parts.part(k).arrays.farthest_rad(self._epoch) for k in parts)

    def _part(self, k: int) -> InMemory:
        """Return a partition from memory or from disk."""
        if k in self._kept:
            self._kept.move_to_end(k)
        else:
            part = self._parts.part(k)
            self._kept[k] = InMemory(part if self._epoch is None else part.at_epoch(self._epoch))
            while len(self._kept) > 1 and sum(map(len, self._kept.values())) > self._catalog.kept_rows:
                self._kept.popitem(last=False)
        return self._kept[k]

    @property
    def fastest_rad(self) -> float:
        """Largest proper motion in radians per year."""
        return max(self._part(k).fastest_rad for k in range(len(self._parts.files)))

    def field(
        self, center: np.ndarray, radius_rad: float, left: np.ndarray, *, always: np.ndarray | None = None, **more
    ) -> FieldRows:
        """Return the targets in a circle that still require a visit, as in `CatalogTargets.field`.

        ``left`` is the number of remaining visits of each target, in the order of slots, as ``always``. The further
        parameters are those of `CatalogTargets.field`.
        """
        rest_rad, around_rad = more.get("rest_rad"), more.get("around_rad")
        fields, wider = [], more.get("margin_rad", 0.0) + self._margin_rad + max(rest_rad or 0.0, around_rad or 0.0)
        for k in self._parts.near(center, radius_rad + wider).tolist():
            first, last = self._first[k : k + 2]
            kept = None if always is None else always[first:last]
            field = self._part(k).field(center, radius_rad, left[first:last], by_row=True, always=kept, **more)
            # a partition without targets of the field can contain targets that sky positions or constraints consider
            if len(field.row) or rest_rad is not None or around_rad is not None or not fields:
                fields.append(field._replace(slot=field.row + first, row=field.row + first))
        if not fields:
            return self._part(0).field(center, 0.0, np.zeros(self._first[1], dtype=np.uint8), around_rad=around_rad)
        slot, row, targets = zip(*fields, strict=True)
        return FieldRows(_stack(slot), _stack(row), _stack_targets(targets))

    def sum_near(self, centers: np.ndarray, radius_rad: float, values: np.ndarray) -> np.ndarray:
        """Return the sum of the values of the targets inside each circle.

        ``values`` is in the order of slots. Each partition is read at most once.
        """
        circles = [self._parts.near(center, radius_rad + self._margin_rad) for center in centers]
        total = np.zeros(len(centers))
        part_of, circle_of = np.concatenate([[], *circles]), np.repeat(np.arange(len(centers)), list(map(len, circles)))
        for k in np.unique(part_of).astype(int).tolist():
            rows, part = circle_of[part_of == k], self._part(k)
            first, last = self._first[k : k + 2]
            total[rows] += part.sum_near(centers[rows], radius_rad, part.to_slots(values[first:last]))
        return total

    def by_slot(self, name: str) -> np.ndarray | None:
        """Return a column of the catalog in the order of slots; None if the catalog does not have this column."""
        return self._parts.column(name)

    def to_slots(self, values: np.ndarray) -> np.ndarray:
        """Return the values unchanged, because the order of rows is also the order of slots."""
        return values

    by_row = to_slots

    has_repeated_ids = False
    """Always False: whether two targets have the same id is not tested, because this requires all ids in memory."""

    @property
    def units(self) -> dict:
        """Units of the additional columns (``extra``) of the catalog, by name."""
        return self._part(0).units

    kinds: ClassVar[dict[str, str]] = {}
    """Always empty, because targets of a catalog in partitions cannot be added or changed."""

    def text_columns(self) -> dict:
        """Return an empty dict, because a test of the text columns would require reading all partitions.

        Text that FITS files cannot contain causes an error when the visits of a tile are written.
        """
        return {}

    def ids(self) -> np.ndarray:
        """Return the ids of all targets, in the order of rows."""
        return self._parts.column("id")

    def ids_by_part(self) -> Iterator[np.ndarray]:
        """Return the ids of each partition, one after the other."""
        return (self._parts.part(k).id for k in range(len(self._parts.files)))

    def digest(self) -> str:
        """Return a digest that identifies the catalog, computed from the columns that a survey requires."""
        return self._parts.digest()


def _stack_targets(targets: tuple[FieldTargets, ...]) -> FieldTargets:
    """Concatenate the targets of several partitions."""
    vectors, ids, columns, others, extra, numbered, around = zip(*targets, strict=True)
    columns = TargetColumns(*(_stack(parts) for parts in zip(*columns, strict=True)))
    extra = {name: _stack([part[name] for part in extra]) for name in extra[0]}
    around = None if around[0] is None else _stack_targets(around)
    return FieldTargets(_stack(vectors), _stack(ids), columns, _stack(others), extra, numbered[0], around)


def _stack(parts: tuple) -> np.ndarray | None:
    """Concatenate the parts of a column from several partitions; return None if the catalog lacks the column."""
    return None if parts[0] is None else np.concatenate(parts)


def digest(*columns: np.ndarray | None) -> str:
    """Return 16 hexadecimal digits that identify the content of columns; a missing column is None."""
    state = hashlib.sha256()
    for column in columns:
        state.update(b"" if column is None else np.ascontiguousarray(column).view(np.uint8))
        state.update(b";")
    return state.hexdigest()[:16]
