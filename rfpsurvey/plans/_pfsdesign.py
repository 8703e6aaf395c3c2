"""Designs of PFS: FITS files pfsDesign-0x*.fits with the extensions DESIGN, PHOTOMETRY and GUIDESTARS.

The data model is defined by https://github.com/Subaru-PFS/datamodel, versions 3 and 4.
"""

import re
from pathlib import Path

import astropy.units as u
import numpy as np
from astropy.table import QTable

from rfpsurvey._readers import read_fits_units
from rfpsurvey.errors import InputError, listed
from rfpsurvey.instrument import pfs_fibers
from rfpsurvey.plans._pfsdesign_write import (
    FLUXES,
    FORMATS,
    FROM_TILE,
    NATIVE,
    PFI_ANGLE,
    check_fibers,
    design_id,
    wrapped,
    write,
)
from rfpsurvey.plans._plan import make_plan, text_of_lost
from rfpsurvey.plans._values import from_keywords, head_of

__all__ = ["lost", "read", "recognizes", "write"]

KINDS = {1: "science", 2: "sky", 3: "standard", 12: "science"}
"""Kind of target for each ``targetType``; fibers with another ``targetType`` have no target."""
REQUIRED = ("fiberId", "ra", "dec", "catId", "objId", "targetType", "pfiNominal")
STRUCTURE = re.compile(
    r"SIMPLE|XTENSION|BITPIX|NAXIS\d*|EXTEND|PCOUNT|GCOUNT|TFIELDS|T[A-Z]+\d+|EXTNAME|CHECKSUM|DATASUM|COMMENT|HISTORY|"
)


def recognizes(path: Path) -> bool:
    """Return whether a file is a FITS file with a design identifier and the extension DESIGN."""
    head = head_of(path, 2**16)
    return head.startswith(b"SIMPLE") and b"W_PFDSGN=" in head and b"EXTNAME = 'DESIGN  '" in head


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
    rows = tables["DESIGN"]
    for name in REQUIRED:
        if name not in rows.dtype.names:
            raise InputError(f"{path}: DESIGN must have the column {name!r}, got {listed(rows.dtype.names)}")
    if len(rows) == 0:
        raise InputError(f"{path}: DESIGN must have at least one row, got none")
    if rows["pfiNominal"].shape != (len(rows), 2):
        raise InputError(f"{path}: pfiNominal must have two numbers per row, got {rows['pfiNominal'].shape[1:]}")
    for name in REQUIRED:
        wanted = "iu" if name in ("fiberId", "catId", "objId", "targetType") else "f"
        if rows[name].dtype.kind not in wanted:
            what = "whole numbers" if wanted == "iu" else "numbers"
            raise InputError(f"{path}: the column {name!r} of DESIGN must hold {what}, got {rows[name].dtype}")
    fiber = rows["fiberId"]
    check_fibers(fiber, path)
    header = _values(primary)
    for name in ("RA", "DEC"):
        if not isinstance(header.get(name), int | float):
            raise InputError(f"{path}: the header card {name} must be a number, got {header.get(name, 'no such card')}")
    kind = np.array([KINDS.get(t, "") for t in rows["targetType"].tolist()])
    columns = {"positioner": _cobras(rows), "fiber_type": np.full(len(rows), ""), "kind": kind, "assigned": kind != ""}
    columns["x"], columns["y"] = rows["pfiNominal"].astype(float).T
    for name, native in NATIVE.items():
        if native in rows.dtype.names:
            columns[name] = rows[native]
    native = {name: rows[name] for name in rows.dtype.names if name not in (*NATIVE.values(), "pfiNominal")}
    native |= _photometry(tables["PHOTOMETRY"], fiber, path)
    guides = units.get("GUIDESTARS")
    meta = {
        "comments": _comments(primary),
        "formats": _forms(rows),
        "rows_id": design_id(fiber, rows["ra"], rows["dec"]),
    }
    if guides is not None:
        stars = {name: guides[1][name].tolist() for name in guides[1].dtype.names}
        meta["guide_stars"] = {
            "header": _values(guides[0]),
            "comments": _comments(guides[0]),
            "columns": stars,
            "formats": _forms(guides[1]),
        }
    epochs = np.unique(rows["epoch"][columns["assigned"]]) if "epoch" in rows.dtype.names else ()
    return make_plan(
        columns,
        native,
        format="pfsdesign",
        instrument="pfs",
        header=header,
        racen=header["RA"],
        deccen=header["DEC"],
        position_angle=wrapped(float(header.get("POSANG", 0.0)) + PFI_ANGLE),
        epoch=str(epochs[0]) if len(epochs) == 1 else None,
        **meta,
        **from_keywords(header),
    )


def lost(plan: QTable) -> list[str]:
    """Return a list of texts that describe which data this format cannot represent."""
    names = {"positioner", "fiber_type", "kind", "assigned", "x", "y", *NATIVE}
    if plan.meta["format"] == "pfsdesign":
        names |= {*FORMATS, *FLUXES, "filterName", *dict(plan.meta.get("formats", ()))}
    else:
        names |= {*FROM_TILE, "spectrograph"}
    found = text_of_lost([name for name in plan.colnames if name not in names])
    if plan.meta["format"] not in ("pfsdesign", "tile") and plan.meta["header"]:
        found.append("the keywords of the header")
    return found


def _cobras(rows: np.ndarray) -> np.ndarray:
    """Return the number of the cobra of each fiber, or -1 for a fiber without a cobra."""
    fiber, _ = pfs_fibers()
    cobra = np.full(fiber.max() + 1, -1)
    cobra[fiber] = np.arange(1, len(fiber) + 1)
    found = rows["fiberId"]
    inside = (found > 0) & (found <= fiber.max())
    by_map = np.where(inside, cobra[np.where(inside, found, 0)], -1)
    if "cobraId" not in rows.dtype.names:
        return by_map
    own = rows["cobraId"].astype(np.int64)
    return np.where((own >= 1) & (own <= len(fiber)), own, -1)


def _photometry(rows: np.ndarray, fiber: np.ndarray, path: Path) -> dict:
    """Return columns of fluxes and filter names, shape (fiber, filter); missing filters have empty names."""
    for name in ("fiberId", "filterName"):
        if name not in rows.dtype.names:
            raise InputError(f"{path}: PHOTOMETRY must have the column {name!r}, got {listed(rows.dtype.names)}")
    if not np.isin(rows["fiberId"], fiber).all():
        strange = rows["fiberId"][~np.isin(rows["fiberId"], fiber)][0]
        raise InputError(f"{path}: PHOTOMETRY must have only fibers of DESIGN, got the fiberId {strange}")
    order = np.argsort(fiber)
    row = order[np.searchsorted(fiber[order], rows["fiberId"])]
    sort = np.argsort(row, kind="stable")
    size = np.bincount(row, minlength=len(fiber))
    place = np.arange(len(rows)) - np.repeat(np.cumsum(size) - size, size)
    columns, shape = {}, (len(fiber), max(int(size.max(initial=0)), 1))
    for name in (*FLUXES, "filterName"):
        if name not in rows.dtype.names:
            continue
        values = np.full(shape, "" if name == "filterName" else np.nan, dtype=rows[name].dtype)
        values[row[sort], place] = rows[name][sort]
        columns[name] = values if name == "filterName" else values * u.nJy
    return columns


def _cards(header) -> dict:
    """Return the cards of a header by keyword, except for the cards that describe the structure of the file."""
    return {card.keyword: card for card in header.cards if not STRUCTURE.fullmatch(card.keyword)}


def _values(header) -> dict:
    return {name: card.value for name, card in _cards(header).items()}


def _comments(header) -> dict:
    return {name: card.comment for name, card in _cards(header).items() if card.comment}


def _forms(rows: np.ndarray) -> list[list[str]]:
    """Return a list with the name and the FITS format of each column; ECSV files do not preserve the order of dicts."""
    letters = {"i1": "B", "u1": "B", "i2": "I", "i4": "J", "i8": "K", "f4": "E", "f8": "D", "b1": "L"}
    forms = []
    for name in rows.dtype.names:
        dtype = rows[name].dtype
        n = int(np.prod(rows[name].shape[1:]))
        form = f"{dtype.itemsize // 4}A" if dtype.kind == "U" else letters[dtype.str[1:]]
        forms.append([name, form if n == 1 else f"{n}{form}"])
    return forms
