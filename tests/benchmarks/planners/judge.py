"""Count what a plan of fibers observes and which arms collide, with code that is independent of rfpsurvey.

``python tests/benchmarks/planners/judge.py SCENE PLAN [PLAN ...]`` prints the counts of plans of a scene. A plan is a
table with the columns ``positioner`` and ``target`` and, optionally, ``side`` (right or left) and ``tile``, or the file
of another program (see ``plan_files.py``). Nothing of rfpsurvey is imported; arms are placed by trigonometry, and
shapely measures the distances between them.
"""

import argparse
import json
from collections import Counter
from pathlib import Path

import numpy as np
import shapely
from astropy.io import fits
from astropy.table import Table
from plan_files import read_plan

EDGE = 1e-6
"""Targets that are out of reach by less than this length (mm) count as in reach."""


def read_scene(path: Path) -> tuple[Table, Table, dict]:
    """Return the positioners, the targets and the settings of a scene."""
    with fits.open(path, memmap=False) as file:
        tables = [Table(file[name].data) for name in ("POSITIONERS", "TARGETS", "SETTINGS")]
    for table in tables:
        table.convert_bytestring_to_unicode()
    return *tables[:2], json.loads(str(tables[2]["json"][0]))


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
    closer |= (limit + radii[a] + radii[b] == 0) & shapely.intersects(shapes[a], shapes[b])
    return {(int(i), int(j)) for i, j in zip(rows[a][closer], rows[b][closer], strict=True)}


def judge(scene: tuple[Table, Table, dict], plan: Table, *, idle: bool = True) -> dict:
    """Return the counts of a plan: targets by kind and priority, collisions, and what is not allowed.

    Without ``idle``, arms without a target that can move are no obstacles, as for programs that ignore them.
    A science target that several tiles observe counts once; ``doubles`` is the number of its other observations.
    """
    positioners, targets, settings = scene
    parts = [(targets, plan)]
    if "tile" in targets.colnames:
        if "tile" not in plan.colnames:
            raise ValueError(f"a plan of several tiles must have the column tile, got {', '.join(plan.colnames)}")
        number, of_plan = np.asarray(targets["tile"]), np.asarray(plan["tile"])
        parts = [(targets[number == k], plan[of_plan == k]) for k in range(len(settings["tiles"]))]
    total, wrong, seen = Counter(), Counter(), {}
    for own, used in parts:
        counts, kinds, errors = judge_tile((positioners, own, settings), used, idle)
        total.update(counts)
        wrong.update(errors)
        for kind, name, priority in kinds:
            total[kind] += kind != "science"
            total["doubles"] += kind == "science" and name in seen
            if kind == "science":
                seen[name] = priority
    science = Counter(seen.values())
    of_science = np.asarray(targets["priority"], dtype=float)[np.asarray(targets["kind"]) == "science"]
    counted = ("assigned", "colliding", "pairs", "standard", "sky", "missing", "doubles")
    return {
        **{name: int(total[name]) for name in counted},
        "science": len(seen),
        "by_priority": [science[one] for one in sorted(set(of_science.tolist()), reverse=True)],
        "wrong": {name: int(n) for name, n in wrong.items() if n},
    }


def judge_tile(scene: tuple[Table, Table, dict], plan: Table, idle: bool) -> tuple[dict, list[tuple], Counter]:
    """Return the counts of a tile, the kind, identifier and priority of the observed targets, and what is wrong."""
    positioners, targets, settings = scene
    row_of = {str(one): k for k, one in enumerate(positioners["id"])}
    target_of = {str(one): k for k, one in enumerate(targets["id"])}
    names = zip(plan["positioner"], plan["target"], strict=True)
    both = [(row_of.get(str(one)), target_of.get(str(other))) for one, other in names]
    known = [i is not None and t is not None for i, t in both]
    used = [one for one, is_known in zip(both, known, strict=True) if is_known]
    xy = np.asarray(targets["x"]) + 1j * np.asarray(targets["y"])
    hidden = np.array(settings["hidden"]).reshape(-1, 3)
    given = plan["side"][known] if "side" in plan.colnames else [""] * len(used)
    poses, fibers, wrong = {}, {}, Counter({"positioner or target that the scene lacks": len(both) - len(used)})
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
    standing = standing_arms(positioners, poses, idle)
    pairs, colliding = collisions(positioners, settings, standing, fibers)
    counted = [(i, t) for i, t in used if i in poses and i not in colliding]
    counts = {
        "assigned": len(used),
        "colliding": sum(i in colliding for i in poses),
        "pairs": len(pairs),
        "missing": missing(positioners, targets, settings, counted),
    }
    observed = [(str(targets["kind"][t]), str(targets["id"][t]), float(targets["priority"][t])) for _, t in counted]
    return counts, observed, wrong


def standing_arms(positioners: Table, poses: dict[int, tuple], idle: bool) -> dict[int, tuple]:
    """Return the poses of all arms that are obstacles: idle arms of equal lengths, if asked, and broken ones."""
    standing = dict(poses)
    arms = np.asarray(positioners["central_arm"]), np.asarray(positioners["eccentric_arm"])
    can_park = np.abs(arms[0] - arms[1]) <= 0.05 * (arms[0] + arms[1])
    for i in np.flatnonzero((can_park & idle) | (np.asarray(positioners["state"]) != "ok")):
        standing.setdefault(int(i), (positioners["theta_parked"][i], positioners["phi_parked"][i]))
    return standing


def collisions(positioners: Table, settings: dict, standing: dict[int, tuple], fibers: dict) -> tuple[set, set]:
    """Return the pairs of rows whose arms collide, and the rows of all arms in a collision with an arm or obstacle."""
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
    return pairs, {i for pair in pairs for i in pair} | hits


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
    parser.add_argument("--ignore-idle", action="store_true", help="arms without a target are no obstacles")
    given = parser.parse_args()
    try:
        scene = read_scene(given.scene)
        for path in given.plans:
            plan = read_plan(path, scene[0])
            print(path, json.dumps(judge(scene, plan, idle=not given.ignore_idle)))
    except (OSError, ValueError) as error:
        parser.error(str(error))


if __name__ == "__main__":
    main()
