"""Read tables in all supported formats, of limited size, and convert columns with units to quantities.

Error messages are single sentences. The columns of Parquet files can have missing values, categories, and types that
NumPy does not have. Integers that floats cannot represent are not converted to quantities.
"""

import os
import warnings
from importlib import import_module
from pathlib import Path

import numpy as np
from astropy.table import Column, QTable, Table
from astropy.units import Unit, UnrecognizedUnit, dimensionless_unscaled

from rfpsurvey._common.files import FORMATS, is_fits, suffix_of, to_path
from rfpsurvey._common.read_documents import check_is_file, check_size, check_width, parse_json, reading
from rfpsurvey._common.read_fits import META_KEY, read_all_fits, read_fits
from rfpsurvey.errors import INCONVERTIBLE, InputError, refusal, short, warn

READERS = {
    "ascii.ecsv": ("read_text", "read_ecsv"),
    "ascii.csv": ("read_text", "read_csv"),
    "votable": ("read_votable", "read_votable"),
    "parquet": ("read_tables", "read_parquet"),
}
"""Module and name of the reader of each format except FITS; the modules are imported on first use."""
STRUCTURE = ("SIMPLE", "BITPIX", "NAXIS", "EXTEND", "CHECKSUM", "DATASUM", "COMMENT", "HISTORY")
MOST_EXACT = 2**53
# The memory of the values of all rows is limited to MOST_RATIO times the size of the file or to FREE bytes, whichever
# is larger. MOST_RATIO is large because repeated values take little space in the file.
MOST_RATIO, FREE = 1000, 2**28
UNITS_KEY = b"table_meta_yaml"


def read_table(
    path: str | os.PathLike, hdu: int | str | None = None, remedy: str = "", *, padded: bool = True
) -> QTable:
    """Read a table in one of `FORMATS`.

    ``hdu`` is the number or the name of one of several tables in a FITS file. Without ``hdu``, a warning about several
    tables ends with ``remedy``, which describes how to read another table. If ``padded`` is False, a FITS file without
    its final padding is read with a warning.
    """
    path = to_path(path)
    suffix = suffix_of(path)
    if suffix not in FORMATS:
        raise InputError(f"{path}: the name of a table must end in one of {', '.join(FORMATS)} (.gz may follow)")
    if hdu is not None and (isinstance(hdu, bool) or not isinstance(hdu, int | np.integer | str)):
        raise refusal("hdu must be the number or the name of a table", hdu)
    check_is_file(path)
    if hdu is not None and not is_fits(path):
        raise InputError(f"{path}: hdu must be used only with FITS files, got {short(hdu)}")
    with reading(path, FORMATS[suffix]):
        if is_fits(path):
            table = read_fits(path, hdu, remedy, padded=padded)
        else:
            module, name = READERS[FORMATS[suffix]]
            table = getattr(import_module(f"rfpsurvey._common.{module}"), name)(path)
        table = _checked(table, path)
    if META_KEY in table.meta:
        table.meta = parse_json(table.meta[META_KEY], f"{path}: the header card {META_KEY}")
    return table


def read_tables(path: str | os.PathLike) -> tuple[dict, list[QTable]]:
    """Return the keywords of the first header of a FITS file, and all of its tables.

    Keywords that describe the structure of the file are omitted. The ``meta`` of each table contains the keywords of
    its header; the keyword ``EXTNAME`` contains the name of the table.
    """
    path = to_path(path)
    with reading(path, "fits"):
        header, tables = read_all_fits(path)
        tables = [_checked(table, path) for table in tables]
    for table in tables:
        table.meta = _keywords(table.meta)
    return _keywords(header), tables


def _checked(table: Table, path: Path) -> QTable:
    """Return a table with quantities and text, after a check of its size."""
    table = with_quantities(table, f"{path}: ")
    for name in table.colnames:
        _make_text(table, name, path)
    check_size(table.meta, path)
    return table


def _keywords(header: dict) -> dict:
    """Return the keywords that have a single value and do not describe the structure of a file."""
    return {
        name: value
        for name, value in header.items()
        if name and name not in STRUCTURE and isinstance(value, str | int | float | bool)
    }


def _make_text(table: QTable, name: str, path: Path) -> None:
    """Convert a column of bytes to text; raise an error if a column of text objects would need too much memory."""
    column = table[name]
    kind = getattr(getattr(column, "dtype", None), "kind", "")
    if kind == "S":
        try:
            text = np.char.rstrip(np.char.decode(np.asarray(column), "utf-8"))
        except UnicodeDecodeError as error:
            raise InputError(
                f"{path}: column {name!r} must contain text in ASCII or UTF-8, got the bytes {error.object[:20]!r}"
            ) from None
        _replace(table, name, text)
    elif kind == "O" and column.ndim == 1 and all(isinstance(v, str) for v in np.asarray(column)):
        check_width(
            path, len(column), max(map(len, np.asarray(column)), default=0), path.stat().st_size, f"a value of {name!r}"
        )


def _replace(table: QTable, name: str, values: np.ndarray) -> None:
    mask = getattr(table[name], "mask", None)
    if mask is not None and np.any(mask):
        values = np.ma.array(values, mask=mask)
    info = table[name].info
    description, meta = info.description, info.meta
    table[name] = values
    table[name].info.description = description
    if meta:
        table[name].info.meta = meta


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


def import_parquet():
    """Return the module that reads and writes Parquet files."""
    try:
        import pyarrow.parquet
    except ImportError as error:
        text = f"Parquet files need another package: {error} (pip install 'rfpsurvey[parquet]')"
        raise InputError(text) from error
    return pyarrow.parquet


def read_parquet(path: Path, names: list[str] | None = None) -> Table:
    """Return a table from a Parquet file: the columns ``names``, or by default all columns that NumPy can represent.

    Columns of times and dates become columns of the NumPy type datetime64. Columns of lists, structures or durations
    are omitted.
    """
    parquet, reads_all = import_parquet(), names is None
    with reading(path, "parquet"):
        with parquet.ParquetFile(path, page_checksum_verification=True) as file:
            n_rows, schema, size = file.metadata.num_rows, file.schema_arrow, path.stat().st_size
            names = [name for name in names or schema.names if _is_plain(schema.field(name).type)]
            if not 0 <= 8 * n_rows * max(len(names), 1) <= max(FREE, MOST_RATIO * size):
                raise InputError(
                    f"{path}: the number of rows must agree with the size of the file, {size} bytes, got {n_rows} rows"
                )
            content = file.read(columns=names)
        if content.num_rows != n_rows:
            raise InputError(f"{path}: the table must have {n_rows} rows, got {content.num_rows}")
        table = _with_units(_to_table(content, names, path), schema.metadata or {}, f"{path}: ")
        return _with_index(table, schema.metadata or {}) if reads_all else table


def table_of_arrow(content: object) -> Table:
    """Return a table from an Arrow table in memory, with the columns that NumPy can represent."""
    names = [name for name in content.schema.names if _is_plain(content.schema.field(name).type)]
    metadata = content.schema.metadata or {}
    return _with_index(_with_units(_to_table(content, names, None), metadata), metadata)


def _is_plain(kind) -> bool:
    """Return whether NumPy can represent a column of this Arrow type."""
    from pyarrow import BaseExtensionType, types

    if types.is_dictionary(kind):
        kind = kind.value_type
    if isinstance(kind, BaseExtensionType):
        return False
    return not _is_any(kind, "nested", "duration", "time", "interval", "run_end_encoded")


def _is_any(kind, *names: str) -> bool:
    """Return whether an Arrow type is one of several types, given by their names."""
    from pyarrow import types

    return any(getattr(types, f"is_{name}")(kind) for name in names)


def _to_table(content, names: list[str], path: Path | None) -> Table:
    """Return a table from Arrow columns, with missing values masked."""
    return Table({name: _to_array(content[name], name, path) for name in names}, copy=False)


def _to_array(column, name: str, path: Path | None) -> np.ndarray:
    import pyarrow as pa
    from pyarrow import types

    if types.is_dictionary(column.type):
        column = column.cast(column.type.value_type)
    if _is_any(column.type, "decimal", "null"):
        column = column.cast(pa.float64())
    missing = np.asarray(column.is_null()) if column.null_count else None
    if _is_any(column.type, "string", "large_string", "string_view"):
        values = _texts(column, path, name)
    elif _is_any(column.type, "binary", "large_binary", "binary_view", "fixed_size_binary"):
        values = np.array([_decoded(value, path, name) for value in column.to_pylist()], dtype=str)
    else:
        if missing is not None and types.is_boolean(column.type):
            column = column.fill_null(False)
        elif missing is not None and types.is_integer(column.type):
            column = column.fill_null(0)
        values = np.array(column.to_numpy())  # arrays of pyarrow can be read-only
    return values if missing is None else np.ma.array(values, mask=missing)


def _texts(column, path: Path | None, name: str) -> np.ndarray:
    import pyarrow.compute as pc

    longest = pc.max(pc.utf8_length(column)).as_py() or 0
    if path is not None:
        check_width(path, len(column), longest, path.stat().st_size, f"a value of the column {name!r}")
    return column.fill_null("").to_numpy().astype(f"U{max(longest, 1)}")


def _decoded(value: bytes | None, path: Path | None, name: str) -> str:
    try:
        return "" if value is None else value.decode("utf-8")
    except UnicodeDecodeError:
        where = "" if path is None else f"{path}: "
        raise InputError(f"{where}column {name!r} must hold numbers or text, got the bytes {value[:20]!r}") from None


def _with_index(table: Table, metadata: dict) -> Table:
    """Return the table; if the index that pandas stored is a range with a name, add the index as a column."""
    for index in parse_json(metadata.get(b"pandas", b"{}").decode("utf-8"), "pandas").get("index_columns", []):
        if isinstance(index, dict) and index.get("kind") == "range" and isinstance(index.get("name"), str):
            numbers = range(*(int(index[name]) for name in ("start", "stop", "step")))
            if len(numbers) == len(table) and index["name"] not in table.colnames:
                table[index["name"]] = np.arange(numbers.start, numbers.stop, numbers.step)
    return table


def unit_metadata(table: Table) -> dict[bytes, bytes]:
    """Return the metadata with which astropy states the units of the columns of a table in a Parquet file."""
    from astropy.table import meta

    plain = Table(table[:0])
    plain.meta = {}
    return {UNITS_KEY: "\n".join(meta.get_yaml_from_table(plain)).encode()}


def _with_units(table: Table, metadata: dict, where: str = "") -> Table:
    """Return the table with the units and coordinate columns that astropy wrote to the metadata."""
    text = metadata.get(UNITS_KEY)
    if text is None:
        return table
    from astropy.table import meta, serialize

    header = meta.get_header_from_yaml(text.decode("utf-8").split("\n"))
    for about in header.get("datatype", []):
        if about["name"] in table.colnames:
            for attribute in ("description", "format", "unit", "meta"):
                if attribute in about:
                    setattr(table[about["name"]], attribute, about[attribute])
    table.meta.update(header.get("meta", {}))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        table = serialize._construct_mixins_from_columns(table)
    return with_quantities(table, where)
