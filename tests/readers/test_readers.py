"""Regression tests: files that lost rows, caused other files to be read, or raised unhandled exceptions."""

import gzip
import json
import struct
import urllib.request

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.io import fits
from astropy.table import MaskedColumn, QTable, Table

import rfpsurvey as rs
from refusals import refusal, sentence
from rfpsurvey import _io
from rfpsurvey._readers import read_fits_bytes, read_table, read_tables
from rfpsurvey._readers._fits import read_plain

DEG = u.deg
GOOD = [f"s{k},{10 + 0.01 * k},20.0" for k in range(100)]


def csv(path, lines, end="\n"):
    path.write_bytes((end.join(["id,ra,dec", *lines]) + end).encode())
    return path


# --- quotation marks and rows of text ------------------------------------------------------------------------------


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("name", ["a.csv", "a.csv.gz"])
def test_an_open_quotation_mark_drops_no_rows(tmp_path, name, end):
    """Regression: only 50 of 100,000 targets were read, without a warning."""
    lines = list(GOOD)
    lines[48] = '"' + lines[48]
    path = csv(tmp_path / "a.csv", lines, end)
    if name.endswith(".gz"):
        path = tmp_path / name
        path.write_bytes(gzip.compress((tmp_path / "a.csv").read_bytes()))
    assert "an unclosed quotation mark in line 50" in refusal(path)


def test_a_quoted_value_over_several_lines_is_refused(tmp_path):
    """Regression: ten rows were interpreted as one value."""
    lines = list(GOOD)
    lines[48], lines[58] = '"' + lines[48], lines[58] + '"'
    assert "an unclosed quotation mark in line 50" in refusal(csv(tmp_path / "a.csv", lines))
    for text in ('a "b,"c d,1,2', 'a,"b",1,"2', ' "x,1,2', '"a""b,1,2'):
        assert "an unclosed quotation mark in line 2" in refusal(csv(tmp_path / "a.csv", [text, *GOOD]))


@pytest.mark.filterwarnings(r"ignore:column .* \(id\) is empty")
def test_good_quotation_marks_are_kept(tmp_path):
    texts = {
        '"a, b"': "a, b",
        '"a ""b"" c"': 'a "b" c',
        '""': "",
        ' "c, d"': "c, d",
        '5" disc': '5" disc',
        "d'Arrest, Ä"[:8]: "d'Arrest",
        '"Größe, Ä"': "Größe, Ä",
    }
    for text, expected in texts.items():
        path = csv(tmp_path / "a.csv", [f"{text},10,20", '"other" ,11,21', "third,12,22"])
        catalog = rs.Catalog.read(path)
        assert catalog.id.tolist() == [expected, "other", "third"]
    path.write_text('"id","ra", "dec"\n"a",10,20\n')
    assert rs.Catalog.read(path).id.tolist() == ["a"]
    path.write_text('"id,ra,dec\na,10,20\n')
    assert "an unclosed quotation mark in line 1" in refusal(path)
    path.write_text("id,ra,dec")
    assert read_table(path).colnames == ["id", "ra", "dec"]


def test_blank_lines_comments_and_line_ends_are_no_rows(tmp_path):
    lines = ['# "a comment', "", *GOOD[:5], "   ", '  # 5" more, of, them', *GOOD[5:], "", ""]
    for end in ("\n", "\r\n", "\r"):
        assert len(rs.Catalog.read(csv(tmp_path / "a.csv", lines, end))) == 100


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("b,10.5", "line 4 must have 3 fields, like the first line, got 2 fields"),
        ("b,10.5,1,2", "line 4 must have 3 fields, like the first line, got 4 fields"),
        ('"b,10.5",1', "line 4 must have 3 fields, like the first line, got 2 fields"),
        ("b\0,10.5,1", "line 4 must be text, got a NUL byte"),
        ("b\x85\udce4,10.5,1", "line 4 must be text in UTF-8, got the byte 0xe4"),
    ],
)
def test_rows_that_are_not_whole_are_refused(tmp_path, line, message):
    """Regression: short rows had empty values, and a NUL byte shifted all values after it."""
    path = tmp_path / "a.csv"
    path.write_bytes("\n".join(["id,ra,dec", *GOOD[:2], line, *GOOD[2:]]).encode("utf-8", "surrogateescape"))
    assert message in refusal(path)


def test_text_of_other_alphabets_has_as_many_rows(tmp_path):
    """Unicode line separators, at which Python splits text, do not end the lines of a file."""
    lines = ["Ä\u2028ö,10,20", "b\x0bc,11,21", "c\x85d,12,22"]
    assert len(rs.Catalog.read(csv(tmp_path / "a.csv", lines))) == 3


@pytest.mark.parametrize("delimiter", [" ", ","])
def test_ecsv_with_an_open_quotation_mark(tmp_path, delimiter):
    table = QTable({"id": ["a b, c", 'd "e"', "f"], "ra": [1, 2, 3.0] * DEG, "dec": [1, 2, 3.0] * DEG})
    path = tmp_path / "a.ecsv"
    table.write(path, delimiter=delimiter)
    assert rs.Catalog.read(path).id.tolist() == ["a b, c", 'd "e"', "f"]
    lines = path.read_text().split("\n")
    for change in ('"' + lines[-2], lines[-2] + delimiter + '"g'):
        path.write_text("\n".join([*lines[:-2], change, *lines[-3:]]))
        assert f"unclosed quotation mark in line {len(lines) - 1}" in refusal(path)


def test_text_in_ecsv_has_a_limited_width(tmp_path):
    path = tmp_path / "a.ecsv"
    path.write_text("# %ECSV 1.0\n# ---\n# datatype:\n# - {name: a, datatype: '<U100000'}\na\nx\n")
    assert "the values of a column must have at most 99999 characters, got the width 100000" in refusal(path)


def test_a_name_of_a_file_with_a_nul_is_refused(tmp_path):
    with pytest.raises(rs.InputError, match=r"a\\x00\.fits: there is no such file"):
        rs.Catalog.read(f"{tmp_path}/a\0.fits")


def test_numbers_beyond_doubles_are_told(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("id,ra,dec,pmra,pmdec\na,10,20,1e999,1\nb,10,21,1,1\n")
    with pytest.warns(rs.RfpsurveyWarning, match="column pmra"):
        catalog = rs.Catalog.read(path)
    assert np.isnan(catalog.coord.pm_ra_cosdec[0])
    assert len(catalog) == 2
    path.write_text("id,ra,dec,pmra,pmdec\na,10,20,1e20,1\n")
    assert "column 'pmra' (pmra) must lie between" in refusal(path)


# --- VOTables ------------------------------------------------------------------------------------------------------

VOTABLE = """<?xml version="1.0"?><VOTABLE version="1.4" xmlns="http://www.ivoa.net/xml/VOTable/v1.3"><RESOURCE><TABLE>
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
    tag = kind.split()[0]
    for address in (f"file://{tmp_path}/secret", "http://127.0.0.1:1/x", "&#102;tp://127.0.0.1/x"):
        path = tmp_path / "a.vot"
        stream = VOTABLE.format(f'<{kind}><STREAM{encoding} href="{address}"/></{tag}>')
        path.write_text(stream.replace('"1.0"', f'"1.0" encoding="{text}"'), encoding=text)
        assert "the element STREAM must contain its data" in refusal(
            path
        ) or "the data must be in an element TABLEDATA" in refusal(path)


def test_entities_and_lost_rows_of_a_votable(tmp_path):
    path = tmp_path / "a.vot"
    path.write_text(VOTABLE.format(ROWS))
    assert rs.Catalog.read(path).id.tolist() == ["abc"]
    path.write_text(VOTABLE.format(ROWS).replace("<VOTABLE", '<!DOCTYPE V [<!ENTITY a "b">]><VOTABLE', 1))
    assert "must not have entities, got 'a'" in refusal(path)
    path.write_text(VOTABLE.format(ROWS).replace("<VOTABLE", '<!DOCTYPE V SYSTEM "file:///etc/passwd"><VOTABLE', 1))
    assert len(rs.Catalog.read(path)) == 1  # the named file is not read
    path.write_text(VOTABLE.format(ROWS.replace("abc", "abcd")))
    assert "every value must fit into its column" in refusal(path)
    path.write_text(VOTABLE.format(ROWS).replace("<TABLE>", '<TABLE nrows="2">'))
    assert "must have as many rows as the attribute nrows states (2), got 1 rows" in refusal(path)
    path.write_text(VOTABLE.format(ROWS + ROWS))
    assert "must have as many rows as the file (2), got 1 rows" in refusal(path)


@pytest.mark.parametrize("form", ["binary", "binary2", "tabledata"])
@pytest.mark.filterwarnings(r"ignore:column .* \(id\) is empty")
def test_votables_of_each_form(tmp_path, form):
    table = QTable({"id": ["a", "bc", ""], "ra": [1, 2, 3.0] * DEG, "dec": np.float32([1, 2, 3]) * DEG})
    table["flag"], table["n"], table["short"] = [True, False, True], [1, 2, 3], np.int16([1, 2, 3])
    table["two"] = np.ones((3, 2))
    path = tmp_path / "a.vot"
    table.write(path, format="votable", tabledata_format=form)
    assert rs.Catalog.read(path).id.tolist() == ["a", "bc", ""]
    if form != "tabledata":
        text = path.read_text()
        begin = text.index(">", text.index("<STREAM")) + 1
        path.write_text(text[:begin] + text[begin + 8 :])
        assert "STREAM must" in refusal(path)
        path.write_text(text[:begin] + "<FIELD/>" + text[begin:])
        assert "the element STREAM must contain only data, got the element FIELD" in refusal(path)


# --- unhandled exceptions ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (3, "must be an object in JSON, got int"),
        ("3", "must be an object in JSON, got int"),
        ('["a"]', "must be an object in JSON, got list"),
        ('"text"', "must be an object in JSON, got str"),
        ("[" * 100_000, "must be nested at most 32 levels deep, got more"),
        ('{"a":' + "[" * 40 + "]" * 40 + "}", "values must be nested at most 32 levels deep, got more"),
        (json.dumps({"a": [0] * 100_001}), "at most 100000 values"),
    ],
    ids=["number", "number in JSON", "list", "text", "open", "nested", "long"],
)
def test_the_meta_of_a_table_must_be_an_object(tmp_path, value, message):
    table = Table({"ra": [1.0], "dec": [2.0]}, meta={"RFPSURVY": value})
    table.write(tmp_path / "a.fits")
    assert message in refusal(tmp_path / "a.fits")


def test_deeply_nested_documents_are_refused(tmp_path):
    path = tmp_path / "a.toml"
    for text in ("a = " + "[" * 100_000, "a = " + "{a=" * 50_000, ".".join(["a"] * 50_000) + " = 1"):
        path.write_text(f"{text}\n")
        assert "at most 32" in refusal(path, rs.Instrument.read)


def test_columns_of_objects_and_of_several_values(tmp_path):
    objects = np.empty(2, dtype=object)
    objects[:] = [{"a": 1}, [1, 2]]
    base = {"ra": [1, 2.0] * DEG, "dec": [1, 2.0] * DEG}
    path = tmp_path / "a.ecsv"
    for role in ("id", "category", "kind", "fiber_type", "priority", "visits"):
        QTable({**base, role: objects}).write(path, overwrite=True)
        assert "must hold numbers or text, got {'a': 1}" in refusal(path)
        QTable({**base, role: [[1, 2], [3, 4]]}).write(path, overwrite=True)
        assert f"column '{role}' ({role}) must have one value per row, got 2 values per row" in refusal(path)
    QTable({**base, "other": objects, "more": [[1, 2], [3, 4]]}).write(path, overwrite=True)
    assert len(rs.Catalog.read(path)) == 2
    QTable({"ra": [[1, 2], [3, 4]] * DEG, "dec": [1, 2.0] * DEG}).write(path, overwrite=True)
    assert "column 'ra' (ra) must have one value per row" in refusal(path)
    with pytest.raises(rs.InputError, match="category must hold numbers or text, got {"):
        rs.Catalog(SkyCoord([1, 2] * DEG, [1, 2] * DEG), category=objects)


def test_bytes_that_are_no_text(tmp_path):
    ids = np.array([b"M\xfcller", b"b"])
    path = tmp_path / "a.fits"
    columns = [
        fits.Column("id", "7A", array=ids),
        *(fits.Column(n, "D", unit="deg", array=[1, 2]) for n in ("ra", "dec")),
    ]
    fits.BinTableHDU.from_columns(columns).writeto(path)
    assert "column 'id' must contain text in ASCII or UTF-8, got the bytes b'M\\xfcller'" in refusal(path)
    table = Table({"ra": [1.0, 2.0], "dec": [1.0, 2.0]})
    table["id"] = MaskedColumn(["Müller".encode(), b"b"], mask=[False, True], description="the name", meta={"a": 1})
    table["id"].info.serialize_method["fits"] = "data_mask"
    table.write(path, overwrite=True)
    column = read_table(path)["id"]  # FITS text is ASCII, so that astropy returns these values as bytes
    assert column.tolist() == ["Müller", None]
    assert (column.info.description, column.info.meta) == ("the name", {"a": 1})
    with pytest.raises(rs.InputError, match="id must be text in ASCII or UTF-8"):
        rs.Catalog(SkyCoord([1, 2] * DEG, [1, 2] * DEG), id=ids)


def test_units_that_nobody_knows(tmp_path):
    path = tmp_path / "a.ecsv"
    QTable({"ra": [1, 2.0] * DEG, "dec": [1, 2.0] * DEG}).write(path)
    path.write_text(path.read_text().replace("unit: deg", "unit: degrrr", 1))
    assert "must have a unit convertible to deg, got degrrr" in refusal(path)


def test_the_meta_of_a_focal_plane(small):
    """In YAML, the name y is a truth value and not text."""
    table = small.focal_plane.to_table()
    table.meta["positioner"] = {True: "8.25 mm"}
    with pytest.raises(rs.InputError, match="unknown entries: True"):
        rs.FocalPlane.from_table(table)
    table.meta["positioner"] = {"central_arm": "far"}
    with pytest.raises(rs.InputError, match="the positioner in the table's meta cannot be read"):
        rs.FocalPlane.from_table(table)


def test_a_damaged_part_of_a_survey_is_named(tmp_path, small):
    """The part has a correct checksum, as if another program had written it."""
    from valid_files import sign

    sky = rs.synthetic_catalog("uniform", SkyCoord(95 * DEG, 23 * DEG), 0.5 * DEG, n_targets=50, rng=1)
    folder = tmp_path / "survey"
    rs.plan_survey(sky, small, SkyCoord([95] * DEG, [23] * DEG), folder=folder)
    part = folder / "tiles" / "000" / "000000.fits"
    good = part.read_bytes()
    for content in (b"", b"nothing", good[:4000], good.replace(b"target_id", b"target_ix"), gzip.compress(good)):
        part.write_bytes(content)
        sign(folder)
        with pytest.raises(rs.InputError, match=r"000000\.fits"):
            rs.Survey.read(folder).tile(0)
    (folder / "tiles.fits").write_bytes((folder / "outcomes.fits").read_bytes())
    sign(folder)
    with pytest.raises(rs.InputError, match=r"tiles\.fits must have the columns of a survey"):
        rs.Survey.read(folder)


# --- FITS ----------------------------------------------------------------------------------------------------------


def changed(content, card, value):
    where = content.index(card.ljust(8).encode() + b"=", 2880)
    return content[: where + 10] + str(value).rjust(20).encode() + content[where + 30 :]


def test_fits_headers_must_agree_with_the_file(tmp_path):
    path = tmp_path / "a.fits"
    QTable({"ra": np.arange(200.0) * DEG, "dec": np.zeros(200) * DEG}).write(path)
    good = path.read_bytes()
    for card, value, message in (
        ("TFIELDS", 999999999, "TFIELDS must be a whole number from 0 to 999, got 999999999"),
        ("TFIELDS", 1, "must have NAXIS1 = 16 bytes in all, got 8 bytes"),
        ("NAXIS2", 100, "NAXIS2 may be wrong"),
        ("NAXIS2", 180, "must begin with XTENSION, got other bytes"),
        ("NAXIS2", 10**12, "the file is cut off"),
        ("NAXIS2", -1, "NAXIS2 must be a whole number of at least 0, got -1"),
        ("NAXIS1", 8, "must have NAXIS1 = 8 bytes in all, got 16 bytes"),
        ("NAXIS", 3, "NAXIS3 must be a whole number"),
        ("BITPIX", 7, "BITPIX must be 8, 16"),
        ("PCOUNT", "x", "PCOUNT must be a whole number"),
        ("NAXIS", 1, "the header card NAXIS of a table must be 2, got 1"),
    ):
        path.write_bytes(changed(good, card, value))
        assert message in refusal(path)
    path.write_bytes(good[:-2880])
    assert "the file is cut off" in refusal(path)
    path.write_bytes(good + bytes(2880 * 3))
    assert len(rs.Catalog.read(path)) == 200
    path.write_bytes(good + bytes(2880) + b"rest".ljust(2880))
    assert "must begin with XTENSION, got other bytes" in refusal(path)
    path.write_bytes(good[:2880])
    assert "must contain a table" in refusal(path)
    path.write_bytes(good[:2880].replace(b"EXTEND  =", b"GROUPS  ="))
    assert "the file must contain a table, got random groups" in refusal(path)
    path.write_bytes(good + fits.ImageHDU().header.tostring().encode() * 999)
    assert "must have at most 1000 header and data units, got more" in refusal(path)
    with pytest.raises(rs.InputError, match="a part cannot be read as fits: name already used"):
        read_fits_bytes(good.replace(b"'dec     '", b"'ra      '"), "a part")


def test_the_first_of_several_tables_is_read_with_a_warning(tmp_path):
    path = tmp_path / "a.fits"
    table = QTable({"ra": [1.0] * DEG, "dec": [1.0] * DEG})
    fits.HDUList([fits.PrimaryHDU(), *(fits.table_to_hdu(table) for _ in range(2))]).writeto(path)
    text = "the file has 2 tables, and only the first one was read: 1, 2; to read another table, give hdu= or --set "
    with pytest.warns(rs.RfpsurveyWarning, match=text):
        assert len(rs.Catalog.read(path)) == 1


def test_fits_tables_of_text_are_read(tmp_path):
    columns = [fits.Column("id", "A7", array=["a", "star 2"]), fits.Column("ra", "F7.3", array=[1.5, 20.25])]
    path = tmp_path / "a.fits"
    fits.TableHDU.from_columns(columns).writeto(path)
    table = read_table(path)
    assert table["id"].tolist() == ["a", "star 2"]
    assert table["ra"].tolist() == [1.5, 20.25]


# --- at the command line -------------------------------------------------------------------------------------------


def test_refused_files_are_one_line_at_the_command_line(run, tmp_path):
    lines = list(GOOD)
    lines[48] = '"' + lines[48]
    csv(tmp_path / "quote.csv", lines)
    (tmp_path / "href.vot").write_text(VOTABLE.format('<BINARY><STREAM href="file:///etc/passwd"/></BINARY>'))
    (tmp_path / "deep.toml").write_text("a = " + "[" * 100_000)
    Table({"ra": [1.0], "dec": [2.0]}, meta={"RFPSURVY": 3}).write(tmp_path / "card.fits")
    for name in ("quote.csv", "href.vot", "card.fits"):
        assert name in sentence(*run("plan", tmp_path / name, "--instrument", "moons")[::2])
    assert "deep.toml" in sentence(*run("plan", "--instrument", tmp_path / "deep.toml")[::2])


def test_masked_columns_stay_masked(tmp_path):
    table = QTable(
        {"ra": [1, 2.0] * DEG, "dec": [1, 2.0] * DEG, "category": MaskedColumn(["a", "b"], mask=[True, False])}
    )
    for name in ("a.ecsv", "a.vot"):
        table.write(tmp_path / name, **({"format": "votable"} if name == "a.vot" else {}))
        assert rs.Catalog.read(tmp_path / name).category.tolist() == ["", "b"]


# --- all tables of a FITS file ---------------------------------------------------------------------------------------


def test_all_tables_of_a_fits_file_are_read_with_their_keywords(tmp_path):
    units = [fits.PrimaryHDU(), fits.ImageHDU(np.zeros((2, 2)))]
    for name, n in (("ONE", 3), ("TWO", 0)):
        units.append(fits.table_to_hdu(Table({"a": np.arange(n), "b": np.full(n, "x")})))
        units[-1].header.update({"EXTNAME": name, "TILE": n})
    units[0].header.update({"OBSERVER": "o" * 100})
    units[0].header["COMMENT"] = "no keyword"
    fits.HDUList(units).writeto(tmp_path / "a.fits")
    header, tables = read_tables(tmp_path / "a.fits")
    assert header == {"OBSERVER": "o" * 100}
    assert [table.meta for table in tables] == [{"EXTNAME": "ONE", "TILE": 3}, {"EXTNAME": "TWO", "TILE": 0}]
    assert [len(table) for table in tables] == [3, 0]
    assert tables[0]["b"].tolist() == ["x"] * 3
    assert "there is no such file" in refusal(tmp_path / "b.fits", read_tables)
    (tmp_path / "b.fits").write_text("id,ra,dec")
    assert "cannot be read as fits: it must begin with SIMPLE" in refusal(tmp_path / "b.fits", read_tables)


def test_the_fast_reader_of_simple_tables_agrees_with_astropy(monkeypatch):
    rng = np.random.default_rng(1)
    columns = {
        "name": np.array(["a", " b ", "", "long name"]),
        "flag": np.array([True, False, True, True]),
        "byte": np.arange(4, dtype="u1"),
        **{kind: rng.normal(0, 1e4, 4).astype(kind) for kind in ("i2", "i4", "i8", "f4", "f8")},
    }
    cards = {"TILE": "it is", "RA": 12.5, "SMALL": 1e-300, "N": (-3, "a comment / with a slash"), "YES": True}
    content = _io.fits_bytes(columns, cards)
    plain = read_plain(content)
    monkeypatch.setattr("rfpsurvey._readers._fits.read_plain", lambda _: None)
    slow = read_fits_bytes(content)
    assert plain[0].dtype == slow[0].dtype
    assert plain[0].tolist() == slow[0].tolist()
    assert plain[0]["f8"].tolist() == columns["f8"].tolist()
    assert plain[1] == slow[1]
    for other in (
        content[:-1],
        content + bytes(2880),
        _io.fits_bytes(columns, {"TILE": "it's"}),
        _io.fits_bytes(columns, {"COMMENT": "a text"}),
        content.replace(b"TTYPE2  = 'flag    '", b"TTYPE2  = 'name    '"),
        content.replace(b"TFORM3  = 'B       '", b"TFORM3  = 'X       '"),
        content.replace(b"RA      =                 12.5", b"RA      =                  nan"),
        content.replace(b"RA      =                 12.5", b"RA      =                1_000"),
        content.replace(b"RA      =                 12.5", b"ra      =                 12.5"),
        content.replace(b"TILE    = 'it is   '", b"TILE    = 'it is    "),
        content.replace(b"TILE    = 'it is   '", b"TILE    = 'it is'  x"),
        content.replace(b"TILE    = 'it is   '", b"TILE    = 'it \xe9s   '"),
        content.replace(b"NAXIS   =                    2", b"NAXIS   =                    3"),
    ):
        assert read_plain(other) is None
