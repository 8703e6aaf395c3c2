"""Plan scenes of DESI with fiberassign, the planner of DESI, through the functions that its programs call.

Written for the version of August 2026 (6.0.1.dev3795). Install desiutil, desimodel, desitarget and fiberassign from
https://github.com/desihub with ``pip install --no-deps``, and fitsio and healpy; data of desimodel are not needed.

The positioners, outlines and targets are those of the scene; flat focal surface, no margins around the outlines.
fiberassign leaves out the outer 0.2 mm and the inner 0.1 mm of the patrol region, and the scenes have the same limits.
Switched off, because the scenes have nothing of the kind: sky positions per slit block, stuck positioners on sky, sky
monitors, edges of petals and guide cameras, later tiles, and second observations of a target. fiberassign's order of
targets of a class is random (``subpriority``); with ``equal``, all subpriorities are equal.
"""

import os
from importlib.metadata import version
from time import process_time

import numpy as np
import shapely
from astropy.table import Table

os.environ.setdefault("DESI_LOGLEVEL", "ERROR")
try:
    from fiberassign import assign
    from fiberassign._internal import (
        Assignment,
        Circle,
        Hardware,
        LocationsAvailable,
        Segments,
        Shape,
        Targets,
        TargetsAvailable,
        Tiles,
    )
except ImportError as error:
    raise ImportError(f"fiberassign cannot be imported: {error}") from error

VERSION = version("fiberassign")
TYPES = {"science": 1, "standard": 2, "sky": 4}
TILE = 1


def shape(parts: list[dict], sign: float) -> "Shape":
    """Return an outline: circles, and the boundary of the polygons; ``sign`` -1 mirrors the outline."""
    circles, polygons = [], []
    for part in parts:
        corners = [(x, sign * y) for x, y in part["vertices"]]
        if len(corners) == 1:
            circles.append(Circle(corners[0], part["radius"]))
        else:
            polygons.append(shapely.Polygon(corners).buffer(part["radius"]))
    outline = shapely.union_all(polygons)
    rings = [np.array(one.exterior.coords) for one in getattr(outline, "geoms", [outline])] if polygons else []
    return Shape((0.0, 0.0), circles, [Segments([tuple(point) for point in ring]) for ring in rings])


def hardware(scene, sign: float) -> "Hardware":
    """Return the focal plane of a scene."""
    p, s, n = scene.positioners, scene.settings, len(scene.positioners)
    whole, zero, none = np.arange(n, dtype=np.int32), np.zeros(n), Shape((0.0, 0.0), [], [])
    phi = np.sort([sign * np.asarray(p[name], dtype=float) for name in ("phi_min", "phi_max")], axis=0)
    radius = np.linspace(0, 500, 501)
    return Hardware(
        timestr="2026-01-01T00:00:00",
        location=np.asarray(p["id"], dtype=np.int32),
        petal=np.asarray(p["spectrograph"], dtype=np.int32),
        device=whole,
        slitblock=np.zeros(n, dtype=np.int32),
        blockfiber=whole,
        fiber=whole,
        device_type=["POS"] * n,
        x=np.asarray(p["x"], dtype=float),
        y=sign * np.asarray(p["y"], dtype=float),
        status=np.where(np.asarray(p["state"]) == "ok", 0, 4).astype(np.int32),
        theta_offset=zero,
        theta_min=zero - 200,
        theta_max=zero + 200,
        theta_pos=sign * np.asarray(p["theta_parked"], dtype=float),
        theta_arm=np.asarray(p["central_arm"], dtype=float),
        phi_offset=zero,
        phi_min=phi[0],
        phi_max=phi[1],
        phi_pos=sign * np.asarray(p["phi_parked"], dtype=float),
        phi_arm=np.asarray(p["eccentric_arm"], dtype=float),
        ps_radius=radius,
        ps_theta=radius / 300,
        arclen=radius,
        excl_theta=[shape(s["central"], sign)] * n,
        excl_phi=[shape(s["eccentric"], sign)] * n,
        excl_gfa=[none] * n,
        excl_petal=[none] * n,
        added_margins={},
    )


def plan(scene, seconds: float, *, equal: bool = False) -> tuple[Table, float, dict]:
    """Return the plan of a scene, the processor time (s) from the lists of targets in reach on, and no facts."""
    t, s = scene.targets, scene.settings
    if s["shape"] != "outline" or s["circles"] or s["polygons"] or s["handedness"] == "both":
        raise NotImplementedError("fiberassign needs outlines of the arms; obstacles and two sides are not translated")
    asked = {(one["what"], one["per"]): one["minimum"] for one in s["requirements"]}
    if not set(asked) <= {("standard", "spectrograph"), ("sky", "spectrograph")}:
        raise NotImplementedError("fiberassign requires numbers of standards and sky positions per petal")
    sign = 1.0 if s["handedness"] == "right" else -1.0
    n, ids = len(t), np.arange(len(t), dtype=np.int64)
    drawn = np.full(n, 0.5) if equal else np.random.default_rng(1).uniform(size=n)
    kinds = np.array([TYPES[one] for one in t["kind"]], dtype=np.uint8)
    targets, plane = Targets(), hardware(scene, sign)
    priority = np.round(np.asarray(t["priority"])).astype(np.int32)
    targets.append("main", ids, np.ones(n, dtype=np.int32), priority, drawn, kinds)
    tiles = Tiles([TILE], [0.0], [0.0], [1], ["2026-01-01T00:00:00"], [0.0], [0.0])
    x, y = np.asarray(t["x"], dtype=float).tolist(), (sign * np.asarray(t["y"], dtype=float)).tolist()
    begin = process_time()
    reach = TargetsAvailable(plane, tiles, {TILE: ids.tolist()}, {TILE: x}, {TILE: y})
    assignment = Assignment(targets, reach, LocationsAvailable(reach), {})
    standards, sky = (asked.get((kind, "spectrograph"), 0) for kind in ("standard", "sky"))
    assign.run(assignment, standards, sky, -1, redistribute=False, use_zero_obsremain=False)  # -1: no slit blocks
    spent = process_time() - begin
    found = assignment.tile_location_target(TILE)
    rows = list(found.values())
    return Table({"positioner": list(found), "target": np.asarray(t["id"])[rows]}), spent, {}


PLANS = {"fiberassign": plan, "fiberassign equal": lambda scene, seconds: plan(scene, seconds, equal=True)}
"""Label and function of each setting."""
