"""Columns with odd names, contents and units are the same after they were written and read, or they are refused."""

import astropy.units as u
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import QTable
from odd_columns import COLUMNS
from raising import refused, warned

import rfpsurvey as rs
from rfpsurvey._sky.arrays import result_name

pytestmark = pytest.mark.filterwarnings("ignore:It is strongly recommended that column names")
CENTER = SkyCoord([95] * u.deg, [23] * u.deg)
REFUSED = {
    *("line break", "carriage return", "NUL", "bell and delete", "form feed", "tab", "next line", "half of a pair"),
    *("bytes in no encoding", "objects of text"),
    *(f"the name {name!r}" for name in ("", " ", " a", "a ", "a\nb", "a\0b", "\u2028")),
}
NOT_IN_FITS = {
    *("accents", "beyond the basic plane", "bytes in UTF-8", "wide blanks", "the name 'é'"),
    "the name 'UPPERUPPERUPPERUPPER'",
}
IN_FITS = ("tile.fits", "catalog.fits", "survey")
TWICE = {"a quantity with the name unit"}
UNKNOWN = "is kept without its unit, counts_of_mine, whose name astropy does not know"


def catalog_of(descriptions):
    table = QTable({"id": [1, 2], "ra": [95.1, 95.3] * u.deg, "dec": [23.1, 23.2] * u.deg})
    for name, values in (COLUMNS[one] for one in descriptions):
        table[name] = values
    table.rename_column(table.colnames[-1], COLUMNS[[*descriptions][-1]][0])  # astropy renames a column without a name
    keep = table.colnames[3:]
    if "unit of the user" in descriptions:
        return warned(UNKNOWN, rs.Catalog.from_table, table, keep=keep)
    return rs.Catalog.from_table(table, keep=keep)


def plan(catalog):
    return rs.plan_tile(catalog, "sdss_apo", "95 23", allocator="nearest")


def tile_again(catalog, path):
    tile = plan(catalog)
    tile.write(path)
    assert rs.Tile.read(path) == tile
    return tile.table, rs.Tile.read(path).table


def catalog_again(catalog, path):
    catalog.write(path)
    return catalog.extra, rs.Catalog.read(path, keep=list(catalog.arrays.extra)).extra


def partitions_again(catalog, path):
    rs.catalog.partition_catalog(catalog, path)
    read = rs.catalog.PartitionedCatalog(path, keep=list(catalog.arrays.extra)).read()
    return catalog.extra, read.extra[np.argsort(read.id)]


def survey_again(catalog, path):
    options = {"allocator": "nearest", "lost_in_collision": False}
    in_memory = rs.plan_survey(catalog, "sdss_apo", CENTER, **options)
    rs.plan_survey(catalog, "sdss_apo", CENTER, folder=path, **options)
    return in_memory.tile(0), rs.Survey.read(path).tile(0)


FORMATS = {
    "tile.ecsv": tile_again,
    "tile.fits": tile_again,
    "catalog.ecsv": catalog_again,
    "catalog.fits": catalog_again,
    "partitions": partitions_again,
    "survey": survey_again,
}


def assert_same(written, read, names):
    for name in names:
        one, other = (table[new_name(table, name)] for table in (written, read))
        assert getattr(one, "unit", None) == getattr(other, "unit", None)
        one, other = (np.ma.filled(getattr(column, "value", column)) for column in (one, other))
        assert one.dtype.kind == other.dtype.kind
        np.testing.assert_array_equal(one, other)


def new_name(table, name):
    return result_name(name) if result_name(name) in table.dtype.names else name


def fits_into(name, descriptions):
    return [one for one in descriptions if one not in NOT_IN_FITS or name not in IN_FITS]


@pytest.mark.parametrize("name", FORMATS)
@pytest.mark.parametrize("descriptions", [[one for one in COLUMNS if one not in REFUSED | TWICE], [*TWICE]])
def test_columns_are_the_same_after_they_were_written_and_read(tmp_path, name, descriptions):
    """Regression: text with line breaks could be written but not read; partitions lost the units of columns."""
    catalog = catalog_of(fits_into(name, descriptions))
    assert_same(*FORMATS[name](catalog, tmp_path / name), catalog.extra.colnames)


@pytest.mark.parametrize("description", sorted(REFUSED))
def test_columns_that_no_table_in_a_file_can_contain_are_refused(description):
    with pytest.raises(rs.InputError, match=r"in keep must be (valid Unicode )?text|columns that are kept") as caught:
        catalog_of([description])
    assert str(caught.value).isprintable()


@pytest.mark.parametrize("name", IN_FITS)
@pytest.mark.parametrize("description", sorted(NOT_IN_FITS))
def test_columns_that_fits_cannot_contain_are_refused_when_they_are_written(tmp_path, name, description):
    """Regression: a survey with a column of a long name ended in an AssertionError of astropy."""
    refused("FITS", lambda: FORMATS[name](catalog_of([description]), tmp_path / name))
    assert name == "survey" or not (tmp_path / name).exists()


def test_identifiers_and_tables_with_control_characters_are_refused(tmp_path):
    stars = rs.Catalog(SkyCoord([1, 2] * u.deg, [1, 2] * u.deg), id=["a\0b", "c"])
    for write in (partitions_again, catalog_again):
        refused(r"'id' must be valid .* and control characters, got 'a\\x00b'", write, stars, tmp_path / "a.ecsv")
    table = plan(rs.Catalog(SkyCoord([95.1] * u.deg, [23.1] * u.deg))).table
    table["note"] = "a\nb"
    with pytest.raises(rs.InputError, match="the column 'note' must be valid Unicode text without line breaks"):
        rs.Tile(table).write(tmp_path / "tile.ecsv")


def test_a_foreign_catalog_with_names_of_its_own(small, tmp_path):
    """The properties name the columns.

    There are two orders, several files per pixel, no identifiers and no Dir level.
    """
    root = tmp_path / "foreign"
    for order, pixel, name in ((1, 0, "Npix=0.parquet"), (2, 4, "Npix=4/a.parquet"), (2, 4, "Npix=4/b.parquet")):
        path = root / f"Norder={order}" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        pq.write_table(pa.table({"RA_x": [45.0 + pixel, 46.0], "DEC_x": [1.0, 2.0], "flux": [1.0, 2.0]}), path)
    (root / "properties").write_text("# made elsewhere\nhats_col_ra = RA_x\nhats_col_dec=DEC_x\n")
    parts = rs.catalog.PartitionedCatalog(root)
    assert parts.read().id.tolist() == list(range(6))
    assert repr(parts) == "<PartitionedCatalog of 6 targets in 3 partitions>"
    assert parts.read().coord.ra.deg[:2].tolist() == [45.0, 46.0]
