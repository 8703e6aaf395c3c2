"""Read and check columns of the tables of DESI."""

import astropy.units as u
import numpy as np

from rfpsurvey._readers import is_number
from rfpsurvey._units import check_columns, rows_of, to_plain
from rfpsurvey.errors import InputError, InputTypeError, InputUnitsError, number_of
from rfpsurvey.instrument._missing import is_missing

MOST_DEVICE, N_PETALS = 542, 10  # LOCATION is 1000 times the petal plus the device
ROW = "_row"
"""Name of a column with the number of each row in the file, counted from 1."""

SPELLED = {"degrees": u.deg}
"""Names of units that desimodel writes and astropy does not accept."""


def number_rows(table, names, path) -> None:
    """Raise an error if a table is empty or lacks a column; number the rows."""
    check_columns(table.colnames, names, f"{path}: the table")
    if len(table) == 0:
        raise InputError(f"{path}: the table must have at least one row, got none")
    table[ROW] = np.arange(1, len(table) + 1)


def numbers(
    table, name: str, unit: u.UnitBase, path, most: float = np.inf, *, low: float | None = None, codes: bool = False
) -> np.ndarray:
    """Return a column of finite numbers in a unit; a column without a unit is assumed to have this unit.

    Numbers from ``low`` (by default, ``-most``) to ``most`` are valid, except codes for missing values if ``codes`` is
    true.
    """
    column, what = table[name], f"{path}: column {name!r}"
    values = to_plain(column, what)
    if values.dtype.kind not in "iuf" or values.ndim != 1:
        raise InputTypeError(f"{what} must hold one number for each row, got {_example(values)}")
    given = getattr(column, "unit", None)
    given = SPELLED.get(str(given), given) or unit
    if not given.is_equivalent(unit):
        raise InputUnitsError(f"{what} must have a unit convertible to {unit}, got {given}")
    missing = ~np.isfinite(values)
    if missing.any():
        in_file = np.zeros(table[ROW].max(), dtype=bool)
        in_file[table[ROW][missing] - 1] = True
        raise InputError(f"{what} must hold a finite number for each row, but {rows_of(in_file)} have none")
    found = (values * given).to_value(unit)
    low = -most if low is None else low
    strange = np.flatnonzero(is_missing(found, low, most, codes=codes))
    if len(strange):
        raise InputError(
            f"{what} must hold numbers from {low:g} to {most:g} {unit}{', and no codes such as 99 or -999' * codes}, "
            f"got {found[strange[0]]:g} in row {table[ROW][strange[0]]}"
        )
    return found


def whole(table, name: str, path) -> np.ndarray:
    """Return a column of whole numbers."""
    what = f"{path}: column {name!r}"
    values = to_plain(table[name], what)
    if values.dtype.kind not in "iuf" or values.ndim != 1:
        raise InputTypeError(f"{what} must hold one whole number for each row, got {_example(values)}")
    with np.errstate(invalid="ignore"):
        wrong = ~(values == np.floor(values)) | ~(np.abs(values) < 2.0**53)
    if wrong.any():
        raise InputError(f"{what} must hold a whole number for each row, but {rows_of(wrong)} have none")
    return values.astype(np.int64)


def some(ids, mask) -> str:
    """Return text with the number of positioners for which a mask is true, and the first few of their ids."""
    few = ", ".join(map(str, ids[mask][:3])) + (", ..." if mask.sum() > 3 else "")
    return f"{number_of(int(mask.sum()), 'positioner')} ({few})"


def _example(values) -> str:
    if values.ndim != 1:
        return f"the shape {values.shape}"
    text = [one for one in values.tolist() if not is_number(one)]
    return f"{values.dtype.name}" if not text else f"{text[0]!r}"
