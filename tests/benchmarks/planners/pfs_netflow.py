"""Plan scenes of PFS with netflow, the planner of PFS, which builds an integer program; HiGHS solves the program.

Written for netflow (ets_fiber_assigner) 3.8.0 and cobraOps 2.0.7. Install https://github.com/Subaru-PFS/ets_fiberalloc
with ``pip install --no-deps``, add ``python`` of https://github.com/Subaru-PFS/ics_cobraOps to ``PYTHONPATH``, and
``pip install pulp highspy pandas``.

netflow takes the cobras from cobraCharmer, which needs the files of the instrument; small stand-ins give it the
cobras of the scene instead, with the same elbows. Rules: two tips, or a tip and an outer arm, are at least as far
apart as the separation, and targets in dots are left out. One target of a class costs 100 times as much as one of the
next class, and calibration targets cost most. A target with some of its visits costs more than any number of targets
without a visit. Switched off, because the scenes have nothing of the kind: fiducials, broken cobras, groups of sky
fibers, and costs of moves and dots. PuLP's call of the solver CBC is replaced by a call of HiGHS with one thread and no
allowed gap. ``pairs_s`` is the time in which netflow builds the program; it is not part of the time of the program.
``bound`` is an upper bound of the number of targets with all their visits, if there is one class.
"""

import contextlib
import io
import sys
from importlib.metadata import version
from time import process_time
from types import ModuleType, SimpleNamespace

import numpy as np
from astropy.table import Table

try:
    import pandas
    import pulp
    from ets_fiber_assigner import netflow

    stand_in = ModuleType("ics.cobraCharmer.cobraCoach")
    stand_in.engineer = None
    sys.modules.setdefault("ics.cobraCharmer", ModuleType("ics.cobraCharmer"))
    sys.modules.setdefault("ics.cobraCharmer.cobraCoach", stand_in)
    from ics.cobraOps.Bench import Bench
except ImportError as error:
    raise ImportError(f"netflow, cobraOps or PuLP cannot be imported: {error}") from error

VERSION = version("ets_fiber_assigner")
EXPOSURE = 900.0
"""Time of a visit (s)."""
CALIBRATION = 1e6
"""Cost of a calibration target that is missing."""
MOST_CLASSES, MOST_CLASSES_RULES = 5, 3
"""Maximum numbers of priority classes without and with calibration targets.

With more classes, targets of the highest class cost more than an observation that is not complete (1e9), or than a
calibration target that is missing.
"""


class Pfi:
    """Angles and elbows of cobras, given by their rows."""

    def __init__(self, center: np.ndarray, l1: np.ndarray, l2: np.ndarray, sign: float) -> None:
        self.center, self.l1, self.l2, self.sign = center, l1, l2, sign

    def positionsToAngles(self, rows: np.ndarray, tips: np.ndarray) -> tuple:
        """Return theta of one side, twice; phi is not used."""
        tip, l1, l2 = tips - self.center[rows], self.l1[rows], self.l2[rows]
        r = np.maximum(abs(tip), 1e-9)
        theta = np.angle(tip) - self.sign * np.arccos(np.clip((l1**2 + r**2 - l2**2) / (2 * l1 * r), -1, 1))
        both = np.column_stack([theta, theta])
        return both, np.zeros_like(both), None

    def anglesToElbowPositions(self, rows: np.ndarray, theta: np.ndarray) -> np.ndarray:
        """Return the positions of the elbows."""
        return self.center[rows] + self.l1[rows] * np.exp(1j * theta)


def bench_of(scene) -> "Bench":
    """Return the bench of cobras of a scene."""
    p, n = scene.positioners, len(scene.positioners)
    center = np.asarray(p["x"]) + 1j * np.asarray(p["y"])
    l1, l2 = (np.asarray(p[name], dtype=float) for name in ("central_arm", "eccentric_arm"))
    cobras = SimpleNamespace(
        centers=center,
        status=np.ones(n, dtype=int),
        tht0=np.zeros(n),
        tht1=np.zeros(n),
        phiIn=np.full(n, -np.pi),
        phiOut=np.zeros(n),
        L1=l1,
        L2=l2,
    )
    hidden = np.array(scene.settings["hidden"], dtype=float).reshape(-1, 3)
    dots = SimpleNamespace(nBlackDots=len(hidden), centers=hidden[:, 0] + 1j * hidden[:, 1], radius=hidden[:, 2])
    coach = SimpleNamespace(
        calibModel=cobras,
        goodIdx=np.arange(n),
        allCobras=np.arange(n),
        pfi=Pfi(center, l1, l2, 1.0 if scene.settings["handedness"] == "right" else -1.0),
    )
    return Bench(coach, dots, fiducials=pandas.DataFrame({"x_mm": [], "y_mm": []}, dtype=float))


def plan(scene, seconds: float, visits: np.ndarray | None = None, exposures: int = 1) -> tuple[Table, float, dict]:
    """Return the plan of a scene, the processor time (s) of the solver, and facts about the search.

    Without ``visits``, each target requires one visit.
    """
    p, t, s = scene.positioners, scene.targets, scene.settings
    free = (np.asarray(p["theta_max"]) - p["theta_min"] >= 360).all() and (np.asarray(p["phi_max"]) > 1e6).all()
    if s["shape"] != "segment" or s["length"] is not None or s["circles"] or s["polygons"] or s["handedness"] == "both":
        raise NotImplementedError("netflow models arms as segments to the fiber, on one side, without obstacles")
    if not free or set(p["state"]) != {"ok"} or set(t["fiber_type"]) != {""}:
        raise NotImplementedError("limits of joints, broken positioners and fiber types are not translated")
    if any(one["per"] != "tile" or one["what"] not in ("sky", "standard") for one in s["requirements"]):
        raise NotImplementedError("numbers of targets per spectrograph or category are not translated")
    kinds, priority = np.asarray(t["kind"], dtype=str), np.asarray(t["priority"], dtype=float)
    classes = sorted(set(priority[kinds == "science"]))
    most = MOST_CLASSES_RULES if s["requirements"] else MOST_CLASSES
    if len(classes) > most:
        raise NotImplementedError(f"the number of priority classes must be at most {most}, got {len(classes)}")
    costs = {f"{k}_P{k}": 10.0 * 100.0**k for k in range(len(classes))}  # netflow uses two characters in names
    costs = {
        name: {"nonObservationCost": c, "partialObservationCost": 1e9, "calib": False} for name, c in costs.items()
    }
    for one in s["requirements"]:
        costs[one["what"]] = {"numRequired": one["minimum"], "nonObservationCost": CALIBRATION, "calib": True}
    rows = [k for k in range(len(t)) if kinds[k] == "science" or kinds[k] in costs]
    needed = np.ones(len(t)) if visits is None else visits
    wanted = [
        netflow.ScienceTarget(k, 0, 0, EXPOSURE * needed[k], level := classes.index(priority[k]), level)
        if kinds[k] == "science"
        else netflow.CalibTarget(k, 0, 0, kinds[k])
        for k in rows
    ]
    xy = np.asarray(t["x"])[rows] + 1j * np.asarray(t["y"])[rows]
    begin = process_time()
    with contextlib.redirect_stdout(io.StringIO()):
        problem = netflow.buildProblem(
            bench_of(scene),
            wanted,
            [xy] * exposures,
            costs,
            EXPOSURE,
            collision_distance=s["min_separation"],
            gurobi=False,
            fiberNonAllocationCost=0.1 if s["requirements"] else 0.0,
            avoidFiducials=False,
        )
    middle = process_time()
    model = problem._prob
    model += problem.cost
    for one in problem._constr:
        model += one
    model.solve(pulp.HiGHS(msg=False, threads=1, timeLimit=seconds, gapRel=0.0))
    spent = process_time() - middle
    used = [
        [int(row) for row in name.split("_")[2:]]
        for name, x in problem._vardict.items()
        if name.startswith("Tv_Cv_") and x.value() > 0.5
    ]
    row, cobra, exposure = np.reshape(used, (-1, 3)).T.astype(int)
    columns = np.asarray(p["id"])[cobra], np.asarray(t["id"])[np.array(rows)[row]], exposure
    facts = {"gap": "0" if model.sol_status == pulp.LpSolutionOptimal else "", "pairs_s": middle - begin}
    if set(costs) == {"0_P0"}:
        unfinished = max(model.solverModel.getInfo().mip_dual_bound, 0.0) / costs["0_P0"]["nonObservationCost"]
        in_reach = sum(name.startswith("STC_T_") for name in problem._vardict)
        facts["bound"] = int(np.floor(in_reach - unfinished + 1e-4))
    return Table(columns, names=("positioner", "target", "exposure")), spent, facts


PLANS = {"netflow": plan}
"""Label and function of each setting."""
