"""Files of catalogs: example catalogs, files with exactly the columns of a catalog, and records of what was read."""

import bz2
import json
import lzma
import os
from pathlib import Path

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord, UnitSphericalCosLatDifferential
from astropy.table import QTable, Table
from astropy.time import Time

from rfpsurvey._common import read_tables
from rfpsurvey._common.files import to_path
from rfpsurvey._common.io import FitsRows, table_cards, write_fits_rows
from rfpsurvey._common.units import to_plain
from rfpsurvey._sky.tables import PER_TARGET
from rfpsurvey.errors import InputError, check_choice, listed


def unpack(packed: bytes) -> str:
    """Convert the bytes of a packed catalog to the text of an ECSV file."""
    blocks, at = [], 0
    while at < len(packed):
        size = int.from_bytes(packed[at : at + 4], "big")
        block = packed[at + 4 : at + 4 + size]
        blocks.append((bz2 if block.startswith(b"BZh") else lzma).decompress(block))
        at += 4 + size
    header = json.loads(blocks[0])
    rows = header["rows"]
    integers = []
    for block, low, width in zip(blocks[1:], header["low"], header["width"], strict=True):
        padded = np.zeros((rows, 8), dtype=np.uint8)
        padded[:, 8 - width :] = np.frombuffer(block, dtype=np.uint8).reshape(width, rows).T
        integers.append(padded.view(">u8").ravel().astype(np.int64) + low)
    columns = []
    for number, is_sorted in header["columns"]:
        if number < 0:
            parts = [integers.pop(0).tolist() for _ in range(-number)]
            columns.append(["-".join(map(str, row)) for row in zip(*parts, strict=True)])
        else:
            values = integers.pop(0)
            values = np.cumsum(values) if is_sorted else values
            columns.append([repr(value / 10**number) for value in values.tolist()])
    lines = map(",".join, zip(*columns, strict=True))
    return "\n".join([header["header"], *lines]) + "\n"


PREFIX = "example:"
EXAMPLES = {"anticenter": "tycho2_anticenter_r5.ecsv"}
# The first folder is in the wheel, where data/wheel.py writes it. The second folder is in the source tree.
_PLACES = ((Path(__file__).parent / "examples", ".packed"), (Path(__file__).parents[2] / "data", ".gz"))


def is_example(path: object) -> bool:
    """Return whether ``path`` is the name of an example catalog, such as "example:anticenter"."""
    return isinstance(path, str | os.PathLike) and os.fspath(path)[: len(PREFIX)] == PREFIX


def path_and_name(path: str | os.PathLike) -> tuple[Path, str]:
    """Return the path of a file or of an example catalog, and the name that results record in their provenance."""
    if not is_example(path):
        path = to_path(path)
        return path, path.name
    name = os.fspath(path)
    file = EXAMPLES[check_choice(name.removeprefix(PREFIX), EXAMPLES, "example catalog")]
    paths = [folder / f"{file}{ending}" for folder, ending in _PLACES]
    example = next((path for path in paths if path.exists()), None)
    if example is None:
        raise InputError(f"the installation must contain {paths[0]}, but the file is missing: install rfpsurvey again")
    return example, name


def read_table(path: Path, hdu: int | str | None = None) -> QTable:
    """Read the table of a catalog from a file, which may be a compressed example catalog (``.packed``)."""
    if path.suffix != ".packed":
        return read_tables.read_table(
            path, hdu, "; to read another table, give hdu= or --set catalog.hdu=NAME", padded=False
        )
    if hdu is not None:
        raise InputError(f"hdu must be used only with FITS files, got {hdu!r} for an example catalog")
    return QTable.read(unpack(path.read_bytes()).splitlines(), format="ascii.ecsv")


EXACT = "RFPSURVEY"
"""Name of the table in a file that `write_exactly` wrote, whose columns are read without any interpretation."""
NUMBERED, EXTRA = "row_id", "extra_"
"""Name of the column of identifiers that are row numbers, and beginning of the names of further columns."""
ROWS = 2**18
"""Number of rows that are written at once."""
EPOCH = ("epoch_jd1", "epoch_jd2")
"""Names of the columns of epochs, which are Julian dates (TDB) in two parts."""


def write_exactly(catalog, path: Path, *, overwrite: bool = False) -> None:
    """Write a FITS file that `Catalog.read` reads with ``hdu=EXACT`` as an equal catalog."""
    icrs = catalog.coord.icrs
    table = {NUMBERED if catalog.numbered else "id": catalog.id}
    # conversions of units would change last digits
    for name, angle in (("ra", icrs.data.lon), ("dec", icrs.data.lat)):
        table[name] = u.Quantity(angle, angle.unit if angle.unit in (u.deg, u.rad) else u.deg)
    if catalog.has_proper_motion:
        motion = icrs.data.differentials["s"]
        is_plain = isinstance(motion, UnitSphericalCosLatDifferential)
        table["pmra"] = motion.d_lon_coslat if is_plain else icrs.pm_ra_cosdec
        table["pmdec"] = motion.d_lat if is_plain else icrs.pm_dec
    if catalog.epoch is not None:
        for name, days in zip(EPOCH, (catalog.epoch.tdb.jd1, catalog.epoch.tdb.jd2), strict=True):
            table[name] = np.broadcast_to(days, len(catalog))
    for name in PER_TARGET[1:]:
        if (values := getattr(catalog, name)) is not None:
            table[name] = values
    for name in () if catalog.extra is None else catalog.extra.colnames:
        table[EXTRA + name] = catalog.extra[name]
    columns = {name: np.asarray(getattr(column, "value", column)) for name, column in table.items()}
    units = {name: str(unit) for name, column in table.items() if (unit := getattr(column, "unit", None)) is not None}
    dtype = np.dtype([(name, column.dtype) for name, column in columns.items()])
    parts = (
        np.rec.fromarrays([column[k : k + ROWS] for column in columns.values()], dtype=dtype)
        for k in range(0, len(catalog), ROWS)
    )
    cards = table_cards(EXACT, columns, {}, units)
    write_fits_rows(path, FitsRows(dtype, cards, parts), overwrite=overwrite)


def exact_columns(table: Table) -> dict:
    """Return the arguments of `Catalog` for the table of a file that `write_exactly` wrote."""
    if not {"ra", "dec"} <= {*table.colnames}:
        raise InputError(f"the table {EXACT} must have the columns ra and dec, got {listed(table.colnames)}")
    motion = {"pm_ra_cosdec": table["pmra"], "pm_dec": table["pmdec"]} if "pmra" in table.colnames else {}
    given = {"coord": SkyCoord(table["ra"], table["dec"], **motion), "numbered": NUMBERED in table.colnames}
    if EPOCH[0] in table.colnames and len(table):
        days = np.column_stack([table[name] for name in EPOCH])
        days = days[:1].T[:, 0] if (days == days[0]).all() else days.T
        given["epoch"] = Time(*days, format="jd", scale="tdb")
    given |= {name: to_plain(table[name]) for name in PER_TARGET if name in table.colnames}
    given |= {"id": to_plain(table[NUMBERED])} if given["numbered"] else {}
    extra = [name for name in table.colnames if name.startswith(EXTRA)]
    return given | ({"extra": {name.removeprefix(EXTRA): table[name] for name in extra}} if extra else {})


def origin_of(path: Path, name: str, given: dict) -> dict:
    """Return the arguments with which a file or a folder was read, as text and numbers, with the absolute path."""
    origin = {key: value for key, value in given.items() if value and (key, value) != ("frame", "icrs")}
    if "units" in origin:
        origin["units"] = {role: str(unit) for role, unit in origin["units"].items()}
    if "keep" in origin:
        origin["keep"] = [origin["keep"]] if isinstance(origin["keep"], str) else [*origin["keep"]]
    return {"path": name if is_example(name) else str(path.resolve()), **origin}
