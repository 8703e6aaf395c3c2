"""Binary streams of VOTables: columns of variable length, incomplete rows, and other content."""

import base64
import struct
import urllib.request

import astropy
import astropy.units as u
import numpy as np
import pytest
from astropy.table import QTable
from astropy.utils import minversion

import rfpsurvey as rs
from refusals import refusal, written
from rfpsurvey._common.read_tables import read_table

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


PLAIN = """<?xml version="1.0"?><VOTABLE version="1.4" xmlns="http://www.ivoa.net/xml/VOTable/v1.3"><RESOURCE><TABLE>
<FIELD name="ra" datatype="double" unit="deg"/><FIELD name="dec" datatype="double" unit="deg"/>
<FIELD name="id" datatype="char" arraysize="3"/><DATA>{}</DATA></TABLE></RESOURCE></VOTABLE>"""
ROWS = "<TABLEDATA><TR><TD>1</TD><TD>2</TD><TD>abc</TD></TR></TABLEDATA>"


@pytest.mark.parametrize("kind", ["BINARY", "BINARY2", "FITS", "PARQUET type='VOTable-remote-file'"])
@pytest.mark.parametrize("encoding", ["", ' encoding="base64"', ' encoding="gzip"'])
@pytest.mark.parametrize("text", ["utf-8", "utf-16"])
def test_a_stream_is_not_fetched(tmp_path, monkeypatch, kind, encoding, text):
    """Regression: addresses on the network and files of this machine were read."""
    monkeypatch.setattr(urllib.request, "urlopen", lambda *_: pytest.fail("fetched"))
    (tmp_path / "secret").write_bytes(struct.pack(">dd3s", 1, 2, b"abc"))
    refused = "the element STREAM must contain its data", "the data must be in an element TABLEDATA"
    for address in (f"file://{tmp_path}/secret", "http://127.0.0.1:1/x", "&#102;tp://127.0.0.1/x"):
        stream = PLAIN.format(f'<{kind}><STREAM{encoding} href="{address}"/></{kind.split()[0]}>')
        stream = stream.replace('"1.0"', f'"1.0" encoding="{text}"').encode(text)
        found = refusal(written(tmp_path / "a.vot", stream))
        assert any(message in found for message in refused)


def test_entities_and_lost_rows_of_a_votable(tmp_path):
    path, good = tmp_path / "a.vot", PLAIN.format(ROWS)
    assert rs.Catalog.read(written(path, good)).id.tolist() == ["abc"]
    system = good.replace("<VOTABLE", '<!DOCTYPE V SYSTEM "file:///etc/passwd"><VOTABLE', 1)
    assert len(rs.Catalog.read(written(path, system))) == 1  # the named file is not read
    for old, new, message in (
        ("<VOTABLE", '<!DOCTYPE V [<!ENTITY a "b">]><VOTABLE', "must not have entities, got 'a'"),
        ("abc", "abcd", "every value must fit into its column"),
        ("<TABLE>", '<TABLE nrows="2">', "must have as many rows as the attribute nrows states (2), got 1 rows"),
        (ROWS, ROWS + ROWS, "must have as many rows as the file (2), got 1 rows"),
    ):
        assert message in refusal(written(path, good.replace(old, new, 1)))


@pytest.mark.parametrize("form", ["binary", "binary2", "tabledata"])
@pytest.mark.filterwarnings(r"ignore:column .* \(id\) is empty")
def test_votables_of_each_form(tmp_path, form):
    table = QTable({"id": ["a", "bc", ""], "ra": [1, 2, 3.0] * u.deg, "dec": np.float32([1, 2, 3]) * u.deg})
    table["flag"], table["n"], table["short"] = [True, False, True], [1, 2, 3], np.int16([1, 2, 3])
    table["two"] = np.ones((3, 2))
    path = tmp_path / "a.vot"
    table.write(path, format="votable", tabledata_format=form)
    assert rs.Catalog.read(path).id.tolist() == ["a", "bc", ""]
    if form != "tabledata":
        text = path.read_text()
        begin = text.index(">", text.index("<STREAM")) + 1
        assert "STREAM must" in refusal(written(path, text[:begin] + text[begin + 8 :]))
        path = written(path, text[:begin] + "<FIELD/>" + text[begin:])
        assert "the element STREAM must contain only data, got the element FIELD" in refusal(path)
