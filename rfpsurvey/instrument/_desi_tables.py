"""Read and check columns of the tables of observatories; values that cannot be true count as missing."""

import astropy.units as u
import numpy as np

from rfpsurvey._readers import is_number
from rfpsurvey._units import check_columns, rows_of, to_plain
from rfpsurvey.errors import InputError, InputTypeError, InputUnitsError, number_of

MOST_DEVICE, N_PETALS = 542, 10  # LOCATION is 1000 times the petal plus the device
MOST_ANGLE = 400.0
"""Largest absolute value of a joint angle that can be true, deg."""
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
    converted = (values * given).to_value(unit)
    low = -most if low is None else low
    for k in np.flatnonzero(is_missing(converted, low, most, codes=codes)):
        raise InputError(
            f"{what} must hold numbers from {low:g} to {most:g} {unit}{', and no codes such as 99 or -999' * codes}, "
            f"got {converted[k]:g} in row {table[ROW][k]}"
        )
    return converted


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
    text = [value for value in values.tolist() if not is_number(value)]
    return f"{values.dtype.name}" if not text else f"{text[0]!r}"


CODES = np.array([99, 999, 9999, 99999, 999999], dtype=float)
"""Numbers that observatories write instead of missing values, with either sign."""


IMPOSSIBLE = "layout.impossible_values"
"""Name of the value of an instrument that counts the positioners with impossible values in the files."""


def entry(value: object, source: str, status: str = "published", unit: str | None = None) -> dict:
    """Return an entry of the values of an instrument."""
    return {"value": value, **({} if unit is None else {"unit": unit}), "status": status, "source": source}


def impossible_entry(n: int, source: str) -> dict:
    """Return the value of an instrument that counts positioners with impossible values; empty if there are none."""
    return {IMPOSSIBLE: entry(n, source, "derived")} if n else {}


def impossible_sentence(instrument) -> str:
    """Return text with the number of positioners with impossible values in the files of an instrument."""
    n = instrument.values.get(IMPOSSIBLE, {}).get("value", 0)
    if not n:
        return ""
    n_disabled = np.count_nonzero(instrument.focal_plane.disabled)
    return (
        " The files of the instrument have impossible values, which count as missing, for "
        f"{number_of(n, 'positioner')} (see its notes); {n_disabled} of all positioners are disabled."
    )


def is_missing(values: np.ndarray, low: float, high: float, *, codes: bool = True) -> np.ndarray:
    """Return whether values are NaN, are outside physical limits, or are codes for missing values.

    If ``codes`` is False, codes between the limits are valid values.
    """
    wrong = ~((values >= low) & (values <= high))
    return wrong | np.isin(np.abs(values), CODES) if codes else wrong
