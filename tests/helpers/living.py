"""A small survey of overlapping tiles, and functions that record events and compare surveys in tests of histories."""

import hashlib
from pathlib import Path

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord
from astropy.table import QTable, Table

import rfpsurvey as rs

CENTER = SkyCoord(120 * u.deg, 30 * u.deg)
N = 60


def instrument() -> rs.Instrument:
    """Return an instrument with seven positioners, whose field has a radius of 0.21 deg."""
    unit = rs.Positioner(8.25 * u.mm, 8.25 * u.mm, 2.25 * u.mm)
    plane = rs.FocalPlane.hexagonal(unit, rings=1, pitch=25.6 * u.mm)
    return rs.Instrument("tiny", plane, plate_scale=200 * u.mm / u.deg)


KINDS = {"science": 0.8, "standard": 0.1, "sky": 0.1}
SEVERAL_ROLES = {"science": 0.5, "science+standard": 0.3, "science+sky": 0.1, "standard": 0.05, "sky": 0.05}


def targets(seed: int = 0, *, kinds: bool = False, roles: bool = False, n: int = N, radius: float = 0.35) -> rs.Catalog:
    """Return targets with priorities and one to three visits.

    If ``kinds`` is true, some of them are standards or sky positions; with ``roles``, some have several roles.
    """
    rng = np.random.default_rng(seed)
    sky = rs.synthetic_catalog("uniform", CENTER, radius * u.deg, n_targets=n, rng=seed)
    fractions = SEVERAL_ROLES if roles else KINDS
    kind = rng.choice([*fractions], n, p=[*fractions.values()]) if kinds or roles else None
    numbers = {"priority": rng.integers(1, 4, n), "visits": rng.integers(1, 4, n)}
    return rs.Catalog(sky.coord, id=1000 + np.arange(n), kind=kind, **numbers)


def tiling(seed: int = 0, n: int = 6, size: float = 0.2) -> rs.Tiling:
    """Return overlapping tiles in two passes, up to ``size`` (deg) from the center in both directions."""
    offsets = np.random.default_rng(seed).uniform(-size, size, (n, 2))
    places = [CENTER.spherical_offsets_by(x * u.deg, y * u.deg) for x, y in offsets]
    table = QTable({"ra": [c.ra.deg for c in places] * u.deg, "dec": [c.dec.deg for c in places] * u.deg})
    table["tile"] = 11 + np.arange(n)
    table["pass"] = 1 + np.arange(n) % 2
    return rs.Tiling.from_table(table)


def events(**columns) -> Table:
    """Return a table; a single value stands for a column of equal values."""
    n = max((len(value) for value in columns.values() if isinstance(value, list)), default=1)
    return Table({name: value if isinstance(value, list) else [value] * n for name, value in columns.items()})


def content(folder: Path) -> dict[str, bytes]:
    """Return the content of every file in a folder, except the lock and temporary files."""
    paths = [path for path in sorted(Path(folder).rglob("*")) if path.is_file() and path.name != "lock"]
    return {str(p.relative_to(folder)): p.read_bytes() for p in paths if ".rfpsurvey" not in str(p)}


def replan(case: tuple, survey: rs.Survey, **options: object) -> rs.Survey:
    """Plan the rest of a survey in its folder with the allocator ``nearest``, from its state or other ``visits``."""
    options = {"visits": options.get("visits") or survey.state(case[0]), "allocator": "nearest", **options}
    return rs.plan_survey(*case, **{"folder": survey.folder, "resume": True, **options})


def part(folder: Path, row: int) -> bytes:
    """Return the content of the file of a tile."""
    return (Path(folder) / f"tiles/000/{row:06d}.fits").read_bytes()


def sha(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def differences(one: rs.Survey, other: rs.Survey) -> list[str]:
    """Return the names of the tables and columns in which two surveys differ."""
    found = [] if one.summary == other.summary else ["summary"]
    for name in ("tiles", "completeness", "outcomes", "targets"):
        a, b = getattr(one, name), getattr(other, name)
        if a.colnames != b.colnames or len(a) != len(b):
            found.append(name)
            continue
        for column in a.colnames:
            equal_nan = np.asarray(a[column]).dtype.kind == "f"
            if not np.array_equal(np.asarray(a[column]), np.asarray(b[column]), equal_nan=equal_nan):
                found.append(f"{name}.{column}")
    return found
