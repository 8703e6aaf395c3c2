"""Plans as plain tables (ECSV or FITS), and tiles of this package."""

from pathlib import Path

import astropy.units as u
import numpy as np
from astropy.table import MaskedColumn, QTable

from rfpsurvey._common.descriptions import COPIED, describe
from rfpsurvey._common.files import WRITABLE, is_fits, suffix_of, to_path
from rfpsurvey._common.io import write_table
from rfpsurvey._common.read_tables import read_table
from rfpsurvey._common.units import to_flags, to_plain, to_unit
from rfpsurvey._field.plan_files import FROM_TILE, as_plan, is_plan, is_tile
from rfpsurvey._field.plan_values import COLUMNS, INSTRUMENT_FILE, find_instrument_file
from rfpsurvey._field.table import OUTCOMES_COLUMNS, TILE_COLUMNS, id_column, without_masks
from rfpsurvey.errors import InputError, InputTypeError, listed, short

ENDINGS = WRITABLE
REQUIRED_OF_TILE = ("id", "target_id", "status", "tip_x", "tip_y")
"""Columns that the table of a tile must have."""
TEXT, NUMBER = (str,), (int, float)
META = {
    **{"format": TEXT, "instrument": TEXT, "epoch": TEXT, "north_of": TEXT, "projection": TEXT, "conditions": (dict,)},
    **{"survey": (dict,), "instrument_digest": TEXT},
    **dict.fromkeys(("racen", "deccen", "position_angle"), NUMBER),
}
"""Entries in the ``meta`` of a plan, or in the provenance of a tile, with their types."""
SUMMARY = ("n_positioners", "n_assigned", "n_colliding", "collision_rate", "seconds")
MUST_HAVE = [f"summary.{name}" for name in SUMMARY]
MUST_HAVE += [f"provenance.{name}" for name in ("instrument.name", "parameters.allocator", "catalog")]
"""Entries of the ``meta`` of the table of each tile."""


def read(path: Path) -> QTable:
    """Return the plan that a table contains."""
    table = read_table(path)
    if not is_plan(table) and not is_tile(table):
        raise InputError(f"{path}: the table must be a tile, or a plan that write_plan wrote")
    for name in table.colnames:  # ECSV files do not distinguish empty text from missing values
        if isinstance(table[name], MaskedColumn) and table[name].dtype.kind == "U":
            table[name] = table[name].filled("")
    names = {name: name for name in COLUMNS}
    if not is_plan(table):
        _check_parts(table, path)
        name_in_tile = {common: name for name, common in FROM_TILE.items()}
        names = {name_in_tile.get(name, name): name for name in COLUMNS if name != "assigned"}
    for name, common in names.items():
        if name in table.colnames:
            _check_column(table, name, common, path)
    plan = as_plan(table)
    _check_meta(plan.meta, path)
    return plan


def write(plan: QTable, path: Path, *, overwrite: bool) -> None:
    """Write a plan as ECSV or FITS, without the other tables of the file from which the plan was read."""
    plan = plan.copy(copy_data=False)
    for name in ("extensions", INSTRUMENT_FILE):
        plan.meta.pop(name, None)
    write_table(plan, path, overwrite=overwrite, name="PLAN")


def recognizes(path: Path) -> bool:
    """Return whether a file contains the table of a plan or of a tile."""
    if suffix_of(path) not in ENDINGS:
        return False
    try:
        table = read_table(path)
    except InputError:
        return False
    return is_plan(table) or is_tile(table)


def lost(plan: QTable) -> list[str]:
    """Return a list of texts that describe which data this format cannot represent."""
    return ["the other tables of the file from which the plan was read"] if plan.meta.get("extensions") else []


def _check_parts(table: QTable, path: Path) -> None:
    """Raise an error if the table of a tile lacks columns, the name of the instrument or the parameters."""
    lacking = [name for name in REQUIRED_OF_TILE if name not in table.colnames]
    if lacking:
        raise InputError(f"{path}: a tile must have the columns {listed(lacking)}, got {listed(table.colnames)}")
    provenance = table.meta["provenance"]
    if not isinstance(provenance.get("parameters"), dict) or not isinstance(provenance.get("instrument"), dict):
        raise InputError(f"{path}: the provenance of a tile must have parameters and the instrument, got {provenance}")
    if not isinstance(provenance["instrument"].get("name"), str):
        raise InputError(f"{path}: the provenance of a tile must have the name of the instrument, got none")


def _check_column(table: QTable, name: str, common: str, path: Path) -> None:
    """Convert a column to the type and the unit of the common column ``common``, or raise an error."""
    column, unit, what = table[name], COLUMNS[common], f"{path}: column {name!r}"
    if len(getattr(column, "shape", ())) != 1:
        raise InputError(f"{what} must have one value per row, got the shape {np.shape(column)}")
    if unit is not None:
        if type(column) is not u.Quantity or column.unit != unit or column.dtype.kind != "f":
            table[name] = to_unit(column, unit, what) * unit
        return
    if common == "assigned":
        table[name] = to_flags(column, what)
        return
    ids = ("iuU", "integers or text")
    kinds, words = {"positioner": ids, "target_id": ids, "priority": ("iuf", "numbers")}.get(common, ("U", "text"))
    values = to_plain(column, what)
    if common == "target_id" and np.any(getattr(column, "mask", False)):  # positioners without a target
        return
    if values.dtype.kind not in kinds:
        raise InputError(f"{what} must hold {words}, got {values.dtype}")


def _check_meta(meta: dict, path: Path) -> None:
    """Raise an error if an entry of the ``meta`` has a wrong type."""
    for name, types in META.items():
        value = meta.get(name)
        if value is None and name not in ("format", "instrument"):
            continue
        if not isinstance(value, types) or isinstance(value, bool) or (types == NUMBER and not np.isfinite(value)):
            words = {TEXT: "text", NUMBER: "a finite number"}.get(types, "a dict")
            raise InputError(f"{path}: {name} in the meta of a plan must be {words}, got {short(value)}")


def check_tile(table: object) -> None:
    """Raise an error if an object is not the table of a tile."""
    if not isinstance(table, QTable):
        raise InputTypeError(f"table must be a QTable, got {type(table).__name__}")
    lacking = [name for name in ("summary", "provenance", "geometry") if name not in table.meta]
    if lacking or "in_collision" not in table.colnames:
        raise InputError("the table does not describe a tile: it lacks " + (", ".join(lacking) or "in_collision"))
    for path in MUST_HAVE:
        value = table.meta
        for name in path.split("."):
            value = value.get(name) if isinstance(value, dict) else None
        if value is None:
            raise InputError(f"the meta of a tile must have the entry {path}, got none")


def read_tile(path: str | Path) -> tuple[QTable, QTable | None]:
    """Return the table of a tile in a file and its outcomes, which files in the format ECSV lack."""
    find_instrument_file(table := read_table(path), to_path(path))
    try:
        table.meta = {k: v for k, v in table.meta.items() if not k.startswith("__")}
        has_target = np.isin(table["status"], ("assigned", "out_of_reach"))
        table["target_id"] = id_column(table["target_id"], has_target)
        check_tile(table := describe(without_masks(table), TILE_COLUMNS, COPIED))
    except KeyError as error:
        raise InputError(f"{path} does not hold a tile: the column {error.args[0]} is missing") from None
    except InputError as error:
        raise InputError(f"{path} does not hold a tile: {error}") from None
    if not table.meta["provenance"].get("outcomes") or not is_fits(to_path(path)):
        return table, None
    return table, describe(without_masks(read_table(path, hdu=2)), OUTCOMES_COLUMNS, COPIED)


def cards_of(tile) -> dict:
    """Return the FITS header cards of a tile."""
    parameters = tile.provenance["parameters"]
    cards = {
        "INSTRUME": (tile.instrument, "instrument"),
        "RA": (parameters.get("ra_deg"), "[deg] right ascension of the field center"),
        "DEC": (parameters.get("dec_deg"), "[deg] declination of the field center"),
        "POSANG": (parameters.get("position_angle_deg"), "[deg] position angle of +y, north toward east"),
        "NORTHOF": (parameters.get("north_of"), "frame or equinox that defines north"),
        "RADESYS": ("ICRS", "frame of right ascensions and declinations"),
        "REFEPOCH": (parameters.get("epoch"), "epoch of the target positions"),
        "ALLOCATR": (parameters.get("allocator"), "allocator"),
        "NASSIGN": (tile.summary["n_assigned"], "positioners with a target"),
        "NCOLLIDE": (tile.summary["n_colliding"], "positioners in collision"),
    }
    return {name: card for name, card in cards.items() if card[0] is not None}
