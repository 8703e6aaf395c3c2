"""Check that each line of a text table is a complete row.

Without this check, a reader would interpret the text after an unclosed quotation mark as one long value, and omit the
rest of the file without a warning. The functions of this module check each line before a reader is called. To be fast,
they test blocks of many lines together with NumPy, and count the fields of single lines only if a block may be invalid.
"""

from pathlib import Path

import numpy as np

from rfpsurvey._readers._limits import MOST_COLUMNS, check_width
from rfpsurvey.errors import InputError

BLOCK = 2**22
# Largest number of blank lines and comments in a file, in addition to ten such lines per row of the table.
MOST_IDLE = 1_000_000
NEWLINE, RETURN, TAB, SPACE, QUOTE, HASH = b'\n\r\t "#'


def line_number(content: bytes, where: int) -> int:
    """Return the number, counted from 1, of the line that contains the byte at offset ``where``."""
    return content.count(b"\n", 0, where) + 1


def count_lines(path: Path, content: bytes, begin: int, delimiter: bytes, *, ragged: bool = False) -> int:
    """Return the number of lines that are neither blank nor comments, including the line with the column names.

    Raise an error for a line with an unclosed quotation mark. Unless ``ragged`` is True, also raise an error for a line
    whose number of fields differs from the number of fields of the first line.
    """
    number, n_lines, n_idle, longest, at, n_fields = line_number(content, begin) - 1, 0, 0, 0, 0, 0
    while begin < len(content):
        end = content.find(b"\n", begin + BLOCK) + 1 or len(content)
        lines = _Lines(content[begin:end], delimiter)
        if not (n_fields or ragged) and lines.data.any():
            first = int(np.argmax(lines.data))
            n_fields = _fields(lines.line(first), delimiter)
            if n_fields > MOST_COLUMNS:
                raise InputError(f"{path}: a table must have at most {MOST_COLUMNS} columns, got {n_fields}")
            if n_fields == 0:
                raise InputError(_open_quote(path, number + first + 1))
        if not lines.are_whole(n_fields):
            _refuse(path, lines, number, n_fields)
        widest = int(lines.length.argmax())
        if lines.length[widest] > longest:
            longest, at = int(lines.length[widest]), number + widest + 1
        n_data = int(np.count_nonzero(lines.data))
        n_lines, n_idle, number = n_lines + n_data, n_idle + len(lines.data) - n_data, number + len(lines.data)
        if n_idle > MOST_IDLE + 10 * n_lines:
            raise InputError(
                f"{path}: most lines must be rows of the table, got {n_idle} blank lines and comments up to "
                f"line {number}"
            )
        begin = end
    check_width(path, n_lines, longest, len(content), f"line {at}")
    return n_lines


class _Lines:
    """A block of complete lines of the file.

    Parameters
    ----------
    block : bytes
        Content of the lines.
    delimiter : bytes
        Character that separates the fields of a line.
    """

    def __init__(self, block: bytes, delimiter: bytes):
        self.block, self.delimiter = block, delimiter
        self.bytes = np.frombuffer(block, np.uint8)
        ends = np.flatnonzero(self.bytes == NEWLINE)
        if not len(ends) or ends[-1] != len(block) - 1:
            ends = np.append(ends, len(block))
        self.end, self.start = ends, np.append(0, ends[:-1] + 1)
        self.length = self.end - self.start
        first = self.bytes[self.start]
        self.data = (first != NEWLINE) & (first != RETURN)
        self.comments = []
        for k in np.flatnonzero((first == SPACE) | (first == TAB) | (first == HASH)).tolist():
            line = self.line(k).strip()
            if not line or line.startswith(b"#"):
                self.data[k] = False
                self.comments.append(k)

    def line(self, k: int) -> bytes:
        return self.block[self.start[k] : self.end[k]]

    def are_whole(self, n_fields: int) -> bool:
        """Return whether the lines are certainly complete rows with ``n_fields`` fields (0: any number of fields).

        In a complete row, each quoted value ends in the line in which it begins.
        """
        text, delimiter = self.bytes, self.delimiter[0]
        if self.comments:
            text = text.copy()
            for k in self.comments:
                text[self.start[k] : self.end[k]] = RETURN
        n_delimiters = (n_fields - 1) * np.count_nonzero(self.data)
        if b'"' not in self.block:
            return not n_fields or np.count_nonzero(text == delimiter) == n_delimiters
        padded = np.full(len(text) + 4, NEWLINE, np.uint8)
        padded[2:-2] = text
        marks = np.flatnonzero((text == delimiter) | (text == QUOTE) | (text == NEWLINE))
        kinds = text[marks]
        quotes = kinds == QUOTE
        inside = (np.cumsum(quotes.view(np.uint8), dtype=np.uint8) & 1).view(bool)
        place = marks[quotes] + 2
        before, after = padded[place[::2] - 1], padded[place[1::2] + 1]
        opens = (before == delimiter) | (before == NEWLINE) | (before == QUOTE)
        opens |= (before == SPACE) & (padded[place[::2] - 2] == delimiter)
        closes = (after == delimiter) | (after == NEWLINE) | (after == QUOTE) | (after == RETURN)
        closes |= (after == SPACE) & (padded[place[1::2] + 2] == delimiter)
        closed = len(place) % 2 == 0 and opens.all() and closes.all() and not (inside & (kinds == NEWLINE)).any()
        return closed and (not n_fields or np.count_nonzero((kinds == delimiter) & ~inside) == n_delimiters)


def _refuse(path: Path, lines: _Lines, before: int, n_fields: int) -> None:
    """Raise an error for the first invalid line of a block; ``before`` is the number of preceding lines."""
    for k in np.flatnonzero(lines.data).tolist():
        found = _fields(lines.line(k), lines.delimiter)
        if found == 0:
            raise InputError(_open_quote(path, before + k + 1))
        if n_fields and found != n_fields:
            raise InputError(
                f"{path}: line {before + k + 1} must have {n_fields} fields, like the first line, got {found} fields"
            )


def _open_quote(path, number) -> str:
    return (
        f"{path}: a quoted value must end in the line in which it begins, got an unclosed quotation mark in "
        f"line {number}"
    )


def _fields(line: bytes, delimiter: bytes) -> int:
    """Return the number of fields of a line, or 0 if a quoted field does not end."""
    if b'"' not in line:
        return line.count(delimiter) + 1
    n, place = 1, 0
    while True:
        while line[place : place + 1] in (b" ", b"\t") and line[place : place + 1] != delimiter:
            place += 1
        if line[place : place + 1] == b'"':
            place = line.find(b'"', place + 1)
            while place >= 0 and line[place + 1 : place + 2] == b'"':
                place = line.find(b'"', place + 2)
            if place < 0:
                return 0
        place = line.find(delimiter, place) + 1
        if place == 0:
            return n
        n += 1
