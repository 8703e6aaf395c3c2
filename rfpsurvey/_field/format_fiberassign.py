"""Files of fiberassign, the planner of DESI: FITS files with the extension FIBERASSIGN.

The page DESI_TARGET/fiberassign of https://desidatamodel.readthedocs.io describes the data model. FIBERASSIGN_X and
FIELDROT are in the coordinate system CS5, in which +x is west; x and the position angle of this package have the
opposite signs.
"""

import re
import warnings
from pathlib import Path

import astropy.units as u
import numpy as np
from astropy.table import QTable, Table

from rfpsurvey._common.descriptions import table_of
from rfpsurvey._common.files import suffix_of
from rfpsurvey._common.io import check_fits_text, writing_to
from rfpsurvey._common.read_documents import head_of, sentence
from rfpsurvey._common.read_tables import read_tables
from rfpsurvey._common.units import check_columns, check_unique, to_plain
from rfpsurvey._field import plan_values
from rfpsurvey._field.plan_values import Native
from rfpsurvey._instruments.as_built import MOST_DEVICE, N_PETALS
from rfpsurvey.errors import InputError, InputTypeError, warn

FORMAT, ENDINGS = "fiberassign", (".fits",)
NAME = re.compile(rb"EXTNAME *= *'FIBERASSIGN *'")
COLUMNS = table_of(
    Native("TARGETID", "i8", "target_id", required=True),
    Native("PETAL_LOC", "i2"),
    Native("DEVICE_LOC", "i4"),
    Native("LOCATION", "i4", "positioner", required=True),
    Native("FIBER", "i4", usual=-1),
    Native("FIBERSTATUS", "i4", required=True),
    Native("TARGET_RA", "f8", "ra", required=True, usual=np.nan),
    Native("TARGET_DEC", "f8", "dec", required=True, usual=np.nan),
    Native("PMRA", "f4", "pm_ra", usual=0),
    Native("PMDEC", "f4", "pm_dec", usual=0),
    Native("REF_EPOCH", "f4"),
    Native("LAMBDA_REF", "f4", usual=5400.0),  # Angstrom; all files of DESI have this value
    Native("FA_TARGET", "i8", usual=0),
    Native("FA_TYPE", "u1"),
    Native("OBJTYPE", "U3"),
    Native("FIBERASSIGN_X", "f4", "x", required=True),
    Native("FIBERASSIGN_Y", "f4", "y", required=True),
    Native("PRIORITY", "i4", "priority", usual=0),
)
"""Columns of the table FIBERASSIGN in a new file; ``x`` and ``FIBERASSIGN_X`` differ in sign."""
COMMON = {column.common: name for name, column in COLUMNS.items() if column.common}
EXACT, RANKS = "PRIORITY_VALUE", "PRIORANK"
"""Column with the priorities of a plan if PRIORITY contains ranks, and keyword that states this."""
UNASSIGNED, STUCK, BROKEN = 1, 2, 4
SCIENCE, STANDARD, SKY, SUPPLEMENTAL_SKY = 1, 2, 4, 16
KINDS = {"science": SCIENCE, "standard": STANDARD, "sky": SKY, "": 0}
POINTING = {"TILERA": "racen", "TILEDEC": "deccen", "REQRA": "racen", "REQDEC": "deccen"}
WHEN = {"FA_HA": "hour_angle_deg", "FA_PLAN": "time"}
"""Keywords of the hour angle and of the time (UTC), and their entries in observing conditions."""
SHARED = ("TILEID", "TILERA", "TILEDEC", "FIELDROT", "REQRA", "REQDEC", "FIELDNUM")
SHARED += ("FA_PLAN", "FA_HA", "FA_RUN", "FA_M_GFA", "FA_M_PET", "FA_M_POS", "FA_VER", "FA_SURV")
"""Keywords of the primary header that the header of the table FIBERASSIGN repeats."""


def recognizes(path: Path) -> bool:
    """Return whether a file is a FITS file with the extension FIBERASSIGN in its first 256 KiB."""
    head = head_of(path, 2**18)
    return head.startswith(b"SIMPLE") and NAME.search(head) is not None


def read(path: Path) -> QTable:
    """Return the plan in a fiberassign file; its ``meta["extensions"]`` contains the other tables of the file."""
    header, tables = read_tables(path)
    assignments = [table for table in tables if table.meta.get("EXTNAME") == "FIBERASSIGN"]
    if not assignments:
        raise InputError(f"{path}: the file must have the extension FIBERASSIGN, got none")
    table = assignments[0]
    required = [name for name, column in COLUMNS.items() if column.required]
    check_columns(table.colnames, required, f"{path}: FIBERASSIGN")
    values = {name: _column(table, name, path) for name in table.colnames if name in COLUMNS}
    check_unique(values["LOCATION"], f"{path}: LOCATION")
    status = values["FIBERSTATUS"]
    columns = {common: values[name] for common, name in COMMON.items() if name in values}
    columns |= {
        "fiber_type": np.full(len(table), ""),
        "kind": _kinds(values),
        "assigned": _is_assigned(status, values["TARGETID"]),
        "x": -values["FIBERASSIGN_X"],
        **({"priority": _column(table, EXACT, path)} if EXACT in table.colnames else {}),
    }
    header |= {name: value for name, value in table.meta.items() if name != "EXTNAME"}
    rotation = _angle(header, "FIELDROT", path)
    plan = plan_values.make_plan(
        columns,
        {name: table[name] for name in table.colnames if name not in (*COMMON.values(), EXACT)},
        format=FORMAT,
        instrument="desi",
        header=header,
        racen=_angle(header, "TILERA", path),
        deccen=_angle(header, "TILEDEC", path),
        position_angle=None if rotation is None else 0.0 - rotation,  # never -0.0
        epoch=_epoch(values.get("REF_EPOCH")),
        **plan_values.from_keywords(header),
    )
    plan.meta["columns"] = list(table.colnames)
    plan.meta["extensions"] = [extension for extension in tables if extension is not table]
    return plan


def write(plan: QTable, path: Path, *, overwrite: bool) -> None:
    """Write a plan as a fiberassign file.

    If the plan was not read from a fiberassign file, columns that the plan lacks get default values such as -1 or NaN.
    """
    from astropy.io import fits

    if suffix_of(path) != ".fits":
        raise InputError(f"{path}: the name of a fiberassign file must end in .fits or .fits.gz")
    header = _header(plan)
    columns = _columns(plan, header, path)
    shared = {name: header[name] for name in SHARED if name in header}
    with writing_to(path, (".fits",), overwrite=overwrite, gzipped=True) as temporary:
        primary = fits.PrimaryHDU()
        _add(primary.header, header, path)
        try:
            units = [primary, _to_hdu("FIBERASSIGN", columns, shared, path)]
            for table in plan.meta.get("extensions", ()):
                columns_of_table = {name: table[name] for name in table.colnames}
                units.append(_to_hdu(table.meta.get("EXTNAME"), columns_of_table, table.meta, path))
            fits.HDUList(units).writeto(temporary)
        except InputError:
            raise
        except (ValueError, TypeError, fits.VerifyError) as error:
            raise InputError(f"{path}: the plan cannot be written as FITS: {sentence(error)}") from error
    if EXACT in columns:
        warn(
            f"{path}: PRIORITY contains ranks, which are larger for more important targets, because 32-bit integers "
            f"cannot represent the priorities; the column {EXACT} contains the priorities"
        )


def file_name(_: QTable, tile: str) -> str:
    """Return the name of the file of a tile, with the number of the tile in six digits."""
    return f"fiberassign-{tile:0>6}.fits"


def lost(plan: QTable) -> list[str]:
    """Return a list of texts that describe which data a fiberassign file cannot represent."""
    known = {*COMMON, "fiber_type", "kind", "assigned", "spectrograph"}
    known |= {*plan.colnames} - {"theta", "phi"} if _is_own(plan) else set()
    return plan_values.texts_of_lost(plan, known, FORMAT, several_roles=True)


def _column(table, name, path) -> np.ndarray:
    """Return a column as text, or as numbers in the unit of the data model; raise an error for a wrong type or unit."""
    what, column = f"{path}: column {name!r}", table[name]
    values = to_plain(column, what)
    expected = "U" if name == "OBJTYPE" else "f" if name == EXACT or COLUMNS[name].type[0] == "f" else "iu"
    fits = values.dtype.kind in ("iuf" if expected == "f" else expected)
    if values.ndim != 1 or not fits:
        kind = {"U": "text", "f": "numbers", "iu": "whole numbers"}[expected]
        raise InputTypeError(f"{what} must hold {kind}, got {values.dtype.name} of the shape {values.shape}")
    unit, given = None if name == EXACT else COLUMNS[name].unit, getattr(column, "unit", None)
    if unit is not None and given is not None:
        if not given.is_equivalent(unit):
            raise InputError(f"{what} must have a unit convertible to {unit}, got {given}")
        values = values if given == unit else (values * given).to_value(unit)
    return values


def _is_assigned(status, target) -> np.ndarray:
    """Return whether each fiber is on a target.

    Fibers of stuck positioners are regarded as not on targets, although they may be on blank sky.
    """
    return ((status & (UNASSIGNED | STUCK | BROKEN)) == 0) & (target >= 0)


def _kinds(values) -> np.ndarray:
    """Return the kinds of targets, with all roles of each target."""
    if "FA_TYPE" in values:
        bits = values["FA_TYPE"]
        roles = (("science", SCIENCE), ("standard", STANDARD), ("sky", SKY | SUPPLEMENTAL_SKY))
        sums, rows = np.unique(bits, return_inverse=True)
        names = ["+".join(role for role, bit in roles if bits_of_target & bit) for bits_of_target in sums.tolist()]
        return np.array([*names, "standard"])[rows.reshape(-1)]  # text of at least eight characters, even without rows
    if "OBJTYPE" in values:
        word = np.char.strip(values["OBJTYPE"])
        conditions = [word == "SKY", np.zeros(len(word), dtype=bool), word == "TGT"]
    else:
        return np.full(len(values["LOCATION"]), "", dtype="U8")
    return np.select(conditions, ["sky", "standard", "science"], "")


def _angle(header, name, path):
    value = header.get(name)
    if value is not None and (isinstance(value, bool | str) or not np.isfinite(value)):
        raise InputError(f"{path}: the keyword {name} must be an angle in degrees, got {value!r}")
    return None if value is None else float(value)


def _epoch(years):
    """Return the epoch of target positions, or None if REF_EPOCH has no positive value or several different ones."""
    years = np.unique(years[years > 0]) if years is not None else []
    return f"J{years[0]:.3f}" if len(years) == 1 else None


def _header(plan) -> dict:
    """Return the keywords of the primary header.

    A plan that was read from a fiberassign file keeps the keywords of that file. Other plans get only a few keywords.
    """
    if _is_own(plan):
        header = dict(plan.meta["header"])
    else:
        tile, conditions = str(plan.meta.get("survey", {}).get("tile")), plan.meta.get("conditions", {})
        header = {"TILEID": int(tile) if tile.isdecimal() else 0, "FIELDNUM": 0}
        header |= {name: conditions[entry] for name, entry in WHEN.items() if entry in conditions}
    for name, entry in POINTING.items():
        if plan.meta.get(entry) is not None and (name in header or not _is_own(plan)):
            header[name] = plan.meta[entry]
    if plan.meta.get("position_angle") is not None and ("FIELDROT" in header or not _is_own(plan)):
        header["FIELDROT"] = 0.0 - plan.meta["position_angle"]
    header.pop(RANKS, None)
    return plan_values.without_keywords(header) | plan_values.to_keywords(plan.meta)


def _is_own(plan) -> bool:
    return plan.meta.get("format") == FORMAT


def _columns(plan, header, path) -> dict:
    """Return the columns of FIBERASSIGN, by name.

    The columns have the order of the file from which the plan was read or, for plans of other formats, of ``COLUMNS``.
    """
    assigned, kind = np.asarray(plan["assigned"], dtype=bool), np.asarray(plan["kind"]).astype(str)
    location = _locations(plan, path)
    bits = np.array([sum(KINDS.get(role, SCIENCE) for role in roles.split("+")) for roles in kind.tolist()], dtype="u1")
    words = np.where(bits == SKY, "SKY", np.where(bits > 0, "TGT", ""))
    common = {name: plan[common_name] for common_name, name in COMMON.items() if common_name in plan.colnames}
    common["FIBERASSIGN_X"] = -plan["x"]
    if "PRIORITY" in common:
        common |= _priorities(np.asarray(common["PRIORITY"]), assigned)
        if EXACT in common:
            header[RANKS] = f"PRIORITY: ranks of {EXACT}"
    if _is_own(plan):
        names = {plan_values.own_name(name): name for name in plan.meta.get("columns", ())}
        known = (*COMMON, "fiber_type", "kind", "assigned")
        columns = {names.get(name, name): plan[name] for name in plan.colnames if name not in known}
        columns |= common
        status = np.array(columns["FIBERSTATUS"]).astype("i8")
        edited = assigned != _is_assigned(status, np.asarray(common["TARGETID"]))
        status[edited & assigned] &= ~(UNASSIGNED | STUCK | BROKEN)
        status[edited & ~assigned] |= UNASSIGNED
        columns["FIBERSTATUS"] = status.astype(np.asarray(columns["FIBERSTATUS"]).dtype)
        edited = kind != _kinds({name: np.asarray(column) for name, column in columns.items()})
        for name, values in (("FA_TYPE", bits), ("OBJTYPE", words)):
            if name in columns and edited.any():
                columns[name] = np.where(edited, values, np.asarray(columns[name]))
    else:
        usual = {name: np.full(len(plan), column.usual) for name, column in COLUMNS.items() if column.usual is not None}
        columns = (
            usual
            | {
                "PETAL_LOC": location // 1000,
                "DEVICE_LOC": location % 1000,
                "FIBERSTATUS": np.where(assigned, 0, UNASSIGNED),
                "FA_TYPE": np.where(assigned & (bits == 0), SCIENCE, bits),
                "OBJTYPE": np.where(assigned & (bits == 0), "TGT", words),
                "REF_EPOCH": np.full(len(plan), _year(plan.meta.get("epoch"))),
            }
            | common
        )
        columns["TARGETID"] = _targets(plan["target_id"], location, assigned, header["TILEID"], path)
    for name, native in COLUMNS.items():
        if name in columns and not (_is_own(plan) and _has_kind(columns[name], native.type)):
            columns[name] = _typed(columns[name], native.type, native.unit, f"{path}: {name}")
    order = dict.fromkeys([*plan.meta.get("columns", COLUMNS), *columns])
    return {name: columns[name] for name in order if name in columns}


def _locations(plan, path) -> np.ndarray:
    """Return the LOCATION in DESI of each positioner of a plan."""
    plan_values.check_instrument(plan, path, "a fiberassign file", "desi")
    ids = np.asarray(plan["positioner"])
    wrong = np.ones(len(ids), dtype=bool)
    if ids.dtype.kind in "iu":
        wrong = (ids < 0) | (ids // 1000 >= N_PETALS) | (ids % 1000 > MOST_DEVICE)
    if wrong.any():
        raise InputError(
            f"{path}: positioner must be a LOCATION of DESI (1000 times the petal plus the device), got "
            f"{ids[wrong][0]}; plan with DESI as built (Instrument.from_desi, or --instrument with the path of a file "
            "such as fp-metrology.csv), whose identifiers are locations, instead of the preset"
        )
    check_unique(ids, f"{path}: LOCATION")
    return ids.astype(np.int64)


def _priorities(values, assigned) -> dict:
    """Return the columns of priorities: PRIORITY and, if 32-bit integers cannot represent all priorities, also EXACT.

    Without the column EXACT, the priority of fibers without a target is 0 if it is missing. With this column, PRIORITY
    contains ranks: 1 for the smallest priority, and 0 for missing priorities.
    """
    known = np.isfinite(values) if values.dtype.kind == "f" else np.ones(len(values), dtype=bool)
    whole = np.where(known | assigned, values, 0)
    try:
        return {"PRIORITY": plan_values.to_type(whole, "i4", "PRIORITY")}
    except InputError:
        rank = np.zeros(len(values), dtype="i4")
        rank[known] = np.unique(values[known], return_inverse=True)[1].reshape(-1) + 1
        return {"PRIORITY": rank, EXACT: values}


def _has_kind(column, kind) -> bool:
    """Return whether a column has a type of the same kind as in the data model, which is written unchanged."""
    return np.asarray(column).dtype.kind in {"i": "iu", "u": "iu", "f": "f", "U": "SUO"}[np.dtype(kind).kind]


def _targets(ids, location, assigned, tile, path) -> np.ndarray:
    """Return the identifiers of the targets; each fiber without a target has its own negative number."""
    values = np.where(assigned, np.asarray(ids), 0 if np.asarray(ids).dtype.kind in "iuf" else "0")
    return np.where(assigned, plan_values.to_type(values, "i8", f"{path}: target_id"), -1 - 10_000 * tile - location)


def _year(epoch) -> float:
    """Return the year of an epoch such as J2026.500, or 0 if the epoch is unknown."""
    match = re.fullmatch(r"J(\d+(?:\.\d+)?)", str(epoch))
    return float(match[1]) if match else 0.0


def _typed(column, kind, unit, what):
    """Return a column with the type of the data model; raise an error if this type cannot represent the values."""
    values = column.to_value(unit) if unit is not None and isinstance(column, u.Quantity) else to_plain(column)
    values = values.astype(kind) if np.dtype(kind).kind == "U" else plan_values.to_type(values, kind, what)
    return values if unit is None else u.Quantity(values, unit)


def _to_hdu(name, columns, header, path):
    """Return a table as a FITS extension; units are written as text, even if the FITS standard does not define them."""
    from astropy.io import fits

    plain = Table({key: getattr(column, "value", column) for key, column in columns.items()}, copy=False)
    check_fits_text({f"values of {key} for {path}": np.asarray(plain[key]) for key in columns}, "write a table in ECSV")
    for column in plain.itercols():
        column.unit = None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # ignore warnings about names of columns
        hdu = fits.table_to_hdu(plain)
    for k, column in enumerate(columns.values(), 1):
        if getattr(column, "unit", None) is not None:
            hdu.header[f"TUNIT{k}"] = str(column.unit)
    _add(hdu.header, {**header, **({"EXTNAME": name} if name else {})}, path)
    return hdu


def _add(header, keywords, path) -> None:
    """Add keywords to a header."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # ignore warnings about names with more than eight characters
        for name, value in keywords.items():
            try:
                header[f"HIERARCH {name}" if "." in name else name] = value
            except ValueError as error:
                raise InputError(f"{path}: the keyword {name} cannot be written: {sentence(error)}") from None
