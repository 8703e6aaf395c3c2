"""Plan scenes with CP-SAT, the constraint solver of OR-tools, without any code of rfpsurvey.

Written for OR-tools 9.15. Install: ``pip install ortools shapely``.

The model has one variable for each triple of a positioner, a target and a side of the elbow. At most one variable of
each positioner and of each target is 1. Variables whose arms are too close to each other exclude each other; the pairs
are found with shapely. The objectives are maximized one after the other, and the values of the objectives before stay
at least as large: the requirements, the science targets of each priority, and, if there are calibration targets, all
targets. One worker searches. ``pairs_s`` is the time to find the candidates and the pairs; it is not part of the time
of the program.
"""

from collections.abc import Callable
from dataclasses import replace
from importlib.metadata import version
from threading import Event, Thread
from time import process_time

import numpy as np
import shapely
from astropy.table import Table, vstack
from judge import EDGE, parts_of, sides_of

try:
    from ortools.sat.python import cp_model
except ImportError as error:
    raise ImportError(f"OR-tools cannot be imported: {error}; install it with: pip install ortools") from error

VERSION = version("ortools")
JOINT = True
SHIFT = 10_000.0
"""Distance (mm) by which the tiles of a scene are separated in the model."""


def side_by_side(scene):
    """Return a scene with several tiles as one plane, on which the tiles lie beside each other.

    The rows of the positioners repeat for each tile; targets keep their identifiers.
    """
    if not scene.n_tiles:
        return scene
    p, t = vstack([scene.positioners] * scene.n_tiles), scene.targets.copy()
    p["x"] = np.asarray(p["x"]) + SHIFT * np.repeat(np.arange(scene.n_tiles), len(scene.positioners))
    t["x"] = np.asarray(t["x"]) + SHIFT * np.asarray(t["tile"])
    fixed = {
        name: [[x + SHIFT * k, y, r] for k in range(scene.n_tiles) for x, y, r in scene.settings[name]]
        for name in ("circles", "hidden")
    }
    polygons = [[[x + SHIFT * k, y] for x, y in q] for k in range(scene.n_tiles) for q in scene.settings["polygons"]]
    if scene.settings["requirements"]:
        raise NotImplementedError("requirements of several tiles are not translated")
    return replace(scene, positioners=p, targets=t, settings={**scene.settings, **fixed, "polygons": polygons})


def candidates(scene) -> dict[str, np.ndarray]:
    """Return the row of the positioner, the row of the target, the side, and the angles (deg) of each candidate."""
    p, t, s = scene.positioners, scene.targets, scene.settings
    center, xy = np.asarray(p["x"]) + 1j * np.asarray(p["y"]), np.asarray(t["x"]) + 1j * np.asarray(t["y"])
    l1, l2 = (np.asarray(p[name], dtype=float) for name in ("central_arm", "eccentric_arm"))
    tree = shapely.STRtree(shapely.points(xy.real, xy.imag))
    i, k = tree.query(shapely.points(center.real, center.imag), predicate="dwithin", distance=l1 + l2 + EDGE)
    hidden = np.array(s["hidden"], dtype=float).reshape(-1, 3)
    dark = np.zeros(len(t), dtype=bool)
    for begin in range(0, len(hidden), 500):
        x, y, radius = hidden[begin : begin + 500].T
        dark |= (abs(xy[:, None] - x - 1j * y) < radius).any(axis=1)
    of_positioner = [set(str(one).split("+")) for one in p["fiber_type"]]
    needed = np.asarray(t["fiber_type"], dtype=str)
    fits = np.array([not needed[b] or needed[b] in of_positioner[a] for a, b in zip(i, k, strict=True)], dtype=bool)
    some = fits & (np.asarray(p["state"])[i] == "ok") & ~dark[k] & (abs(xy[k] - center[i]) >= abs(l1 - l2)[i] - EDGE)
    i, k = i[some], k[some]
    tip, r = xy[k] - center[i], abs(xy[k] - center[i])
    with np.errstate(divide="ignore", invalid="ignore"):
        cosine = np.where(r > 0, np.clip((l1[i] ** 2 + r**2 - l2[i] ** 2) / (2 * l1[i] * r), -1, 1), 1.0)
    found = []
    for side in sides_of(s):
        theta = np.angle(tip) - np.arccos(cosine) * (1 if side == "right" else -1)
        theta = np.where(r > 0, theta, np.deg2rad(np.asarray(p["theta_parked"], dtype=float)[i]))
        phi = np.where(r > 0, np.angle((tip - l1[i] * np.exp(1j * theta)) * np.exp(-1j * theta)), np.pi)
        inside = np.ones(len(i), dtype=bool)
        for joint, angle in (("theta", theta), ("phi", phi)):
            low, high = (np.asarray(p[f"{joint}_{end}"], dtype=float)[i] for end in ("min", "max"))
            turned = np.rad2deg(angle)[:, None] + 360.0 * np.arange(-3, 4)
            within = (turned >= low[:, None] - 1e-6) & (turned <= high[:, None] + 1e-6)
            inside &= within.any(axis=1) | (np.maximum(abs(low), abs(high)) > 1e6)
        columns = i, k, np.full(len(i), side), np.rad2deg(theta), np.rad2deg(phi)
        found.append([column[inside] for column in columns])
    return dict(
        zip(
            ("positioner", "target", "side", "theta", "phi"), map(np.concatenate, zip(*found, strict=True)), strict=True
        )
    )


def parked(scene) -> np.ndarray:
    """Return the rows of the positioners that are obstacles without a target."""
    p = scene.positioners
    l1, l2 = np.asarray(p["central_arm"]), np.asarray(p["eccentric_arm"])
    return np.flatnonzero((abs(l1 - l2) <= 0.05 * (l1 + l2)) | (np.asarray(p["state"]) != "ok"))


def pairs(scene, found: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the pairs of poses that exclude each other, and the poses that touch an obstacle.

    Poses are the candidates, and after them the parked arms.
    """
    p, t, s = scene.positioners, scene.targets, scene.settings
    idle = parked(scene)
    of = np.concatenate([found["positioner"], idle])
    poses = zip(found["positioner"], found["target"], found["theta"], found["phi"], strict=True)
    rows = [dict(zip(p.colnames, row, strict=True)) for row in p]
    parts = [parts_of(rows[i], s, theta, phi, str(t["fiber_type"][k])) for i, k, theta, phi in poses]
    parts += [parts_of(rows[i], s, rows[i]["theta_parked"], rows[i]["phi_parked"], "") for i in idle]
    pose = np.repeat(np.arange(len(parts)), [len(some) for some in parts])
    shapes, radii, eccentric = (
        np.array(column) for column in zip(*(one for some in parts for one in some), strict=True)
    )
    limit = s["min_separation"]
    tree, close = shapely.STRtree(shapes), []
    for begin in range(0, len(shapes), 5000):
        a, b = tree.query(shapes[begin : begin + 5000], predicate="dwithin", distance=limit + 2 * radii.max())
        a += begin
        some = (pose[a] < pose[b]) & (of[pose[a]] != of[pose[b]]) & (eccentric[a] | eccentric[b])
        a, b = a[some], b[some]
        nearest, reach = shapely.distance(shapes[a], shapes[b]), limit + radii[a] + radii[b]
        near = (nearest < reach) | ((reach == 0) & (nearest == 0))
        close.append(np.unique(np.column_stack([pose[a[near]], pose[b[near]]]), axis=0))
    both = np.unique(np.concatenate(close), axis=0)
    hit = np.zeros(len(parts), dtype=bool)
    fixed = [(shapely.Point(x, y), r) for x, y, r in s["circles"]] + [(shapely.Polygon(q), 0.0) for q in s["polygons"]]
    for shape, radius in fixed:
        near = shapely.distance(shapes, shape) - radius - radii < s["clearance"]
        hit[pose[near & eccentric]] = True
    return both[:, 0], both[:, 1], hit


def objectives(scene, found: dict[str, np.ndarray], x: list, model) -> list:
    """Return the objectives, in order of importance; requirements add variables to the model."""
    p, t = scene.positioners, scene.targets
    kind, category, needed = (np.asarray(t[name], dtype=str) for name in ("kind", "category", "fiber_type"))
    k, where = found["target"], np.asarray(p["spectrograph"])[found["positioner"]]
    met = []
    for one in scene.settings["requirements"]:
        counts = (kind[k] == one["what"]) | (category[k] == one["what"])
        counts &= (needed[k] == one["fiber_type"]) | (one["fiber_type"] == "")
        for place in np.unique(p["spectrograph"]) if one["per"] == "spectrograph" else [None]:
            some = counts if place is None else counts & (where == place)
            total = sum(x[c] for c in np.flatnonzero(some))
            if one["maximum"] is not None:
                model.add(total <= one["maximum"])
            met.append(model.new_int_var(0, one["minimum"], ""))
            model.add(met[-1] <= total)
    goals = [sum(met)] if met else []
    science = kind[k] == "science"
    priority = np.asarray(t["priority"], dtype=float)[k]
    for one in sorted(set(priority[science]), reverse=True):
        goals.append(sum(x[c] for c in np.flatnonzero(science & (priority == one))))
    return goals if science.all() else [*goals, sum(x)]


def build(scene, found: dict[str, np.ndarray], close: tuple) -> tuple:
    """Return the model, its variables and its objectives."""
    model, n = cp_model.CpModel(), len(found["target"])
    a, b, hit = close
    x = [model.new_bool_var("") for _ in range(n)]
    names, same = np.unique(np.asarray(scene.targets["id"]), return_inverse=True)  # one target, in any tile
    rows = {"positioner": found["positioner"], "target": same[found["target"]]}
    of = {"positioner": [[] for _ in scene.positioners], "target": [[] for _ in names]}
    for name, some in of.items():
        for c, row in enumerate(rows[name]):
            some[row].append(x[c])
        for one in some:
            if len(one) > 1:
                model.add_at_most_one(one)
    for c in np.flatnonzero(hit[:n]):
        model.add(x[c] == 0)
    idle = parked(scene)
    excluded: dict[tuple[int, int], list] = {}
    for c, d in zip(a.tolist(), b.tolist(), strict=True):
        if d >= n:  # a parked arm: its positioner has to move
            if c < n:
                model.add(x[c] <= sum(of["positioner"][idle[d - n]]))
        else:
            excluded.setdefault((c, int(found["positioner"][d])), []).append(x[d])
    for (c, _), others in excluded.items():
        model.add_at_most_one([x[c], *others])
    return model, x, objectives(scene, found, x, model)


def search(model, seconds: float) -> tuple:
    """Return the solver and its status after a search that takes at most the given processor time."""
    solver, end, done = cp_model.CpSolver(), process_time() + seconds, Event()
    solver.parameters.num_workers = 1

    def watch() -> None:
        while not done.wait(0.02):
            if process_time() > end:
                solver.stop_search()

    watcher = Thread(target=watch)
    watcher.start()
    status = solver.solve(model)
    done.set()
    watcher.join()
    return solver, status in (cp_model.OPTIMAL, cp_model.FEASIBLE)


def maximize(model, x: list, goals: list, seconds: float) -> tuple[np.ndarray, list[tuple[int, int]]]:
    """Return the chosen variables, and the value and the bound of each objective."""
    end, chosen, levels = process_time() + seconds, np.zeros(len(x), dtype=bool), []
    for level, goal in enumerate(goals):
        model.maximize(goal)
        solver, found = search(model, (end - process_time()) / (len(goals) - level))
        if not found:
            solver, found = search(model, end - process_time())
        if not found:
            break
        chosen = np.array([solver.boolean_value(one) for one in x], dtype=bool)
        levels.append((round(solver.objective_value), round(solver.best_objective_bound)))
        model.add(goal >= levels[-1][0])
        model.clear_hints()
        for one, value in zip(x, chosen.tolist(), strict=True):
            model.add_hint(one, value)
    return chosen, levels


def plan(scene, seconds: float, *, pairs: Callable = pairs) -> tuple[Table, float, dict]:
    """Return the plan of a scene, the processor time (s) without the pairs, and facts about the search."""
    n = len(scene.positioners)
    scene = side_by_side(scene)
    begin = process_time()
    found = candidates(scene)
    close = pairs(scene, found)
    middle = process_time()
    chosen, levels = maximize(*build(scene, found, close), seconds)
    spent = process_time() - middle
    rows = np.flatnonzero(chosen)
    table = Table(
        {
            "positioner": np.asarray(scene.positioners["id"])[found["positioner"][rows]],
            "target": np.asarray(scene.targets["id"])[found["target"][rows]],
            "side": found["side"][rows],
        }
    )
    if "tile" in scene.targets.colnames:
        table["tile"] = found["positioner"][rows] // n
    unproven = max((bound - value for value, bound in levels), default=0)
    facts = {"gap": f"{unproven} targets" if unproven else "0", "pairs_s": middle - begin, "levels": levels}
    return table, spent, facts


PLANS = {"CP-SAT": plan}
"""Label and function of each setting."""
