"""The tables of a tile, of its positioners and of the targets of its field, which are made when they are used first."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import astropy.units as u
import numpy as np
from astropy.table import MaskedColumn, QTable
from astropy.utils.masked import Masked

from rfpsurvey._assignment.allocation import IDLE_REASONS, IdleReasons, find_idle_reasons
from rfpsurvey._assignment.constraints.motion import PATHS
from rfpsurvey._common.descriptions import Column, describe, make_table, table_of, with_unit
from rfpsurvey._common.small_figures import BLUE, GRAY, RED, dots
from rfpsurvey._common.units import to_lonlat
from rfpsurvey._field.plan import FieldPlan
from rfpsurvey._field.verdicts import OUTCOMES, Outcome, outcome_codes
from rfpsurvey._instruments.arms import Arms, nearest_distance
from rfpsurvey._instruments.focal_plane import FocalPlane
from rfpsurvey._instruments.instrument import Instrument
from rfpsurvey._instruments.motion import CollisionReport
from rfpsurvey._sky.catalog import Catalog


def _coordinates(prefix: str, place: str, points: Callable) -> tuple[Column, Column]:
    """Return the columns of the coordinates x and y of points, which are a function of the data of the table."""
    text = f"coordinate of {place}"
    return (
        Column(f"{prefix}x", f"x {text}", "mm", lambda t: points(t)[:, 0]),
        Column(f"{prefix}y", f"y {text}", "mm", lambda t: points(t)[:, 1]),
    )


TARGET_ID = Column("target_id", "identifier of the target", value=lambda t: t.target_id)
TARGET_COLUMNS = (
    Column("ra", "right ascension of the target (ICRS)", "deg", lambda t: t.place_deg[0]),
    Column("dec", "declination of the target (ICRS)", "deg", lambda t: t.place_deg[1]),
    Column("kind", "kind of the target: science, standard or sky"),
    Column("category", "category of the target in the catalog"),
    Column("priority", "priority of the target; targets with larger values are more important"),
)
STATUS = "status of the positioner: assigned, out_of_reach, parked, recorded, idle, disabled or stuck"
WITHOUT_PATH = "whether the positioner has a target that its arm does not reach on a planned path"
PLANNER = "whether the arm collides if all arms unfold at the same time, or cannot turn while it is folded"
TILE_COLUMNS = table_of(
    Column("id", "identifier of the positioner", value=lambda t: t.plane.id),
    Column("spectrograph", "spectrograph that the fiber feeds", value=lambda t: t.spectrograph),
    *_coordinates("", "the center of the positioner in the focal plane", lambda t: t.plane.arrays.xy),
    Column("status", STATUS, value=lambda t: t.status),
    TARGET_ID,
    *TARGET_COLUMNS,
    Column("fiber_type", "fiber type of the fiber on the target", value=lambda t: t.fiber_type_of_target),
    Column("theta", "angle of the central arm", "deg", lambda t: np.rad2deg(t.posed.theta)),
    Column("phi", "angle of the eccentric arm", "deg", lambda t: np.rad2deg(t.posed.phi)),
    *_coordinates("elbow_", "the elbow in the focal plane", lambda t: t.posed.elbow),
    *_coordinates("tip_", "the fiber in the focal plane", lambda t: t.posed.tip),
    Column("in_collision", "whether the arm of the positioner collides", value=lambda t: t.report.in_collision),
    Column("colliding_with", "positioners and obstacles with which the arm collides", value=lambda t: t.partners),
    Column("needs_planner", PLANNER, value=lambda t: getattr(t.report.motion, "needs_planner", None)),
    Column("without_path", WITHOUT_PATH, value=lambda t: getattr(t.report.motion, "without_path", None)),
    Column("clearance", "distance to the nearest other arm minus the minimum separation", "mm", lambda t: t.clearance),
    *_coordinates("arm_", "the outer end of the arm segment that can collide", lambda t: t.posed.segments[:, 2:]),
)
"""Columns of the table of a tile, which is made from a `TableOfTile`."""
OUTCOMES_COLUMNS = table_of(
    TARGET_ID,
    *TARGET_COLUMNS,
    *_coordinates("", "the target in the focal plane", lambda t: t.xy_mm),
    Column("outcome", "observed, or the reason why the target is not observed", value=lambda t: t.outcome_names),
    Column(
        "positioner", "identifier of the positioner to which the target is assigned", value=lambda t: t.positioner_id
    ),
)
"""Columns of the outcomes of a tile, which are made from `TargetsOfField`."""


@dataclass(frozen=True, eq=False)
class TableOfTile:
    """The data from which the table of a tile is made; ``TILE_COLUMNS`` describes the columns and their values.

    ``ids``, ``sky_deg`` (right ascensions and declinations in ICRS) and ``kind`` describe the targets. ``target_of``
    contains, for each positioner, the row of its target, or -1 if the positioner has no target. ``carried`` contains
    further columns of the table, by name.
    """

    instrument: Instrument
    ids: np.ndarray
    sky_deg: np.ndarray
    target_of: np.ndarray
    fiber_type: np.ndarray
    posed: Arms
    report: CollisionReport
    kind: np.ndarray | None = None
    carried: dict = field(default_factory=dict)
    meta: dict = field(default_factory=dict)

    def make(self) -> QTable:
        """Return the table of the tile, with a row for each positioner."""
        table = make_table(TILE_COLUMNS, self)
        table.meta = self.meta
        return table

    @property
    def plane(self) -> FocalPlane:
        """The positioners."""
        return self.instrument.focal_plane

    @property
    def columns(self) -> dict:
        """The kinds of the targets, and the columns that are copied from the catalog, by name."""
        return ({} if self.kind is None else {"kind": np.append(self.kind, "")[self.target_of]}) | self.carried

    @cached_property
    def status(self) -> np.ndarray:
        """The status of each positioner."""
        return status_of(self.plane, self.posed)

    @property
    def target_id(self) -> MaskedColumn:
        """The identifier of the target of each positioner."""
        ids = self.ids if len(self.ids) else np.zeros(1, dtype=self.ids.dtype)
        return id_column(ids[self._row], self.posed.assigned)

    @property
    def place_deg(self) -> np.ndarray:
        """The right ascension and declination of the target of each positioner."""
        sky_deg = self.sky_deg if len(self.ids) else np.full((2, 1), np.nan)
        return np.where(self.posed.assigned, sky_deg[:, self._row], np.nan)

    @property
    def _row(self) -> np.ndarray:
        return np.where(self.posed.assigned, self.target_of, 0)

    @property
    def clearance(self) -> np.ndarray:
        """The distance (mm) of each arm to the nearest other arm, minus the minimum separation."""
        return nearest_distance(self.plane, self.posed) - self.plane.arrays.separation

    @property
    def partners(self) -> np.ndarray:
        """The identifiers of the arms and obstacles that collide with each arm, separated by spaces."""
        ids, partners = self.plane.id, {}
        for i, j in self.report.pairs.tolist():
            partners.setdefault(i, []).append(str(ids[j]))
            partners.setdefault(j, []).append(str(ids[i]))
        for i, j in self.report.obstacle_pairs.tolist():
            partners.setdefault(i, []).append(f"obstacle-{j}")
        texts = [" ".join(names) for names in partners.values()]
        column = np.full(len(ids), "", dtype=f"U{max(map(len, texts), default=1)}")
        column[list(partners)] = texts
        return column

    @property
    def spectrograph(self) -> np.ndarray | None:
        """The spectrograph that the fiber of each positioner feeds; None if there is only one."""
        plane = self.plane
        if not plane.spectrograph.any():
            return None
        if plane.spectrograph.ndim == 1:
            return plane.spectrograph
        column = np.array([plane.fiber_types.index(t) if t else 0 for t in self.fiber_type])
        return plane.spectrograph[np.arange(len(plane)), column]

    @property
    def fiber_type_of_target(self) -> np.ndarray | None:
        """The type of the fiber of each positioner with a target; None if the fibers have no types."""
        return None if self.plane.fiber_types == ("",) else np.where(self.posed.assigned, self.fiber_type, "")


def status_of(plane, posed: Arms) -> np.ndarray:
    """Return the status of each positioner."""
    status = np.full(len(plane), "idle", dtype="U12")
    for flag, word in (
        (posed.parked, "parked"),
        (slice(0) if posed.recorded is None else posed.recorded, "recorded"),
        (plane.disabled, "disabled"),
        (plane.arrays.is_stuck, "stuck"),
        (posed.assigned, "assigned"),
        (posed.clipped, "out_of_reach"),
    ):
        status[flag] = word
    return status


def only_with_target(values: np.ndarray, has_target: np.ndarray) -> np.ndarray | MaskedColumn:
    """Return a column in which the values of positioners without a target are NaN, empty text, False, or masked."""
    kind = values.dtype.kind
    if kind == "i":
        # the fill value differs from all values of targets, so that files preserve the values of targets
        spare = np.iinfo(np.int64).min if np.any(values[has_target] == -1) else -1
        return MaskedColumn(np.where(has_target, values, np.int64(spare)), mask=~has_target, fill_value=spare)
    if kind == "U":
        return np.where(has_target, values, "")
    return values & has_target if kind == "b" else np.where(has_target, values, np.nan)


def id_column(ids, has_target) -> MaskedColumn:
    """Return identifiers, masked for positioners without a target."""
    ids = np.ma.filled(ids, "") if ids.dtype.kind == "U" else np.asarray(ids)
    if ids.dtype.kind == "i":
        return only_with_target(ids, has_target)
    return MaskedColumn(only_with_target(ids.astype(str), has_target), mask=~has_target, fill_value="")


def without_masks(table: QTable) -> QTable:
    """Replace masked values of a table from a file by NaN, empty text or False; masked integers remain masked."""
    for name in table.colnames:
        column = table[name]
        if isinstance(column, Masked):
            table[name] = column.filled(np.nan)
        elif isinstance(column, MaskedColumn) and column.dtype.kind == "i":
            table[name] = only_with_target(np.asarray(column), ~column.mask)
        elif isinstance(column, MaskedColumn) and column.dtype.kind in "fUb" and name != "target_id":
            table[name] = column.filled({"U": "", "b": False}.get(column.dtype.kind, np.nan))
    return table


COLUMNS = ("kind", "category", "priority")
IDLE_COLUMNS = table_of(
    Column("id", "identifier of the positioner"),
    Column("reason", "reason why the positioner has no target"),
    Column("n_in_reach", "number of targets that the positioner can observe"),
    Column("n_free", "number of targets in reach that no positioner observes"),
    Column("n_possible", "number of free targets at which the arm would not collide"),
    Column("colliding_with", "arms and obstacles with which the arm would collide at free targets"),
    Column("target_id", "identifier of a free target in reach"),
    OUTCOMES_COLUMNS["x"],
    OUTCOMES_COLUMNS["y"],
    OUTCOMES_COLUMNS["kind"],
    Column("possible", "whether the arm can observe the target without a collision"),
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
    def target_id(self) -> np.ndarray:
        """Identifiers of the targets."""
        return self.catalog.id[self.rows]

    @cached_property
    def place_deg(self) -> np.ndarray:
        """Right ascensions and declinations of the targets (ICRS)."""
        lon, lat = to_lonlat(self.catalog.arrays.vectors[self.rows])
        return np.rad2deg([lon % (2 * np.pi), lat])

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

    @property
    def outcome_names(self) -> np.ndarray:
        """Outcome of each target as text."""
        return np.array(OUTCOMES)[self.outcome]

    @property
    def positioner_id(self) -> np.ndarray | MaskedColumn:
        """Identifier of the positioner of each target."""
        return only_with_target(self.plan.instrument.focal_plane.id[self.positioner], self.positioner >= 0)

    def idle(self) -> tuple[QTable, QTable]:
        """Return a table of the positioners without a target, and a table of the free targets that they can reach."""
        plan = self.plan
        law = getattr(plan.report.motion, "law", "")
        law = "" if law == PATHS else law
        reasons = find_idle_reasons(plan.instrument.focal_plane, plan.allocation, plan.arms, law)
        return idle_tables(reasons, self, plan.instrument.focal_plane.id)

    def table(self) -> QTable:
        """Return a table with a row for each target; its columns have units."""
        return make_table(OUTCOMES_COLUMNS, self)


def idle_tables(idle: IdleReasons, targets: TargetsOfField, positioner_id: np.ndarray) -> tuple[QTable, QTable]:
    """Return a table of the positioners without a target, and a table of their free targets in reach."""
    # for each positioner and free target, the arms and obstacles that block the arm, in one set for each handedness
    pairs: dict[tuple[int, int], list[set[int]]] = {}
    for positioner, target, others in zip(idle.owner.tolist(), idle.target.tolist(), idle.blocked_by, strict=True):
        pairs.setdefault((positioner, target), []).append(set(others))
    blockers: dict[int, set[int]] = {positioner: set() for positioner in idle.positioner.tolist()}
    n_possible = dict.fromkeys(blockers, 0)
    for (positioner, _), attempts in pairs.items():
        blockers[positioner].update(*attempts)
        n_possible[positioner] += not all(attempts)
    table = QTable({"id": positioner_id[idle.positioner]})
    table["reason"] = np.array(IDLE_REASONS)[idle.reason]
    table["n_in_reach"], table["n_free"] = idle.n_in_reach, idle.n_free
    table["n_possible"] = np.array(list(n_possible.values()), dtype=int)
    table["colliding_with"] = _texts(blockers.values(), positioner_id)
    positioner, target = np.array(list(pairs), dtype=int).reshape(-1, 2).T
    row = targets.given[target]
    free = QTable({"id": positioner_id[positioner], "target_id": targets.target_id[row]})
    free["x"], free["y"] = (with_unit(coordinates, "mm") for coordinates in targets.xy_mm[row].T)
    if "kind" in targets.columns:
        free["kind"] = targets.columns["kind"][row]
    free["possible"] = np.array([not all(attempts) for attempts in pairs.values()], dtype=bool)
    free["colliding_with"] = _texts((set().union(*attempts) for attempts in pairs.values()), positioner_id)
    return describe(table, IDLE_COLUMNS), describe(free, IDLE_COLUMNS)


def _texts(groups, ids) -> np.ndarray:
    """Return the identifiers of positioners and obstacles as text, separated by spaces."""
    names = [" ".join(str(ids[k]) if k >= 0 else f"obstacle-{-1 - k}" for k in sorted(rows)) for rows in groups]
    return np.array(names, dtype=str)


def same_table(a, b) -> bool:
    """Return whether two tables are equal; a table that is None is equal to any table."""
    return a is None or b is None or (a.colnames == b.colnames and all(_same(a[name], b[name]) for name in a.colnames))


def _same(a, b) -> bool:
    if getattr(a, "unit", None) != getattr(b, "unit", None):
        return False
    if not np.array_equal(np.ma.getmaskarray(np.ma.asarray(a)), np.ma.getmaskarray(np.ma.asarray(b))):
        return False
    if isinstance(a, MaskedColumn):
        return bool(np.array_equal(a.filled(), b.filled()))
    a, b = np.asarray(getattr(a, "value", a)), np.asarray(getattr(b, "value", b))
    return bool(np.array_equal(a, b, equal_nan=a.dtype.kind == "f"))


def collision_shape(summary: dict) -> str:
    """Return the arm model of a summary as text for a count of collisions; empty for tiles of earlier versions."""
    return f" (arm model: {summary['arm_model']})" if "arm_model" in summary else ""


def figure_of(table: QTable) -> str:
    """Return a small figure of the focal plane of a tile for notebooks."""
    assigned, colliding = np.asarray(table["status"]) == "assigned", np.asarray(table["in_collision"])
    groups = {
        "other positioners": (GRAY, ~assigned & ~colliding),
        "assigned": (BLUE, assigned & ~colliding),
        "in collision": (RED, colliding),
    }
    return dots(np.column_stack([table[axis].to_value(u.mm) for axis in "xy"]), groups)
