"""The table of a tile, which is made when it is used for the first time."""

from dataclasses import dataclass, field

import astropy.units as u
import numpy as np
from astropy.table import QTable

from rfpsurvey.collision import Arms, CollisionReport, nearest_distance
from rfpsurvey.instrument import Instrument
from rfpsurvey.tile._columns import KEPT_COLUMN, TILE_COLUMNS, describe, id_column


@dataclass(frozen=True, eq=False)
class TableOfTile:
    """The data from which the table of a tile is made.

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
    carried: dict | None = None
    meta: dict = field(default_factory=dict)

    def make(self) -> QTable:
        """Return the table of the tile, with a row for each positioner."""
        instrument, posed, report, fiber_type = self.instrument, self.posed, self.report, self.fiber_type
        plane, has_target, ids, sky_deg = instrument.focal_plane, posed.assigned, self.ids, self.sky_deg
        if len(ids) == 0:  # there are no targets
            ids, sky_deg = np.zeros(1, dtype=ids.dtype), np.full((2, 1), np.nan)
        row = np.where(has_target, self.target_of, 0)
        table = QTable({"id": plane.id})
        if plane.spectrograph.any():
            table["spectrograph"] = _spectrograph(plane, fiber_type)
        table["x"], table["y"] = plane.arrays.xy.T * u.mm
        table["status"] = status_of(plane, posed)
        table["target_id"] = id_column(ids[row], has_target)
        table["ra"], table["dec"] = np.where(has_target, sky_deg[:, row], np.nan) * u.deg
        if plane.fiber_types != ("",):
            table["fiber_type"] = np.where(has_target, fiber_type, "")
        table["theta"], table["phi"] = np.rad2deg(posed.theta) * u.deg, np.rad2deg(posed.phi) * u.deg
        table["elbow_x"], table["elbow_y"] = posed.elbow.T * u.mm
        table["tip_x"], table["tip_y"] = posed.tip.T * u.mm
        table["in_collision"] = report.in_collision
        table["colliding_with"] = _partners(plane, report)
        if report.motion is not None:
            table["needs_planner"] = report.motion.needs_planner
        table["clearance"] = (nearest_distance(plane, posed) - plane.arrays.separation) * u.mm
        table["arm_x"], table["arm_y"] = posed.segments[:, 2:].T * u.mm
        if self.kind is not None:
            table["kind"] = np.append(self.kind, "")[self.target_of]
        for name, values in (self.carried or {}).items():
            table[name] = values
        table.meta = self.meta
        return describe(table, TILE_COLUMNS, KEPT_COLUMN)


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


def _partners(plane, report):
    """Return for each positioner a string with the identifiers of the arms and obstacles that collide with its arm."""
    partners = {}
    for i, j in report.pairs.tolist():
        partners.setdefault(i, []).append(str(plane.id[j]))
        partners.setdefault(j, []).append(str(plane.id[i]))
    for i, j in report.obstacle_pairs.tolist():
        partners.setdefault(i, []).append(f"obstacle-{j}")
    texts = [" ".join(found) for found in partners.values()]
    column = np.full(len(plane), "", dtype=f"U{max(map(len, texts), default=1)}")
    column[list(partners)] = texts
    return column


def _spectrograph(plane, fiber_type):
    if plane.spectrograph.ndim == 1:
        return plane.spectrograph
    column = np.array([plane.fiber_types.index(t) if t else 0 for t in fiber_type])
    return plane.spectrograph[np.arange(len(plane)), column]
