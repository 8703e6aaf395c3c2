"""The outcome of every target of a field, and completeness by class."""

from typing import NamedTuple

import astropy.units as u
import numpy as np
from astropy.table import QTable

from rfpsurvey._units import to_lonlat
from rfpsurvey.allocation import KINDS, find_idle_reasons
from rfpsurvey.catalog import Catalog
from rfpsurvey.pipeline import OUTCOMES, FieldPlan, Outcome, category_classes, outcome_codes, priority_classes
from rfpsurvey.tile._columns import COMPLETENESS, KEPT_COLUMN, OUTCOMES_COLUMNS, describe, only_with_target, with_unit
from rfpsurvey.tile._idle import idle_tables

__all__ = ["TargetsOfField", "by_positioner", "completeness_table", "counts_by_kind", "targets_of_field"]

COLUMNS = ("kind", "category", "priority")
LOST, OBSERVED, UNREACHED, UNUSED = (
    OUTCOMES[k] for k in (Outcome.LOST_TO_A_COLLISION, Outcome.OBSERVED, Outcome.OUT_OF_REACH, Outcome.NOT_REQUESTED)
)


class TargetsOfField(NamedTuple):
    """All targets of a field as plain arrays, from which a table is made on request."""

    id: np.ndarray
    vectors: np.ndarray
    """ICRS unit vectors."""
    xy_mm: np.ndarray
    """Positions on the focal plane; NaN for targets that are not requested."""
    columns: dict
    """Kind, category, priority and further columns of the catalog, by name."""
    outcome: np.ndarray
    """Index of ``OUTCOMES``."""
    positioner: np.ndarray
    """Row of the positioner of each target; -1 for targets without a positioner."""
    plan: FieldPlan | None = None
    """The plan, from which the reasons why positioners are idle are found on request."""
    given: np.ndarray | None = None
    """Row of each target of the plan."""

    def idle(self, positioner_id: np.ndarray) -> tuple[QTable, QTable]:
        """Return a table with a row for each positioner without a target, and a table of its free targets in reach."""
        found = find_idle_reasons(self.plan.instrument.focal_plane, self.plan.allocation, self.plan.arms)
        return idle_tables(found, self, positioner_id)

    def table(self, positioner_id: np.ndarray) -> QTable:
        """Return a table with a row for each target, with units."""
        lon, lat = to_lonlat(self.vectors)
        table = QTable({"target_id": self.id})
        table["ra"], table["dec"] = np.rad2deg(lon % (2 * np.pi)) * u.deg, np.rad2deg(lat) * u.deg
        table["x"], table["y"] = self.xy_mm.T * u.mm
        table["outcome"] = np.array(OUTCOMES)[self.outcome]
        table["positioner"] = only_with_target(positioner_id[self.positioner], self.positioner >= 0)
        for name, values in self.columns.items():
            table[name] = values
        return describe(table, OUTCOMES_COLUMNS, KEPT_COLUMN)


def targets_of_field(catalog: Catalog, rows: np.ndarray, given: np.ndarray, plan: FieldPlan) -> TargetsOfField:
    """Return all targets of a field (``rows`` of the catalog); ``given`` are those that the allocator received."""
    allocation, n = plan.allocation, len(given)
    place = np.arange(n) if n == len(rows) else np.searchsorted(rows, given)
    outcome, positioner = np.full(len(rows), Outcome.NOT_REQUESTED, dtype=np.uint8), np.full(len(rows), -1)
    xy = np.full((len(rows), 2), np.nan)
    of_catalog, colliding = plan.target >= 0, plan.report.in_collision[plan.positioner]
    lost, observed = np.zeros(n, dtype=bool), np.zeros(n, dtype=bool)
    lost[plan.target[of_catalog & colliding]] = True
    observed[plan.target[of_catalog & ~colliding]] = True
    outcome[place] = outcome_codes(allocation.in_reach[:n], lost, observed)
    positioner[place[plan.target[of_catalog]]] = plan.positioner[of_catalog]
    xy[place] = allocation.xy.to_value(u.mm)[:n]
    columns = {name: getattr(catalog, name) for name in COLUMNS}
    columns = {name: values[rows] for name, values in columns.items() if values is not None}
    units = catalog.arrays.extra_units
    columns.update((name, with_unit(values[rows], units[name])) for name, values in catalog.arrays.extra.items())
    return TargetsOfField(catalog.id[rows], catalog.arrays.vectors[rows], xy, columns, outcome, positioner, plan, place)


def counts_by_kind(catalog: Catalog, rows: np.ndarray, plan: FieldPlan) -> dict:
    """Return the numbers of targets of each kind: in the field (``rows``), assigned, and assigned without collision."""
    free = ~plan.report.in_collision[plan.positioner]
    found = {}
    for kind in KINDS:
        is_kind = plan.kind == kind
        n_in_field = len(rows) * (kind == "science") if catalog.kind is None else (catalog.kind[rows] == kind).sum()
        counts = {"n_in_field": n_in_field, "n_assigned": is_kind.sum(), "n_observed": (is_kind & free).sum()}
        if kind == "science" or any(counts.values()):
            found[kind] = {name: int(number) for name, number in counts.items()}
    return found


def by_positioner(catalog: Catalog, plan: FieldPlan, row_of: np.ndarray) -> dict:
    """Return the columns of the catalog by positioner; ``row_of`` is the row of each positioner in the plan, or -1."""
    if len(plan.target) == 0:
        return {}
    given = (row_of >= 0) & (plan.target >= 0)[row_of]
    found = {name: only_with_target(values[row_of], given) for name, values in plan.carried.items()}
    return {name: with_unit(values, catalog.arrays.extra_units.get(name)) for name, values in found.items()}


def completeness_table(outcomes: QTable) -> QTable:
    """Return a table with a row for each kind, each category, and each priority class of science targets."""
    outcome = np.asarray(outcomes["outcome"])
    masks = {
        "n_in_field": np.ones(len(outcome), dtype=bool),
        "n_reachable": (outcome != UNREACHED) & (outcome != UNUSED),
        "n_assigned": (outcome == OBSERVED) | (outcome == LOST),
        "n_observed": outcome == OBSERVED,
    }
    kind = np.asarray(outcomes["kind"]) if "kind" in outcomes.colnames else np.full(len(outcome), "science")
    science = kind == "science"
    rows = []

    def add(selected, **labels):
        counts = [int(np.count_nonzero(mask & selected)) for mask in masks.values()]
        labels = [labels.get(name, "all") for name in ("kind", "category", "priority")]
        rows.append((*labels, *counts, counts[-1] / max(counts[0], 1)))

    for name in KINDS:
        if name == "science" or (kind == name).any():
            add(kind == name, kind=name)
    if "category" in outcomes.colnames:
        class_of, names = category_classes(np.asarray(outcomes["category"]), masks["n_in_field"])
        for k, name in enumerate(names if len(names) > 1 else []):
            add(class_of == k, category=name)
    if "priority" in outcomes.colnames:
        class_of, names = priority_classes(np.asarray(outcomes["priority"]), science)
        for k, name in enumerate(names if len(names) > 1 else []):
            add(science & (class_of == k), kind="science", priority=name)
    return describe(QTable(rows=rows, names=list(COMPLETENESS)), COMPLETENESS)
