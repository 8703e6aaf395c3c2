"""Read the first lines of a text table, which determine the delimiter, and the names and units of the columns."""

import re
from itertools import islice
from pathlib import Path

from rfpsurvey.errors import INCONVERTIBLE, InputError

DELIMITERS = {b",": "comma", b";": "semicolon", b"\t": "tab", b"|": "vertical bar"}
DATA = re.compile(rb"^[ \t]*[^#\s][^\n]*", re.MULTILINE)
# The names of the columns must be within this number of bytes from the beginning of the file.
MOST_BYTES = 2**22
QUOTED = re.compile(rb'"[^"]*"')


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
    lines = _data_lines(content)
    if not lines:
        return content, b",", {}
    begin, end = lines[0]
    delimiter = _delimiter(path, content[begin:end], content[slice(*lines[min(1, len(lines) - 1)])])
    names = _split(content[begin:end], delimiter)
    if len(names) == 1 and len(names[0].split()) > 1:
        raise InputError(f"{path}: commas must separate the names of the columns, got blanks in {names[0]!r}")
    if all(is_number(name) for name in names):
        before = content.rfind(b"\n", 0, max(begin - 1, 0)) + 1
        comment = content[before:begin].strip()
        words = _split(comment.lstrip(b"#"), delimiter)
        if not comment.startswith(b"#") or len(words) != len(names) or any(is_number(word) for word in words):
            raise InputError(f"{path}: the first row must contain the names of the columns, got {names[0]!r}")
        return content[:before] + content[before:begin].replace(b"#", b"", 1) + content[begin:], delimiter, {}
    for k in (1, 2):
        if (
            len(lines) > k
            and set(content[slice(*lines[k])].strip()) <= set(b"- " + delimiter)
            and (b"-" in content[slice(*lines[k])])
        ):
            words = _split(content[slice(*lines[1])], delimiter) if k == 2 else []
            for start, _ in reversed(lines[1 : k + 1]):
                content = content[:start] + b"#" + content[start:]
            return content, delimiter, dict(zip(names, words, strict=False))
    return content, delimiter, {}


def _data_lines(content: bytes) -> list[tuple[int, int]]:
    """Return the offsets of the start and end of each of the first three lines that are neither blank nor comments."""
    return [line.span() for line in islice(DATA.finditer(content, 0, MOST_BYTES), 3)]


def _delimiter(path: Path, header: bytes, row: bytes) -> bytes:
    header, row = QUOTED.sub(b"", header), QUOTED.sub(b"", row)
    there = [one for one in DELIMITERS if one in header]
    if len(there) > 1:
        there = [one for one in there if header.count(one) == row.count(one)] or there
    if b"," in there or not there:
        return b","
    if len(there) > 1:
        names = " and ".join(DELIMITERS[one] for one in there)
        raise InputError(
            f"{path}: one delimiter must separate the columns, got {names}; put commas between all columns"
        )
    return there[0]


def _split(line: bytes, delimiter: bytes) -> list[str]:
    return [word.decode("utf-8").strip(' "\r\t') for word in line.split(delimiter)]


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
