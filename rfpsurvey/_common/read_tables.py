"""Read tables in all supported formats, of limited size; error messages are single sentences."""

import os
from collections.abc import Iterable
from importlib import import_module
from pathlib import Path

import numpy as np
from astropy.table import QTable, Table

from rfpsurvey._common.read_documents import (
    check_is_file,
    check_size,
    check_width,
    parse_json,
    reading,
)
from rfpsurvey._common.read_fits import META_KEY, read_all_fits, read_fits
from rfpsurvey._common.read_parquet import (
    with_quantities,
)
from rfpsurvey.errors import InputError, refusal, short

FORMATS = {
    ".fits": "fits",
    ".fit": "fits",
    ".ecsv": "ascii.ecsv",
    ".csv": "ascii.csv",
    ".tsv": "ascii.csv",
    ".vot": "votable",
    ".xml": "votable",
    ".votable": "votable",
    ".parquet": "parquet",
}


READERS = {
    "ascii.ecsv": ("read_text", "read_ecsv"),
    "ascii.csv": ("read_text", "read_csv"),
    "votable": ("read_votable", "read_votable"),
    "parquet": ("read_parquet", "read_parquet"),
}
"""Module and name of the reader of each format except FITS; the modules are imported on first use."""
STRUCTURE = ("SIMPLE", "BITPIX", "NAXIS", "EXTEND", "CHECKSUM", "DATASUM", "COMMENT", "HISTORY")
ZIPPED = (".gz", ".bz2", ".xz")
"""Endings of compressed files, which follow the ending that determines the format."""


def to_path(path: object) -> Path:
    """Convert text or a path object to a `pathlib.Path`; refuse empty text, which would name the current folder."""
    if isinstance(path, str) and not path.strip():
        raise InputError(f"a path must not be empty, got {path!r}")
    try:
        return Path(path)
    except TypeError:
        raise refusal("a path must be text or a Path object", path, str) from None


def suffix_of(path: Path) -> str:
    """Return the file extension that determines the format; a final ``.gz``, ``.bz2`` or ``.xz`` is ignored."""
    suffixes = [s.lower() for s in path.suffixes]
    if suffixes and suffixes[-1] in ZIPPED:
        suffixes.pop()
    return suffixes[-1] if suffixes else ""


def has_ending(path: Path, endings: Iterable[str]) -> bool:
    """Return whether a file name has one of some endings, such as ``.csv``; a final ``.gz`` or the like is ignored."""
    name = path.name.lower()
    name = name.removesuffix(path.suffix.lower()) if path.suffix.lower() in ZIPPED else name
    return any(name.endswith(ending) and name != ending for ending in endings)


def is_fits(path: Path) -> bool:
    """Return whether a file is in FITS format, which can contain several tables, but only ASCII text."""
    return FORMATS.get(suffix_of(path)) == "fits"


def is_csv(path: Path) -> bool:
    """Return whether a file is in CSV format, which cannot contain units."""
    return FORMATS.get(suffix_of(path)) == "ascii.csv"


def lacks_units(path: Path) -> bool:
    """Return whether a file has a format whose columns usually have no units: CSV or Parquet."""
    return is_csv(path) or FORMATS.get(suffix_of(path)) == "parquet"


def read_table(
    path: str | os.PathLike, hdu: int | str | None = None, remedy: str = "", *, padded: bool = True
) -> QTable:
    """Read a table in one of `FORMATS`.

    ``hdu`` is the number or the name of one of several tables in a FITS file. Without ``hdu``, a warning about several
    tables ends with ``remedy``, which describes how to read another table. If ``padded`` is False, a FITS file without
    its final padding is read with a warning.
    """
    path = to_path(path)
    suffix = suffix_of(path)
    if suffix not in FORMATS:
        raise InputError(f"{path}: the name of a table must end in one of {', '.join(FORMATS)} (.gz may follow)")
    if hdu is not None and (isinstance(hdu, bool) or not isinstance(hdu, int | np.integer | str)):
        raise refusal("hdu must be the number or the name of a table", hdu)
    check_is_file(path)
    if hdu is not None and not is_fits(path):
        raise InputError(f"{path}: hdu must be used only with FITS files, got {short(hdu)}")
    with reading(path, FORMATS[suffix]):
        if is_fits(path):
            table = read_fits(path, hdu, remedy, padded=padded)
        else:
            module, name = READERS[FORMATS[suffix]]
            table = getattr(import_module(f"rfpsurvey._common.{module}"), name)(path)
        table = _checked(table, path)
    if META_KEY in table.meta:
        table.meta = parse_json(table.meta[META_KEY], f"{path}: the header card {META_KEY}")
    return table


def read_tables(path: str | os.PathLike) -> tuple[dict, list[QTable]]:
    """Return the keywords of the first header of a FITS file, and all of its tables.

    Keywords that describe the structure of the file are omitted. The ``meta`` of each table contains the keywords of
    its header; the keyword ``EXTNAME`` contains the name of the table.
    """
    path = to_path(path)
    with reading(path, "fits"):
        header, tables = read_all_fits(path)
        tables = [_checked(table, path) for table in tables]
    for table in tables:
        table.meta = _keywords(table.meta)
    return _keywords(header), tables


def _checked(table: Table, path: Path) -> QTable:
    """Return a table with quantities and text, after a check of its size."""
    table = with_quantities(table, f"{path}: ")
    for name in table.colnames:
        _make_text(table, name, path)
    check_size(table.meta, path)
    return table


def _keywords(header: dict) -> dict:
    """Return the keywords that have a single value and do not describe the structure of a file."""
    return {
        name: value
        for name, value in header.items()
        if name and name not in STRUCTURE and isinstance(value, str | int | float | bool)
    }


def _make_text(table: QTable, name: str, path: Path) -> None:
    """Convert a column of bytes to text; raise an error if a column of text objects would need too much memory."""
    column = table[name]
    kind = getattr(getattr(column, "dtype", None), "kind", "")
    if kind == "S":
        try:
            text = np.char.rstrip(np.char.decode(np.asarray(column), "utf-8"))
        except UnicodeDecodeError as error:
            raise InputError(
                f"{path}: column {name!r} must contain text in ASCII or UTF-8, got the bytes {error.object[:20]!r}"
            ) from None
        _replace(table, name, text)
    elif kind == "O" and column.ndim == 1 and all(isinstance(v, str) for v in np.asarray(column)):
        check_width(
            path, len(column), max(map(len, np.asarray(column)), default=0), path.stat().st_size, f"a value of {name!r}"
        )


def _replace(table: QTable, name: str, values: np.ndarray) -> None:
    mask = getattr(table[name], "mask", None)
    if mask is not None and np.any(mask):
        values = np.ma.array(values, mask=mask)
    info = table[name].info
    description, meta = info.description, info.meta
    table[name] = values
    table[name].info.description = description
    if meta:
        table[name].info.meta = meta
