"""Count what a plan of fibers observes and which arms collide, with code that is independent of rfpsurvey.

``python tests/benchmarks/planners/judge.py SCENE PLAN [PLAN ...]`` prints the counts of plans of a scene. A plan is a
table with the columns ``positioner`` and ``target`` and, optionally, ``side`` (right or left), or the file of another
program (see ``read_plan``). Nothing of rfpsurvey is imported; arms are placed by trigonometry, and shapely measures the
distances between them.
"""

import argparse
import json
from collections import Counter
from pathlib import Path

import numpy as np
import shapely
from astropy.io import fits
from astropy.table import Table

EDGE = 1e-6
"""Targets that are out of reach by less than this length (mm) count as in reach."""


def read_scene(path: Path) -> tuple[Table, Table, dict]:
    """Return the positioners, the targets and the settings of a scene."""
    with fits.open(path, memmap=False) as file:
        tables = [Table(file[name].data) for name in ("POSITIONERS", "TARGETS", "SETTINGS")]
    for table in tables:
        table.convert_bytestring_to_unicode()
    return *tables[:2], json.loads(str(tables[2]["json"][0]))


def read_plan(path: Path) -> Table:
    """Return the columns ``positioner`` and ``target`` of a plan, and ``side`` if the plan has it.

    Of a FITS file, the first table is read. The tables of fiberassign and of rfpsurvey have other names of the columns.
    """
    names = {"positioner": ("positioner", "LOCATION", "id"), "target": ("target", "TARGETID", "target_id")}
    table = Table.read(path, **({"hdu": 1} if ".fits" in path.name else {}))
    found = {new: next(one for one in old if one in table.colnames) for new, old in names.items()}
    columns = {new: np.ma.filled(np.ma.asarray(table[old]), -1) for new, old in found.items()}
    if "side" in table.colnames or "handedness" in table.colnames:
        columns["side"] = table["side" if "side" in table.colnames else "handedness"]
    plan = Table(columns)
    return plan[np.array([str(one) not in ("-1", "", "--") for one in plan["target"]])]


def place(positioners: Table, row: int, xy: complex, side: str) -> tuple[float, float] | None:
    """Return theta and phi (deg) of an arm at a point, or None if the point is out of reach."""
    p = positioners[row]
    l1, l2 = float(p["central_arm"]), float(p["eccentric_arm"])
    tip = xy - complex(p["x"], p["y"])
    r = abs(tip)
    if not abs(l1 - l2) - EDGE <= r <= l1 + l2 + EDGE:
        return None
    cosine = 1.0 if r == 0 else np.clip((l1**2 + r**2 - l2**2) / (2 * l1 * r), -1, 1)
    turn = np.arccos(cosine) if side == "right" else -np.arccos(cosine)
    theta = np.deg2rad(p["theta_parked"]) if r == 0 else np.angle(tip) - turn
    phi = np.angle((tip - l1 * np.exp(1j * theta)) * np.exp(-1j * theta)) if r else np.pi
    angles = np.rad2deg([theta, phi])
    limits = [(p[f"{joint}_min"], p[f"{joint}_max"]) for joint in ("theta", "phi")]
    turns = 360.0 * np.arange(-3, 4)
    inside = all(
        (np.clip(angle + turns, low, high) == angle + turns).any() or np.abs(np.array([low, high])).max() > 1e6
        for angle, (low, high) in zip(angles, ((low - 1e-6, high + 1e-6) for low, high in limits), strict=True)
    )
    return (*angles,) if inside else None


def sides_of(settings: dict) -> tuple[str, ...]:
    """Return the sides of the elbow that the positioners of a scene can have."""
    return {"right": ("right",), "left": ("left",), "both": ("right", "left")}[settings["handedness"]]


def parts_of(positioner, settings: dict, theta: float, phi: float, fiber_type: str) -> list[tuple]:
    """Return the parts of an arm in a pose: geometry, radius, and whether the part belongs to the eccentric arm."""
    center, along = complex(positioner["x"], positioner["y"]), np.exp(1j * np.deg2rad(theta))
    elbow, outer = center + float(positioner["central_arm"]) * along, along * np.exp(1j * np.deg2rad(phi))
    if settings["shape"] == "segment":
        length = settings["length"] or float(positioner["eccentric_arm"])
        used = fiber_type or str(positioner["fiber_type"]).split("+")[0]
        angle = settings["angle"].get(used, settings["angle"].get("", 0.0))
        end = elbow + length * outer * np.exp(1j * np.deg2rad(angle))
        return [(shapely.LineString([(elbow.real, elbow.imag), (end.real, end.imag)]), 0.0, True)]
    found = []
    for name, origin, direction in (("eccentric", elbow, outer), ("central", center, along)):
        for part in settings[name]:
            points = origin + np.array(part["vertices"]) @ np.array([1, 1j]) * direction
            corners = list(zip(points.real, points.imag, strict=True))
            kind = {1: lambda c: shapely.Point(c[0]), 2: shapely.LineString}.get(len(corners), shapely.Polygon)
            found.append((kind(corners), part["radius"], name == "eccentric"))
    return found


def gaps(parts: list[list[tuple]], limit: float) -> set[tuple[int, int]]:
    """Return the pairs of rows whose parts are closer than the limit; one part of a pair must be eccentric."""
    rows = np.repeat(np.arange(len(parts)), [len(some) for some in parts])
    flat = [one for some in parts for one in some]
    shapes, radii = np.array([one[0] for one in flat], dtype=object), np.array([one[1] for one in flat])
    eccentric = np.array([one[2] for one in flat], dtype=bool)
    if not len(shapes):
        return set()
    a, b = shapely.STRtree(shapes).query(shapes, predicate="dwithin", distance=limit + 2 * radii.max())
    some = (rows[a] < rows[b]) & (eccentric[a] | eccentric[b])
    a, b = a[some], b[some]
    closer = shapely.distance(shapes[a], shapes[b]) < limit + radii[a] + radii[b]
    flush = limit + radii[a] + radii[b] == 0  # shapes that only touch do not collide
    closer |= flush & shapely.intersects(shapes[a], shapes[b]) & ~shapely.touches(shapes[a], shapes[b])
    return {(int(i), int(j)) for i, j in zip(rows[a][closer], rows[b][closer], strict=True)}


def judge(scene: tuple[Table, Table, dict], plan: Table) -> dict:
    """Return the counts of a plan: targets by kind and priority, collisions, and what is not allowed."""
    positioners, targets, settings = scene
    row_of = {str(one): k for k, one in enumerate(positioners["id"])}
    target_of = {str(one): k for k, one in enumerate(targets["id"])}
    used = [(row_of[str(p)], target_of[str(t)]) for p, t in zip(plan["positioner"], plan["target"], strict=True)]
    xy = np.asarray(targets["x"]) + 1j * np.asarray(targets["y"])
    hidden = np.array(settings["hidden"]).reshape(-1, 3)
    given = plan["side"] if "side" in plan.colnames else [""] * len(plan)
    poses, fibers, wrong = {}, {}, Counter()
    for (i, t), side in zip(used, given, strict=True):
        wrong["positioner used twice"] += i in poses
        wrong["positioner that cannot move"] += str(positioners["state"][i]) != "ok"
        needed = str(targets["fiber_type"][t])
        wrong["fiber of another type"] += bool(needed) and needed not in str(positioners["fiber_type"][i]).split("+")
        wrong["target in a hidden circle"] += bool((abs(xy[t] - hidden[:, 0] - 1j * hidden[:, 1]) < hidden[:, 2]).any())
        found = [place(positioners, i, xy[t], one) for one in ([side] if side else sides_of(settings))]
        found = [one for one in found if one is not None]
        wrong["out of reach"] += not found
        if found:
            poses[i], fibers[i] = found[0], needed
    wrong["target observed twice"] = sum(n - 1 for n in Counter(t for _, t in used).values())
    standing = dict(poses)
    arms = np.asarray(positioners["central_arm"]), np.asarray(positioners["eccentric_arm"])
    parked = (np.abs(arms[0] - arms[1]) <= 0.05 * (arms[0] + arms[1])) | (np.asarray(positioners["state"]) != "ok")
    for i in np.flatnonzero(parked):
        standing.setdefault(int(i), (positioners["theta_parked"][i], positioners["phi_parked"][i]))
    rows = sorted(standing)
    parts = [parts_of(positioners[i], settings, *standing[i], fibers.get(i, "")) for i in rows]
    pairs = {(rows[i], rows[j]) for i, j in gaps(parts, settings["min_separation"])}
    fixed = [(shapely.Point(x, y), r) for x, y, r in settings["circles"]]
    fixed += [(shapely.Polygon(one), 0.0) for one in settings["polygons"]]
    hits = set()
    for i, some in zip(rows, parts, strict=True):
        for shape, radius, is_eccentric in some:
            near = is_eccentric and any(
                shapely.distance(shape, one) - r - radius < settings["clearance"] for one, r in fixed
            )
            hits |= {i} if near else set()
    colliding = {i for pair in pairs for i in pair} | hits
    counted = [(i, t) for i, t in used if i in poses and i not in colliding]
    observed = [t for _, t in counted]
    kinds = Counter(str(targets["kind"][t]) for t in observed)
    science = [t for t in observed if str(targets["kind"][t]) == "science"]
    classes = Counter(float(targets["priority"][t]) for t in science)
    return {
        "assigned": len(used),
        "colliding": sum(i in colliding for i in poses),
        "pairs": len(pairs),
        "science": kinds["science"],
        "by_priority": [classes[one] for one in sorted({float(p) for p in targets["priority"]}, reverse=True)][:6],
        "standard": kinds["standard"],
        "sky": kinds["sky"],
        "missing": missing(positioners, targets, settings, counted),
        "wrong": {name: n for name, n in wrong.items() if n},
    }


def missing(positioners: Table, targets: Table, settings: dict, used: list[tuple[int, int]]) -> int:
    """Return the number of targets that the requirements lack."""
    total = 0
    for one in settings["requirements"]:
        places = [None] if one["per"] == "tile" else np.unique(positioners["spectrograph"]).tolist()
        for where in places:
            n = sum(
                one["what"] in (str(targets["category"][t]), str(targets["kind"][t]))
                and (not one["fiber_type"] or str(targets["fiber_type"][t]) == one["fiber_type"])
                and (where is None or positioners["spectrograph"][i] == where)
                for i, t in used
            )
            total += max(one["minimum"] - n, 0)
    return total


def main() -> None:
    """Print the counts of plans."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", type=Path)
    parser.add_argument("plans", type=Path, nargs="+", metavar="PLAN")
    given = parser.parse_args()
    scene = read_scene(given.scene)
    for path in given.plans:
        print(path, json.dumps(judge(scene, read_plan(path))))


if __name__ == "__main__":
    main()
