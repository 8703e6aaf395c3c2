"""Binary streams of VOTables: columns of variable length, incomplete rows, and other content."""

import base64
import struct

import astropy
import numpy as np
import pytest
from astropy.table import QTable
from astropy.utils import minversion

import rfpsurvey as rs
from refusals import refusal, written
from rfpsurvey._readers import read_table

VOTABLE = """<?xml version="1.0"?><VOTABLE version="1.4" xmlns="http://www.ivoa.net/xml/VOTable/v1.3"><RESOURCE><TABLE>
{}<DATA><{kind}><STREAM {how}>{}</STREAM></{kind}></DATA></TABLE></RESOURCE></VOTABLE>"""
COORDINATES = '<FIELD name="ra" datatype="double" unit="deg"/><FIELD name="dec" datatype="double" unit="deg"/>'
FIELDS = (
    '<FIELD name="id" datatype="char" arraysize="*"/><FIELD name="note" datatype="unicodeChar" arraysize="9*"/>'
    '<FIELD name="flux" datatype="float" arraysize="*"/><FIELD name="pairs" datatype="short" arraysize="2x*"/>'
    '<FIELD name="bits" datatype="bit" arraysize="10"/>'
)
TARGETS = (("a", "Größe", [1.5, 2.5], [[1, 2], [3, 4], [5, 6]]), ("star 2", "", [], [[7, 8]]))


def row(number, text, note, flux, pairs):
    """Return the bytes of a row: each array of variable length is preceded by the number of its elements."""
    numbers = [n for pair in pairs for n in pair]
    found = struct.pack(">ddI", number, 20.0, len(text)) + text.encode("ascii")
    found += struct.pack(">I", len(note)) + note.encode("utf-16-be")
    found += struct.pack(f">I{len(flux)}f", len(flux), *flux)
    return found + struct.pack(f">I{len(numbers)}h", len(pairs), *numbers) + b"\xff\xc0"  # the last are ten bits


def document(content, kind="BINARY", fields=COORDINATES + FIELDS, how='encoding="base64"'):
    text = content if isinstance(content, str) else base64.b64encode(content).decode()
    return VOTABLE.format(fields, text, kind=kind, how=how)


KINDS = pytest.mark.parametrize(("kind", "before"), [("BINARY", b""), ("BINARY2", b"\0")])


@pytest.mark.skipif(
    not minversion(astropy, "8.0"), reason="astropy before 8.0 returns no rows, which is refused with an error"
)
@KINDS
def test_columns_of_variable_length_are_read(tmp_path, kind, before):
    content = b"".join(before + row(k, *target) for k, target in enumerate(TARGETS))
    path = written(tmp_path / "a.vot", document(content, kind))
    table = read_table(path)
    for k, target in enumerate(TARGETS):
        assert tuple(np.asarray(table[name][k]).tolist() for name in ("id", "note", "flux", "pairs")) == target
        assert table["bits"][k].tolist() == [True] * 10
    catalog = rs.Catalog.read(path)
    assert catalog.id.tolist() == ["a", "star 2"]
    assert catalog.coord.ra.deg.tolist() == [0.0, 1.0]


@KINDS
def test_a_stream_with_columns_of_variable_length_must_end_after_a_row(tmp_path, kind, before):
    content = b"".join(before + row(k, *target) for k, target in enumerate(TARGETS))
    first = len(before + row(0, *TARGETS[0]))
    many = before + struct.pack(">ddI", 1, 2, 2**32 - 1) + content  # a number of elements beyond the stream
    ends = (*range(1, first, 7), first - 1, first + 1, len(content) - 3, len(content) - 1)
    for part, n in [(many, 0), *((content[:end], int(end > first)) for end in ends)]:
        text = refusal(written(tmp_path / "a.vot", document(part, kind)))
        assert text == f": the element STREAM must contain complete rows, got an incomplete row after {n} rows"


def test_text_of_any_length_that_astropy_writes_is_read(tmp_path):
    """Astropy writes a column of objects with arraysize="*"."""
    names = np.array(["a", "a longer name", "Ä"], dtype=object)
    path = tmp_path / "a.vot"
    table = QTable({"id": names, "ra": [1.0, 2.0, 3.0], "dec": [1.0, 2.0, 3.0]})
    table.write(path, format="votable", tabledata_format="binary2")
    assert 'arraysize="*"' in path.read_text()
    catalog = rs.Catalog.read(path, units={"ra": "deg", "dec": "deg"})
    assert catalog.id.tolist() == ["a", "a longer name", "Ä"]


def test_other_streams_tables_and_columns_are_refused(tmp_path):
    content = row(1, *TARGETS[0])
    head, _, table = document(content).partition("<TABLE>")
    tables, end = f"<TABLE>{table.partition('</TABLE>')[0]}</TABLE>" * 2, "</RESOURCE></VOTABLE>"
    column = COORDINATES + '<FIELD name="id" datatype="text" arraysize="*"/>'
    defined, many = "a datatype and an arraysize that VOTable defines", '<FIELD name="a" datatype="short"/>' * 10_001
    for text, message in (
        (document("", how='encoding="gzip"'), "the encoding of STREAM must be base64, got 'gzip' (line 2)"),
        (document("", how=""), "the encoding of STREAM must be base64, got None (line 2)"),
        (document("no base64!"), "the element STREAM must be in base64: "),
        (document("AAA"), "the element STREAM must be in base64: "),
        (head + tables + end, "the file must contain one table, got 2 tables"),
        (head + end, "the file must contain one table, got 0 tables"),
        (
            document(b"", fields=many),
            "a table must have at most 10000 columns, got more",
        ),
        (document(content, fields=column), f"the column id must have {defined}, got 'text' and '*'"),
    ):
        assert refusal(written(tmp_path / "a.vot", text)).startswith(f": {message}")
