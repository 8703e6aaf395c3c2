"""Columns of a catalog that are included in results, but that allocators do not read."""

from collections.abc import Mapping

import astropy.units as u
import numpy as np
from astropy.table import QTable, Table
from astropy.utils.masked import Masked
from astropy.utils.shapes import ShapedLikeNDArray

from rfpsurvey._descriptions import OUTCOMES_COLUMNS, TILE_COLUMNS, VISITS_COLUMNS
from rfpsurvey._outputs import check_text
from rfpsurvey._readers import is_known, without_unit
from rfpsurvey._units import to_plain
from rfpsurvey.errors import InputError, InputTypeError, listed, short, warn

RESERVED = frozenset({"tile", *TILE_COLUMNS, *OUTCOMES_COLUMNS, *VISITS_COLUMNS})
"""Names of the columns that results always contain."""
MOST_EXACT = 2**53
COLUMN_KINDS = {"b": "b", "i": "i", "u": "i", "f": "f", "U": "U", "S": "U"}


def pick_columns(table: Table, keep: object, used: set) -> QTable | None:
    """Return the columns of a table whose names are in ``keep`` but not in ``used``, or None if there are none."""
    if keep is None:
        return None
    if not isinstance(keep, str | list | tuple):
        raise InputTypeError(f"keep must be a list of column names, got {short(keep)}")
    names = [keep] if isinstance(keep, str) else list(keep)
    for name in names:
        if name not in table.colnames:
            raise InputError(
                f"columns that are kept, or that a rule uses, must be columns of the table ({listed(table.colnames)}), "
                f"got {name!r}"
            )
    names = [name for name in names if name not in used]
    return extra_columns({name: table[name] for name in names}, len(table)) if names else None


def extra_columns(columns: object, n: int) -> QTable | None:
    """Convert columns to numbers, quantities, booleans or text, with one value for each of n targets.

    Missing numbers become NaN, and missing text becomes empty. The columns can be written to all formats of files
    except for characters outside ASCII: text has no blanks at its ends, and numbers have at most 64 bits.
    """
    if columns is None:
        return None
    if not isinstance(columns, Mapping | Table):
        raise InputTypeError(f"extra must be a dict or a table of columns, got {type(columns).__name__}")
    names = columns.colnames if isinstance(columns, Table) else list(columns)
    for name in map(str, names):
        if not name.isprintable() or name != name.strip() or not name:
            raise InputError(f"the name of a column in keep must be text without blanks at its ends, got {name!a}")
    extra = QTable({str(name): _plain(columns[name], str(name)) for name in names})
    if len(extra) != n:
        raise InputError(f"columns of extra must have one value for each of the {n} targets, got {len(extra)} values")
    return extra


def result_name(name: str) -> str:
    """Return the name of an extra column in results: the prefix ``target_`` is added to names in ``RESERVED``.

    The comparison of names ignores case, because FITS does not distinguish column names that differ only in case.
    """
    while name.lower() in RESERVED:
        name = f"target_{name}"
    return name


def _plain(column, name):
    if isinstance(column, ShapedLikeNDArray) and not isinstance(column, Masked):  # such as Time and SkyCoord
        raise InputError(
            f"column {name!r} in keep must contain numbers, text or booleans, got a {type(column).__name__}"
        )
    unit = getattr(column, "unit", None)
    values, missing = getattr(column, "value", column), np.ma.getmaskarray(np.ma.asarray(column))
    if isinstance(column, Masked):
        values, missing = getattr(column.unmasked, "value", column.unmasked), np.asarray(column.mask)
    values = np.asarray(values)
    values = values.astype(values.dtype.newbyteorder("="), copy=False)
    if values.dtype.kind == "O":
        values, missing = _of_objects(values, missing, name)
    if values.ndim != 1 or values.dtype.kind not in COLUMN_KINDS:
        raise InputError(
            f"column {name!r} in keep must contain one number, text or boolean per target, got the type "
            f"{values.dtype} and the shape {values.shape}"
        )
    kind = COLUMN_KINDS[values.dtype.kind]
    if kind == "U":
        values = np.char.strip(np.where(missing, "", to_plain(values, f"column {name!r} in keep")))
        check_text(values, f"column {name!r} in keep")
        return values
    if kind == "f" and values.dtype.itemsize not in (4, 8):  # files contain numbers of 32 or 64 bits
        values = values.astype(float)
    if missing.any() and kind == "i" and np.abs(values[~missing].astype(float)).max(initial=0) >= MOST_EXACT:
        raise InputError(
            f"column {name!r} in keep must not have missing values: missing values become NaN, but floats cannot "
            "represent the integers of this column exactly"
        )
    if missing.any():
        values = np.where(missing, np.nan, values.astype(float))
    elif kind == "i":
        if values.max(initial=0) >= 2**63:
            raise InputError(f"column {name!r} in keep must contain integers below 2**63, got {values.max()}")
        values = values.astype(np.int64)
    if unit is None or unit == u.dimensionless_unscaled:
        return values
    if values.dtype.kind == "i" and without_unit(values, f"the column {name!r}", unit):
        return values
    if not is_known(unit):
        warn(f"the column {name!r} is kept without its unit, {unit}, whose name astropy does not know")
        return values
    return values.astype(float) * u.Unit(unit)


def _of_objects(values, missing, name):
    """Convert a column of Python objects, as in pandas, to text or numbers."""
    missing = missing | np.array([v is None or v is np.ma.masked or v != v for v in values.tolist()], dtype=bool)
    known = values[~missing].tolist()
    if all(isinstance(v, str) for v in known):
        return np.array([v if isinstance(v, str) else "" for v in values.tolist()], dtype=str), missing
    if all(isinstance(v, int | float | np.number) for v in known):
        return np.array([0.0 if gone else float(v) for v, gone in zip(values.tolist(), missing, strict=True)]), missing
    raise InputError(f"column {name!r} in keep must contain numbers or text, got objects of other types")
