"""The outcome of every target of a field, and the completeness for each kind, category and priority."""

from dataclasses import dataclass
from functools import cached_property

import astropy.units as u
import numpy as np
from astropy.table import QTable

from rfpsurvey._roles import has_role
from rfpsurvey._units import to_lonlat
from rfpsurvey.allocation import KINDS, find_idle_reasons
from rfpsurvey.catalog import Catalog
from rfpsurvey.pipeline import OUTCOMES, FieldPlan, Outcome, category_classes, outcome_codes, priority_classes
from rfpsurvey.tile._columns import COMPLETENESS, KEPT_COLUMN, OUTCOMES_COLUMNS, describe, only_with_target, with_unit
from rfpsurvey.tile._idle import idle_tables

COLUMNS = ("kind", "category", "priority")
LOST, OBSERVED, UNREACHED, UNUSED = (
    OUTCOMES[k] for k in (Outcome.LOST_TO_A_COLLISION, Outcome.OBSERVED, Outcome.OUT_OF_REACH, Outcome.NOT_REQUESTED)
)


@dataclass(frozen=True, eq=False)
class TargetsOfField:
    """All targets of a field; arrays and tables are made when they are used for the first time."""

    catalog: Catalog
    rows: np.ndarray
    """Rows, in the catalog, of all targets of the field."""
    given: np.ndarray
    """For each target that the allocator received, its index among all targets of the field."""
    plan: FieldPlan

    @cached_property
    def id(self) -> np.ndarray:
        """Identifiers of the targets."""
        return self.catalog.id[self.rows]

    @cached_property
    def vectors(self) -> np.ndarray:
        """Unit vectors of the directions of the targets in ICRS."""
        return self.catalog.arrays.vectors[self.rows]

    @cached_property
    def xy_mm(self) -> np.ndarray:
        """Positions of the targets on the focal plane in mm; NaN for targets that are not requested."""
        xy = np.full((len(self.rows), 2), np.nan)
        xy[self.given] = self.plan.allocation.xy_mm[: len(self.given)]
        return xy

    @cached_property
    def columns(self) -> dict:
        """Kind, category, priority and further columns of the catalog, by name."""
        columns = {name: getattr(self.catalog, name) for name in COLUMNS}
        columns = {name: values[self.rows] for name, values in columns.items() if values is not None}
        units, extra = self.catalog.arrays.extra_units, self.catalog.arrays.extra
        columns.update((name, with_unit(values[self.rows], units[name])) for name, values in extra.items())
        return columns

    @cached_property
    def outcome(self) -> np.ndarray:
        """Outcome of each target, as an index into ``OUTCOMES``."""
        plan, n = self.plan, len(self.given)
        of_catalog, colliding = plan.target >= 0, plan.report.in_collision[plan.positioner]
        outcome = np.full(len(self.rows), Outcome.NOT_REQUESTED, dtype=np.uint8)
        lost, observed = np.zeros(n, dtype=bool), np.zeros(n, dtype=bool)
        lost[plan.target[of_catalog & colliding]] = True
        observed[plan.target[of_catalog & ~colliding]] = True
        outcome[self.given] = outcome_codes(plan.allocation.in_reach[:n], plan.allocation.excluded, lost, observed)
        return outcome

    @cached_property
    def positioner(self) -> np.ndarray:
        """Row of the positioner of each target; -1 for targets without a positioner."""
        plan, of_catalog = self.plan, self.plan.target >= 0
        positioner = np.full(len(self.rows), -1)
        positioner[self.given[plan.target[of_catalog]]] = plan.positioner[of_catalog]
        return positioner

    def __reduce__(self):
        # copies and files contain the targets of the field instead of the complete catalog
        part = self.catalog[self.rows]
        return TargetsOfField, (part, np.arange(len(self.rows)), self.given, self.plan)

    def idle(self, positioner_id: np.ndarray) -> tuple[QTable, QTable]:
        """Return a table of the positioners without a target, and a table of the free targets that they can reach."""
        plan = self.plan
        law = "" if plan.report.motion is None else plan.report.motion.law
        found = find_idle_reasons(plan.instrument.focal_plane, plan.allocation, plan.arms, law)
        return idle_tables(found, self, positioner_id)

    def table(self, positioner_id: np.ndarray) -> QTable:
        """Return a table with a row for each target; its columns have units."""
        lon, lat = to_lonlat(self.vectors)
        table = QTable({"target_id": self.id})
        table["ra"], table["dec"] = np.rad2deg(lon % (2 * np.pi)) * u.deg, np.rad2deg(lat) * u.deg
        table["x"], table["y"] = self.xy_mm.T * u.mm
        table["outcome"] = np.array(OUTCOMES)[self.outcome]
        table["positioner"] = only_with_target(positioner_id[self.positioner], self.positioner >= 0)
        for name, values in self.columns.items():
            table[name] = values
        return describe(table, OUTCOMES_COLUMNS, KEPT_COLUMN)


def counts_by_kind(catalog: Catalog, rows: np.ndarray, plan: FieldPlan) -> dict:
    """Return, for each kind, the numbers of targets in the field, of assigned targets, and of observed targets.

    ``rows`` contains the rows, in the catalog, of the targets in the field with requested visits. A target is observed
    if it is assigned and not lost to a collision.
    """
    free = ~plan.report.in_collision[plan.positioner]
    found = {}
    for kind in KINDS:
        is_kind, kinds = has_role(plan.kind, kind), catalog.kind
        n_in_field = len(rows) * (kind == "science") if kinds is None else has_role(kinds[rows], kind).sum()
        counts = {"n_in_field": n_in_field, "n_assigned": is_kind.sum(), "n_observed": (is_kind & free).sum()}
        if (both := is_kind & has_role(plan.kind, "science")).any() and kind != "science":
            counts["n_also_science"] = both.sum()
        if kind == "science" or any(counts.values()):
            found[kind] = {name: int(number) for name, number in counts.items()}
    return found


def by_positioner(catalog: Catalog, plan: FieldPlan, row_of: np.ndarray) -> dict:
    """Return columns of the catalog, with the values of the target of each positioner.

    ``row_of`` contains, for each positioner, its row in the plan, or -1 if the plan has no row for the positioner.
    """
    if len(plan.target) == 0:
        return {}
    given = (row_of >= 0) & (plan.target >= 0)[row_of]
    found = {name: only_with_target(values[row_of], given) for name, values in plan.carried.items()}
    return {name: with_unit(values, catalog.arrays.extra_units.get(name)) for name, values in found.items()}


def completeness_table(outcomes: QTable, kinds: dict) -> QTable:
    """Return a table with a row for each kind, each category, and each priority class of science targets.

    ``kinds`` are the `counts_by_kind`, since rules can remove a role of targets.
    """
    outcome = np.asarray(outcomes["outcome"])
    kind = np.asarray(outcomes["kind"]) if "kind" in outcomes.colnames else np.full(len(outcome), "science")
    science = has_role(kind, "science")
    masks = {
        "n_in_field": ~science | (outcome != UNUSED),  # science targets that are not requested are not counted
        "n_reachable": (outcome != UNREACHED) & (outcome != UNUSED),
        "n_assigned": (outcome == OBSERVED) | (outcome == LOST),
        "n_observed": outcome == OBSERVED,
    }
    rows = []

    def add(selected, most=None, **labels):
        counts = [int(np.count_nonzero(mask & selected)) for mask in masks.values()]
        if most is not None:
            counts[2:] = [min(counts[2], most["n_assigned"]), min(counts[3], most["n_observed"])]
        labels = [labels.get(name, "all") for name in ("kind", "category", "priority")]
        rows.append((*labels, *counts, counts[-1] / max(counts[0], 1)))

    for name in KINDS:
        if name == "science" or has_role(kind, name).any():
            add(has_role(kind, name), kinds.get(name), kind=name)
    if "category" in outcomes.colnames:
        class_of, names = category_classes(np.asarray(outcomes["category"]), masks["n_in_field"])
        for k, name in enumerate(names if len(names) > 1 else []):
            add(class_of == k, category=name)
    if "priority" in outcomes.colnames:
        class_of, names = priority_classes(np.asarray(outcomes["priority"]), science & masks["n_in_field"])
        for k, name in enumerate(names if len(names) > 1 else []):
            add(science & (class_of == k), kind="science", priority=name)
    return describe(QTable(rows=rows, names=list(COMPLETENESS)), COMPLETENESS)
