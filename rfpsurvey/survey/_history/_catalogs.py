"""Catalogs of surveys with recorded events: the columns that rules use, and comparisons of catalogs."""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from rfpsurvey._roles import has_role
from rfpsurvey._units import to_visits
from rfpsurvey.catalog import Catalog, PartitionedCatalog, as_catalog
from rfpsurvey.errors import InputError, listed, number_of
from rfpsurvey.pipeline import PLANNED_COLUMNS
from rfpsurvey.survey._history._rule import VisitRule
from rfpsurvey.survey._source import InMemory, digest


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
    # recorded numbers of visits replace the given numbers in the catalog
    return columns_of(state.catalog, None if state.events.target_tables else state.given[1])["requested"]


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
