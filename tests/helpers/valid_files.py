"""Valid files of every format, functions that read them, and independent numbers of their rows."""

import bz2
import gzip
import hashlib
import lzma
import re
import warnings
from base64 import b64decode
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord
from astropy.table import QTable

import rfpsurvey as rs

N_ROWS = 60
CENTER = SkyCoord("6h20m +23d")


@dataclass(frozen=True)
class Sample:
    """A valid file or folder."""

    format: str
    path: Path
    read: Callable[[Path], int]
    """Function that returns the number of rows that were read, or were dropped with a warning."""
    count: Callable[[Path], int | None]
    """Function that counts the rows independently; it returns None if this is not possible."""
    pieces: tuple[str, ...] = ()
    """Files that may be damaged; empty for a single file."""
    repair: Callable[[Path], None] = lambda path: None
    """Function that updates checksums after the damage."""


def read_catalog(path: Path) -> int:
    catalog = rs.Catalog.read(path)
    return len(catalog) + catalog.n_dropped


def read_partitions(path: Path) -> int:
    catalog = rs.catalog.PartitionedCatalog(path).read()
    return len(catalog) + catalog.n_dropped


def read_survey(path: Path) -> int:
    survey = rs.Survey.read(path)
    repr(survey)
    return len(survey.outcomes) + sum(len(survey.tile(tile)) for tile in survey.tiles["tile"])


def samples(folder: Path) -> list[Sample]:
    """Write valid files, and return them."""
    rng = np.random.default_rng(5)
    n, made = N_ROWS, []
    ra, dec = rng.uniform(94, 96, n) * u.deg, rng.uniform(22, 24, n) * u.deg
    table = QTable({"id": [f"star, {k}" for k in range(n)], "ra": ra, "dec": dec, "priority": rng.integers(0, 4, n)})
    table["pmra"], table["pmdec"] = rng.normal(0, 9, (2, n)) * u.mas / u.yr
    table["ref_epoch"] = np.full(n, 2016.0) * u.yr
    table["category"] = rng.choice(["sky_boss", "science", "standard_boss"], n)
    numbers = table.copy()
    numbers["id"] = np.arange(n) + 4_000_000_000
    numbers["category"] = np.full(n, "science")
    made.append(_table(folder / "a.fits", "FITS", table, "fits", count_fits))
    made.append(_table(folder / "a.ecsv", "ECSV", table, "ascii.ecsv", count_lines))
    made.append(_table(folder / "b.ecsv", "ECSV", numbers, "ascii.ecsv", count_lines, delimiter=","))
    made.append(_table(folder / "a.csv", "CSV", table, "ascii.csv", count_lines))
    made.append(_table(folder / "b.csv", "CSV", numbers, "ascii.csv", count_lines))
    made.append(_table(folder / "a.vot", "VOTable", table, "votable", count_tr))
    made.append(_table(folder / "b.vot", "VOTable", numbers, "votable", count_stream, tabledata_format="binary2"))
    for name in ("a.fits", "a.csv", "a.ecsv", "a.vot"):
        sample = next(s for s in made if s.path.name == name)
        path = folder / f"{name}.gz"
        path.write_bytes(gzip.compress(sample.path.read_bytes(), mtime=0))
        made.append(Sample(sample.format, path, read_catalog, sample.count))
    made += _parquet(folder, table)
    made += _results(folder, table)
    made.append(_instrument(folder))
    made.append(_survey(folder, table))
    return made


def _table(path, name, table, kind, count, **options) -> Sample:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        table.write(path, format=kind, **options)
    return Sample(name, path, read_catalog, count)


def _parquet(folder, table) -> list[Sample]:
    try:
        import pyarrow as pa
        from pyarrow import parquet
    except ImportError:
        return []
    columns = {name: np.asarray(getattr(table[name], "value", table[name])) for name in table.colnames}
    parquet.write_table(pa.table(columns), folder / "plain.parquet")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        table.write(folder / "a.parquet", format="parquet")
    rs.catalog.partition_catalog(rs.Catalog.from_table(table), folder / "sky", order=5)
    parts = [str(path.relative_to(folder / "sky")) for path in sorted((folder / "sky").rglob("Npix=*.parquet"))]
    return [
        Sample("Parquet", folder / "a.parquet", read_catalog, count_all),
        Sample("partitions", folder / "sky", read_partitions, count_all, ("hats.properties", *parts)),
    ]


def _instrument(folder) -> Sample:
    text = (Path(rs.__file__).parent / "presets" / "sdss_apo.toml").read_text()
    path = folder / "mine.toml"
    path.write_text(re.sub(r"rings = \{ value = 13", "rings = { value = 13", text))

    def read(path):
        rs.Instrument.read(path)
        return 0

    return Sample("TOML", path, read, lambda path: None)


def _survey(folder, table) -> Sample:
    catalog = rs.Catalog.from_table(table["id", "ra", "dec", "priority"])
    tiles = SkyCoord([94.8, 95.2] * u.deg, [23, 23] * u.deg)
    whole = rs.plan_survey(catalog, _small(), tiles, folder=folder / "survey")
    n = len(whole.outcomes) + sum(len(whole.tile(k)) for k in range(2))
    pieces = ("tiles.fits", "outcomes.fits", "completeness.ecsv", "tiles/000/000000.fits", "index.csv", "survey.json")
    return Sample("survey", folder / "survey", read_survey, lambda path: _count_survey(path, n), pieces, sign)


def _results(folder, table) -> list[Sample]:
    """Return further files that this package writes, in addition to catalogs and surveys."""
    small = _small()
    tile = rs.plan_tile(rs.Catalog.from_table(table["id", "ra", "dec", "priority"]), small, CENTER)
    tiling = rs.Tiling.from_table(QTable({"ra": table["ra"], "dec": table["dec"]}))
    plane = small.focal_plane.to_table()
    tile.write(folder / "tile.fits")
    tile.write(folder / "tile.ecsv")
    tiling.write(folder / "tiling.ecsv")
    plane.write(folder / "plane.ecsv")

    def read_plane(path):
        from rfpsurvey._common.read_tables import read_table

        return len(rs.FocalPlane.from_table(read_table(path)))

    def read_tile(path):
        found = rs.Tile.read(path)
        repr(found)
        return len(found) + (0 if found.outcomes is None else len(found.outcomes))

    return [
        Sample("tile", folder / "tile.fits", read_tile, count_fits),
        Sample("tile", folder / "tile.ecsv", read_tile, count_lines),
        Sample("tiling", folder / "tiling.ecsv", lambda path: len(rs.Tiling.read(path)), count_lines),
        Sample("focal plane", folder / "plane.ecsv", read_plane, lambda path: None),
    ]


def _small() -> rs.Instrument:
    unit = rs.Positioner(8.25 * u.mm, 8.25 * u.mm, 2.25 * u.mm)
    plane = rs.FocalPlane.hexagonal(unit, rings=3, pitch=25.6 * u.mm)
    return rs.Instrument("small", plane, plate_scale=200 * u.mm / u.deg)


def sign(folder: Path) -> None:
    """Write the index again, so that checksums do not reveal the damage."""
    lines = ["file,bytes,sha256"]
    for path in sorted([*folder.rglob("*.fits"), *folder.glob("*.ecsv")]):
        content = path.read_bytes()
        name = path.relative_to(folder).as_posix()
        lines.append(f"{name},{len(content)},{hashlib.sha256(content).hexdigest()}")
    (folder / "index.csv").write_text("\n".join(lines) + "\n")


def _count_survey(folder: Path, n: int) -> int:
    """Return the number of rows of all tables, if their headers and sizes are unchanged."""
    return n


def content(path: Path) -> bytes:
    """Return the content of a file, decompressed according to its first bytes."""
    found = path.read_bytes()
    for magic, opener in ((b"\x1f\x8b", gzip.decompress), (b"BZh", bz2.decompress), (b"\xfd7zXZ", lzma.decompress)):
        if found.startswith(magic):
            return opener(found)
    return found


def count_lines(path: Path) -> int:
    """Return the number of lines of a text table, without comments and the line of names."""
    lines = [line.strip() for line in re.split(rb"\r\n|\r|\n", content(path).removeprefix(b"\xef\xbb\xbf"))]
    return max(sum(1 for line in lines if line and not line.startswith(b"#")) - 1, 0)


def count_fits(path: Path) -> int:
    """Return the number of rows of all tables if they fill their blocks, otherwise -1."""
    found, place, total = content(path), 0, 0
    while (begin := found.find(b"XTENSION= 'BINTABLE'", place)) >= 0:
        header = found[begin : found.find(b"END" + b" " * 77, begin)]
        width, rows = (int(re.search(rb"NAXIS%d\s*=\s*(\d+)" % k, header)[1]) for k in (1, 2))
        data = begin + -(-(len(header) + 80) // 2880) * 2880
        place, total = data + -(-width * rows // 2880) * 2880, total + rows
        rest = found[place:]
        if len(found) not in (data + width * rows, place) and rest.strip(b"\0 ") and not rest.startswith(b"XTENSION"):
            return -1
    return total


def count_tr(path: Path) -> int:
    return len(re.findall(rb"<TR[\s>/]", re.sub(rb"<!--.*?-->", b"", content(path), flags=re.DOTALL)))


def count_stream(path: Path) -> int:
    """Return the number of rows of a stream: a byte for missing values, seven numbers, and seven characters of two
    bytes.
    """
    stream = re.search(rb"<STREAM[^>]*>(.*?)</STREAM>", content(path), re.DOTALL)
    return len(b64decode(stream[1])) // (1 + 7 * 8 + 7 * 2)


def count_all(path: Path) -> int:
    return N_ROWS
