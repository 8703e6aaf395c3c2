"""Designs of PFS: FITS files pfsDesign-0x*.fits with the extensions DESIGN, PHOTOMETRY and GUIDESTARS.

The data model is defined by https://github.com/Subaru-PFS/datamodel, versions 3 and 4.
"""

import re
from contextlib import suppress
from pathlib import Path

import astropy.units as u
import numpy as np
from astropy.table import QTable

from rfpsurvey._common.read_documents import head_of
from rfpsurvey._common.read_fits import read_fits_units
from rfpsurvey._common.units import check_columns, check_unique, to_plain
from rfpsurvey._field import format_pfsdesign_write as design
from rfpsurvey._field.format_pfsdesign_write import file_name, write
from rfpsurvey._field.plan_values import from_keywords, make_plan, own_name, texts_of_lost
from rfpsurvey._instruments.pfs_files import PFI_ANGLE, pfs_fibers
from rfpsurvey.errors import InputError, listed, warn

__all__ = ["ENDINGS", "file_name", "lost", "neglected", "read", "recognizes", "write"]

ENDINGS = (".fits",)
KINDS = {1: "science", 2: "sky", 3: "standard", 12: "science"}
"""Kind of target for each ``targetType``; fibers with another ``targetType`` have no target."""
NO_FILTER = "none"
STRUCTURE = re.compile(
    r"SIMPLE|XTENSION|BITPIX|NAXIS\d*|EXTEND|PCOUNT|GCOUNT|TFIELDS|THEAP|EXTNAME|CHECKSUM|DATASUM|"
    r"T(TYPE|FORM|UNIT|NULL|SCAL|ZERO|DISP|DIM|BCOL)\d+|"
)


def recognizes(path: Path) -> bool:
    """Return whether a file is a FITS file with the extension DESIGN and an identifier or a version of the format.

    Some files of the second version have no identifier.
    """
    head = head_of(path, 2**16)
    is_design = b"W_PFDSGN=" in head or b"DAMD_VER=" in head
    return head.startswith(b"SIMPLE") and is_design and b"EXTNAME = 'DESIGN  '" in head


def read(path: Path) -> QTable:
    """Return the plan in a design file.

    The column ``positioner`` contains the number of the cobra (the positioner of PFS) that carries the fiber. This
    number is ``cobraId`` or, if the file lacks this column, the number in the fiber map of PFS. Engineering fibers have
    the value -1.

    The columns ``x`` and ``y`` contain ``pfiNominal``, the position of the fiber on the focal plane.
    """
    units = read_fits_units(path)
    primary, tables = units[None][0], {name: rows for name, (_, rows) in units.items() if name is not None}
    version = primary.get("DAMD_VER", 0)
    has_stars = isinstance(version, int | float) and version >= 2  # older files have no guide stars
    for name in ("DESIGN", "PHOTOMETRY", *(("GUIDESTARS",) if has_stars else ())):
        if name not in tables:
            raise InputError(f"{path}: the file must have the extension {name}, got {listed(tables)}")
    tables = {name: _without_ragged(rows, name, path) for name, rows in tables.items()}
    rows = tables["DESIGN"]
    check_columns(rows.dtype.names, design.REQUIRED, f"{path}: DESIGN")
    if len(rows) == 0:
        raise InputError(f"{path}: DESIGN must have at least one row, got none")
    for name, column in design.DESIGN.items():
        if name in rows.dtype.names and column.kinds:
            _check_column(rows, "DESIGN", name, column.kinds, path)
    fiber = rows["fiberId"]
    check_unique(fiber, f"{path}: fiberId")
    header = _values(primary, path)
    center = [_number(header, name, path) for name in ("RA", "DEC")]
    posang = _number(header, "POSANG", path) if "POSANG" in primary else 0.0
    kind = np.array([KINDS.get(t, "") for t in rows["targetType"].tolist()])
    columns = {"positioner": _cobras(rows), "fiber_type": np.full(len(rows), ""), "kind": kind, "assigned": kind != ""}
    columns["x"], columns["y"] = rows["pfiNominal"].astype(float).T
    for name, native in design.NATIVE.items():
        if native in rows.dtype.names:
            columns[name] = rows[native]
    native = {name: rows[name] for name in rows.dtype.names if name not in (*design.NATIVE.values(), "pfiNominal")}
    native |= _photometry(units["PHOTOMETRY"][0], tables["PHOTOMETRY"], fiber, path)
    guides = (units["GUIDESTARS"][0], tables["GUIDESTARS"]) if "GUIDESTARS" in tables else None
    meta = {
        "comments": _comments(primary),
        "formats": _forms(rows),
        "rows_id": design.design_id(fiber, rows["ra"], rows["dec"]),
    }
    if guides is not None:
        stars = {name: guides[1][name].tolist() for name in guides[1].dtype.names}
        meta["guide_stars"] = {
            "header": _values(guides[0], path),
            "comments": _comments(guides[0]),
            "columns": stars,
            "formats": _forms(guides[1]),
        }
    epochs = np.unique(rows["epoch"][columns["assigned"]]) if "epoch" in rows.dtype.names else ()
    return make_plan(
        columns,
        native,
        format=design.FORMAT,
        instrument="pfs",
        header=header,
        racen=center[0],
        deccen=center[1],
        position_angle=design.wrapped(posang + PFI_ANGLE),
        epoch=str(epochs[0]) if len(epochs) == 1 else None,
        **meta,
        **from_keywords(header),
    )


def lost(plan: QTable) -> list[str]:
    """Return a list of texts that describe which data this format cannot represent."""
    names = {"positioner", "fiber_type", "kind", "assigned", "x", "y", *design.NATIVE}
    if plan.meta["format"] == design.FORMAT:
        names |= {*design.DESIGN, *design.FLUXES, "filterName", *map(own_name, dict(plan.meta.get("formats", ())))}
    else:
        names |= {"spectrograph", *(name for name, c in design.DESIGN.items() if c.usual is not None and not c.common)}
    return texts_of_lost(plan, names, design.FORMAT)


def neglected(plan: QTable, sky: bool) -> list[str]:
    """Return a text if assigned rows have fibers that are not good, which a score neglects."""
    bad = to_plain(plan["fiberStatus"]) != design.GOOD if "fiberStatus" in plan.colnames else np.zeros(0)
    text = f"{bad.sum()} fibers with a target have a fiberStatus other than {design.GOOD} (good), but count as assigned"
    return [text] if bad.any() else []


def _cobras(rows: np.ndarray) -> np.ndarray:
    """Return the number of the cobra of each fiber, or -1 for a fiber without a cobra."""
    fiber, _ = pfs_fibers()
    cobra = np.full(fiber.max() + 1, -1)
    cobra[fiber] = np.arange(1, len(fiber) + 1)
    fiber_ids = rows["fiberId"]
    inside = (fiber_ids > 0) & (fiber_ids <= fiber.max())
    by_map = np.where(inside, cobra[np.where(inside, fiber_ids, 0)], -1)
    if "cobraId" not in rows.dtype.names:
        return by_map
    recorded = rows["cobraId"].astype(np.int64)
    return np.where((recorded >= 1) & (recorded <= len(fiber)), recorded, -1)


def _number(header: dict, name: str, path: Path) -> float:
    """Return the value of a header card; raise an error unless it is a finite number."""
    value = header.get(name)
    if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
        raise InputError(f"{path}: the header card {name} must be a finite number, got {value!r}")
    return float(value)


def _check_column(rows: np.ndarray, table: str, name: str, kinds: str, path: Path) -> None:
    """Raise an error unless a column has the expected type, and one value per row (``pfiNominal``: two values)."""
    dtype, shape = rows[name].dtype, rows[name].shape[1:]
    if dtype.kind not in kinds or (kinds == design.WHOLE and dtype.str[1:] == "u8" and (rows[name] >= 2**63).any()):
        words = {design.WHOLE: "whole numbers", design.NUMBERS: "numbers", design.TEXT: "text"}
        what = words.get(kinds, "text or numbers")
        raise InputError(f"{path}: the column {name!r} of {table} must hold {what}, got {dtype}")
    if shape != ((2,) if name == "pfiNominal" else ()):
        expected = "two values" if name == "pfiNominal" else "one value"
        raise InputError(f"{path}: the column {name!r} of {table} must have {expected} per row, got the shape {shape}")


def _without_ragged(rows: np.ndarray, table: str, path: Path) -> np.ndarray:
    """Return rows without the columns whose rows have different lengths, which plans cannot contain."""
    ragged = [name for name in rows.dtype.names if rows[name].dtype.kind == "O"]
    if ragged:
        warn(f"{path}: the rows of these columns of {table} have different lengths; they are omitted: {listed(ragged)}")
    return rows[[name for name in rows.dtype.names if name not in ragged]]


def _photometry(header, rows: np.ndarray, fiber: np.ndarray, path: Path) -> dict:
    """Return columns of fluxes and filter names, shape (fiber, filter, ...); missing filters have empty names."""
    for name, kinds in (("fiberId", design.WHOLE), ("filterName", design.TEXT)):
        check_columns(rows.dtype.names, [name], f"{path}: PHOTOMETRY")
        _check_column(rows, "PHOTOMETRY", name, kinds, path)
    if not np.isin(rows["fiberId"], fiber).all():
        strange = rows["fiberId"][~np.isin(rows["fiberId"], fiber)][0]
        raise InputError(f"{path}: PHOTOMETRY must have only fibers of DESIGN, got the fiberId {strange}")
    order = np.argsort(fiber)
    row = order[np.searchsorted(fiber[order], rows["fiberId"])]
    sort = np.argsort(row, kind="stable")
    size = np.bincount(row, minlength=len(fiber))
    # the number of each row among the rows of its fiber
    place = np.arange(len(rows)) - np.repeat(np.cumsum(size) - size, size)
    columns, shape = {}, (len(fiber), max(int(size.max(initial=0)), 1))
    for name in design.FLUXES:
        if name not in rows.dtype.names:
            continue
        given = rows[name].astype(float) if rows[name].dtype.kind in "iu" else rows[name]
        if given.dtype.kind != "f":
            raise InputError(f"{path}: the column {name!r} of PHOTOMETRY must hold numbers, got {given.dtype}")
        values = np.full((*shape, *given.shape[1:]), np.nan, dtype=given.dtype)
        values[row[sort], place] = given[sort]
        columns[name] = values * _unit_of_flux(header, rows.dtype.names.index(name) + 1, path)
    names = np.where(rows["filterName"] == "", NO_FILTER, rows["filterName"])
    if n := np.count_nonzero(rows["filterName"] == ""):
        warn(f"{path}: {n} of {len(rows)} rows of PHOTOMETRY have no filterName, and are named {NO_FILTER}")
    columns["filterName"] = np.full(shape, "", dtype=names.dtype)
    columns["filterName"][row[sort], place] = names[sort]
    return columns


def _unit_of_flux(header, number: int, path: Path) -> u.UnitBase:
    """Return the unit of a column of fluxes; the data model has nJy."""
    text = header.get(f"TUNIT{number}", "nJy")
    unit = u.Unit(text, parse_strict="silent")
    if not unit.is_equivalent(u.nJy):
        raise InputError(f"{path}: the fluxes of PHOTOMETRY must have a unit convertible to nJy, got {text}")
    return unit


def _cards(header) -> dict:
    """Return the cards of a header by keyword, except for the cards that describe the structure of the file."""
    return {card.keyword: card for card in header.cards if not STRUCTURE.fullmatch(card.keyword)}


def _values(header, path: Path) -> dict:
    """Return the value of each card, with None for undefined values; lines of commentary cards are joined."""
    values, bad = {}, []
    for name in _cards(header):
        try:
            value = header[name]
            values[name] = "\n".join(map(str, value)) if name in design.COMMENTARY else value
        except Exception:  # astropy can raise any exception
            bad.append(name)
    if bad:
        warn(f"{path}: these header cards cannot be read and are omitted: {', '.join(bad)}")
    return values


def _comments(header) -> dict:
    comments = {}
    for name, card in _cards(header).items():
        with suppress(Exception):  # astropy can raise any exception
            comments[name] = card.comment
    return {name: text for name, text in comments.items() if text}


def _forms(rows: np.ndarray) -> list[list[str]]:
    """Return a list with the name and the FITS format of each column; ECSV files do not preserve the order of dicts."""
    letters = {"i1": "B", "u1": "B", "i2": "I", "u2": "I", "i4": "J", "u4": "J", "i8": "K", "u8": "K"}
    letters |= {"f4": "E", "f8": "D", "c8": "C", "c16": "M", "b1": "L"}
    forms = []
    for name in rows.dtype.names:
        dtype = rows[name].dtype
        n = int(np.prod(rows[name].shape[1:]))
        form = f"{dtype.itemsize // 4}A" if dtype.kind == "U" else letters[dtype.str[1:]]
        forms.append([name, form if n == 1 else f"{n}{form}"])
    return forms
