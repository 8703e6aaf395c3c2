"""Columns of the catalog that allocators do not use, and that results contain."""

from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import MaskedColumn, QTable, Table
from astropy.time import Time
from raising import refused, warned

import rfpsurvey as rs
from rfpsurvey._field.table import OUTCOMES_COLUMNS, TILE_COLUMNS
from rfpsurvey._sky.arrays import RESERVED
from rfpsurvey._survey.work import VISITS_COLUMNS

COORD = SkyCoord([95.0, 95.1, np.nan, 95.3] * u.deg, [23.0, 23.1, 23.2, 23.3] * u.deg)


def table():
    return Table(
        {
            "id": [1, 2, 3],
            "ra": [95.0, 95.1, 95.2] * u.deg,
            "dec": [23.0, 23.1, 23.2] * u.deg,
            "g": MaskedColumn([10.5, 11.5, 12.5], mask=[False, True, False], unit="mag"),
            "n": MaskedColumn([1, 2, 3], mask=[False, False, True]),
            "name": MaskedColumn(["a", "b", "c"], mask=[True, False, False]),
            "seen": [True, False, True],
            "mixed": np.array(["x", None, np.nan], dtype=object),
        }
    )


def test_columns_of_every_type():
    extra = rs.Catalog.from_table(table(), keep=["g", "n", "name", "seen", "mixed"]).extra
    assert extra["g"].unit == u.mag
    np.testing.assert_array_equal(extra["g"].value, [10.5, np.nan, 12.5])
    np.testing.assert_array_equal(extra["n"], [1, 2, np.nan])
    assert (extra["name"].tolist(), extra["seen"].tolist()) == (["", "b", "c"], [True, False, True])
    assert extra["mixed"].tolist() == ["x", "", ""]
    numbers = QTable({**table()["id", "ra", "dec"], "note": np.array([1, None, 2.5], dtype=object)})
    np.testing.assert_array_equal(rs.Catalog.from_table(numbers, keep="note").extra["note"], [1, np.nan, 2.5])


def test_rows_stay_together():
    catalog = warned("1 of 4 targets", rs.Catalog, COORD, extra={"n": [0, 1, 2, 3], "g": [0.0, 1, 2, 3] * u.mag})
    assert (catalog.extra["n"].tolist(), catalog[[2, 0]].extra["n"].tolist()) == ([0, 1, 3], [3, 0])
    assert catalog.within(COORD[3], 1 * u.arcsec).extra["g"] == [3] * u.mag
    assert replace(catalog, priority=[1, 2, 3]).extra["n"].tolist() == [0, 1, 3]
    assert repr(catalog) == "<Catalog of 3 targets with n, g>"
    assert "targets" in catalog._repr_html_()


def test_written_and_read_back(tmp_path):
    catalog = rs.Catalog.from_table(table(), keep=["g", "name"])
    catalog.write(tmp_path / "stars.fits")
    again = rs.Catalog.read(tmp_path / "stars.fits", keep=["g", "name"])
    np.testing.assert_array_equal(again.extra["g"].value, catalog.extra["g"].value)
    assert again.extra["g"].unit == u.mag
    assert rs.Catalog.read(tmp_path / "stars.fits").extra is None


def test_columns_of_results_are_reserved():
    """A column of the catalog never replaces a column of a result."""
    assert {*TILE_COLUMNS, *OUTCOMES_COLUMNS, *VISITS_COLUMNS, "tile"} == RESERVED
    catalog = rs.Catalog(COORD[:2], extra={"RA": [1, 2], "g": [3, 4]})
    assert list(catalog.arrays.extra) == ["target_RA", "g"]


WRONG_COLUMNS = [
    ({"n": [1, 2]}, "columns of extra must have one value for each of the 4 targets, got 2 values"),
    ({"n": [[1, 2]] * 4}, r"column 'n' in keep must contain .* got the type int64 and the shape \(4, 2\)"),
    ({"t": Time([2000, 2001, 2002, 2003], format="jyear")}, "column 't' in keep must contain .* got a Time"),
    ({"c": [1j] * 4}, "column 'c' in keep must contain"),
    ({"u": np.full(4, 2**63, dtype=np.uint64)}, r"column 'u' in keep must contain integers below 2\*\*63, got 92"),
    ({"o": np.array([{}, 1, 2, 3], dtype=object)}, "got objects of other types"),
    ({"big": MaskedColumn([2**60, 1, 2, 3], mask=[0, 1, 0, 0])}, "'big' in keep must not have missing values"),
    (5, "extra must be a dict or a table of columns, got int"),
]


@pytest.mark.parametrize(("columns", "message"), WRONG_COLUMNS)
def test_columns_that_cannot_be_kept(columns, message):
    refused(message, rs.Catalog, COORD, extra=columns)


def test_keep_names_columns_of_the_table():
    with pytest.raises(rs.InputError, match=r"must be columns of the table \(id, ra, dec, .*got 'mag'"):
        rs.Catalog.from_table(table(), keep="mag")


def test_columns_that_results_have_are_not_kept_twice():
    stars = table()
    for name in ("id", "target_id", "priority", "category", "kind", "fiber_type"):
        stars[name] = ["science"] * 3 if name == "kind" else [1, 2, 3] if "id" in name else ["5", "6", "7"]
    names = ["ra", "dec", "id", "priority", "category", "kind"]
    assert rs.Catalog.from_table(stars, keep=names).extra is None
    assert rs.Catalog.from_table(stars, keep=[*names, "g"]).extra.colnames == ["g"]
    # the columns of results with these names have a different meaning
    other = {"category": "name", "priority": "-priority"}
    kept = rs.Catalog.from_table(stars, keep=[*names, "fiber_type"], columns=other)
    assert list(kept.arrays.extra) == ["target_priority", "target_category", "target_fiber_type"]
    assert rs.Catalog.from_table(stars, keep="ra", frame="fk5").extra.colnames == ["ra"]
    kept = rs.Catalog.from_table(stars, keep="id", columns={"id": "target_id"})
    assert list(kept.arrays.extra) == ["target_target_id"]


def test_kept_columns_are_described_in_files(tmp_path):
    from astropy.io import fits

    coord = rs.synthetic_catalog("uniform", "95 23", 1 * u.deg, n_targets=50, rng=1).coord
    stars = rs.Catalog(coord, extra={"g": np.arange(50.0) * u.mag})
    tile = rs.plan_tile(stars, "sdss_apo", "95 23")
    tile.write(tmp_path / "tile.fits")
    rs.plan_survey(stars, "sdss_apo", SkyCoord([95] * u.deg, [23] * u.deg), folder=tmp_path / "survey")
    (part,) = (tmp_path / "survey" / "tiles").rglob("*.fits")
    for file, number in ((tmp_path / "tile.fits", 1), (tmp_path / "tile.fits", 2), (part, 1)):
        header = fits.getheader(file, number)
        name = next(key for key, value in header.items() if value == "g")
        assert header[name.replace("TTYPE", "TCOMM")] == "copied from the catalog"
    assert rs.Tile.read(tmp_path / "tile.fits") == tile


def test_partitions_keep_columns(tmp_path):
    pytest.importorskip("pyarrow")
    rng = np.random.default_rng(1)
    coord = SkyCoord(rng.uniform(90, 100, 500) * u.deg, rng.uniform(20, 26, 500) * u.deg)
    stars = rs.Catalog(coord, id=np.arange(500), extra={"g": rng.uniform(8, 12, 500)})
    rs.catalog.partition_catalog(stars, tmp_path / "stars", order=4)
    parts = rs.catalog.PartitionedCatalog(tmp_path / "stars", keep=["g"])
    whole = parts.read()
    np.testing.assert_array_equal(whole.extra["g"], np.asarray(stars.extra["g"])[whole.id])
    tiles = SkyCoord([94, 96] * u.deg, [23, 23] * u.deg)
    of_parts, of_whole = (rs.plan_survey(catalog, "sdss_apo", tiles).targets for catalog in (parts, whole))
    assert len(of_parts) > 10
    for name in ("target_id", "g"):
        np.testing.assert_array_equal(of_parts[name], of_whole[name])
    refused("or that a rule uses, must be columns of", rs.catalog.PartitionedCatalog, tmp_path / "stars", keep=["h"])


def test_a_table_with_units_is_taken_as_it_is():
    assert rs.Catalog(COORD[:2], extra=QTable({"g": [1, 2] * u.mag})).extra["g"].unit == u.mag
