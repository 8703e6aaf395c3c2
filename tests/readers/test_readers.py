"""Regression tests: files that lost rows, caused other files to be read, or raised unhandled exceptions."""

import gzip
import json
from functools import partial

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.io import fits
from astropy.table import MaskedColumn, QTable, Table

import rfpsurvey as rs
from refusals import refusal, sentence, written
from rfpsurvey._common import io as _io
from rfpsurvey._common.read_fits import read_fits_bytes, read_plain
from rfpsurvey._common.read_tables import read_table, read_tables

DEG = u.deg
PLACES = {"ra": [1, 2.0] * DEG, "dec": [1, 2.0] * DEG}
GOOD = [f"s{k},{10 + 0.01 * k},20.0" for k in range(100)]
OPEN = [*GOOD[:48], '"' + GOOD[48], *GOOD[49:]]
UNCLOSED = "an unclosed quotation mark in line"


def rows(lines, end="\n"):
    return (end.join(["id,ra,dec", *lines]) + end).encode("utf-8", "surrogateescape")


# --- quotation marks and rows of text ------------------------------------------------------------------------------


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("name", ["a.csv", "a.csv.gz"])
def test_an_open_quotation_mark_drops_no_rows(tmp_path, name, end):
    """Regression: only 50 of 100,000 targets were read, without a warning."""
    content = gzip.compress(rows(OPEN, end)) if name.endswith(".gz") else rows(OPEN, end)
    assert f"{UNCLOSED} 50" in refusal(written(tmp_path / name, content))


def test_rows_that_are_not_whole_are_refused(tmp_path):
    """Regression: short rows had empty values, a NUL byte shifted all values after it, and ten rows were one value."""
    assert f"{UNCLOSED} 50" in refusal(written(tmp_path / "a.csv", rows([*OPEN[:58], OPEN[58] + '"', *OPEN[59:]])))
    for text in ('a "b,"c d,1,2', 'a,"b",1,"2', ' "x,1,2', '"a""b,1,2'):
        assert f"{UNCLOSED} 2" in refusal(written(tmp_path / "a.csv", rows([text, *GOOD])))
    for line, message in (
        ("b,10.5", "have 3 fields, like the first line, got 2 fields"),
        ("b,10.5,1,2", "have 3 fields, like the first line, got 4 fields"),
        ('"b,10.5",1', "have 3 fields, like the first line, got 2 fields"),
        ("b\0,10.5,1", "be text, got a NUL byte"),
        ("b\x85\udce4,10.5,1", "be text in UTF-8, got the byte 0xe4"),
    ):
        path = written(tmp_path / "a.csv", rows([*GOOD[:2], line, *GOOD[2:]]))
        assert f"line 4 must {message}" in refusal(path)
    assert f"{UNCLOSED} 1" in refusal(written(path, '"id,ra,dec\na,10,20\n'))


@pytest.mark.filterwarnings(r"ignore:column .* \(id\) is empty")
def test_good_quotation_marks_are_kept(tmp_path):
    texts = {'"a, b"': "a, b", '"a ""b"" c"': 'a "b" c', '""': "", ' "c, d"': "c, d", '5" disc': '5" disc'}
    texts |= {"d'Arrest": "d'Arrest", '"Größe, Ä"': "Größe, Ä"}
    for text, expected in texts.items():
        path = written(tmp_path / "a.csv", rows([f"{text},10,20", '"other" ,11,21', "third,12,22"]))
        assert rs.Catalog.read(path).id.tolist() == [expected, "other", "third"]
    assert rs.Catalog.read(written(path, '"id","ra", "dec"\n"a",10,20\n')).id.tolist() == ["a"]
    assert read_table(written(path, "id,ra,dec")).colnames == ["id", "ra", "dec"]


def test_blank_lines_comments_and_line_ends_are_no_rows(tmp_path):
    """Unicode line separators, at which Python splits text, do not end the lines of a file."""
    lines = ['# "a comment', "", *GOOD[:5], "   ", '  # 5" more, of, them', *GOOD[5:], "", ""]
    for end in ("\n", "\r\n", "\r"):
        assert len(rs.Catalog.read(written(tmp_path / "a.csv", rows(lines, end)))) == 100
    lines = ["Ä\u2028ö,10,20", "b\x0bc,11,21", "c\x85d,12,22"]
    assert len(rs.Catalog.read(written(tmp_path / "a.csv", rows(lines)))) == 3


@pytest.mark.parametrize("delimiter", [" ", ","])
def test_ecsv_with_an_open_quotation_mark(tmp_path, delimiter):
    table = QTable({"id": ["a b, c", 'd "e"', "f"], "ra": [1, 2, 3.0] * DEG, "dec": [1, 2, 3.0] * DEG})
    path = tmp_path / "a.ecsv"
    table.write(path, delimiter=delimiter)
    assert rs.Catalog.read(path).id.tolist() == ["a b, c", 'd "e"', "f"]
    lines = path.read_text().split("\n")
    for change in ('"' + lines[-2], lines[-2] + delimiter + '"g'):
        text = refusal(written(path, "\n".join([*lines[:-2], change, *lines[-3:]])))
        assert f"unclosed quotation mark in line {len(lines) - 1}" in text


def test_text_in_ecsv_has_a_limited_width(tmp_path):
    text = "# %ECSV 1.0\n# ---\n# datatype:\n# - {name: a, datatype: '<U100000'}\na\nx\n"
    message = "the values of a column must have at most 99999 characters, got the width 100000"
    assert message in refusal(written(tmp_path / "a.ecsv", text))


def test_a_name_of_a_file_with_a_nul_is_refused(tmp_path):
    with pytest.raises(rs.InputError, match=r"a\\x00\.fits: there is no such file"):
        rs.Catalog.read(f"{tmp_path}/a\0.fits")


def test_numbers_beyond_doubles_are_told(tmp_path):
    path = written(tmp_path / "a.csv", "id,ra,dec,pmra,pmdec\na,10,20,1e999,1\nb,10,21,1,1\n")
    with pytest.warns(rs.RfpsurveyWarning, match="column pmra"):
        catalog = rs.Catalog.read(path)
    assert np.isnan(catalog.coord.pm_ra_cosdec).tolist() == [True, False]
    text = "id,ra,dec,pmra,pmdec\na,10,20,1e20,1\n"
    assert "column 'pmra' (pmra) must lie between" in refusal(written(path, text))


# --- unhandled exceptions ------------------------------------------------------------------------------------------


def test_the_meta_of_a_table_must_be_an_object(tmp_path):
    kinds, path = {3: "int", "3": "int", '["a"]': "list", '"text"': "str"}, tmp_path / "a.fits"
    messages = {value: f"must be an object in JSON, got {kind}" for value, kind in kinds.items()}
    messages["[" * 100_000] = "must be nested at most 32 levels deep, got more"
    messages['{"a":' + "[" * 40 + "]" * 40 + "}"] = "values must be nested at most 32 levels deep, got more"
    messages[json.dumps({"a": [0] * 100_001})] = "at most 100000 values"
    for value, message in messages.items():
        Table({"ra": [1.0], "dec": [2.0]}, meta={"RFPSURVY": value}).write(path, overwrite=True)
        assert message in refusal(path)


def test_deeply_nested_documents_are_refused(tmp_path):
    for text in ("a = " + "[" * 100_000, "a = " + "{a=" * 50_000, ".".join(["a"] * 50_000) + " = 1"):
        assert "at most 32" in refusal(written(tmp_path / "a.toml", f"{text}\n"), rs.Instrument.read)


def test_columns_of_objects_and_of_several_values(tmp_path):
    objects = np.empty(2, dtype=object)
    objects[:] = [{"a": 1}, [1, 2]]
    many, path = [[1, 2], [3, 4]], tmp_path / "a.ecsv"
    refused = {"ra": (many * DEG, "column 'ra' (ra) must have one value per row")}
    for role in ("id", "category", "kind", "fiber_type", "priority", "visits"):
        refused[role] = many, f"column '{role}' ({role}) must have one value per row, got 2 values per row"
        QTable(PLACES | {role: objects}).write(path, overwrite=True)
        assert "must hold numbers or text, got {'a': 1}" in refusal(path)
    for role, (values, message) in refused.items():
        QTable(PLACES | {role: values}).write(path, overwrite=True)
        assert message in refusal(path)
    QTable(PLACES | {"other": objects, "more": many}).write(path, overwrite=True)
    assert len(rs.Catalog.read(path)) == 2
    with pytest.raises(rs.InputError, match="category must hold numbers or text, got {"):
        rs.Catalog(SkyCoord(*PLACES.values()), category=objects)


def test_bytes_that_are_no_text(tmp_path):
    ids, path = np.array([b"M\xfcller", b"b"]), tmp_path / "a.fits"
    columns = [fits.Column("id", "7A", array=ids), *(fits.Column(n, "D", array=[1, 2]) for n in ("ra", "dec"))]
    fits.BinTableHDU.from_columns(columns).writeto(path)
    assert "column 'id' must contain text in ASCII or UTF-8, got the bytes b'M\\xfcller'" in refusal(path)
    table = Table(PLACES)
    table["id"] = MaskedColumn(["Müller".encode(), b"b"], mask=[False, True], description="the name", meta={"a": 1})
    table["id"].info.serialize_method["fits"] = "data_mask"
    table.write(path, overwrite=True)
    column = read_table(path)["id"]  # FITS text is ASCII, so that astropy returns these values as bytes
    assert (column.tolist(), column.description, column.meta) == (["Müller", None], "the name", {"a": 1})
    with pytest.raises(rs.InputError, match="id must be text in ASCII or UTF-8"):
        rs.Catalog(SkyCoord(*PLACES.values()), id=ids)


def test_units_that_nobody_knows(tmp_path):
    path = tmp_path / "a.ecsv"
    QTable(PLACES).write(path)
    path = written(path, path.read_text().replace("unit: deg", "unit: degrrr", 1))
    assert "must have a unit convertible to deg, got degrrr" in refusal(path)


def test_the_meta_of_a_focal_plane(small):
    """In YAML, the name y is a truth value and not text."""
    table = small.focal_plane.to_table()
    for value, message in (
        ({True: "8.25 mm"}, "unknown entries: True"),
        ({"central_arm": "far"}, "the positioner in the table's meta cannot be read"),
    ):
        table.meta["positioner"] = value
        with pytest.raises(rs.InputError, match=message):
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
    cards = (
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
    )
    images = fits.ImageHDU().header.tostring().encode() * 999
    for content, message in (
        *((changed(good, card, value), message) for card, value, message in cards),
        (good[:-2880], "the file is cut off"),
        (good + bytes(2880) + b"rest".ljust(2880), "must begin with XTENSION, got other bytes"),
        (good[:2880], "must contain a table"),
        (good[:2880].replace(b"EXTEND  =", b"GROUPS  ="), "the file must contain a table, got random groups"),
        (good + images, "must have at most 1000 header and data units, got more"),
    ):
        assert message in refusal(written(path, content))
    assert len(rs.Catalog.read(written(path, good + bytes(2880 * 3)))) == 200
    with pytest.raises(rs.InputError, match="a part cannot be read as fits: name already used"):
        read_fits_bytes(good.replace(b"'dec     '", b"'ra      '"), "a part")


def test_fits_tables_of_text_are_read(tmp_path):
    columns = [fits.Column("id", "A7", array=["a", "star 2"]), fits.Column("ra", "F7.3", array=[1.5, 20.25])]
    path = tmp_path / "a.fits"
    fits.TableHDU.from_columns(columns).writeto(path)
    assert [column.tolist() for column in read_table(path).itercols()] == [["a", "star 2"], [1.5, 20.25]]


# --- at the command line -------------------------------------------------------------------------------------------


def test_refused_files_are_one_line_at_the_command_line(run, tmp_path):
    (tmp_path / "quote.csv").write_bytes(rows(OPEN))
    (tmp_path / "href.vot").write_text('<VOTABLE><STREAM href="file:///etc/passwd"/></VOTABLE>')
    (tmp_path / "deep.toml").write_text("a = " + "[" * 100_000)
    Table({"ra": [1.0], "dec": [2.0]}, meta={"RFPSURVY": 3}).write(tmp_path / "card.fits")
    for name in ("quote.csv", "href.vot", "card.fits"):
        assert name in sentence(*run("plan", tmp_path / name, "--instrument", "moons")[::2])
    assert "deep.toml" in sentence(*run("plan", "--instrument", tmp_path / "deep.toml")[::2])


def test_masked_columns_stay_masked(tmp_path):
    table = QTable(PLACES | {"category": MaskedColumn(["a", "b"], mask=[True, False])})
    for name in ("a.ecsv", "a.vot"):
        table.write(tmp_path / name, **({"format": "votable"} if name == "a.vot" else {}))
        assert rs.Catalog.read(tmp_path / name).category.tolist() == ["", "b"]


# --- several tables of a FITS file -----------------------------------------------------------------------------------


def test_a_table_of_a_file_is_chosen_by_its_number_or_name(tmp_path):
    """Only the first table of a FITS file could be read."""
    path = tmp_path / "a.fits"
    hdus = [fits.PrimaryHDU(), fits.ImageHDU(np.zeros((2, 2)))]
    for n, name in ((1, "TARGETS"), (2, "sky"), (3, "TWICE"), (4, "TWICE"), (5, "")):
        hdus.append(fits.table_to_hdu(QTable({"ra": np.arange(n) * DEG, "dec": np.arange(n) * DEG})))
        hdus[-1].name = name
    fits.HDUList(hdus).writeto(path)
    for hdu, n in ((2, 1), ("2", 1), (np.int32(3), 2), ("SKY", 2), (" targets ", 1), (5, 4), (6, 5)):
        for read in (rs.Catalog.read, rs.Tiling.read):
            assert len(read(path, hdu=hdu)) == n
    text = (
        r"the file has 5 tables, and only the first one was read: 2 \(TARGETS\), 3 \(SKY\), 4 .*, 6; to read another "
    )
    for read, remedy in ((rs.Catalog.read, "table, give hdu= or --set "), (rs.Tiling.read, ".*--set tiles.hdu=NAME$")):
        with pytest.warns(rs.RfpsurveyWarning, match=text + remedy):
            assert len(read(path)) == 1
    assert rs.Catalog.read(path, hdu="sky").meta["hdu"] == "sky"
    rs.Catalog.read(path, hdu=3).write(tmp_path / "a.ecsv")
    tables = "the number or the unique name of a table in the file (2 (TARGETS), 3 (SKY), 4 (TWICE), 5 (TWICE), 6)"
    for name, hdu, message in (
        *(("a.fits", hdu, f"must be {tables}, got {hdu!r}") for hdu in (0, 1, 7, -1, "TWICE", "none", "")),
        ("a.ecsv", "sky", "must be used only with FITS files, got 'sky'"),
    ):
        text = refusal(tmp_path / name, partial(rs.Catalog.read, hdu=hdu))
        assert f"hdu {message}" in text
    for hdu in (True, 2.0):
        with pytest.raises(TypeError, match="hdu must be the number or the name of a table, got"):
            rs.Catalog.read(path, hdu=hdu)


def test_all_tables_of_a_fits_file_are_read_with_their_keywords(tmp_path):
    units = [fits.PrimaryHDU(), fits.ImageHDU(np.zeros((2, 2)))]
    for name, n in (("ONE", 3), ("TWO", 0)):
        units.append(fits.table_to_hdu(Table({"a": np.arange(n), "b": np.full(n, "x")})))
        units[-1].header.update({"EXTNAME": name, "TILE": n})
    units[0].header.update({"OBSERVER": "o" * 100, "COMMENT": "no keyword"})
    fits.HDUList(units).writeto(tmp_path / "a.fits")
    header, tables = read_tables(tmp_path / "a.fits")
    assert header == {"OBSERVER": "o" * 100}
    assert [table.meta for table in tables] == [{"EXTNAME": "ONE", "TILE": 3}, {"EXTNAME": "TWO", "TILE": 0}]
    assert [table["b"].tolist() for table in tables] == [["x"] * 3, []]
    assert "there is no such file" in refusal(tmp_path / "b.fits", read_tables)
    path = written(tmp_path / "b.fits", "id,ra,dec")
    assert "cannot be read as fits: it must begin with SIMPLE" in refusal(path, read_tables)


def test_the_fast_reader_of_simple_tables_agrees_with_astropy(monkeypatch):
    rng = np.random.default_rng(1)
    columns = {"name": np.array(["a", " b ", "", "long name"]), "flag": np.arange(4) != 1, "byte": np.uint8(range(4))}
    columns |= {kind: rng.normal(0, 1e4, 4).astype(kind) for kind in ("i2", "i4", "i8", "f4", "f8")}
    cards = {"TILE": "it is", "RA": 12.5, "SMALL": 1e-300, "N": (-3, "a comment / with a slash"), "YES": True}
    cards |= {"LONG": "long text " * 15, "NONE": ""}
    content = _io.fits_bytes(columns, cards)
    plain = read_plain(content)
    monkeypatch.setattr("rfpsurvey._common.read_fits.read_plain", lambda _: None)
    slow = read_fits_bytes(content)
    assert plain[0].dtype == slow[0].dtype
    assert plain[0].tolist() == slow[0].tolist()
    assert plain[0]["f8"].tolist() == columns["f8"].tolist()
    assert plain[1] == slow[1]
    ra, tile = "RA      =                 12.5", "TILE    = 'it is   '"
    changes = {ra: [ra.replace("12.5", " nan"), ra.replace(" 12.5", "1_000"), ra.lower()]}
    changes[tile] = ["TILE    = 'it is    ", f"{tile[:16]}'  x", "TILE    = 'it \xe9s   '", f"CONTINUE={tile[9:]}"]
    changes[tile].append(f"CONTINUE {tile[9:]}")
    changes["TTYPE2  = 'flag    '"] = ["TTYPE2  = 'name    '"]
    changes["TFORM3  = 'B       '"] = ["TFORM3  = 'X       '", "TFORM3  =  T        "]  # T caused an AttributeError
    changes["NAXIS   =                    2"] = ["NAXIS   =                    3"]
    for old, new in ((old, new) for old, others in changes.items() for new in others):
        assert len(old) == len(new)
        assert content.count(old.encode()) == 1
        assert read_plain(content.replace(old.encode(), new.encode("latin-1"))) is None
    others = [_io.fits_bytes(columns, cards) for cards in ({"TILE": "it's"}, {"COMMENT": "a text"})]
    for other in (content[:-1], content + bytes(2880), *others):
        assert read_plain(other) is None
