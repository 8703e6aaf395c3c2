"""Valid files of plans of every format, and a function that reads, scores and converts them.

A damaged file must be read completely or refused. If it is read, each score and each conversion of the plan must
succeed or be refused with a sentence, and each file that a conversion writes must be read.
"""

import re
import tempfile
import warnings
from contextlib import redirect_stdout
from dataclasses import replace
from io import StringIO
from pathlib import Path

import astropy.units as u
import desi_files
import numpy as np
import pfs_files
from astropy.coordinates import SkyCoord

import rfpsurvey as rs
import sdssv_files
from rfpsurvey import plans
from rfpsurvey._cli.export import convert
from valid_files import Sample, content, count_fits, count_lines

FIELD = SkyCoord(150 * u.deg, -2 * u.deg)
TARGETS = {"confsummary": "a.par", "fiberassign": "a.fits", "pfsdesign": "b.fits", "table": "a.ecsv"}


def plan_samples(folder: Path) -> list[Sample]:
    """Write valid files of plans, and return them."""
    folder = folder / "plans"
    folder.mkdir()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        models = _instruments(folder)
        made = _native(folder, models)
        for name, model in models.items():
            path = folder / f"tile-{name}.{'ecsv' if name == 'pfs' else 'fits'}"
            xy = model.focal_plane.xy[::2]  # every second positioner has a target
            sky = model.projection(FIELD).to_sky(xy + [2, 1] * u.mm)
            ids = [f"star {k}" for k in range(len(xy))] if name == "small" else None
            rs.plan_tile(rs.Catalog(sky, id=ids), model, FIELD).write(path)
            made.append(_sample("tile plan", path, models))
        for sample in list(made):
            path = folder / f"{sample.path.name}.ecsv"
            plans.write_plan(plans.read_plan(sample.path), path)
            made.append(_sample("plan table", path, models))
    return made


def _instruments(folder: Path) -> dict:
    """Return small instruments, whose positioners the plans assign, by the names of the instruments."""
    desi_files.metrology(folder / "fp.csv", per_petal=4)
    sdssv_files.calibration(folder / "calibration")
    pfs = rs.Instrument.preset("pfs")
    table = pfs.focal_plane.to_table()
    table = table[table["id"] <= 60]
    unit = rs.Positioner(8.25 * u.mm, 8.25 * u.mm, 2.25 * u.mm)
    plane = rs.FocalPlane.hexagonal(unit, rings=2, pitch=25.6 * u.mm)
    return {
        "desi": rs.Instrument.from_desi(folder / "fp.csv"),
        "sdss_apo": rs.Instrument.read(folder / "calibration"),
        "pfs": replace(pfs, focal_plane=rs.FocalPlane.from_table(table, positioner=pfs.focal_plane.positioner)),
        "small": rs.Instrument("small", plane, plate_scale=200 * u.mm / u.deg),
    }


def _native(folder: Path, models: dict) -> list[Sample]:
    """Write the files of other programs."""
    desi_files.tile(folder / "desi.fits", per_petal=4)
    n = 61
    motion = np.random.default_rng(3).normal(0, 20, (2, n)).astype("f4")
    more = {"cobraId": np.append(np.arange(1, n), 65533).astype("i4"), "epoch": np.full(n, "J2016.0")}
    more |= {"pmRa": motion[0], "pmDec": motion[1]}
    pfs_files.write_design(folder / "pfs3.fits")
    pfs_files.write_design(folder / "pfs4.fits", pfs_files.design(**more), DAMD_VER=4)
    found = {"fiberassign": ["desi.fits"], "pfsDesign": ["pfs3.fits", "pfs4.fits"]}
    try:
        import pydl  # noqa: F401

        for name in ("sdssv.par", "focal.par.gz"):
            sdssv_files.configuration(folder / name, wok=name == "sdssv.par", change=_without_motion)
        found["confSummary"] = ["sdssv.par", "focal.par.gz"]
    except ImportError:
        pass
    return [_sample(kind, folder / name, models) for kind, names in found.items() for name in names]


def _without_motion(text: str) -> str:
    """Rename the column pmra, because sky positions with one component of the proper motion are refused."""
    return text.replace("float pmra;", "float parallax;")


def _sample(kind: str, path: Path, models: dict) -> Sample:
    text = path.suffix == ".ecsv"
    counts = {"fiberassign": count_fits, "confSummary": count_rows, "plan table": count_lines if text else count_fits}
    count = counts.get(kind, lambda path: None)
    return Sample(kind, path, lambda path: use(path, models), count)


def count_rows(path: Path) -> int:
    """Return the number of rows of the table FIBERMAP."""
    return len(re.findall(rb"(?mi)^\s*FIBERMAP\s", content(path)))


def use(path: Path, models: dict) -> int:
    """Read, score and convert a plan; return the number of its rows and of those of the other tables of its file."""
    plan = plans.read_plan(path)
    model = models.get(plan.meta["instrument"]) if isinstance(plan.meta["instrument"], str) else None
    model = model or models["small"]
    for options in ({}, {"positions": "sky", "missing": "skip"}, {"positions": "sky", "epoch": 2026.5}):
        _attempt(lambda options=options: rs.score_tile(plan, model, **options))
    with tempfile.TemporaryDirectory() as folder, redirect_stdout(StringIO()):
        for kind, name in TARGETS.items():
            target = Path(folder) / name
            if _attempt(lambda target=target, kind=kind: convert(path, target, kind)):
                _read_again(target, kind)
    return len(plan) + sum(len(table) for table in plan.meta.get("extensions", ()))


def _attempt(function) -> bool:
    """Call a function, and return whether it succeeded; errors must be sentences."""
    try:
        function()
    except rs.InputError as error:
        if "\n" in str(error) or len(str(error)) > 1000:
            raise
        return False
    return True


def _read_again(path: Path, kind: str) -> None:
    try:
        plans.read_plan(path, format=kind)
    except rs.InputError as error:
        raise AssertionError(f"the conversion to {kind} wrote a file that cannot be read: {error}") from error
