"""Plans as plain tables (ECSV or FITS), and tiles of this package."""

from pathlib import Path

from astropy.table import MaskedColumn, QTable

from rfpsurvey._io import read_table, suffix_of, write_table
from rfpsurvey.errors import InputError
from rfpsurvey.plans._plan import as_plan, is_plan, is_tile

__all__ = ["lost", "read", "recognizes", "write"]


def read(path: Path) -> QTable:
    """Return the plan that a table contains."""
    table = read_table(path)
    if not is_plan(table) and not is_tile(table):
        raise InputError(f"{path}: the table must be a tile, or a plan that write_plan wrote")
    for name in table.colnames:  # ECSV files do not distinguish empty text from missing values
        if isinstance(table[name], MaskedColumn) and table[name].dtype.kind == "U":
            table[name] = table[name].filled("")
    return as_plan(table)


def write(plan: QTable, path: Path, *, overwrite: bool) -> None:
    """Write a plan as ECSV or FITS, without the other tables of the file from which the plan was read."""
    plan = plan.copy(copy_data=False)
    plan.meta.pop("extensions", None)
    write_table(plan, path, overwrite=overwrite, name="PLAN")


def recognizes(path: Path) -> bool:
    """Return whether a file contains the table of a plan or of a tile."""
    if suffix_of(path) not in (".ecsv", ".fits"):
        return False
    try:
        table = read_table(path)
    except InputError:
        return False
    return is_plan(table) or is_tile(table)


def lost(plan: QTable) -> list[str]:
    """Return a list of texts that describe which data this format cannot represent."""
    return ["the other tables of the file from which the plan was read"] if plan.meta.get("extensions") else []
