"""Plan fields of SDSS-V with robostrategy, the planner of SDSS-V: one exposure, with the robots of the scene.

Written for robostrategy 1.6.11dev of February 2025, roboscheduler of the same time, mugatu 2.6.1 and kaiju 1.4.2a0.
Install kaiju as for ``sdss_kaiju.py``, https://github.com/sdss/roboscheduler in the same way, and OR-tools, and ``pip
install --no-deps sdss-mugatu``. Set ``ROBOSTRATEGY_DIR`` to a copy of https://github.com/sdss/robostrategy, and add its
folder ``python`` to ``PYTHONPATH``.

``Field.assign_science_and_calibs`` assigns the targets priority by priority, and reserves fibers for sky positions and
standards. The grid of robots is that of the scene instead of the grid as built, and positions are those of the scene.
Small stand-ins replace what needs the network or the observatory: the databases, the versions of calibrations, the time
of observation, and the names that recent versions of numpy lack. Switched off, because the scenes have nothing of the
kind: magnitudes, bright neighbors, offsets, several exposures, and zones of standards. ``pairs_s`` is the time in which
the targets in reach of each robot are listed; it is not part of the time of the program.
"""

import contextlib
import io
import os
import sys
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from time import process_time
from types import SimpleNamespace
from unittest.mock import MagicMock

import numpy as np
from astropy.table import Table

for name in ("kaiju", "mugatu", "roboscheduler", "robostrategy"):
    if find_spec(name) is None:
        raise ImportError(f"robostrategy cannot be imported: {name} is not installed")
for name in (
    *("sdssdb", "sdssdb.peewee", "sdssdb.peewee.sdss5db"),
    *(f"sdssdb.peewee.sdss5db.{one}" for one in ("targetdb", "catalogdb", "opsdb")),
    *("fps_calibrations", "sdss_access", "sdss_access.path", "PyAstronomy", "PyAstronomy.pyasl"),
):
    sys.modules.setdefault(name, MagicMock(__name__=name))
vars(np).update(unicode_=np.str_, compat=SimpleNamespace(unicode=str))
try:
    import mugatu.designmode
    from kaiju.cKaiju import RobotGrid
    from kaiju.robotGrid import RobotGrid as PythonGrid
    from robostrategy import __version__ as release
    from robostrategy import field
except ImportError as error:
    raise ImportError(f"robostrategy cannot be imported: {error}") from error

VERSION = f"{release}, kaiju {version('sdss-kaiju')}"
CADENCE = "one_exposure"
HEIGHT = 143.0


def grid_of(scene) -> PythonGrid:
    """Return the grid of robots of a scene: segments from the elbow on, fibers beside the segments."""
    s, grid = scene.settings, PythonGrid(stepSize=0.05)
    segment, axes = [[0.0, 0.0], [float(s["length"]), 0.0]], np.eye(3).tolist()
    for i, row in enumerate(scene.positioners, 1):
        places = {}
        for name, angle in s["angle"].items():
            place = float(row["eccentric_arm"]) * np.exp(-1j * np.deg2rad(angle))
            places[name] = [place.real, place.imag]
        center, arm = [float(row["x"]), float(row["y"]), 0.0], float(row["central_arm"])
        has_apogee, left = "APOGEE" in str(row["fiber_type"]).split("+"), s["handedness"] == "left"
        RobotGrid.addRobot(
            grid, i, str(row["id"]), center, *axes, [0.0, 0.0, 0.0], arm, 0.0, 0.0, HEIGHT, 1.0, [14.0, 0.0],
            places["BOSS"], places["APOGEE"], segment, has_apogee, s["clearance"], left,
        )  # fmt: skip
    for k, (x, y, radius) in enumerate(s["circles"]):
        grid.addFiducial(k, [x, y, HEIGHT], radius)
    grid.maxDisplacement = s["min_separation"] - 2 * s["clearance"]
    grid.initGrid()
    for robot in grid.robotDict:
        grid.homeRobot(robot)
    return grid


class SceneField(field.Field):
    """The field of a scene, whose positions are known."""

    def __init__(self, scene) -> None:
        self.scene = scene
        super().__init__(racen=0.0, deccen=0.0, observatory="apo", bright_neighbors=False, nooffset=True)

    def _robotGrid(self) -> PythonGrid:
        grid = grid_of(self.scene)
        self.robotHasApogee = np.array([one.hasApogee for one in grid.robotDict.values()], dtype=bool)
        return grid

    def radec2xyz(self, ra: np.ndarray, **_) -> tuple:
        """Return the positions of the targets of the scene; right ascensions are not used."""
        t, n = self.scene.targets, len(ra)
        return np.asarray(t["x"], dtype=float)[:n], np.asarray(t["y"], dtype=float)[:n], np.full(n, HEIGHT)

    def xy2radec(self, x: np.ndarray, **_) -> tuple:
        """Return zeros: directions are not used."""
        return np.zeros(np.shape(x)), np.zeros(np.shape(x))


def targets_of(scene) -> np.ndarray:
    """Return the targets of a scene; small priorities are important."""
    t = scene.targets
    kind, fiber = np.asarray(t["kind"], dtype=str), np.asarray(t["fiber_type"], dtype=str)
    found = np.zeros(len(t), dtype=field.targets_dtype)
    found["rsid"] = found["catalogid"] = np.arange(1, len(t) + 1)
    found["priority"] = np.unique(-np.asarray(t["priority"], dtype=float), return_inverse=True)[1] + 1
    found["category"] = [f"{k}_{f.lower()}" if k != "science" else k for k, f in zip(kind, fiber, strict=True)]
    found["fiberType"], found["cadence"], found["stage"], found["value"] = fiber, CADENCE, "srd", 1.0
    found["lambda_eff"] = np.where(fiber == "APOGEE", 16000.0, 5400.0)
    return found


def field_of(scene) -> SceneField:
    """Return a field with one exposure and the required numbers of a scene, before the targets are given."""
    field.coordio.time.Time = field.obstime.ObsTime = MagicMock()
    found = SceneField(scene)
    modes = Path(os.environ.get("ROBOSTRATEGY_DIR", ".")) / "data" / "default_designmodes.fits"
    found.designModeDict = mugatu.designmode.allDesignModes(filename=str(modes))
    limits = {"delta": [-1.0], "delta_min": [-1.0], "delta_max": [-1.0], "max_length": [1e7], "max_airmass": [1.6]}
    limits |= {"min_moon_sep": [35.0], "min_deltav_ks91": [-1.5], "min_twilight_ang": [15.0]}
    field.clist.add_cadence(
        name=CADENCE, nepochs=1, nexp=[1], skybrightness=[0.35], obsmode_pk=["dark_faint"], **limits
    )
    found.set_field_cadence(CADENCE)
    for numbers in found.required_calibrations.values():
        numbers[:] = 0
    for one in scene.settings["requirements"]:
        name = one["what"] if "_" in one["what"] else f"{one['what']}_{one['fiber_type'].lower()}"
        found.required_calibrations[name][:] = one["minimum"]
        found.achievable_calibrations[name][:] = one["minimum"]
    return found


def plan(scene, seconds: float) -> tuple[Table, float, dict]:
    """Return the plan of a scene, the processor time (s) of the assignment, and facts about it."""
    p, t, s = scene.positioners, scene.targets, scene.settings
    if s["shape"] != "segment" or s["length"] is None or set(s["angle"]) != {"BOSS", "APOGEE"}:
        raise NotImplementedError("only positioners of SDSS-V are translated for robostrategy")
    if set(p["state"]) != {"ok"} or not set(t["fiber_type"]) <= {"BOSS", "APOGEE"}:
        raise NotImplementedError("broken positioners and targets of any fiber type are not translated")
    begin = process_time()
    with contextlib.redirect_stdout(io.StringIO()):
        found = field_of(scene)
        found.targets_fromarray(targets_of(scene))
        middle = process_time()
        found.assign_science_and_calibs()
    spent = process_time() - middle
    robots = np.asarray(found.assignments["robotID"]).reshape(len(t), -1)[:, 0]
    rows = np.flatnonzero(robots > 0)
    plan = Table({"positioner": np.asarray(p["id"])[robots[rows] - 1], "target": np.asarray(t["id"])[rows]})
    return plan, spent, {"pairs_s": middle - begin}


PLANS = {"robostrategy": plan}
"""Label and function of each setting."""
