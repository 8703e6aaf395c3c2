"""Make a tile from the poses of its arms and their collisions."""

import json
import sys
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import PackageNotFoundError, version

import numpy as np

from rfpsurvey.collision import Arms, CollisionReport
from rfpsurvey.instrument import Instrument
from rfpsurvey.tile._model import model_sentence
from rfpsurvey.tile._table import TableOfTile, status_of
from rfpsurvey.tile._targets import TargetsOfField
from rfpsurvey.tile._tile import Tile

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
    """Return a tile; its table is made when the table is used for the first time.

    ``ids``, ``sky_deg`` (right ascensions and declinations in ICRS) and ``kind`` describe the targets. ``target_of``
    contains, for each positioner, the row of its target, or -1 if the positioner has no target. ``carried`` contains
    further columns of the table, by name. ``targets`` contains all targets of the field. ``software`` contains the
    versions of further packages, which the provenance of the tile lists.
    """
    plane = instrument.focal_plane
    projection, status = parameters.get("projection", "radial"), status_of(plane, posed)
    summary = {
        **summary,
        "n_positioners": len(plane),
        "n_assigned": int(posed.assigned.sum()),
        **{f"n_{word}": int((status == word).sum()) for word in ("parked", "idle")},
        "n_colliding": int((report.in_collision & report.counted).sum()),
        "n_colliding_pairs": len(report.pairs),
        "arm_model": plane.positioner.arm_model,
        **({"margins": str(plane.margins)} if plane.margins else {}),
        "n_obstacle_collisions": len(report.obstacle_pairs),
        **({} if report.motion is None else report.motion.counts),
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
            "min_separation_mm": float(plane.arrays.separation),
            "arm_model": plane.positioner.arm_model,
            "obstacles_mm": plane.arrays.obstacles.tolist(),
            "obstacle_polygons_mm": [one.tolist() for one in plane.arrays.obstacle_polygons],
            **({} if plane.positioner.outline is None else {"outline_mm": plane.positioner.outline.to_dict()}),
        },
    }
    meta = json.loads(json.dumps(meta, default=str))  # converts the values to types that all file formats support
    columns = TableOfTile(instrument, ids, sky_deg, target_of, fiber_type, posed, report, kind, carried, meta)
    return Tile(columns, targets)


def _one_or_all(values):
    """Return one number if all numbers are equal, otherwise the list of the numbers."""
    return float(values[0]) if (values == values[0]).all() else values.tolist()


@cache
def versions() -> dict:
    """Return the versions of Python and of the packages on which results depend."""
    found = {"python": sys.version.split()[0]}
    for name in ("rfpsurvey", "astropy", "numpy", "numba", "scipy"):
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "unknown"
    return found
