"""Designs of PFS: FITS files pfsDesign-0x*.fits with the extensions DESIGN, PHOTOMETRY and GUIDESTARS.

The data model is that of https://github.com/Subaru-PFS/datamodel, versions 3 and 4.
"""

import gzip
import hashlib
import re
import zlib
from pathlib import Path

import astropy.units as u
import numpy as np
from astropy.table import QTable

from rfpsurvey._io import output_path
from rfpsurvey._readers import read_fits_units
from rfpsurvey.errors import InputError
from rfpsurvey.instrument import pfs_engineering_fibers, pfs_fibers
from rfpsurvey.plans._plan import make_plan, text_of_lost

__all__ = ["design_id", "lost", "read", "recognizes", "write"]

# Position angle (deg) of +y of the PFI at POSANG = 0. PFI +x points north and +y west, except for a rotation by 0.1 deg
# between pfiNominal and the coordinates of the design 0x2a3e0e7f53f47587.
PFI_ANGLE = -89.898
KINDS = {1: "science", 2: "sky", 3: "standard", 12: "science"}
"""Kinds of targets by ``targetType``; other types are no targets."""
TYPES = {"science": 1, "sky": 2, "standard": 3}
UNASSIGNED, ENGINEERING, GOOD, NO_COBRA = 4, 5, 1, 65533
NATIVE = {"target_id": "objId", "ra": "ra", "dec": "dec", "pm_ra": "pmRa", "pm_dec": "pmDec"}
FORMATS = {
    "fiberId": "J",
    "cobraId": "J",
    "tract": "J",
    "patch": "A",
    "ra": "D",
    "dec": "D",
    "catId": "J",
    "objId": "K",
    "targetType": "J",
    "epoch": "A",
    "pmRa": "E",
    "pmDec": "E",
    "parallax": "E",
    "proposalId": "A",
    "obCode": "A",
    "pfiNominal": "2E",
    "fiberStatus": "J",
}
"""Columns of a new file."""
REQUIRED = ("fiberId", "ra", "dec", "catId", "objId", "targetType", "pfiNominal")
FLUXES = ("fiberFlux", "psfFlux", "totalFlux", "fiberFluxErr", "psfFluxErr", "totalFluxErr")
FLUX_UNITS = dict.fromkeys(FLUXES, "nJy")
GUIDE_STARS = {
    "objId": "K", "epoch": "7A", "ra": "D", "dec": "D", "pmRa": "E", "pmDec": "E", "parallax": "E", "magnitude": "E",
    "passband": "1A", "color": "E", "agId": "J", "agX": "E", "agY": "E", "mask": "J",
}  # fmt: skip
GUIDE_UNITS = {
    "ra": "degrees", "dec": "degrees", "pmRa": "mas/year", "pmDec": "mas/year", "parallax": "mas", "agX": "pixels",
    "agY": "pixels",
}  # fmt: skip
GUIDE_COMMENTS = {"TEL_ELEV": "[degree] elevation of the telescope", "GS_CATID": "catalog of the guide stars"}
STRUCTURE = re.compile(
    r"SIMPLE|XTENSION|BITPIX|NAXIS\d*|EXTEND|PCOUNT|GCOUNT|TFIELDS|T[A-Z]+\d+|EXTNAME|CHECKSUM|DATASUM|COMMENT|HISTORY|"
)
NAME = re.compile(r"pfsDesign-0x([0-9a-f]{16})\.fits(\.gz)?", re.IGNORECASE)


def recognizes(path: Path) -> bool:
    """Return whether a file is a FITS file with a design identifier and the extension DESIGN."""
    try:
        with path.open("rb") as file:
            head = file.read(2)
        with (gzip.open if head == b"\x1f\x8b" else open)(path, "rb") as file:
            head = file.read(2**16)
    except (OSError, EOFError, zlib.error):
        return False
    return head.startswith(b"SIMPLE") and b"W_PFDSGN=" in head and b"EXTNAME = 'DESIGN  '" in head


def read(path: Path) -> QTable:
    """Return the plan in a file.

    ``positioner`` is the column ``cobraId`` where the file has it, otherwise the cobra that the fiber map of PFS
    assigns to the fiber; it is -1 for engineering fibers. ``x`` and ``y`` are ``pfiNominal``.
    """
    units = read_fits_units(path)
    primary, tables = units[None][0], {name: rows for name, (_, rows) in units.items() if name is not None}
    version = primary.get("DAMD_VER", 0)
    has_stars = isinstance(version, int | float) and version >= 2  # older files have no guide stars
    for name in ("DESIGN", "PHOTOMETRY", *(("GUIDESTARS",) if has_stars else ())):
        if name not in tables:
            raise InputError(f"{path}: the file must have the extension {name}, got {', '.join(tables)}")
    rows = tables["DESIGN"]
    for name in REQUIRED:
        if name not in rows.dtype.names:
            raise InputError(f"{path}: DESIGN must have the column {name!r}, got {', '.join(rows.dtype.names)}")
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
    if len(np.unique(fiber)) < len(fiber):
        names, counts = np.unique(fiber, return_counts=True)
        raise InputError(f"{path}: fiberId must be unique, but {names[counts > 1][0]} occurs more than once")
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
        "formats": dict(zip(rows.dtype.names, _forms(rows), strict=True)),
        "rows_id": design_id(fiber, rows["ra"], rows["dec"]),
    }
    if guides is not None:
        stars = {name: guides[1][name].tolist() for name in guides[1].dtype.names}
        formats = dict(zip(stars, _forms(guides[1]), strict=True))
        meta["guide_stars"] = {
            "header": _values(guides[0]),
            "comments": _comments(guides[0]),
            "columns": stars,
            "formats": formats,
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
        position_angle=_wrapped(float(header.get("POSANG", 0.0)) + PFI_ANGLE),
        epoch=str(epochs[0]) if len(epochs) == 1 else None,
        **meta,
    )


def write(plan: QTable, path: Path, *, overwrite: bool) -> None:
    """Write a plan; a name such as ``pfsDesign-0x*.fits`` must contain the identifier of the design."""
    from astropy.io import fits

    rows, header = _rows(plan, path), _header(plan, path)
    number = _identifier(plan, rows)
    header["W_PFDSGN"] = number
    match = NAME.fullmatch(path.name)
    if match and int(match[1], 16) != number:
        raise InputError(f"{path}: the file of this design must have the name pfsDesign-0x{number:016x}.fits")
    comments = plan.meta.get("comments", {}) if plan.meta["format"] == "pfsdesign" else COMMENTS
    with output_path(path, (".fits",), overwrite=overwrite, gzipped=True) as temporary:
        try:
            units = fits.HDUList([fits.PrimaryHDU(header=_fits_header(header, comments))])
            # tables repeat the cards of the primary header
            units.append(_table("DESIGN", rows, _fits_header(header, comments)))
            units.append(_table("PHOTOMETRY", _flux_rows(plan), _fits_header(header, comments), FLUX_UNITS))
            units.append(_guide_stars(plan))
            units.writeto(temporary)
        except (ValueError, TypeError) as error:
            raise InputError(f"{path}: the plan cannot be written as FITS: {error}") from error


def lost(plan: QTable) -> list[str]:
    """Return a description of the data that this format cannot represent."""
    names = {"positioner", "fiber_type", "kind", "assigned", "x", "y", *NATIVE, *FORMATS, *FLUXES, "filterName"}
    names |= {*plan.meta.get("formats", ())} if plan.meta["format"] == "pfsdesign" else {"spectrograph"}
    found = text_of_lost([name for name in plan.colnames if name not in names])
    if plan.meta["format"] not in ("pfsdesign", "tile") and plan.meta["header"]:
        found.append("the keywords of the header")
    return found


def design_id(fiber: np.ndarray, ra: np.ndarray, dec: np.ndarray) -> int:
    """Return the identifier of a design: the last 63 bits of a SHA-1 of its fibers and coordinates in arcsec.

    The text is the Python list of one text for each fiber, with fiberId, ra and dec rounded to arcsec in degrees.
    """
    if np.all(ra == 0) and np.all(dec == 0):
        return 0

    def rounded(value):
        return value if np.isnan(value) else int(value * 3600 + 0.5) / 3600

    texts = [f"{f:d} {rounded(a):0.6f} {rounded(d):0.6f}" for f, a, d in zip(fiber.tolist(), ra, dec, strict=True)]
    return int.from_bytes(hashlib.sha1(str(texts).encode(), usedforsecurity=False).digest()[-8:]) & (2**63 - 1)


COMMENTS = {
    "RA": "[degree] field center",
    "DEC": "[degree] field center",
    "POSANG": "[degree] position angle of the PFI",
    "ARMS": "arms to expose",
    "DSGN_NAM": "name of the design",
    "DAMD_VER": "version of the data model",
    "W_PFDSGN": "identifier of the design",
}


def _cobras(rows: np.ndarray) -> np.ndarray:
    """Return the cobra of each fiber, or -1."""
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
    """Return the fluxes of each fiber as columns with a value for each filter; missing filters have empty names."""
    for name in ("fiberId", "filterName"):
        if name not in rows.dtype.names:
            raise InputError(f"{path}: PHOTOMETRY must have the column {name!r}, got {', '.join(rows.dtype.names)}")
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
    """Return the cards of a header by keyword, except for those that describe the structure of the file."""
    return {card.keyword: card for card in header.cards if not STRUCTURE.fullmatch(card.keyword)}


def _values(header) -> dict:
    return {name: card.value for name, card in _cards(header).items()}


def _comments(header) -> dict:
    return {name: card.comment for name, card in _cards(header).items() if card.comment}


def _forms(rows: np.ndarray) -> list[str]:
    """Return the FITS formats of columns."""
    letters = {"i1": "B", "u1": "B", "i2": "I", "i4": "J", "i8": "K", "f4": "E", "f8": "D", "b1": "L"}
    forms = []
    for name in rows.dtype.names:
        dtype = rows[name].dtype
        n = int(np.prod(rows[name].shape[1:]))
        form = f"{dtype.itemsize // 4}A" if dtype.kind == "U" else letters[dtype.str[1:]]
        forms.append(form if n == 1 else f"{n}{form}")
    return forms


def _wrapped(angle: float) -> float:
    """Return an angle in degrees from -180 (exclusive) to 180, rounded to 1e-9."""
    return round(180 - (180 - angle) % 360, 9)


def _rows(plan: QTable, path: Path) -> dict:
    """Return the columns of DESIGN with their formats."""
    if plan.meta["instrument"] != "pfs":
        raise InputError(f"{path}: a design of PFS must be a plan of pfs, got one of {plan.meta['instrument']}")
    plain = {name: np.asarray(getattr(plan[name], "value", plan[name])) for name in plan.colnames}
    if plan.meta["format"] != "pfsdesign":
        return _new_rows(plan, plain, path)
    found = {}
    for native, form in plan.meta["formats"].items():
        name = next((n for n, other in NATIVE.items() if other == native), native)
        if native == "pfiNominal":
            values = np.column_stack([plain["x"], plain["y"]])
        elif name not in plain:
            raise InputError(f"{path}: the plan must have the column {name!r}, got {', '.join(plan.colnames)}")
        else:
            values = plain[name]
        found[native] = values, _text_form(values) if form.endswith("A") else form
    return found


def _new_rows(plan: QTable, plain: dict, path: Path) -> dict:
    """Return the columns of DESIGN for a plan that was not read from a design."""
    fiber, _ = pfs_fibers()
    ids = plain["positioner"]
    known = np.isin(ids.astype(str), np.arange(1, len(fiber) + 1).astype(str))
    if not known.all():
        raise InputError(f"{path}: positioner must be a cobraId from 1 to {len(fiber)}, got {ids[~known][0]!r}")
    cobra = ids.astype(np.int64)
    target = plain["target_id"]
    has_target = plain["assigned"].astype(bool)
    if target.dtype.kind == "U":
        if not np.char.isdecimal(target[has_target]).all():
            raise InputError(f"{path}: objId must be whole numbers, got text identifiers of targets")
        target = np.where(has_target, target, "-1").astype(np.int64)
    kinds = np.where(plain["kind"] == "", "science", plain["kind"])
    types = np.where(has_target, [TYPES.get(kind, 1) for kind in kinds.tolist()], UNASSIGNED)
    spare = np.setdiff1d(pfs_engineering_fibers(), fiber[cobra - 1])
    order = np.argsort(np.concatenate([fiber[cobra - 1], spare]))
    n = len(spare)

    def numbers(name, default=np.nan):
        values = plain.get(name, np.full(len(plan), default)).astype(float)
        return np.concatenate([np.where(has_target, values, default), np.full(n, default)])[order]

    def texts(value):
        return np.full(len(order), value)

    def whole(values, default):
        return np.concatenate([values, np.full(n, default)])[order]

    found = {
        "fiberId": np.concatenate([fiber[cobra - 1], spare])[order],
        "cobraId": whole(cobra, NO_COBRA),
        "tract": np.full(len(order), -1),
        "patch": texts("0,0"),
        "ra": numbers("ra"),
        "dec": numbers("dec"),
        "catId": whole(np.where(has_target, 0, -1), -1),
        "objId": whole(np.where(has_target, target, -1), -1),
        "targetType": whole(types, ENGINEERING),
        "epoch": texts(str(plan.meta.get("epoch") or "J2000.0")),
        "pmRa": numbers("pm_ra", 0.0),
        "pmDec": numbers("pm_dec", 0.0),
        "parallax": np.full(len(order), 1e-8),
        "proposalId": texts("N/A"),
        "obCode": texts("N/A"),
        "pfiNominal": np.column_stack([numbers("x"), numbers("y")]),
        "fiberStatus": np.full(len(order), GOOD),
    }
    return {name: (v, _text_form(v) if FORMATS[name] == "A" else FORMATS[name]) for name, v in found.items()}


def _text_form(values: np.ndarray) -> str:
    return f"{max(int(np.char.str_len(values.astype(str)).max(initial=1)), 1)}A"


def _header(plan: QTable, path: Path) -> dict:
    """Return the keywords of the primary header."""
    if plan.meta["format"] == "pfsdesign":
        return dict(plan.meta["header"])
    for name in ("racen", "deccen", "position_angle"):
        if plan.meta.get(name) is None:
            raise InputError(f"{path}: the plan must have {name} in its meta, got none; score or plan it on the sky")
    return {
        "RA": float(plan.meta["racen"]),
        "DEC": float(plan.meta["deccen"]),
        "POSANG": _wrapped(float(plan.meta["position_angle"]) - PFI_ANGLE),
        "ARMS": "brn",
        "DSGN_NAM": "",
        "DAMD_VER": 4,
        "W_PFDSGN": 0,
        "VARIANT": 0,
        "PFDSGN0": 0,
        "W_DSGVER": "",
    }


def _identifier(plan: QTable, rows: dict) -> int:
    """Return the identifier of the file that was read if fibers and coordinates are unchanged, otherwise a new one."""
    number = design_id(*(np.asarray(rows[name][0]) for name in ("fiberId", "ra", "dec")))
    if plan.meta["format"] == "pfsdesign" and number == plan.meta["rows_id"]:
        return int(plan.meta["header"].get("W_PFDSGN", number))
    return number


def _fits_header(values: dict, comments: dict):
    from astropy.io import fits

    header = fits.Header()
    for name, value in values.items():
        key = name if len(name) <= 8 and re.fullmatch(r"[A-Z0-9_-]+", name) else f"HIERARCH {name}"
        header[key] = value, comments.get(name, "")
    return header


def _table(name: str, columns: dict, header, units: dict | None = None):
    """Return a header-data unit with a table of columns, given with their formats."""
    from astropy.io import fits

    made = [
        fits.Column(name=k, format=form, array=values, unit=(units or {}).get(k))
        for k, (values, form) in columns.items()
    ]
    return fits.BinTableHDU.from_columns(made, header, name=name)


def _flux_rows(plan: QTable) -> dict:
    """Return the columns of PHOTOMETRY, with one row for each fiber and filter."""
    names = [name for name in FLUXES if name in plan.colnames]
    form = dict.fromkeys(names or FLUXES, "E")
    if plan.meta["format"] != "pfsdesign" or "filterName" not in plan.colnames:
        none = {name: (np.empty(0, dtype=np.float32), "E") for name in form}
        return {"fiberId": (np.empty(0, dtype=np.int32), "J"), **none, "filterName": (np.empty(0, dtype="U1"), "1A")}
    filters = np.asarray(plan["filterName"]).reshape(len(plan), -1)
    keep = filters != ""
    found = {"fiberId": (np.repeat(np.asarray(plan["fiberId"]), keep.sum(axis=1)), "J")}
    for name in names:
        found[name] = u.Quantity(plan[name]).to_value(u.nJy).reshape(keep.shape)[keep], "E"
    return {**found, "filterName": (filters[keep], _text_form(filters[keep]))}


def _guide_stars(plan: QTable):
    """Return the header-data unit of the guide stars of the file that was read; it is empty if there are none."""
    stars = plan.meta.get("guide_stars", {}) if plan.meta["format"] == "pfsdesign" else {}
    formats = stars.get("formats", GUIDE_STARS)
    columns = {}
    for name, form in formats.items():
        columns[name] = (
            np.array(stars["columns"][name] if stars else [], dtype=str if form.endswith("A") else None),
            form,
        )
    header = stars.get("header", {"DAMD_VER": 1, "TEL_ELEV": 0.0, "GS_CATID": 0})
    return _table("GUIDESTARS", columns, _fits_header(header, stars.get("comments", GUIDE_COMMENTS)), GUIDE_UNITS)
