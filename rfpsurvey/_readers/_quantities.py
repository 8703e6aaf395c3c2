"""Convert text to numbers, and columns with units to quantities, except integers that floats cannot represent."""

import warnings

import numpy as np
from astropy.table import Column, QTable, Table
from astropy.units import Unit, UnrecognizedUnit, dimensionless_unscaled

from rfpsurvey.errors import INCONVERTIBLE, warn

MOST_EXACT = 2**53


def with_quantities(table: Table, where: str = "") -> QTable:
    """Return a table in which columns with a unit are quantities.

    Columns of integers lose their unit if it is dimensionless, or if floating-point numbers cannot represent the
    integers exactly; in the latter case, a warning that begins with ``where`` is issued.
    """
    for name, column in table.columns.items():
        if isinstance(column, Column) and isinstance(column.unit, UnrecognizedUnit):
            known = Unit(str(column.unit), parse_strict="silent")  # FITS does not know units such as mag(AB)
            column.unit = known if str(known) == str(column.unit) else column.unit
        is_whole = isinstance(column, Column) and column.unit is not None and column.dtype.kind in "iu"
        if is_whole and without_unit(np.ma.filled(column, 0), f"{where}the column {name!r}", column.unit):
            column.unit = None
    with warnings.catch_warnings():  # text can have a unit, such as h:m:s of sexagesimal text
        warnings.filterwarnings("ignore", message="column .* has a unit but is kept as a")
        return QTable(table)


def without_unit(integers: np.ndarray, what: str, unit: object) -> bool:
    """Return whether integers cannot have a unit, because it is dimensionless, or because quantities are not exact."""
    if unit == dimensionless_unscaled:
        return True
    wide = bool(((integers > MOST_EXACT) | (integers < -MOST_EXACT)).any())
    if wide:
        warn(f"{what} is read without its unit, {unit}, because quantities cannot represent its integers exactly")
    return wide


def is_known(unit: object, text: str | None = None, **options: str) -> bool:
    """Return whether astropy converts the text of a unit, by default its name, to the same unit."""
    try:
        return Unit(str(unit) if text is None else text, **options) == Unit(unit)
    except (ValueError, TypeError):
        return False


def is_number(text: object) -> bool:
    """Return whether a value of a table, such as text, can be read as a number."""
    try:
        parse_number(text)
    except INCONVERTIBLE:
        return False
    return True


def parse_number(text: object, kind: type = float) -> float:
    """Return the number in a text; text such as 1_0, which only Python reads as a number, is a ValueError."""
    if isinstance(text, str) and ("_" in text or has_other_digits(text)):
        raise ValueError(f"{text!r} is not a decimal number")
    return kind(text)


def has_other_digits(text: str) -> bool:
    """Return whether a text contains decimal digits other than 0 to 9, such as Arabic ones, which Python reads."""
    return not text.isascii() and any(c.isdecimal() and not c.isascii() for c in text)
