"""Plan scenes with the allocators of rfpsurvey; the focal plane is made from the file of the scene alone."""

from dataclasses import replace
from importlib.metadata import version
from time import process_time

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord
from astropy.table import Table, vstack
from scene import EVERY, Scene

import rfpsurvey as rs
from rfpsurvey.allocation import METHODS
from rfpsurvey.positioner import ArmOutline

VERSION = version("rfpsurvey").partition("+")[0]


def focal_plane(scene: Scene) -> rs.FocalPlane:
    """Return the focal plane of a scene."""
    p, s = scene.positioners, scene.settings
    shape: dict = {}
    if s["shape"] == "outline":
        parts = [
            [(np.array(one["vertices"]) * u.mm, one["radius"] * u.mm) for one in s[arm]]
            for arm in ("eccentric", "central")
        ]
        shape = {"arm_model": "outline", "outline": ArmOutline(*parts)}
    elif s["length"] is not None:
        angle = {name: value * u.deg for name, value in s["angle"].items()}
        shape = {"arm_model": "capsule", "arm_length": s["length"] * u.mm, "arm_angle": angle.get("", angle)}
    arms = [np.asarray(p[name], dtype=float) * u.mm for name in ("central_arm", "eccentric_arm")]
    free = np.asarray(p["state"]) == "ok"
    parked = np.column_stack([p["theta_parked"], p["phi_parked"]]).astype(float)
    home = parked[free][0]
    unit = rs.Positioner(
        np.median(arms[0]),
        np.median(arms[1]),
        s["clearance"] * u.mm,
        displacement=(s["min_separation"] - 2 * s["clearance"]) * u.mm,
        handedness=s["handedness"],
        home=home * u.deg,
        **shape,
    )
    limits = {}
    for joint in ("theta", "phi"):
        ends = np.column_stack([p[f"{joint}_min"], p[f"{joint}_max"]]).astype(float)
        if (np.abs(ends) < EVERY).any():
            limits[f"{joint}_range"] = np.where(np.abs(ends) < EVERY, ends, np.nan) * u.deg
    stuck = np.where((np.asarray(p["state"]) == "stuck")[:, None], parked, np.nan)
    return rs.FocalPlane(
        np.column_stack([p["x"], p["y"]]) * u.mm,
        unit,
        id=np.asarray(p["id"]),
        spectrograph=np.asarray(p["spectrograph"]),
        fiber_type=np.asarray(p["fiber_type"], dtype=str),
        central_arm=arms[0] if np.ptp(arms[0].value) > 0 else None,
        eccentric_arm=arms[1] if np.ptp(arms[1].value) > 0 else None,
        disabled=np.asarray(p["state"]) == "disabled",
        stuck=stuck * u.deg if np.isfinite(stuck).any() else None,
        obstacles=np.array(s["circles"]) * u.mm if s["circles"] else None,
        obstacle_polygons=[np.array(one) * u.mm for one in s["polygons"]] or None,
        hidden=np.array(s["hidden"]) * u.mm if s["hidden"] else None,
        **limits,
    )


def requirements(scene: Scene) -> list[rs.Requirement]:
    """Return the requirements of a scene."""
    return [rs.Requirement(**one) for one in scene.settings["requirements"]]


def plan(scene: Scene, seconds: float, *, allocator: str) -> tuple[Table, float, dict]:
    """Return the plan of a scene, the processor time (s), and facts about the search.

    ``random`` after the name of the allocator stands for random subpriorities.
    """
    allocator, _, subpriority = allocator.partition(" ")
    plane, t = focal_plane(scene), scene.targets
    xy = np.column_stack([t["x"], t["y"]]).astype(float) * u.mm
    limit = {"time_limit": seconds * u.s} if METHODS[allocator].searches else {}
    options = rs.AllocationOptions(allocator, requirements=requirements(scene), **limit)
    columns = {
        "priority": np.asarray(t["priority"], dtype=float),
        "kind": np.asarray(t["kind"], dtype=str),
        "category": np.asarray(t["category"], dtype=str),
        "fiber_type": np.asarray(t["fiber_type"], dtype=str),
    }
    if subpriority:
        columns["subpriority"] = rs.allocation.subpriorities(np.arange(len(t)), 1)
    begin = process_time()
    found = rs.allocate(plane, xy, allocator=options, **columns)
    spent = process_time() - begin
    rows = np.flatnonzero(found.target_of_positioner >= 0)
    table = Table({"positioner": plane.id[rows], "target": np.asarray(t["id"])[found.target_of_positioner[rows]]})
    if found.handedness is not None:
        table["side"] = np.asarray(found.handedness)[rows]
    return table, spent, {"gap": percent(found.gap)}


def percent(gap: float | None) -> str:
    """Return a relative gap as text: 0 if the plan is proven to be optimal, empty if there is no bound."""
    return "" if gap is None or np.isnan(gap) else f"{100 * gap:.2g} %" if gap else "0"


def plan_together(scene: Scene, seconds: float, *, allocator: str) -> tuple[Table, float, dict]:
    """Return the joint plan of the tiles of a scene, the processor time (s), and facts about the search.

    The time includes the projection of the targets. No iterations follow the search for augmenting paths if the time
    limit is reached; the tiles are first planned one after the other.
    """
    t = scene.targets
    if not scene.n_tiles or scene.settings["requirements"] or set(t["fiber_type"]) != {""}:
        raise NotImplementedError("a joint plan needs several tiles; requirements and fiber types are not translated")
    instrument = replace(rs.Instrument.preset(scene.settings["preset"]), focal_plane=focal_plane(scene))
    rows = np.unique(np.asarray(t["id"]), return_index=True)[1]
    catalog = Table({"id": t["id"][rows], "ra": t["ra"][rows] * u.deg, "dec": t["dec"][rows] * u.deg})
    catalog["priority"] = t["priority"][rows]
    centers = SkyCoord([(one["ra"], one["dec"]) for one in scene.settings["tiles"]] * u.deg)
    first = rs.AllocationOptions("optimal", time_limit=seconds / 2 * u.s)
    joint = rs.JointOptions(allocator=first, time_limit=seconds / 2 * u.s)
    begin = process_time()
    survey = rs.plan_survey(catalog, instrument, centers, allocator=joint)
    spent = process_time() - begin
    parts = [Table({"positioner": one["positioner"], "target": one["target_id"]}) for one in survey]
    for part, k in zip(parts, np.asarray(survey.tiles["tile"]).tolist(), strict=True):
        part["tile"] = k
    return vstack(parts), spent, {"gap": percent(float(survey.joint["gap"][-1]))}
