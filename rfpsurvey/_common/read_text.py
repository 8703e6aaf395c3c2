"""Read text tables (CSV and ECSV), after a check that each line is a complete row."""

import re
import warnings
from itertools import islice
from pathlib import Path

import numpy as np
from astropy.table import Table
from astropy.units import Unit, UnrecognizedUnit, dimensionless_unscaled

from rfpsurvey._common.read_documents import MOST_COLUMNS, check_rows, check_width, content_of, warn_of_open_end
from rfpsurvey._common.read_tables import is_number
from rfpsurvey.errors import InputError, warn

DELIMITERS = {b",": "comma", b";": "semicolon", b"\t": "tab", b"|": "vertical bar"}
DATA = re.compile(rb"^[ \t]*[^#\s][^\n]*", re.MULTILINE)
# The names of the columns must be within this number of bytes from the beginning of the file.
MOST_NAMES_BYTES = 2**22
QUOTED = re.compile(rb'"[^"]*"')
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
    check_rows(path, table, n_lines - 1)
    return table


def read_ecsv(path: Path) -> Table:
    """Return the table of an ECSV file."""
    content = _checked_content(path)
    warn_of_open_end(path, content)
    row = DATA.search(content)
    begin = row.start() if row else len(content)
    header = content[:begin]
    if begin > MOST_HEADER:
        raise InputError(f"{path}: the ECSV header must have at most {MOST_HEADER} bytes, got {begin}")
    for shape in SHAPE.findall(header):
        sizes = [int(n) for n in re.findall(rb"\d{1,9}", shape)]
        if np.prod(sizes, dtype=float) > MOST_CELLS:
            raise InputError(f"{path}: a value must have at most {MOST_CELLS} elements, got [{shape.decode()}]")
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
    check_rows(path, table, n_lines - 1)
    return table


def _parse(text: str, options: dict) -> Table:
    from astropy.io import ascii as text_tables

    if text.isascii():
        if "\n" not in text:  # astropy interprets text without a line break as a path
            text += "\n"
        return text_tables.read(text, fast_reader={"enable": "force"}, **options)
    # the fast reader cannot read characters outside ASCII
    lines = [line for line in text.split("\n") if line.strip() and not line.lstrip(" \t").startswith("#")]
    return text_tables.read(lines, fast_reader=False, **options)


def _keep_leading_zeros(table: Table, marked: Table) -> None:
    """Restore leading zeros in columns of digits; in the table ``marked``, numbers with leading zeros are text."""
    for name, marked_name in zip(table.colnames, marked.colnames, strict=True):
        if table[name].dtype.kind != "i" or marked[marked_name].dtype.kind != "U":
            continue
        missing = np.ma.getmaskarray(np.ma.asarray(table[name]))
        text = np.char.lstrip(np.where(missing, "", np.asarray(marked[marked_name])), MARK)
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


BLOCK = 2**22
# Largest number of blank lines and comments in a file, in addition to ten such lines per row of the table.
MOST_IDLE = 1_000_000
NEWLINE, BEFORE_IDLE = ord("\n"), list(b"\n\r \t#")
"""Codes of a line break, and of the first characters of blank lines and comments."""


def line_number(content: bytes, where: int) -> int:
    """Return the number, counted from 1, of the line that contains the byte at offset ``where``."""
    return content.count(b"\n", 0, where) + 1


def count_lines(path: Path, content: bytes, begin: int, delimiter: bytes, *, ragged: bool = False) -> int:
    """Return the number of lines that are neither blank nor comments, including the line with the column names.

    Raise an error for a line with an unclosed quotation mark. Unless ``ragged`` is True, also raise an error for a line
    whose number of fields differs from the number of fields of the first line.
    """
    # the mark at the beginning of a quoted value; blanks before it take time, and few files have them
    begins, blanks = rb'"(?<![^%s\n]")' % delimiter, b" \t".replace(delimiter, b"")
    if any(blank + b'"' in content for blank in (blanks[:1], blanks[-1:])):
        begins = rb'(?:^|(?<=%s))[%s]*"' % (re.escape(delimiter), blanks)
    opened = re.compile(begins, re.MULTILINE)
    quoted = re.compile(begins + rb'[^"\n]*+(?:""[^"\n]*+)*+"', re.MULTILINE)
    number, n_lines, n_idle, longest, at, n_fields = line_number(content, begin) - 1, 0, 0, 0, 0, 0
    while begin < len(content):
        end = content.find(b"\n", begin + BLOCK) + 1 or len(content)
        block = content[begin:end]
        text = quoted.sub(b"x", block) if b'"' in block else block
        codes, ends = np.frombuffer(text, np.uint8), _ends_of_lines(text)
        numbers = np.diff(np.searchsorted(np.flatnonzero(codes == delimiter[0]), ends), prepend=0) + 1
        if b'"' in text:
            numbers[np.searchsorted(ends, [unclosed.start() for unclosed in opened.finditer(text)])] = 0
        starts = np.append(0, ends[:-1] + 1)
        unusual = np.flatnonzero(np.isin(codes[starts], BEFORE_IDLE)).tolist()
        idle = [k for k in unusual if not DATA.match(text, starts[k], ends[k])]
        rows = np.delete(np.arange(len(ends)), idle)
        n_fields = n_fields or int(next(iter(numbers[rows]), 0))
        if n_fields > MOST_COLUMNS and not ragged:
            raise InputError(f"{path}: a table must have at most {MOST_COLUMNS} columns, got {n_fields}")
        for k in rows[(numbers[rows] == 0) | ((numbers[rows] != n_fields) & (not ragged))]:
            if numbers[k] == 0:
                raise InputError(
                    f"{path}: a quoted value must end in the line in which it begins, got an unclosed quotation mark "
                    f"in line {number + k + 1}"
                )
            raise InputError(
                f"{path}: line {number + k + 1} must have {n_fields} fields, like the first line, got {numbers[k]} "
                "fields"
            )
        lengths = np.diff(_ends_of_lines(block), prepend=-1) - 1
        if lengths.max() > longest:
            longest, at = int(lengths.max()), number + int(lengths.argmax()) + 1
        n_lines, n_idle = n_lines + len(rows), n_idle + len(idle)
        number, begin = number + len(ends), end
        if n_idle > MOST_IDLE + 10 * n_lines:
            raise InputError(
                f"{path}: most lines must be rows of the table, got {n_idle} blank lines and comments up to "
                f"line {number}"
            )
    check_width(path, n_lines, longest, len(content), f"line {at}")
    return n_lines


def _ends_of_lines(text: bytes) -> np.ndarray:
    """Return the offset of the end of each line."""
    ends = np.flatnonzero(np.frombuffer(text, np.uint8) == NEWLINE)
    return ends if text.endswith(b"\n") else np.append(ends, len(text))


def find_names(path: Path, content: bytes) -> tuple[bytes, bytes, dict[str, str]]:
    """Return the content of a text table, its delimiter, and a dictionary of column names to units.

    In the returned content, the first row contains the names of the columns. The delimiter is found in the line with
    these names. If this line contains several possible delimiters, the delimiter that occurs equally often in this line
    and in the next line is used. The names of the columns can be in a comment before the first row. Lines that are not
    rows of the table are converted to comments. Examples are the line ``sep=;`` of spreadsheets, and the lines with
    units and dashes that VizieR writes after the names.
    """
    if content[:4].lower() == b"sep=":
        content = b"#" + content
    # the first three lines that are neither blank nor comments
    lines = list(islice(DATA.finditer(content, 0, MOST_NAMES_BYTES), 3))
    if not lines:
        return content, b",", {}
    begin = lines[0].start()
    delimiter = _delimiter(path, lines[0][0], lines[min(1, len(lines) - 1)][0])
    names = _split(lines[0][0], delimiter)
    if len(names) == 1 and len(names[0].split()) > 1:
        raise InputError(f"{path}: commas must separate the names of the columns, got blanks in {names[0]!r}")
    if all(is_number(name) for name in names):
        before = content.rfind(b"\n", 0, max(begin - 1, 0)) + 1
        comment = content[before:begin].strip()
        words = _split(comment.lstrip(b"#"), delimiter)
        if not comment.startswith(b"#") or len(words) != len(names) or any(is_number(word) for word in words):
            raise InputError(f"{path}: the first row must contain the names of the columns, got {names[0]!r}")
        return content[:before] + content[before:begin].replace(b"#", b"", 1) + content[begin:], delimiter, {}
    for k, line in enumerate(lines[1:], 1):
        if set(line[0].strip()) <= set(b"- " + delimiter) and b"-" in line[0]:
            words = _split(lines[1][0], delimiter) if k == 2 else []
            for one in reversed(lines[1 : k + 1]):
                content = content[: one.start()] + b"#" + content[one.start() :]
            return content, delimiter, dict(zip(names, words, strict=False))
    return content, delimiter, {}


def _delimiter(path: Path, header: bytes, row: bytes) -> bytes:
    header, row = QUOTED.sub(b"", header), QUOTED.sub(b"", row)
    there = [delimiter for delimiter in DELIMITERS if delimiter in header]
    if len(there) > 1:
        there = [delimiter for delimiter in there if header.count(delimiter) == row.count(delimiter)] or there
    if b"," in there or not there:
        return b","
    if len(there) > 1:
        names = " and ".join(DELIMITERS[delimiter] for delimiter in there)
        raise InputError(
            f"{path}: one delimiter must separate the columns, got {names}; put commas between all columns"
        )
    return there[0]


def _split(line: bytes, delimiter: bytes) -> list[str]:
    return [word.decode("utf-8").strip(' "\r\t') for word in line.split(delimiter)]
