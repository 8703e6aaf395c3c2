"""The catalog of a survey, in memory or in partitions on disk, with the columns that rules use."""

import hashlib
from collections import OrderedDict
from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import cached_property
from typing import ClassVar

import numpy as np

from rfpsurvey._assignment.allocate import TargetColumns
from rfpsurvey._common.units import to_visits
from rfpsurvey._field.plan import FieldTargets
from rfpsurvey._field.targets import PLANNED_COLUMNS, CatalogTargets, FieldRows
from rfpsurvey._sky.arrays import SkyIndex, has_role
from rfpsurvey._sky.catalog import Catalog
from rfpsurvey._sky.partitions import PartitionedCatalog, as_catalog
from rfpsurvey._survey.history.rule import VisitRule
from rfpsurvey.errors import InputError, listed, number_of, warn


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

    def speeds(self, row: np.ndarray) -> np.ndarray:
        """Return the proper motions of the targets in given rows, in radians per year; 0 if they are unknown."""
        part_of, speed = np.searchsorted(self._first, row, side="right") - 1, np.zeros(len(row))
        for k in np.unique(part_of).tolist():
            speed[part_of == k] = self._part(k).speeds(row[part_of == k] - self._first[k])
        return speed

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


def first_visits(
    catalog: object, rule: VisitRule, visits: object = None
) -> tuple[Catalog | PartitionedCatalog, np.ndarray]:
    """Return a catalog with the priorities, and the requested visits, that a rule determines before any observation."""
    catalog = catalog if isinstance(catalog, PartitionedCatalog) else as_catalog(catalog)
    columns, none = columns_of(catalog, visits), np.zeros(len(catalog), dtype=np.uint8)
    wanted, priority = rule.apply({**columns, "observed": none, "failed": none, "last": none})
    if priority is not columns["priority"]:
        catalog = replace(in_memory(catalog, "rules that change priorities"), priority=priority)
    return catalog, wanted


def columns_of(catalog, visits: object) -> dict:
    """Return the columns of a catalog that rules use."""
    columns = {name: column_of(catalog, name) for name in ("id", "priority", "category", "kind", "visits")}
    requested = columns.pop("visits") if visits is None else to_visits(visits, len(catalog))
    return {**columns, "requested": np.ones(len(catalog), dtype=np.uint8) if requested is None else requested}


def visits_without_rule(state) -> np.ndarray:
    """Return the number of visits of each target that is requested in a `SurveyState` before its rule is applied."""
    if state.cadences is not None:
        return state.cadences.visits(state.catalog, required_in(state.catalog, state.given[2]))
    # recorded numbers of visits replace the given numbers in the catalog
    return columns_of(state.catalog, None if state.events.target_tables else state.given[1])["requested"]


def required_in(catalog: Catalog | PartitionedCatalog, ids: list[str] | None) -> np.ndarray | None:
    """Return whether each target is one of the required targets with the given ids; None if no ids are given."""
    return None if ids is None else np.isin(column_of(catalog, "id").astype(str), ids)


def is_science(catalog: Catalog | PartitionedCatalog) -> np.ndarray:
    """Return whether each target is a science target."""
    kind = column_of(catalog, "kind")
    return np.ones(len(catalog), dtype=bool) if kind is None else has_role(kind, "science")


def column_of(catalog: Catalog | PartitionedCatalog, name: str) -> np.ndarray | None:
    """Return a column of a catalog; None if the catalog does not have this column."""
    return getattr(catalog, name) if isinstance(catalog, Catalog) else catalog.parts.column(name)


def is_same(catalog: Catalog | PartitionedCatalog, other: Catalog | PartitionedCatalog) -> bool:
    """Return whether two catalogs are equal in all columns that a plan uses."""
    if catalog is other:
        return True
    if isinstance(catalog, PartitionedCatalog) or isinstance(other, PartitionedCatalog):
        return type(catalog) is type(other) and catalog.parts.digest() == other.parts.digest()
    places = [(sky.coord.icrs.ra.deg, sky.coord.icrs.dec.deg) for sky in (catalog, other)]
    names = ("id", "visits", *PLANNED_COLUMNS)
    is_same_column = (np.array_equal(getattr(catalog, name), getattr(other, name)) for name in names)
    return all(map(np.array_equal, *places)) and all(is_same_column)


def in_memory(catalog: Catalog | PartitionedCatalog, what: str) -> Catalog:
    """Return the catalog, or raise an error if it is partitioned."""
    if isinstance(catalog, PartitionedCatalog):
        raise InputError(f"{what} must be used with a catalog in memory, got a partitioned catalog")
    return catalog


def check_first_catalog(request: dict, catalog: Catalog | PartitionedCatalog, visits: object, rule: VisitRule) -> None:
    """Raise an error if a catalog is not that of the first plan of the survey with a recorded request.

    All functions that attribute visits to targets depend on this check, because visits refer to the rows of the
    catalog.
    """
    recorded, present = request.get("given", request.get("first", {}).get("catalog")), digest_of(catalog)
    if recorded is None and not request.get("epoch"):  # an earlier version planned the survey, and did not move targets
        recorded = request.get("catalog")
        for possible in (catalog, first_visits(catalog, rule, visits)[0]) if recorded is not None else ():
            source = possible.parts if isinstance(possible, PartitionedCatalog) else InMemory(possible)
            if recorded == f"{number_of(len(possible), 'target')}, digest {source.digest()}":
                present = recorded
    if recorded is not None and present != recorded:
        raise InputError(
            f"the catalog must be that of the first plan, with {recorded}, got another catalog with {present}; to add "
            "or change targets, record a table of targets"
        )
    columns = request.get("columns", {})
    now = column_digests(catalog, columns)
    for name, before in columns.items():
        if now[name] != before and (name != "visits" or visits is None):
            raise InputError(
                f"the catalog must be that of the first plan, got another catalog with other values of {name!r}; to "
                "add or change targets, record a table of targets"
            )


def check_number_of_visits(request: dict, catalog: Catalog | PartitionedCatalog) -> None:
    """Issue a warning if the first plan requested another number of visits than the catalog."""
    first = request.get("first", request)
    targets, said = (str(first.get(name, "")).partition(",")[0] for name in ("catalog", "visits"))
    now = number_of(int(columns_of(catalog, None)["requested"].sum(dtype=np.int64)), "visit")
    is_same = targets == number_of(len(catalog), "target")  # another catalog is an error when the survey is planned
    if is_same and said not in ("", now) and not request.get("required"):
        warn(
            f"the first plan requested {said}, but the catalog requests {now}; give the visits= and rule= of the first "
            "plan, unless they have changed"
        )


def digest_of(catalog: Catalog | PartitionedCatalog) -> str:
    """Return a digest of the positions and columns that allocators use, which does not require an index on the sky.

    Further columns (``extra``) do not determine which target is in a row; `extra_digest` identifies them.
    """
    if isinstance(catalog, PartitionedCatalog):
        content = catalog.parts.digest()
    else:
        icrs, columns = catalog.coord.icrs, (getattr(catalog, name) for name in ("id", *PLANNED_COLUMNS))
        content = digest(icrs.ra.deg, icrs.dec.deg, *map(_widest, columns))
    return f"{number_of(len(catalog), 'target')}, digest {content}"


def column_digests(catalog: Catalog | PartitionedCatalog, names: Iterable[str]) -> dict[str, str]:
    """Return a digest of each of the given columns of a catalog in memory, such as visits and magnitudes."""
    if isinstance(catalog, PartitionedCatalog):  # `digest_of` includes all columns
        return dict.fromkeys(names, "")
    columns = {"visits": catalog.visits, **catalog.arrays.extra}
    return {name: digest(_widest(columns.get(name, getattr(catalog, name, None)))) for name in names}


def extra_digest(catalog: Catalog | PartitionedCatalog) -> str:
    """Return a digest of the further columns (``extra``) of a catalog in memory."""
    columns = {} if isinstance(catalog, PartitionedCatalog) else catalog.arrays.extra
    return f"{listed(columns)}, digest {digest(*map(_widest, columns.values()))}"


def _widest(column: np.ndarray | None) -> np.ndarray | None:
    """Return a column with the data type that does not depend on the format of the file of the catalog."""
    if column is None or column.dtype.kind not in "iufU":
        return column
    if column.dtype.kind == "U":
        return column.astype(f"U{max(np.char.str_len(column).max(initial=1), 1)}")
    return column.astype(np.float64 if column.dtype.kind == "f" else np.int64)
