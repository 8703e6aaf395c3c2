"""Read VOTables; the files and web addresses to which a VOTable refers are not read.

Astropy reads the table. The module first parses the XML, because astropy 8.0 reads the addresses to which a stream
refers, and omits an incomplete last row and the rows of a second element TABLEDATA without a message. The table that
astropy returns must have the number of rows that the XML contains.
"""

import binascii
import math
import re
import struct
import warnings
from pathlib import Path

from astropy.table import Table

from rfpsurvey._common.read_documents import MOST_COLUMNS, MOST_PADDING, check_rows, open_content
from rfpsurvey.errors import InputError

SIZES = {"bit": 1 / 8, "doubleComplex": 16} | dict.fromkeys(("boolean", "unsignedByte", "char"), 1)
SIZES |= dict.fromkeys(("short", "unicodeChar"), 2) | dict.fromkeys(("int", "float"), 4)
SIZES |= dict.fromkeys(("long", "double", "floatComplex"), 8)
# Largest number of bytes in one row, and number of bytes in all rows together that is always allowed, even if the file
# is small.
MOST_ROW, FREE_ROWS = 400_000, 2**29
# Warnings of astropy about values that it changes: truncated text, and numbers out of the range of their type.
ALTERED = re.compile(r"\b(?:W46|W51): (.*)")


def read_votable(path: Path) -> Table:
    """Return the only table of a VOTable file."""
    with open_content(path) as file:
        about = _Contents(path)
        about.read(file)
        n_rows = about.n_rows(file.tell())
        file.seek(0)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            table = Table.read(file, format="votable", verify="warn")
    for warning in caught:
        altered = ALTERED.search(str(warning.message))
        if altered:
            raise InputError(f"{path}: every value must fit into its column, got a value that does not: {altered[1]}")
    check_rows(path, table, n_rows)
    return table


class _Contents:
    """Parser that counts the rows and columns of a VOTable from its XML elements."""

    def __init__(self, path: Path):
        from xml.parsers import expat

        self._path, self._error = path, expat.ExpatError
        self._parser = expat.ParserCreate()
        self._parser.StartElementHandler = self._start
        self._parser.EntityDeclHandler = self._refuse_entity
        self._parser.SkippedEntityHandler = self._refuse_entity
        self._n_tables = self._n_tr = 0
        self._fields, self._rows_said, self._data = [], None, None
        self._stream: list[str] = []
        self._in_stream = False

    def read(self, file) -> None:
        """Parse the whole file."""
        try:
            self._parser.ParseFile(file)
        except self._error as error:
            raise InputError(f"{self._path} cannot be read as a VOTable: {error}") from None

    def _start(self, name, attributes):
        name = name.rpartition(":")[2]
        if self._in_stream:
            self._refuse(f"the element STREAM must contain only data, got the element {name}")
        if name == "TR":
            self._n_tr += 1
        elif name == "TABLE":
            self._n_tables += 1
            self._rows_said = attributes.get("nrows")
        elif name == "FIELD":
            self._add_field(attributes)
        elif name in ("TABLEDATA", "BINARY", "BINARY2"):
            self._data = name
        elif name in ("FITS", "PARQUET"):
            self._refuse(f"the data must be in an element TABLEDATA, BINARY or BINARY2, got {name}")
        elif name == "STREAM":
            if "href" in attributes:
                self._refuse(
                    f"the element STREAM must contain its data, got the address {attributes['href'][:80]!r}, "
                    "which is not read"
                )
            if attributes.get("encoding") != "base64":
                self._refuse(f"the encoding of STREAM must be base64, got {attributes.get('encoding')!r}")
            self._in_stream = True
            self._parser.CharacterDataHandler = self._stream.append
            self._parser.EndElementHandler = self._end

    def _end(self, name):
        self._in_stream = False
        self._parser.CharacterDataHandler = self._parser.EndElementHandler = None

    def _refuse(self, text):
        raise InputError(f"{self._path}: {text} (line {self._parser.CurrentLineNumber})")

    def _refuse_entity(self, name, *_):
        self._refuse(f"a VOTable must not have entities, got {name!r}")

    def _add_field(self, attributes):
        kind, size = attributes.get("datatype", ""), attributes.get("arraysize", "1").strip()
        name = attributes.get("name") or attributes.get("ID") or len(self._fields) + 1
        numbers = re.fullmatch(r"(?:(\d{1,9}(?:x\d{1,9})*)x?)?(\*?)", size)
        if kind not in SIZES or not numbers:
            self._refuse(
                f"the column {name} must have a datatype and an arraysize that VOTable defines, got {kind!r} "
                f"and {size!r}"
            )
        n = math.prod(map(int, (numbers[1] or "1").split("x")))
        if numbers[2] and kind not in ("char", "unicodeChar") and not size.endswith("x*"):
            n = 1  # only the last dimension can have a variable length
        self._fields.append((kind, n, bool(numbers[2])))
        if len(self._fields) > MOST_COLUMNS:
            self._refuse(f"a table must have at most {MOST_COLUMNS} columns, got more")

    def n_rows(self, size: int) -> int:
        """Return the number of rows; raise an error if rows are incomplete or too large for a file of this ``size``."""
        path = self._path
        if self._n_tables != 1:
            raise InputError(f"{path}: the file must contain one table, got {self._n_tables} tables")
        n = self._n_tr if self._data == "TABLEDATA" else 0 if self._data is None else self._binary_rows()
        said = self._rows_said
        if said is not None and said.strip() != str(n):
            raise InputError(
                f"{path}: the table must have as many rows as the attribute nrows states ({said[:20]}), got {n} rows"
            )
        width = sum((4 if kind in ("char", "unicodeChar") else SIZES[kind]) * k for kind, k, open_ in self._fields)
        if width > MOST_ROW or (n + 512) * width > max(FREE_ROWS, MOST_PADDING * size):
            raise InputError(
                f"{path}: a row must have at most {MOST_ROW} bytes, and all rows together must not be much larger "
                f"than the file, got {width:.0f} bytes per row"
            )
        return n

    def _binary_rows(self) -> int:
        """Return the number of rows of a binary stream; raise an error if the stream contains incomplete rows."""
        try:
            content = binascii.a2b_base64(re.sub(r"\s", "", "".join(self._stream)), strict_mode=True)
        except ValueError as error:
            raise InputError(f"{self._path}: the element STREAM must be in base64: {error}") from None
        steps = [(len(self._fields) + 7) // 8 if self._data == "BINARY2" else 0]
        for kind, n, varies in self._fields:
            if varies:
                steps += [(kind, n if kind not in ("char", "unicodeChar") else 1), 0]
            else:
                steps[-1] += -(-SIZES[kind] * n // 1)
        n_rows, place = 0, 0
        while place < len(content):
            try:
                end = _skip_row(content, place, steps)
            except struct.error:
                end = -1
            if not place < end <= len(content):
                raise InputError(
                    f"{self._path}: the element STREAM must contain complete rows, got an incomplete row after "
                    f"{n_rows} rows"
                )
            n_rows, place = n_rows + 1, end
        return n_rows


def _skip_row(content: bytes, place: int, steps: list) -> int:
    """Return the offset of the end of the row that begins at ``place``.

    In a row, the length of each array of variable length precedes the array.
    """
    place = int(place)
    for step in steps:
        if isinstance(step, tuple):
            kind, n = step
            (count,) = struct.unpack_from(">I", content, place)
            item = SIZES[kind] * n
            place += 4 + int(count * (item if item >= 1 and kind != "bit" else -(-item // 1)))
        else:
            place += int(step)
    return place
