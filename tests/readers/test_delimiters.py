"""Text tables with delimiters other than commas, and with lines before the names of the columns."""

import gzip

import astropy.units as u
import numpy as np
import pytest

import rfpsurvey as rs
from refusals import refusal, written
from rfpsurvey._common.read_tables import read_table

pytestmark = pytest.mark.filterwarnings("ignore:column 'id' .id. is empty in 1 of")


@pytest.fixture
def path(tmp_path):
    return tmp_path / "a.csv"


DELIMITERS = pytest.mark.parametrize("delimiter", [",", ";", "\t", "|"], ids=["comma", "semicolon", "tab", "bar"])


@pytest.mark.parametrize("name", ["a.csv", "a.tsv", "a.csv.gz"])
@pytest.mark.parametrize("text", ["s", "ä"])  # a different reader of astropy reads this
@DELIMITERS
def test_the_delimiter_is_found_in_the_line_of_names(tmp_path, delimiter, text, name):
    rows = ["id,ra,dec,pmra,pmdec", f"{text},10,20,1,2", ",11,21,,", "b,12,22,3,4"]
    content = "\n".join(rows).replace(",", delimiter).encode()
    catalog = rs.Catalog.read(written(tmp_path / name, gzip.compress(content) if name.endswith("gz") else content))
    assert catalog.id.tolist() == [text, "", "b"]
    assert catalog.coord.ra.deg.tolist() == pytest.approx([10, 11, 12])
    np.testing.assert_allclose(catalog.coord.pm_ra_cosdec.value, [1, np.nan, 3])
    np.testing.assert_allclose(catalog.coord.pm_dec.value, [2, np.nan, 4])


@pytest.mark.parametrize("delimiter", [";", "\t", "|"])
def test_quoted_values_may_hold_the_delimiter(path, delimiter):
    text = '"id";"ra";"dec"\n"a;b";10;20\n;11;21\n'.replace(";", delimiter).replace(f"a{delimiter}", "a;")
    assert rs.Catalog.read(written(path, text)).id.tolist() == ["a;b", ""]
    for text, message in (
        ('id;ra;dec\n"a;b;10;20\n', "an unclosed quotation mark in line 2"),
        ("id;ra;dec\na;10\n", "line 2 must have 3 fields, like the first line, got 2 fields"),
    ):
        assert message in refusal(written(path, text.replace(";", delimiter)))


def test_files_without_names_or_delimiters_are_refused(path):
    numbers = "column 'ra' (ra) must hold decimal numbers or sexagesimal text, got '10,5'"
    two = "one delimiter must separate the columns, got semicolon and vertical bar; put commas"
    begins = ("", "# a comment\n", "# 1,2\n")
    for message, contents in {
        "commas must separate the names of the columns, got blanks in 'ra dec'": ["ra dec\n10 20\n"],
        two: ["id;ra|dec\na;10|20\n"],
        f"{numbers}; replace the decimal comma with a point": ["ra;dec\n10,5;20,5\n"],
        "the first row must contain the names of the columns, got no row": ["", "# nothing\n", "\n\n"],
        "the first row must contain the names of the columns, got '10'": [f"{one}10,20\n11,21\n" for one in begins],
        "the file must be text in UTF-8, got UTF-16; save it as UTF-8": ["ra,dec\n10,20\n".encode("utf-16")],
    }.items():
        for content in contents:
            assert message in refusal(written(path, content))


def test_names_and_delimiters_are_found(path):
    """Two delimiters are distinguished by the first row; names can be in a comment or after lines of spreadsheets."""
    for content, expected in (
        ("ra,dec,name; or id\n10,20,x\n", [10]),
        ("ra;dec;name, or id\n10;20;x\n", [10]),
        ("# from somewhere\n# ra, dec\n10,20\n11,21\n", [10, 11]),
        ('RAJ2000;DEJ2000\n"h:m:s";"d:m:s"\n-----;---\n06 20 00;+23 00 00\n', [95]),
        ("ra;dec\n--;--\n10;20\n", [10]),  # a line of dashes without a line of units
        (b"\xef\xbb\xbfsep=;\r\nra;dec\r\n10;20\r\n", [10]),
    ):
        assert rs.Catalog.read(written(path, content)).coord.ra.deg.tolist() == pytest.approx(expected)


def test_tables_of_vizier_have_units(tmp_path):
    text = (
        "#RESOURCE=yCat_1355\n#Name: I/355/gaiadr3\n\n_RAJ2000\tDEJ2000\tSource\tpmRA\tpmDE\tName\n"
        "arcmin\tdeg\t \tarcsec/yr\tmas/yr\tnounit\n------\t---\t-----\t---\t---\t---\n"
        " 600.0\t 20.0\t1152921504606846977\t 0.001\t 2\tx\n 660.0\t 21.0\t1152921504606846978\t      \t  \ty\n\n"
    )
    catalog = rs.Catalog.read(written(tmp_path / "a.tsv", text))
    assert catalog.coord.ra.deg.tolist() == pytest.approx([10, 11])
    assert catalog.id.tolist() == [2**60 + 1, 2**60 + 2]
    np.testing.assert_allclose(catalog.coord.pm_ra_cosdec.to_value(u.mas / u.yr), [1, np.nan])


def test_dashes_in_a_later_row_are_a_row(path):
    assert len(read_table(written(path, "ra,dec\n10,20\n11,21\n--,--\n"))) == 3


def test_words_for_missing_numbers(path):
    found = rs.Catalog.read(written(path, "ra,dec,pmra,pmdec\n10,20,null,--\n11,21,N/A,\n12,22,1,2\n"))
    np.testing.assert_allclose(found.coord.pm_dec.value, [np.nan, np.nan, 2])


LEADING = {"id": ["001", "01", "12"], "quoted": ["007", "8", "9"], "gap": [None, "02", "3"], "n": [1, 20, 3]}
LEADING |= {"zero": [0, 3, 10], "signed": [-5, 5, 7], "dec": [5, 1.5, 2]}


@pytest.mark.parametrize("last", ["s", "ä"])  # a different reader of astropy reads this
@DELIMITERS
def test_digits_with_leading_zeros_stay_text(path, delimiter, last):
    rows = ["id,n,zero,signed,dec,quoted,gap,last", '001,1,0,-5,05,"007",,a', '01,20,3,05,1.5,"8",02,b']
    rows.append(f'12,3,10,7,2,"9",3,{last}')
    table = read_table(written(path, "\n".join(rows).replace(",", delimiter)))
    assert {name: table[name].tolist() for name in (*LEADING, "last")} == LEADING | {"last": ["a", "b", last]}


def test_numbers_with_leading_zeros_are_read_as_numbers(path):
    written(path, "id,ra,dec,priority\r\n01,005,10,02\r\n001,010,20,03\r\n")
    assert read_table(path)["priority"].tolist() == ["02", "03"]
    catalog = rs.Catalog.read(path)
    assert catalog.id.tolist() == ["01", "001"]
    assert catalog.coord.ra.deg.tolist() == pytest.approx([5, 10])
    assert catalog.priority.tolist() == [2, 3]
