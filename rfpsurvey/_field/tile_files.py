"""The content of the files of tiles, and the check of a table that is to be a tile."""

from pathlib import Path

import numpy as np
from astropy.table import QTable

from rfpsurvey._common import io as _io
from rfpsurvey._common.descriptions import COPIED, describe
from rfpsurvey._common.read_tables import read_table
from rfpsurvey._field.plan_files import find_instrument_file
from rfpsurvey._field.table import OUTCOMES_COLUMNS, TILE_COLUMNS, id_column, without_masks
from rfpsurvey.errors import InputError, InputTypeError

SUMMARY = ("n_positioners", "n_assigned", "n_colliding", "collision_rate", "seconds")
MUST_HAVE = [f"summary.{name}" for name in SUMMARY]
MUST_HAVE += [f"provenance.{name}" for name in ("instrument.name", "parameters.allocator", "catalog")]
"""Entries of the ``meta`` of the table of each tile."""


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
    find_instrument_file(table := read_table(path), _io.to_path(path))
    try:
        table.meta = {k: v for k, v in table.meta.items() if not k.startswith("__")}
        has_target = np.isin(table["status"], ("assigned", "out_of_reach"))
        table["target_id"] = id_column(table["target_id"], has_target)
        check_tile(table := describe(without_masks(table), TILE_COLUMNS, COPIED))
    except KeyError as error:
        raise InputError(f"{path} does not hold a tile: the column {error.args[0]} is missing") from None
    except InputError as error:
        raise InputError(f"{path} does not hold a tile: {error}") from None
    if not table.meta["provenance"].get("outcomes") or not _io.is_fits(_io.to_path(path)):
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
