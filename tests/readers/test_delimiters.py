"""Text tables with delimiters other than commas, and with lines before the names of the columns."""

import astropy.units as u
import numpy as np
import pytest

import rfpsurvey as rs
from refusals import refusal
from rfpsurvey._readers import read_table

pytestmark = pytest.mark.filterwarnings("ignore:column 'id' .id. is empty in 1 of")
ROWS = {"comma": ",", "semicolon": ";", "tab": "\t", "bar": "|"}


@pytest.mark.parametrize("name", ["a.csv", "a.tsv", "a.csv.gz"])
@pytest.mark.parametrize("text", ["s", "ä"])  # a different reader of astropy reads this
@pytest.mark.parametrize("delimiter", ROWS.values(), ids=ROWS)
def test_the_delimiter_is_found_in_the_line_of_names(tmp_path, delimiter, text, name):
    import gzip

    rows = [["id", "ra", "dec", "pmra", "pmdec"], [text, 10, 20, 1, 2], ["", 11, 21, "", ""], ["b", 12, 22, 3, 4]]
    content = "\n".join(delimiter.join(map(str, row)) for row in rows).encode()
    (tmp_path / name).write_bytes(gzip.compress(content) if name.endswith("gz") else content)
    catalog = rs.Catalog.read(tmp_path / name)
    assert catalog.id.tolist() == [text, "", "b"]
    assert catalog.coord.ra.deg.tolist() == pytest.approx([10, 11, 12])
    np.testing.assert_allclose(catalog.coord.pm_ra_cosdec.value, [1, np.nan, 3])
    np.testing.assert_allclose(catalog.coord.pm_dec.value, [2, np.nan, 4])


@pytest.mark.parametrize("delimiter", [";", "\t", "|"])
def test_quoted_values_may_hold_the_delimiter(tmp_path, delimiter):
    path = tmp_path / "a.csv"
    path.write_text('"id";"ra";"dec"\n"a;b";10;20\n;11;21\n'.replace(";", delimiter).replace(f"a{delimiter}", "a;"))
    assert rs.Catalog.read(path).id.tolist() == ["a;b", ""]
    path.write_text('id;ra;dec\n"a;b;10;20\n'.replace(";", delimiter))
    assert "an unclosed quotation mark in line 2" in refusal(path)
    path.write_text("id;ra;dec\na;10\n".replace(";", delimiter))
    assert "line 2 must have 3 fields, like the first line, got 2 fields" in refusal(path)


def test_two_delimiters_are_told_apart_by_the_first_row(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("ra,dec,name; or id\n10,20,x\n")
    assert rs.Catalog.read(path).coord.ra.deg.tolist() == [10]
    path.write_text("ra;dec;name, or id\n10;20;x\n")
    assert rs.Catalog.read(path).coord.ra.deg.tolist() == [10]
    path.write_text("id;ra|dec\na;10|20\n")
    assert "one delimiter must separate the columns, got semicolon and vertical bar; put commas" in refusal(path)


def test_files_without_names_or_delimiters_are_refused(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("ra dec\n10 20\n")
    assert "commas must separate the names of the columns, got blanks in 'ra dec'" in refusal(path)
    for text in ("", "# nothing\n", "\n\n"):
        path.write_text(text)
        assert "the first row must contain the names of the columns, got no row" in refusal(path)


def test_decimal_commas_are_refused_with_a_remedy(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("ra;dec\n10,5;20,5\n")
    text = "column 'ra' (ra) must hold decimal numbers or sexagesimal text, got '10,5'; replace the decimal comma with"
    assert f"{text} a point" in refusal(path)


def test_the_names_may_stand_in_a_comment(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("# from somewhere\n# ra, dec\n10,20\n11,21\n")
    assert rs.Catalog.read(path).coord.ra.deg.tolist() == pytest.approx([10, 11])
    for text in ("10,20\n11,21\n", "# a comment\n10,20\n11,21\n", "# 1,2\n10,20\n11,21\n"):
        path.write_text(text)
        assert "the first row must contain the names of the columns, got '10'" in refusal(path)


def test_tables_of_vizier_have_units(tmp_path):
    path = tmp_path / "a.tsv"
    path.write_text(
        "#RESOURCE=yCat_1355\n#Name: I/355/gaiadr3\n\n_RAJ2000\tDEJ2000\tSource\tpmRA\tpmDE\tName\n"
        "arcmin\tdeg\t \tarcsec/yr\tmas/yr\tnounit\n------\t---\t-----\t---\t---\t---\n"
        " 600.0\t 20.0\t1152921504606846977\t 0.001\t 2\tx\n 660.0\t 21.0\t1152921504606846978\t      \t  \ty\n\n"
    )
    catalog = rs.Catalog.read(path)
    assert catalog.coord.ra.deg.tolist() == pytest.approx([10, 11])
    assert catalog.id.tolist() == [2**60 + 1, 2**60 + 2]
    np.testing.assert_allclose(catalog.coord.pm_ra_cosdec.to_value(u.mas / u.yr), [1, np.nan])
    path.write_text('RAJ2000;DEJ2000\n"h:m:s";"d:m:s"\n-----;---\n06 20 00;+23 00 00\n')
    assert rs.Catalog.read(path).coord.ra.deg.tolist() == pytest.approx([95])
    path.write_text("ra;dec\n--;--\n10;20\n")  # a line of dashes without a line of units
    assert len(rs.Catalog.read(path)) == 1


def test_dashes_in_a_later_row_are_a_row(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("ra,dec\n10,20\n11,21\n--,--\n")
    assert len(read_table(path)) == 3


def test_what_spreadsheets_write_before_the_names(tmp_path):
    path = tmp_path / "a.csv"
    path.write_bytes(b"\xef\xbb\xbfsep=;\r\nra;dec\r\n10;20\r\n")
    assert rs.Catalog.read(path).coord.ra.deg.tolist() == [10]
    path.write_text("ra,dec\n10,20\n", encoding="utf-16")
    assert "the file must be text in UTF-8, got UTF-16; save it as UTF-8" in refusal(path)


def test_words_for_missing_numbers(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("ra,dec,pmra,pmdec\n10,20,null,--\n11,21,N/A,\n12,22,1,2\n")
    np.testing.assert_allclose(rs.Catalog.read(path).coord.pm_dec.value, [np.nan, np.nan, 2])


@pytest.mark.parametrize("last", ["s", "ä"])  # a different reader of astropy reads this
@pytest.mark.parametrize("delimiter", ROWS.values(), ids=ROWS)
def test_digits_with_leading_zeros_stay_text(tmp_path, delimiter, last):
    rows = ["id,n,zero,signed,dec,quoted,gap,last", '001,1,0,-5,05,"007",,a', '01,20,3,05,1.5,"8",02,b']
    rows.append(f'12,3,10,7,2,"9",3,{last}')
    path = tmp_path / "a.csv"
    path.write_text("\n".join(rows).replace(",", delimiter), encoding="utf-8")
    table = read_table(path)
    assert table["id"].tolist() == ["001", "01", "12"]
    assert table["quoted"].tolist() == ["007", "8", "9"]
    assert table["gap"].tolist() == [None, "02", "3"]
    assert table["n"].tolist() == [1, 20, 3]
    assert table["zero"].tolist() == [0, 3, 10]
    assert table["signed"].tolist() == [-5, 5, 7]
    assert table["dec"].tolist() == [5, 1.5, 2]
    assert table["last"].tolist() == ["a", "b", last]


def test_numbers_with_leading_zeros_are_read_as_numbers(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("id,ra,dec,priority\r\n01,005,10,02\r\n001,010,20,03\r\n")
    assert read_table(path)["priority"].tolist() == ["02", "03"]
    catalog = rs.Catalog.read(path)
    assert catalog.id.tolist() == ["01", "001"]
    assert catalog.coord.ra.deg.tolist() == pytest.approx([5, 10])
    assert catalog.priority.tolist() == [2, 3]
