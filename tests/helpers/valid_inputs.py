"""Valid inputs other than catalogs and plans: calibrations, descriptions, states, conditions, tiles and checkpoints."""

import csv
import hashlib
import re
import subprocess
import warnings
from contextlib import suppress
from pathlib import Path

import astropy.units as u
import desi_files
import numpy as np
import pfs_files
from astropy.coordinates import SkyCoord
from astropy.table import Table
from own_instrument import description

import rfpsurvey as rs
import sdssv_files
from rfpsurvey._survey.selection import run as _folder
from rfpsurvey._survey.tiling.columns import times_of_tiles
from rfpsurvey.design import explore_designs
from valid_files import CENTER, Sample

PRESETS = Path(rs.__file__).parent / "presets"
TABLE = description(
    (8.25, 8.25),
    2.25,
    'table = { value = "plane.ecsv" }\nstates = { value = "states.csv" }',
    'plate_scale = { value = 200.0, unit = "mm / deg" }',
)
HEIR = """
inherits = "table"
name = "heir"
status = "assumed"
source = "test"
layout.states.value = [{ id = 3, state = "stuck", theta = 20, phi = 90 }]
"""
CONDITIONS = """
site = [-105.82, 32.78, 2788.0]
time = "2026-07-01T06:30:00"
wavelength = { BOSS = "0.54 um", APOGEE = "1.6 um" }
guide_wavelength = "0.62 um"
pressure = "720 hPa"
temperature = "5 deg_C"
humidity = 0.2
exposure_time = "900 s"
"""
STATES = {
    "id": np.arange(1, 13),
    "state": ["broken", "stuck", "ok"] * 4,
    "from": ["2026-01-01", "", "2026-02-01T12:00:00"] * 4,
    "to": ["2027-01-01", "", ""] * 4,
    "theta": [np.nan, 20.5, np.nan] * 4,
    "phi": [np.nan, 91.25, np.nan] * 4,
}
SCAN = {"central_arm": [8, 9] * u.mm, "ratio": [1, 1.5], "pitch": 25.6 * u.mm, "clearance": [1.5, 2.5] * u.mm}
SEARCH = rs.JointOptions(iterations=2, patch_size=40)


class StopError(Exception):
    """An error that ends a computation, so that its checkpoints remain."""


def inputs(folder: Path) -> list[Sample]:
    """Write valid inputs to a folder, and return them."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        small = _small()
        return [
            *_calibrations(folder),
            *_descriptions(folder, small),
            *_tables(folder, small),
            *_checkpoints(folder, small),
        ]


def _sample(kind, path, read, pieces=(), repair=lambda path: None) -> Sample:
    """Return a sample whose rows are not counted; its reader fails with an error unless all values are valid."""

    def read_all(path):
        read(path)
        return 0

    return Sample(kind, path, read_all, lambda path: None, tuple(pieces), repair)


def _small() -> rs.Instrument:
    unit = rs.Positioner(8.25 * u.mm, 8.25 * u.mm, 2.25 * u.mm)
    plane = rs.FocalPlane.hexagonal(unit, rings=3, pitch=25.6 * u.mm)
    return rs.Instrument("small", plane, plate_scale=200 * u.mm / u.deg)


def _names(folder: Path) -> list[str]:
    return sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())


def _calibrations(folder: Path) -> list[Sample]:
    sdssv, pfs = sdssv_files.calibration(folder / "sdssv"), folder / "pfs"
    pfs.mkdir()
    pfs_files.write_cobras(pfs / "cobras.xml", pfs_files.cobra_columns())
    pfs_files.write_files(pfs)
    made = [_sample("SDSS-V", sdssv, rs.Instrument.read, _names(sdssv)), _sample("PFS", pfs, _read, _names(pfs))]
    for name, ending in (("desi", "json"), ("desi-yaml", "yaml")):
        desi = folder / name
        desi.mkdir()
        plane = desi_files.focal_plane(desi / "desi-focalplane_2020-01-01T00:00:00.ecsv", per_petal=9)
        event = {"TIME": "2021-01-01T00:00:00", "LOCATION": plane["LOCATION"][3], "STATE": 2, "POS_T": 20.0}
        desi_files.state(desi / "desi-state_2020-01-01T00:00:00.ecsv", plane, [event])
        desi_files.exclusions(desi / f"desi-exclusion_2020-01-01T00:00:00.{ending}")
        made.append(_sample("DESI", desi, _read, _names(desi)))
    metrology = folder / "fp-metrology.csv"
    desi_files.metrology(metrology, per_petal=9)
    return [*made, _sample("DESI", metrology, _read), _sample("ray trace", _ray_trace(folder), _read_ray_trace)]


def _read(path: Path) -> None:
    found = rs.Instrument.read(path, time="2026-07-01")
    found.provenance, found.field_radius  # noqa: B018  (computed from all values)


def _read_ray_trace(path: Path) -> None:
    rs.projection.DistortionMap.from_ray_trace(path, degree=3, harmonics=1)


def _ray_trace(folder: Path) -> Path:
    path, rows = folder / "ray-trace.csv", []
    for angle in (-90, -30, 0):
        for x, y in np.random.default_rng(3).uniform(-0.02, 0.02, (40, 2)).tolist():
            rows.append((angle, -angle, x, y, 13000 * x + angle / 100, 13000 * y - angle / 90))
    Table(rows=rows, names=["ADC1", "ADC2", "X_TAN", "Y_TAN", "X_FP", "Y_FP"]).write(path, format="ascii.csv")
    return path


def _descriptions(folder: Path, small: rs.Instrument) -> list[Sample]:
    made = []
    for preset in sorted(PRESETS.glob("*.toml")):
        path = folder / f"my_{preset.name}"
        path.write_text(re.sub(r"rings = \{ value = \d+", "rings = { value = 13", preset.read_text()))
        with suppress(rs.InputError):  # the names of cobras require all rings
            _read(path)
            made.append(_sample("instrument", path, _read))
    own = folder / "own"
    own.mkdir()
    small.focal_plane.to_table().write(own / "plane.ecsv")
    _states_table().write(own / "states.csv", format="ascii.csv")
    (own / "table.toml").write_text(TABLE)
    (own / "heir.toml").write_text(HEIR)
    made.append(_sample("instrument", own, lambda path: _read(path / "heir.toml"), _names(own)))
    made.append(_sample("instrument", own, lambda path: _read(path / "table.toml"), _names(own)))
    (folder / "conditions.toml").write_text(CONDITIONS)
    return [*made, _sample("conditions", folder / "conditions.toml", _read_conditions)]


def _read_conditions(path: Path) -> None:
    found = rs.ObservingConditions.read(path)
    repr(found), found.record


def _states_table() -> Table:
    table = Table(STATES)
    for name in ("theta", "phi"):
        table[name] = np.ma.masked_invalid(table[name])
    return table


def _tables(folder: Path, small: rs.Instrument) -> list[Sample]:
    """Return tables of states and of tiles in several formats."""
    made = []

    def read_states(path):
        small.with_states(path, time="2026-07-01").provenance  # noqa: B018

    def read_tiles(path):
        found = rs.Tiling.read(path).with_conditions(rs.ObservingConditions("apache point", hour_angle=0 * u.hourangle))
        times_of_tiles(found)
        repr(found), found.conditions

    tiles = Table({"tile": [f"t{k}" for k in range(20)], "ra": np.linspace(94, 96, 20), "dec": np.linspace(22, 24, 20)})
    tiles["ra"].unit = tiles["dec"].unit = "deg"
    tiles["pass"] = np.arange(20) // 10
    tiles["time"] = ["2026-07-01T06:30:00"] * 20
    for ending, kind in (("csv", "ascii.csv"), ("ecsv", "ascii.ecsv"), ("fits", "fits"), ("vot", "votable")):
        _states_table().write(folder / f"states.{ending}", format=kind)
        tiles.write(folder / f"tiles.{ending}", format=kind)
        made.append(_sample("states", folder / f"states.{ending}", read_states))
        made.append(_sample("tiles", folder / f"tiles.{ending}", read_tiles))
    return made


def _checkpoints(folder: Path, small: rs.Instrument) -> list[Sample]:
    """Return finished and unfinished results: a design scan, surveys and selection probabilities."""
    made = []
    for ending in ("ecsv", "fits"):
        path = folder / f"scan.{ending}"
        explore_designs(**SCAN, n_designs=6, path=path)
        made.append(_sample("scan", path, lambda path: explore_designs(**SCAN, n_designs=6, path=path, resume=True)))
    rng = np.random.default_rng(5)
    sky = CENTER.spherical_offsets_by(*rng.uniform(-0.4, 0.4, (2, 90)) * u.deg)
    catalog = rs.Catalog(sky, id=np.arange(90), priority=rng.integers(1, 3, 90), visits=rng.integers(0, 3, 90))
    tiles = SkyCoord([94.9, 95.1, 95.0] * u.deg, [23, 23, 23.2] * u.deg)

    def plan(path, **options):
        found = rs.plan_survey(catalog, small, tiles, folder=path, **options)
        repr(found), len(found.targets)

    def resume(path):
        plan(path, resume=True)

    def resume_joint(path):
        plan(path, resume=True, allocator=SEARCH)

    def select(path, **options):
        found = rs.selection_probabilities(catalog, small, tiles, 33, folder=path, **options)
        repr(found), found.table, found.provenance

    def read_selection(path):
        found = rs.SelectionProbabilities.read(path)
        repr(found), found.table, found.provenance

    plan(folder / "unfinished")
    plan(folder / "joint", allocator=SEARCH)
    select(folder / "selection")
    _stop(folder / "begun", select)
    for name, read in (("unfinished", resume), ("joint", resume_joint), ("joint", rs.Survey.read)):
        made.append(_results(folder / name, "survey folder", read))
    for name, read in (("selection", read_selection), ("selection", _again(select)), ("begun", _again(select))):
        made.append(_results(folder / name, "selection folder", read))
    (folder / "selection.fits").write_bytes((folder / "selection" / "selection.fits").read_bytes())
    return [*made, _sample("selection", folder / "selection.fits", read_selection)]


def _again(compute):
    return lambda path: compute(path, resume=True)


def _stop(path: Path, compute) -> None:
    """Begin a computation, and end it in the second block of realizations, such that each kind of checkpoint exists."""
    before, _folder.EVERY = _folder.EVERY, 0.0

    def stop(done, total):
        if done >= total - 4:
            raise StopError

    try:
        with suppress(StopError):
            compute(path, progress=stop)
    finally:
        _folder.EVERY = before
    assert {file.stem.partition("-")[0] for file in path.glob("*.npz")} == {"reach", "block", "state"}


def _folder_names(folder: Path) -> list[str]:
    return [name for name in _names(folder) if name != "lock"]


def _results(folder: Path, kind: str, read) -> Sample:
    """Return a sample of a folder that is read from a copy, because unfinished work is continued in the folder."""

    def read_copy(path):
        copy = path.with_name(f"{path.name}-copy")
        subprocess.run(["cp", "-a", str(path), str(copy)], check=True)
        read(copy)

    return _sample(kind, folder, read_copy, _folder_names(folder), sign)


def sign(folder: Path) -> None:
    """Update the checksums of all files that an index contains, so that they do not reveal the damage."""
    with suppress(OSError, UnicodeDecodeError, csv.Error):
        names = [line.split(",")[0] for line in (folder / "index.csv").read_text().splitlines()[1:]]
        lines = ["file,bytes,sha256"]
        for name in names:
            if (folder / name).is_file():
                found = (folder / name).read_bytes()
                lines.append(f"{name},{len(found)},{hashlib.sha256(found).hexdigest()}")
        (folder / "index.csv").write_text("\n".join(lines) + "\n")
