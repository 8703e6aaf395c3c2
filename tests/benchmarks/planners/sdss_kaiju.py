"""Plan scenes of SDSS-V with CP-SAT and the collisions that kaiju finds; kaiju itself does not choose targets.

Written for kaiju 1.4.2a0 and OR-tools 9.15. Install https://github.com/sdss/kaiju with ``pip install --no-deps .``,
and its requirements. The build downloads two files of coordio; the source archive of sdss-coordio has them, too.

The model is that of ``cpsat.py``; ``sdss_robostrategy.py`` runs robostrategy, which plans SDSS-V. kaiju is asked about
each pair of poses whose collision segments are nearer than 0.1 mm more than the separation, as found with shapely;
kaiju's paths of the arms are not used. ``pairs_s`` is the time to find the candidates and the pairs; it is not part of
the time of the program.
"""

from importlib.metadata import version

import cpsat
import numpy as np
import shapely
from astropy.table import Table
from judge import parts_of

try:
    from kaiju.cKaiju import RobotGrid
except ImportError as error:
    raise ImportError(f"kaiju cannot be imported: {error}") from error

VERSION = f"{version('sdss-kaiju')}, OR-tools {cpsat.VERSION}"
STEP = 0.1
"""Step of the joints (deg) of the grid, which matters for paths only."""


def grid_of(scene) -> "RobotGrid":
    """Return the grid of robots and fiducials of a scene, on a flat focal plane."""
    p, s = scene.positioners, scene.settings
    grid = RobotGrid(STEP)
    for i, row in enumerate(p):
        length = float(s["length"] or row["eccentric_arm"])
        fiber = [float(row["eccentric_arm"]), 0.0]
        center, axes = [float(row["x"]), float(row["y"]), 0.0], np.eye(3).tolist()
        segment = [[0.0, 0.0], [length, 0.0]]
        arm, height, lefthanded = float(row["central_arm"]), 143.0, s["handedness"] == "left"
        grid.addRobot(
            i, str(i), center, *axes, [0.0, 0.0, 0.0], arm, 0.0, 0.0, height, 1.0, fiber, fiber, fiber, segment, True,
            s["clearance"], lefthanded,
        )  # fmt: skip
    for k, (x, y, radius) in enumerate(s["circles"]):
        grid.addFiducial(k, [x, y, height], radius)
    grid.maxDisplacement = s["min_separation"] - 2 * s["clearance"]
    grid.initGrid()
    return grid


def pairs(scene, found: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the pairs of poses that exclude each other by kaiju, and the poses that touch a fiducial."""
    p, t, s = scene.positioners, scene.targets, scene.settings
    grid, idle = grid_of(scene), cpsat.parked(scene)
    rows = [dict(zip(p.colnames, row, strict=True)) for row in p]
    of = np.concatenate([found["positioner"], idle])
    parked = np.column_stack([p["theta_parked"], p["phi_parked"]]).astype(float)
    angles = np.concatenate([np.column_stack([found["theta"], found["phi"]]), parked[idle]])
    needed = [str(t["fiber_type"][k]) for k in found["target"]] + [""] * len(idle)
    for k, i in enumerate(of):  # the angle of the segment instead of that of the fiber
        used = needed[k] or str(rows[i]["fiber_type"]).split("+")[0]
        angles[k, 1] += s["angle"].get(used, s["angle"].get("", 0.0))
    free = {**s, "angle": {}}
    shapes = np.array([parts_of(rows[i], free, *pose, "")[0][0] for i, pose in zip(of, angles, strict=True)])
    robots = [grid.robotDict[i] for i in range(len(p))]
    hit, tree = np.zeros(len(of), dtype=bool), shapely.STRtree(shapes)
    both = []
    for k, (i, (theta, phi)) in enumerate(zip(of.tolist(), angles.tolist(), strict=True)):
        near = tree.query(shapes[k], predicate="dwithin", distance=s["min_separation"] + 0.1)
        robots[i].setAlphaBeta(theta % 360, phi % 360)
        hit[k] = bool(grid.fiducialColliders(i))
        for n in near[(near > k) & (of[near] != i)].tolist():
            j = int(of[n])
            robots[j].setAlphaBeta(angles[n, 0] % 360, angles[n, 1] % 360)
            if j in grid.robotColliders(i):
                both.append((k, n))
    a, b = np.array(both, dtype=int).reshape(-1, 2).T
    return a, b, hit


def plan(scene, seconds: float) -> tuple[Table, float, dict]:
    """Return the plan of a scene, the processor time (s) without the pairs, and facts about the search."""
    s = scene.settings
    if s["shape"] != "segment" or s["length"] is None or s["polygons"]:
        raise NotImplementedError("only positioners of SDSS-V are translated for kaiju")
    return cpsat.plan(scene, seconds, pairs=pairs)


PLANS = {"CP-SAT, kaiju": plan}
"""Label and function of each setting."""
