"""Convert columns with units to quantities, except integers that floating-point numbers cannot represent."""

import warnings

import numpy as np
from astropy.table import Column, QTable, Table
from astropy.units import Unit, UnrecognizedUnit, dimensionless_unscaled

from rfpsurvey.errors import warn

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
