"""Write designs of PFS, and define the names and FITS formats of their columns."""

import hashlib
import math
import re
import warnings
from pathlib import Path

import astropy.units as u
import numpy as np
from astropy.table import QTable

from rfpsurvey._common.descriptions import table_of
from rfpsurvey._common.io import writing_to
from rfpsurvey._common.read_documents import sentence
from rfpsurvey._common.units import check_columns, check_unique
from rfpsurvey._field.plan_values import Native, check_instrument, own_name, to_keywords, to_type, without_keywords
from rfpsurvey._instruments.pfs_files import PFI_ANGLE, pfs_engineering_fibers, pfs_fibers
from rfpsurvey.errors import InputError, listed

FORMAT = "pfsdesign"
TYPES = {"science": 1, "sky": 2, "standard": 3}
UNASSIGNED, ENGINEERING, GOOD, NO_COBRA = 4, 5, 1, 65533
WHOLE, NUMBERS, TEXT = "iu", "iuf", "U"
DESIGN = table_of(
    Native("fiberId", "J", required=True, kinds=WHOLE),
    Native("cobraId", "J", kinds=WHOLE),
    Native("tract", "J", usual=-1),
    Native("patch", "A", usual="0,0"),
    Native("ra", "D", "ra", required=True, usual=np.nan, kinds=NUMBERS),
    Native("dec", "D", "dec", required=True, usual=np.nan, kinds=NUMBERS),
    Native("catId", "J", required=True, usual=-1, kinds=WHOLE),
    Native("objId", "K", "target_id", required=True, kinds=WHOLE),
    Native("targetType", "J", required=True, kinds=WHOLE),
    Native("epoch", "A", kinds=TEXT + NUMBERS),
    Native("pmRa", "E", "pm_ra", usual=0.0, kinds=NUMBERS),
    Native("pmDec", "E", "pm_dec", usual=0.0, kinds=NUMBERS),
    Native("parallax", "E"),
    Native("proposalId", "A", usual="N/A"),
    Native("obCode", "A", usual="N/A"),
    Native("pfiNominal", "2E", required=True, kinds=NUMBERS),
    Native("fiberStatus", "J"),
)
"""Columns of the table DESIGN in a new file; a column with a usual value is copied from a tile with this column."""
NATIVE = {column.common: name for name, column in DESIGN.items() if column.common}
REQUIRED = [name for name, column in DESIGN.items() if column.required]
DTYPES = {"B": "u1", "I": "i2", "J": "i4", "K": "i8", "E": "f4"}
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
COMMENTARY = ("COMMENT", "HISTORY")
GUIDE_COMMENTS = {"TEL_ELEV": "[degree] elevation of the telescope", "GS_CATID": "catalog of the guide stars"}
CARDS = {
    "RA": ("[degree] right ascension of the field center", lambda meta: float(meta["racen"])),
    "DEC": ("[degree] declination of the field center", lambda meta: float(meta["deccen"])),
    "POSANG": ("[degree] position angle of the PFI", lambda meta: wrapped(float(meta["position_angle"]) - PFI_ANGLE)),
    "ARMS": ("spectrograph arms to expose", "brn"),
    "DSGN_NAM": ("name of the design", lambda meta: meta.get("survey", {}).get("tile", "")),
    "DAMD_VER": ("version of the data model", 4),
    "W_PFDSGN": ("identifier of the design", 0),
    "VARIANT": ("", 0),
    "PFDSGN0": ("", 0),
    "W_DSGVER": ("", ""),
}
"""Cards of the primary header of a new file: comments, and values or functions of the ``meta`` of a plan."""
COMMENTS = {name: comment for name, (comment, _) in CARDS.items()}
NAME = re.compile(r"pfsDesign-0x([0-9a-f]{16})\.fits(\.gz)?", re.IGNORECASE)


def write(plan: QTable, path: Path, *, overwrite: bool) -> None:
    """Write a plan as a design file.

    If the name of the file is ``pfsDesign-0x*.fits``, ``*`` must be the identifier of the design (16 hexadecimal
    digits).
    """
    from astropy.io import fits

    rows, header = _rows(plan, path), without_keywords(_header(plan, path)) | to_keywords(plan.meta)
    check_unique(rows["fiberId"][0], f"{path}: fiberId")
    number = _identifier(plan, rows)
    header["W_PFDSGN"] = number
    match = NAME.fullmatch(path.name)
    if match and int(match[1], 16) != number:
        raise InputError(f"{path}: the file of this design must have the name pfsDesign-0x{number:016x}.fits")
    comments = plan.meta.get("comments", {}) if plan.meta["format"] == FORMAT else COMMENTS
    with writing_to(path, (".fits",), overwrite=overwrite, gzipped=True) as temporary, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # ignore warnings about names of columns and keywords
        try:
            units = fits.HDUList([fits.PrimaryHDU(header=_fits_header(header, comments))])
            # tables repeat the cards of the primary header
            units.append(_table("DESIGN", rows, _fits_header(header, comments)))
            units.append(_table("PHOTOMETRY", _flux_rows(plan), _fits_header(header, comments), FLUX_UNITS))
            units.append(_guide_stars(plan))
            units.writeto(temporary)
        except (ValueError, TypeError, fits.VerifyError) as error:
            raise InputError(f"{path}: the plan cannot be written as FITS: {sentence(error)}") from error


def file_name(plan: QTable, _: str) -> str:
    """Return the name of the file of a design, which contains its identifier."""
    return f"pfsDesign-0x{_identifier(plan, _rows(plan, Path('pfsDesign'))):016x}.fits"


def design_id(fiber: np.ndarray, ra: np.ndarray, dec: np.ndarray) -> int:
    """Return the identifier of a design: the last 63 bits of the SHA-1 hash of its fibers and their coordinates.

    The hash is computed from the text of a Python list that contains one string for each fiber. The string contains the
    fiberId, ra and dec; ra and dec are in degrees, rounded to 1 arcsec.
    """
    if np.all(ra == 0) and np.all(dec == 0):
        return 0

    def rounded(value):
        return value if not np.isfinite(value) else int(value * 3600 + 0.5) / 3600

    texts = [f"{f:d} {rounded(a):0.6f} {rounded(d):0.6f}" for f, a, d in zip(fiber.tolist(), ra, dec, strict=True)]
    return int.from_bytes(hashlib.sha1(str(texts).encode(), usedforsecurity=False).digest()[-8:]) & (2**63 - 1)


def wrapped(angle: float) -> float:
    """Return an angle (deg) converted to the range from -180 (exclusive) to 180, and rounded to 1e-9."""
    return round(180 - (180 - angle) % 360, 9)


def _rows(plan: QTable, path: Path) -> dict:
    """Return the values and the FITS format of each column of DESIGN, by name."""
    check_instrument(plan, path, "a design of PFS", "pfs")
    plain = {name: np.asarray(getattr(plan[name], "value", plan[name])) for name in plan.colnames}
    if plan.meta["format"] != FORMAT:
        return _new_rows(plan, plain, path)
    columns = {}
    for native, form in plan.meta["formats"]:
        name = next((n for n, other in NATIVE.items() if other == native), own_name(native))
        if native == "pfiNominal":
            values = np.column_stack([plain["x"], plain["y"]])
        else:
            check_columns(plan.colnames, [name], f"{path}: the plan")
            values = plain[name]
        columns[native] = values, _text_form(values) if form.endswith("A") else form
    for name in REQUIRED:
        if name not in columns:
            raise InputError(f"{path}: formats in the meta of the plan must have {name!r}, got {listed(columns)}")
    return columns


def _new_rows(plan: QTable, plain: dict, path: Path) -> dict:
    """Return the columns of DESIGN for a plan that was not read from a design."""
    fiber, _ = pfs_fibers()
    ids = plain["positioner"]
    known = np.isin(ids.astype(str), np.arange(1, len(fiber) + 1).astype(str))
    if not known.all():
        raise InputError(f"{path}: positioner must be a cobraId from 1 to {len(fiber)}, got {ids[~known][0]}")
    cobra = ids.astype(np.int64)
    target = plain["target_id"]
    has_target = plain["assigned"].astype(bool)
    if target.dtype.kind == "U":
        if not np.char.isdecimal(target[has_target]).all():
            raise InputError(f"{path}: objId must be whole numbers, got text for the identifiers of targets")
        target = to_type(np.where(has_target, target, "-1"), "i8", f"{path}: objId")
    kinds = np.where(plain["kind"] == "", "science", plain["kind"])
    types = np.where(has_target, [TYPES.get(kind.rpartition("+")[2], 1) for kind in kinds.tolist()], UNASSIGNED)
    spare = np.setdiff1d(pfs_engineering_fibers(), fiber[cobra - 1])
    order = np.argsort(np.concatenate([fiber[cobra - 1], spare]))
    n = len(spare)

    def whole(values, spare):
        return np.concatenate([values, np.full(n, spare)])[order]

    def of_targets(name, usual, missing=None):
        """Return a column of the plan, with the usual value of fibers without a target."""
        values = plain.get(name, np.full(len(plan), usual if missing is None else missing))
        return whole(np.where(has_target, values, usual), usual)

    columns = {name: of_targets(c.common or name, c.usual) for name, c in DESIGN.items() if c.usual is not None}
    columns |= {
        "fiberId": np.concatenate([fiber[cobra - 1], spare])[order],
        "cobraId": whole(cobra, NO_COBRA),
        "catId": of_targets("catId", -1, missing=0),
        "objId": whole(np.where(has_target, target, -1), -1),
        "targetType": whole(types, ENGINEERING),
        "epoch": np.full(len(order), str(plan.meta.get("epoch") or "J2000.0")),
        "parallax": np.full(len(order), 1e-8),
        "pfiNominal": np.column_stack([of_targets(name, np.nan) for name in ("x", "y")]),
        "fiberStatus": np.full(len(order), GOOD),
    }
    forms = {name: _text_form(columns[name]) if column.type == "A" else column.type for name, column in DESIGN.items()}
    return {name: (columns[name], form) for name, form in forms.items()}


def _text_form(values: np.ndarray) -> str:
    return f"{max(int(np.char.str_len(values.astype(str)).max(initial=1)), 1)}A"


def _header(plan: QTable, path: Path) -> dict:
    """Return the keywords of the primary header of a design."""
    if plan.meta["format"] == FORMAT:
        return dict(plan.meta["header"])
    for name in ("racen", "deccen", "position_angle"):
        if plan.meta.get(name) is None:
            raise InputError(
                f"{path}: the plan must have {name} in its meta, got none; plan or score the tile with sky coordinates"
            )
    return {name: value(plan.meta) if callable(value) else value for name, (_, value) in CARDS.items()}


def _identifier(plan: QTable, rows: dict) -> int:
    """Return the identifier of the design.

    A design that was read from a file keeps its identifier if its fibers and their coordinates are unchanged.
    Otherwise, `design_id` computes the identifier.
    """
    number = design_id(*(np.asarray(rows[name][0]) for name in ("fiberId", "ra", "dec")))
    if plan.meta["format"] == FORMAT and number == plan.meta["rows_id"]:
        return int(plan.meta["header"].get("W_PFDSGN", number))
    return number


def _fits_header(values: dict, comments: dict):
    from astropy.io import fits

    header = fits.Header()
    for name, value in values.items():
        if name in COMMENTARY:
            for line in value.split("\n"):
                header[name] = line
            continue
        key = name if len(name) <= 8 and re.fullmatch(r"[A-Z0-9_-]+", name) else f"HIERARCH {name}"
        header[key] = value, comments.get(name, "")
    return header


def _table(name: str, columns: dict, header, units: dict | None = None):
    """Return a table as a header-data unit; ``columns`` contains the values and the FITS format of each column."""
    from astropy.io import fits

    made = []
    for key, (values, form) in columns.items():
        kind, more = DTYPES.get(form[-1]), {}
        values = np.asarray(values)
        if key not in DESIGN and values.dtype.str[1:] in ("i1", "u2", "u4", "u8"):  # FITS stores these with an offset
            more["bzero"] = -128 if values.dtype.kind == "i" else 2 ** (8 * values.dtype.itemsize - 1)
        elif kind is not None:
            values = to_type(values, kind, f"column {key!r} of {name}")
        shape = values.shape[:0:-1]
        if form.endswith("A") and shape:
            width = int(form[:-1])
            form, more["dim"] = f"{width * math.prod(shape)}A", str((width, *shape))
        elif len(shape) > 1:
            more["dim"] = str(shape)
        made.append(fits.Column(name=key, format=form, array=values, unit=(units or {}).get(key), **more))
    return fits.BinTableHDU.from_columns(made, header, name=name)


def _flux_rows(plan: QTable) -> dict:
    """Return the columns of PHOTOMETRY, with one row for each fiber and filter."""
    names = [name for name in FLUXES if name in plan.colnames]
    form = dict.fromkeys(FLUXES, "E")
    if plan.meta["format"] != FORMAT or "filterName" not in plan.colnames:
        none = {name: (np.empty(0, dtype=np.float32), "E") for name in form}
        return {"fiberId": (np.empty(0, dtype=np.int32), "J"), **none, "filterName": (np.empty(0, dtype="U1"), "1A")}
    filters = np.asarray(plan["filterName"]).reshape(len(plan), -1)
    keep = filters != ""
    columns = {"fiberId": (np.repeat(np.asarray(plan["fiberId"]), keep.sum(axis=1)), "J")}
    for name in names:
        values = u.Quantity(plan[name]).to_value(u.nJy)
        values = values.reshape(*keep.shape, *values.shape[keep.ndim :])[keep]
        n = math.prod(values.shape[1:])
        columns[name] = values, f"{n if n > 1 else ''}{'D' if values.dtype.itemsize > 4 else 'E'}"
    return {**columns, "filterName": (filters[keep], _text_form(filters[keep]))}


def _guide_stars(plan: QTable):
    """Return the table of guide stars of the file that was read, or an empty table if there are no guide stars."""
    stars = plan.meta.get("guide_stars", {}) if plan.meta["format"] == FORMAT else {}
    formats = dict(stars.get("formats", GUIDE_STARS))
    columns = {}
    for name, form in formats.items():
        columns[name] = (
            np.array(stars["columns"][name] if stars else [], dtype=str if form.endswith("A") else None),
            form,
        )
    header = stars.get("header", {"DAMD_VER": 1, "TEL_ELEV": 0.0, "GS_CATID": 0})
    return _table("GUIDESTARS", columns, _fits_header(header, stars.get("comments", GUIDE_COMMENTS)), GUIDE_UNITS)
