"""Read CSV files (commas or other delimiters) and ECSV files, in which each line is a row."""

import re
import warnings
from pathlib import Path

import numpy as np
from astropy.table import Table
from astropy.units import Unit, UnrecognizedUnit, dimensionless_unscaled

from rfpsurvey._readers._header import find_names
from rfpsurvey._readers._limits import content_of, warn_of_open_end
from rfpsurvey._readers._lines import count_lines, line_number
from rfpsurvey.errors import InputError, warn

MOST_HEADER = 2**18
MOST_CELLS = 100_000
MARK = "x"  # with this prefix, a number is read as text
COMMA = re.compile(rb"^# *delimiter: *['\"]?,", re.MULTILINE)
SHAPE = re.compile(rb"subtype: *['\"]?\w+\[([^\]\n]*)")
WIDE = re.compile(rb"datatype: *['\"]?[<>=|]?[SUVa](\d+)")


def read_csv(path: Path) -> Table:
    """Return the table of a CSV file, delimited by commas, semicolons, tabs or vertical bars; comments begin with #."""
    content, delimiter, units = find_names(path, _checked_content(path))
    n_lines = count_lines(path, content, 0, delimiter)
    if n_lines == 0:
        raise InputError(f"{path}: the first row must contain the names of the columns, got no row")
    if delimiter == b"\t" and b'"' not in content:  # for other delimiters, astropy removes blanks
        content = re.sub(rb" *\t *", b"\t", content)
    # the expression begins with the zero, because a search for a single byte is fast
    zeros = re.compile(rb'0(?<=[\n" %s]0)(?=\d+ *(?:["\r\n%s]|\Z))' % (delimiter, delimiter))
    marked = zeros.sub(MARK.encode() + b"0", content).decode("utf-8") if zeros.search(content) else None
    text = content.decode("utf-8")
    del content
    # only the format "tab" keeps an empty first value
    options = {"format": "tab" if delimiter == b"\t" else "csv", "guess": False, "comment": "#"}
    if delimiter not in b",\t":
        options["delimiter"] = delimiter.decode()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        table = _parse(text, options)
        if marked is not None:
            _keep_leading_zeros(table, _parse(marked, options))
    for message in dict.fromkeys(str(w.message) for w in caught if "FloatType" in str(w.message)):
        warn(f"{path}: {message}")
    table.meta.clear()
    for name in set(units) & set(table.colnames):
        unit = Unit(units[name], parse_strict="silent")
        is_known = not isinstance(unit, UnrecognizedUnit) and unit != dimensionless_unscaled
        if is_known and table[name].dtype.kind in "if":
            table[name].unit = unit
    return _with_all_rows(path, table, n_lines - 1)


def read_ecsv(path: Path) -> Table:
    """Return the table of an ECSV file."""
    content = _checked_content(path)
    warn_of_open_end(path, content)
    begin = _end_of_header(content)
    header = content[:begin]
    if begin > MOST_HEADER:
        raise InputError(f"{path}: the ECSV header must have at most {MOST_HEADER} bytes, got {begin}")
    for found in SHAPE.findall(header):
        sizes = [int(n) for n in re.findall(rb"\d{1,9}", found)]
        if np.prod(sizes, dtype=float) > MOST_CELLS:
            raise InputError(f"{path}: a value must have at most {MOST_CELLS} elements, got [{found.decode()}]")
    for width in WIDE.findall(header):
        if len(width) > 5:
            raise InputError(
                f"{path}: the values of a column must have at most 99999 characters, got the width {width.decode()}"
            )
    from astropy.io import ascii as text_tables

    n_lines = count_lines(path, content, begin, b"," if COMMA.search(header) else b" ", ragged=True)
    lines = content.decode("utf-8").split("\n")
    del content
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        table = text_tables.read(lines, format="ecsv", guess=False)
    return _with_all_rows(path, table, n_lines - 1)


def _parse(text: str, options: dict) -> Table:
    from astropy.io import ascii as text_tables

    if text.isascii():
        if "\n" not in text:  # astropy interprets text without a line break as a path
            text += "\n"
        return text_tables.read(text, fast_reader={"enable": "force"}, **options)
    # the fast reader cannot read characters outside ASCII
    return text_tables.read([line for line in text.split("\n") if _is_data(line)], fast_reader=False, **options)


def _keep_leading_zeros(table: Table, marked: Table) -> None:
    """Restore leading zeros in columns of digits; in the table ``marked``, numbers with leading zeros are text."""
    for name, other in zip(table.colnames, marked.colnames, strict=True):
        if table[name].dtype.kind != "i" or marked[other].dtype.kind != "U":
            continue
        missing = np.ma.getmaskarray(np.ma.asarray(table[name]))
        text = np.char.lstrip(np.where(missing, "", np.asarray(marked[other])), MARK)
        if np.char.isdigit(text[~missing]).all():
            table[name] = np.ma.array(text, mask=missing) if missing.any() else text


def _checked_content(path: Path) -> bytes:
    """Return the content of a text file, in which every line ends with LF or CR LF."""
    content = content_of(path).removeprefix(b"\xef\xbb\xbf")  # the byte-order mark that spreadsheets write
    if b"\r" in content and content.count(b"\r") != content.count(b"\r\n"):
        content = content.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    if content.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise InputError(f"{path}: the file must be text in UTF-8, got UTF-16; save it as UTF-8")
    where = content.find(b"\0")
    if where >= 0:
        raise InputError(f"{path}: line {line_number(content, where)} must be text, got a NUL byte")
    try:
        if not content.isascii():
            content.decode("utf-8")
    except UnicodeDecodeError as error:
        number = line_number(content, error.start)
        raise InputError(
            f"{path}: line {number} must be text in UTF-8, got the byte 0x{content[error.start]:02x}"
        ) from None
    return content


def _is_data(line: str) -> bool:
    line = line.lstrip(" \t")
    return bool(line.strip()) and not line.startswith("#")


def _end_of_header(content: bytes) -> int:
    """Return the position of the first byte after the comments at the beginning of an ECSV file."""
    place = 0
    while place < len(content):
        end = content.find(b"\n", place) + 1 or len(content)
        line = content[place:end].lstrip(b" \t")
        if line.strip() and not line.startswith(b"#"):
            break
        place = end
        if place > MOST_HEADER:
            break
    return place


def _with_all_rows(path, table, n_rows):
    if len(table) != n_rows:
        raise InputError(f"{path}: the table must have as many rows as the file ({n_rows}), got {len(table)} rows")
    return table
