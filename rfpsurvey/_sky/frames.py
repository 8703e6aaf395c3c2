"""Convert DataFrames of pandas and Polars, Arrow tables and structured arrays of NumPy to astropy tables."""

import numpy as np
from astropy.table import Table

from rfpsurvey._common.read_tables import is_number, table_of_arrow
from rfpsurvey._sky.columns import Finder
from rfpsurvey.errors import InputError, InputTypeError, listed, number_of, refusal, short

PANDAS, ARROW = ("pandas", "DataFrame"), (("polars", "DataFrame"), ("pyarrow", "Table"))
"""Packages and names of the types that are converted to tables."""


def is_table(given: object) -> bool:
    """Return whether an object is a table of astropy or of another package."""
    return isinstance(given, Table) or _is_records(given) or _is_of(given, PANDAS, *ARROW)


def as_table(given: object, columns: dict | None = None, *, index_as_id: bool = True) -> tuple[Table, bool]:
    """Convert an object to an astropy table; also return whether tables of this type cannot have units.

    If the index of a DataFrame has names, the index becomes columns with these names. An index without names becomes
    the column ``id`` if ``index_as_id`` is true and no column contains identifiers.
    """
    if isinstance(given, Table):
        return given, False
    if not isinstance(columns, dict | None):
        raise InputError(f"columns must be a dict from role to column, got {short(columns)}")
    try:
        if _is_records(given):
            return Table(given), True
        if _is_of(given, PANDAS):
            return _of_pandas(given, columns, index_as_id), True
        if _is_of(given, *ARROW):
            given = given.to_arrow() if hasattr(given, "to_arrow") else given
            return table_of_arrow(given), not (given.schema.metadata or {}).get(b"table_meta_yaml")
    except InputError:
        raise
    except Exception as error:  # other packages can raise any exception
        raise InputError(f"{short(given)} cannot be used as a table: {error}") from error
    raise InputTypeError(f"table must be an astropy Table, a QTable or a DataFrame, got {short(given)}")


def select_rows(table: Table, select: dict | None) -> tuple[Table, str]:
    """Return the rows with the given values of columns, and text that states their number.

    Values are compared as text and, if both are numbers, as numbers; missing values are never selected.
    """
    if not isinstance(select, dict | None):
        raise refusal("select must be a dict from column to value", select, dict)
    n = len(table)
    for name, value in (select or {}).items():
        if name not in table.colnames:
            raise InputError(f"select: there is no column {name!r}; the columns are: {listed(table.colnames)}")
        table = table[_has_value(table[name], value)]
        if len(table) == 0:
            raise InputError(f"select must leave at least one row, got {name}={value}, which selects no row")
    chosen = ", ".join(f"{name}={value}" for name, value in (select or {}).items())
    return table, f"; selected: {chosen} ({len(table)} of {number_of(n, 'row')})" if chosen else ""


def _has_value(column, value: object) -> np.ndarray:
    """Return whether each row of a column has a value."""
    texts = np.array([str(getattr(cell, "value", cell)).strip() for cell in column], dtype=str)
    kind, numbers = getattr(getattr(column, "dtype", None), "kind", ""), getattr(column, "value", column)
    matches = np.char.lower(texts) == str(value).lower() if kind == "b" else texts == str(value)
    if kind in "biuf" and np.ndim(column) == 1 and is_number(str(value)):
        numbers = np.ma.getdata(np.ma.asarray(numbers)).astype(float)
        # integers that float64 does not distinguish are compared only as text
        matches |= (numbers == float(value)) & ((kind == "f") | (np.abs(numbers) < 2.0**53))
    mask = np.asarray(getattr(column, "mask", False))
    return matches & ~(mask if mask.ndim == 1 else np.zeros(len(matches), dtype=bool))


def _is_records(given) -> bool:
    """Return whether an object is a structured array or a list of dicts, one for each row."""
    if isinstance(given, list):
        return len(given) > 0 and all(isinstance(row, dict) for row in given)
    return isinstance(given, np.ndarray) and given.ndim == 1 and given.dtype.names is not None


def _is_of(given, *types: tuple[str, str]) -> bool:
    """Return whether an object has one of several types of other packages, without importing these packages."""
    return any((base.__module__.partition(".")[0], base.__name__) in types for base in type(given).__mro__)


def _of_pandas(frame, columns, index_as_id) -> Table:
    names = [str(name) for name in frame.columns]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise InputError(f"the columns of a DataFrame must have different names, got {twice[0]!r} more than once")
    has_names = any(name is not None for name in frame.index.names)
    index, meta = frame.index, dict(frame.attrs)
    frame = frame.reset_index() if has_names else frame.set_axis(names, axis=1)
    table = Table.from_pandas(frame)
    table.meta.update(meta)
    index_as_id = index_as_id and not has_names and index.nlevels == 1
    if index_as_id and names and Finder(table, columns or {}).name_of("id") is None:
        table["id"] = index.to_numpy()
    return table
