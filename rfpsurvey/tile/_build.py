"""Make a tile from the poses of its arms and their collisions."""

import json
import sys
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import PackageNotFoundError, version

import astropy.units as u
import numpy as np
from astropy.table import QTable

from rfpsurvey.collision import Arms, CollisionReport, nearest_distance
from rfpsurvey.instrument import Instrument
from rfpsurvey.tile._columns import KEPT_COLUMN, TILE_COLUMNS, describe, id_column
from rfpsurvey.tile._model import model_sentence
from rfpsurvey.tile._targets import TargetsOfField
from rfpsurvey.tile._tile import Tile

__all__ = ["build_tile", "versions"]

MODEL = "static geometry in the focal plane at one wavelength; no refraction, no dynamic collisions"
REFRACTED = "static geometry in the focal plane with atmospheric refraction; no dynamic collisions"


def build_tile(
    instrument: Instrument,
    ids: np.ndarray,
    sky_deg: np.ndarray,
    target_of: np.ndarray,
    fiber_type: np.ndarray,
    posed: Arms,
    report: CollisionReport,
    summary: dict,
    parameters: dict,
    catalog_meta: dict,
    kind: np.ndarray | None = None,
    carried: dict | None = None,
    targets: TargetsOfField | None = None,
    software: dict | None = None,
) -> Tile:
    """Return a tile with all of its columns.

    ``ids``, ``sky_deg`` (rows ra, dec in ICRS) and ``kind`` describe the targets; ``target_of`` contains the row of the
    target of each positioner, or -1 if it has no target. The columns in ``carried`` have a value for each positioner;
    ``targets`` are all targets of the field. ``software`` lists the packages whose versions the tile records in
    addition to those of the usual packages.
    """
    plane = instrument.focal_plane
    n, projection = len(plane), parameters.get("projection", "radial")
    has_target = posed.assigned
    if len(ids) == 0:  # there are no targets
        ids, sky_deg = np.zeros(1, dtype=ids.dtype), np.full((2, 1), np.nan)
    row = np.where(has_target, target_of, 0)
    status = np.full(n, "idle", dtype="U12")
    for flag, word in (
        (posed.parked, "parked"),
        (plane.disabled, "disabled"),
        (plane.arrays.is_stuck, "stuck"),
        (has_target, "assigned"),
        (posed.clipped, "out_of_reach"),
    ):
        status[flag] = word
    table = QTable({"id": plane.id})
    if plane.spectrograph.any():
        table["spectrograph"] = _spectrograph(plane, fiber_type)
    table["x"], table["y"] = plane.arrays.xy.T * u.mm
    table["status"] = status
    table["target_id"] = id_column(ids[row], has_target)
    table["ra"], table["dec"] = np.where(has_target, sky_deg[:, row], np.nan) * u.deg
    if plane.fiber_types != ("",):
        table["fiber_type"] = np.where(has_target, fiber_type, "")
    table["theta"], table["phi"] = np.rad2deg(posed.theta) * u.deg, np.rad2deg(posed.phi) * u.deg
    table["elbow_x"], table["elbow_y"] = posed.elbow.T * u.mm
    table["tip_x"], table["tip_y"] = posed.tip.T * u.mm
    table["in_collision"] = report.in_collision
    table["colliding_with"] = _partners(plane, report)
    table["clearance"] = (nearest_distance(plane, posed) - plane.positioner.numbers.separation) * u.mm
    table["arm_x"], table["arm_y"] = posed.segments[:, 2:].T * u.mm
    if kind is not None:
        table["kind"] = np.append(kind, "")[target_of]
    for name, values in (carried or {}).items():
        table[name] = values
    summary = {
        **summary,
        "n_positioners": n,
        "n_assigned": int(has_target.sum()),
        "n_parked": int(posed.parked.sum()),
        "n_idle": int((status == "idle").sum()),
        "n_colliding": int((report.in_collision & report.counted).sum()),
        "n_colliding_pairs": len(report.pairs),
        "n_obstacle_collisions": len(report.obstacle_pairs),
        "collision_rate": report.rate,
        "collision_rate_assigned": report.rate_assigned,
        "model": model_sentence(instrument, posed, projection),
    }
    meta = {
        "summary": summary,
        "provenance": {
            "software": {**versions(), **(software or {})},
            "created": datetime.now(UTC).isoformat(timespec="seconds"),
            "model": MODEL if projection in ("tangent", "radial") else REFRACTED,
            "instrument": instrument.provenance,
            "catalog": dict(catalog_meta),
            "parameters": parameters,
            "outcomes": targets is not None,
        },
        "geometry": {
            "inner_radius_mm": _one_or_all(plane.arrays.inner_radius),
            "outer_radius_mm": _one_or_all(plane.arrays.outer_radius),
            "min_separation_mm": float(plane.positioner.numbers.separation),
            "arm_model": plane.positioner.arm_model,
            "obstacles_mm": plane.arrays.obstacles.tolist(),
            "obstacle_polygons_mm": [one.tolist() for one in plane.arrays.obstacle_polygons],
            **({} if plane.positioner.outline is None else {"outline_mm": plane.positioner.outline.to_dict()}),
        },
    }
    table.meta = json.loads(json.dumps(meta, default=str))  # converts to types that all file formats support
    return Tile(describe(table, TILE_COLUMNS, KEPT_COLUMN), targets)


def _partners(plane, report):
    """Return for each positioner one string with the identifiers of everything that it collides with."""
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


def _one_or_all(values):
    """Return one number if all numbers are equal, otherwise the list of the numbers."""
    return float(values[0]) if (values == values[0]).all() else values.tolist()


def _spectrograph(plane, fiber_type):
    if plane.spectrograph.ndim == 1:
        return plane.spectrograph
    column = np.array([plane.fiber_types.index(t) if t else 0 for t in fiber_type])
    return plane.spectrograph[np.arange(len(plane)), column]


@cache
def versions() -> dict:
    """Return the versions of the packages on which results depend."""
    found = {"python": sys.version.split()[0]}
    for name in ("rfpsurvey", "astropy", "numpy", "numba", "scipy"):
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "unknown"
    return found
