"""Catalogs from tables of other packages, and from tables without units."""

import importlib.util

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import MaskedColumn, QTable, Table
from astropy.time import Time
from pfs_files import target_list
from raising import refused, warned

import rfpsurvey as rs

pd = pytest.importorskip("pandas")
N = 300
DEG = u.deg


@pytest.fixture
def frame(rng):
    return pd.DataFrame(
        {
            "RA": 95 + rng.uniform(-1, 1, N),
            "Dec": 23 + rng.uniform(-1, 1, N),
            "source_id": 2**60 + rng.permutation(N),
            "priority": rng.integers(0, 3, N).astype(float),
        }
    )


def test_a_tile_of_a_dataframe_is_that_of_its_table(frame):
    tile, table = rs.plan_tile(frame, "sdss_apo", "95 23"), QTable.from_pandas(frame)
    table["RA"].unit = table["Dec"].unit = DEG
    expected = rs.plan_tile(table, "sdss_apo", SkyCoord(95 * DEG, 23 * DEG))
    assert (tile.table["target_id"] == expected.table["target_id"]).all()
    assert tile.provenance["catalog"]["assumed_units"] == "RA in deg, Dec in deg"
    assert "assumed_units" not in expected.provenance["catalog"]


def test_all_functions_of_catalogs_take_dataframes(frame, tmp_path):
    assert len(rs.place_tiles(frame, "sdss_apo")) > 0
    tiling = SkyCoord([95] * DEG, [23] * DEG)
    assert rs.plan_survey(frame, "sdss_apo", tiling).summary["n_visits_observed"] > 0
    assert len(rs.compare_allocators(frame, "sdss_apo", allocators=["lamost_rule"])) == 1
    assert len(rs.compare_instruments(frame, ["sdss_apo"], allocators=["lamost_rule"], center="95 23")) == 1
    pytest.importorskip("pyarrow")
    assert len(rs.catalog.partition_catalog(frame, tmp_path / "parts")) == N


def tables_of(frame):
    """Return a DataFrame of pandas, a DataFrame of Polars and an Arrow table, if these packages are installed."""
    yield frame
    if importlib.util.find_spec("polars"):
        import polars

        yield polars.DataFrame({name: frame[name].to_numpy() for name in frame.columns})
    if importlib.util.find_spec("pyarrow"):
        import pyarrow

        yield pyarrow.Table.from_pandas(frame, preserve_index=False)
    yield frame.to_records(index=False)


def test_tilings_of_dataframes_are_those_of_their_tables():
    """The index of a filtered DataFrame must not be used as the identifier of a tile."""
    frame = pd.DataFrame({"RACEN": [94.0, 95.0, 96.0], "DECCEN": 23.0, "pa": [0.0, 30.0, 0.0], "PASS": [1, 1, 2]})
    expected = rs.Tiling.from_table(QTable.from_pandas(frame), units={"ra": "deg", "dec": "deg"}).table
    for given in tables_of(frame):
        found = rs.Tiling.from_table(given).table
        assert found.colnames == expected.colnames
        assert all((found[name] == expected[name]).all() for name in expected.colnames)
        sky = rs.synthetic_catalog("uniform", SkyCoord("95d 23d"), 1 * DEG, n_targets=50, rng=1)
        assert (len(rs.plan_survey(sky, "sdss_apo", given)), len(rs.tiling.Centers(given).coord)) == (3, 3)
    assert rs.Tiling.from_table(frame[frame["RACEN"] > 94.5]).table["tile"].tolist() == [0, 1]
    hours = rs.Tiling.from_table(frame.assign(RACEN=frame["RACEN"] / 15), units={"ra": "hourangle"})
    np.testing.assert_allclose(hours.table["ra"].to_value(DEG), frame["RACEN"])
    refused("no column", lambda: rs.Tiling.from_table(frame.drop(columns="RACEN")))


@pytest.mark.parametrize("positions", ["focal_plane", "sky"])
def test_assignments_of_dataframes_are_scored_as_their_tables(frame, positions):
    tile = rs.plan_tile(frame, "sdss_apo", "95 23", allocator="lamost_rule")
    rows = tile.table["status"] == "assigned"
    columns = {"hole": tile.table["id"][rows]}
    for name in ("ra", "dec") if positions == "sky" else ("tip_x", "tip_y"):
        columns[name] = tile.table[name].value[rows]
    found = pd.DataFrame(columns)
    where = {"center": "95 23", "position_angle": 0 * DEG} if positions == "sky" else {}
    for given in tables_of(found):
        scored = rs.score_tile(given, "sdss_apo", **where)
        assert scored.table["in_collision"].tolist() == tile.table["in_collision"].tolist()
        assert scored.summary["n_assigned"] == tile.summary["n_assigned"] > 50
    with pytest.raises(rs.InputError, match="positioner"):  # the index is not a positioner
        rs.score_tile(found.drop(columns="hole"), "sdss_apo", **where)


def test_missing_and_odd_columns_of_dataframes(frame):
    frame["visits"] = pd.array([1, None] * (N // 2), dtype="Int64")
    frame["category"] = pd.Categorical(["sky_a", None] * (N // 2))
    frame["when"], frame["list"] = pd.Timestamp("2020-01-01", tz="UTC"), [[1, 2]] * N
    frame["period"], frame["flag"] = pd.period_range("2020-01", periods=N, freq="D"), pd.array([True, None] * (N // 2))
    refused(r"'visits' .visits. must have a number .* 150 of 300 rows .rows 2, 4, 6, ", rs.Catalog.from_table, frame)
    catalog = rs.Catalog.from_table(frame, fill={"visits": 3, "category": "none"})
    assert (catalog.visits[:2].tolist(), catalog.category[:2].tolist()) == ([1, 3], ["sky_a", "none"])


def test_the_index_of_a_dataframe_identifies_its_rows(frame):
    assert rs.Catalog.from_table(frame.set_index("source_id")).id.tolist() == frame["source_id"].tolist()
    part = frame.drop(columns="source_id")[frame["priority"] > 0]
    assert rs.Catalog.from_table(part).id.tolist() == part.index.tolist()
    assert rs.Catalog.from_table(part, columns={"id": "priority"}).id.tolist() == part["priority"].tolist()
    part.index = [f"s{k}" for k in range(len(part))]
    assert rs.Catalog.from_table(part).id[0] == "s0"


def test_dataframes_that_are_refused_are_not_pasted(frame):
    rows = "got a DataFrame of 300 rows"
    for message, call, *given in (
        ("must have different names, got 'Dec' more", rs.Catalog.from_table, pd.concat([frame, frame], axis=1)),
        ("the catalog must have at least one target", rs.plan_tile, frame[:0], "sdss_apo"),
        ("no column for ra and dec; the columns are: none", rs.plan_tile, pd.DataFrame(), "sdss_apo"),
        ("catalog must be a Catalog, SkyCoord, Table or DataFrame, got [1]", rs.plan_tile, [1], "sdss_apo"),
        (f"TOML file, {rows}", rs.plan_tile, frame, frame),
        (f"center must be a SkyCoord, {rows}", rs.plan_tile, frame, "sdss_apo", frame),
        (f"or a date such as 2026-07-01, {rows}", lambda: rs.plan_tile(frame, "sdss_apo", epoch=frame)),
        (f"or None, {rows}", lambda: rs.plan_tile(frame, "sdss_apo", rng=frame)),
        (f"{rows} without a unit", lambda: rs.AllocationOptions(sky_separation=frame)),
        ("unknown allocator a DataFrame of 300 rows", rs.AllocationOptions, frame),
        (f"coord must be a SkyCoord, {rows}", rs.Catalog, frame),
        ("columns must be a dict from role to column, got a Data", lambda: rs.Catalog.from_table(frame, columns=frame)),
    ):
        text = refused("", call, *given)
        assert message in text
        assert "\n" not in text


def test_parquet_of_pandas(frame, tmp_path):
    """Regression: consecutive identifiers were lost, because pandas writes only the first and the last one."""
    pytest.importorskip("pyarrow")
    path = tmp_path / "a.parquet"
    frame.to_parquet(path)
    catalog = rs.Catalog.read(path)
    assert catalog.id.tolist() == frame["source_id"].tolist()
    assert catalog.meta["assumed_units"] == "RA in deg, Dec in deg"
    frame["source_id"] = 2**60 + 2 * np.arange(N)
    frame.set_index("source_id").to_parquet(path)
    assert rs.Catalog.read(path).id.tolist() == frame["source_id"].tolist()


def test_tables_of_arrow(frame):
    pa = pytest.importorskip("pyarrow")
    frame["visits"] = pd.array([1, None] * (N // 2), dtype="Int64")
    catalog = rs.Catalog.from_table(pa.Table.from_pandas(frame), fill={"visits": 2})
    assert (catalog.id.tolist(), catalog.visits[:2].tolist()) == (frame["source_id"].tolist(), [1, 2])


def test_structured_arrays():
    rows = np.array([(1.0, 2.0, 7)], dtype=[("ra", float), ("dec", float), ("id", int)])
    assert (rs.Catalog.from_table(rows).id.tolist(), len(rs.place_tiles(rows, "sdss_apo"))) == ([7], 1)


def test_sexagesimal_text_may_have_a_unit(tmp_path):
    """Regression: the user received warnings of the table reader."""
    from astropy.io import fits

    columns = {"RA": ("h:m:s", ["06:20:00", "06:24:00"]), "DEC": ("d:m:s", ["+20:00:00", "-01:00:00"])}
    columns = [fits.Column(name, "10A", array=texts, unit=unit) for name, (unit, texts) in columns.items()]
    fits.BinTableHDU.from_columns(columns).writeto(tmp_path / "a.fits")
    assert rs.Catalog.read(tmp_path / "a.fits").coord.ra.deg.tolist() == pytest.approx([95, 96])


def test_a_missing_column_has_a_remedy():
    with pytest.raises(
        rs.InputError, match=r"are: x; state its name, for example columns=.'ra': .... or --column ra=..."
    ):
        rs.Catalog.from_table(Table({"x": [1.0]}))
    with pytest.raises(rs.InputError, match="give the frame of the longitudes and latitudes, for example frame="):
        rs.Catalog.from_table(Table({"l": [1.0], "b": [1.0]}))


def test_a_table_without_any_unit_is_read_with_a_warning():
    table = Table({"ra": [1.0, 2.0], "dec": [3.0, 4.0], "pmra": [1, 2], "pmdec": [3, 4]})
    catalog = warned(
        "assumed units are ra in deg, dec in deg, pmra in mas / yr, pmdec in mas", rs.Catalog.from_table, table
    )
    assert catalog.coord.pm_dec[1].to_value(u.mas / u.yr) == pytest.approx(4)
    units = {"ra": "deg", "dec": "deg", "pmra": "mas/yr", "pmdec": "mas/yr"}
    assert "assumed_units" not in rs.Catalog.from_table(table, units=units).meta


@pytest.mark.parametrize("name", ["ra", "dec", "pmra", "pmdec"])
def test_positions_without_units_are_refused_only_if_another_position_has_a_unit(name):
    """A table in which a magnitude had a unit, but no position, was refused."""
    table = QTable({"ra": [1.0, 2.0], "dec": [3.0, 4.0], "pmra": [1, 2], "pmdec": [3, 4], "mag": [1, 2] * u.mag})
    with pytest.warns(rs.RfpsurveyWarning, match="the positions and proper motions have no units: the assumed units"):
        assert rs.Catalog.from_table(table).coord.dec.deg == pytest.approx([3, 4])
    table[name] = table[name] * (u.mas / u.yr if "pm" in name else u.deg)
    refused(f"column '{'dec' if name == 'ra' else 'ra'}' has no unit", rs.Catalog.from_table, table)


def test_right_ascensions_in_hours():
    dec = {"dec": [1.0] * DEG}
    for unit in ("hourangle", "h", "hour", "Hours", "hr"):
        table = QTable({"ra": [6.5], "dec": [1.0]})
        catalog = rs.Catalog.from_table(table, units={"ra": unit, "dec": "deg"})
        assert catalog.coord.ra.deg == pytest.approx(97.5)
    for unit in (u.hourangle, u.h):
        catalog = rs.Catalog.from_table(Table({"ra": [6.5] * unit, **dec}))
        assert catalog.coord.ra.deg == pytest.approx(97.5)
    table = Table({"ra": ["06:30:00", "", "null"], "dec": [1.0, 2, 3] * DEG})
    catalog = warned("2 of 3 targets have no finite coordinates", rs.Catalog.from_table, table)
    assert catalog.coord.ra.deg == pytest.approx(97.5)
    words = "the value of units for ra must be a unit, got 'somewhere'"
    refused(words, rs.Catalog.from_table, Table({"ra": [1.0], **dec}), units={"ra": "somewhere"})


def test_hours_are_suspected_only_where_they_explain_an_empty_field(frame):
    hours = frame.assign(RA=frame["RA"] / 15)
    with pytest.raises(
        rs.InputError, match="; 300 of the targets would be in the field if right ascensions were in hours: give"
    ):
        rs.plan_tile(hours, "sdss_apo", "95 23")
    refused("deg away$", rs.plan_tile, hours, "sdss_apo", "50 23")
    refused("deg away$", rs.plan_tile, frame, "sdss_apo", "50 23")


def test_values_for_missing_priorities():
    table = QTable({"ra": [1.0, 2, 3] * DEG, "dec": [1.0, 2, 3] * DEG})
    table["mag"] = MaskedColumn([15.0, 0, np.nan], mask=[False, True, False])
    columns = {"priority": "-mag"}
    with pytest.raises(
        rs.InputError, match="'mag' .priority. must have a number in every row, but 2 of 3 rows .rows 2, 3"
    ):
        rs.Catalog.from_table(table, columns=columns)
    for fill in (-99, "-99"):
        catalog = rs.Catalog.from_table(table, columns=columns, fill={"priority": fill})
        assert catalog.priority.tolist() == [-15, -99, -99]
    for fill, message in (
        ({"id": 1}, "unknown column role to fill 'id'"),
        ({"priority": "low"}, "the value of fill for priority must be a number, got 'low'"),
        ([1], "fill must be a dict from role to value, got .1."),
    ):
        refused(message, rs.Catalog.from_table, table, columns=columns, fill=fill)
    for bad in (np.nan, np.inf, -np.inf):
        with pytest.raises(
            rs.InputError, match=r"priority must be a finite number for every target, but 1 of 2 rows .row 2. have"
        ):
            rs.Catalog(SkyCoord([1, 2] * DEG, [1, 2] * DEG), priority=[1, bad])


def test_identifiers_that_are_whole_numbers_may_be_floats():
    coord = SkyCoord([1, 2] * DEG, [1, 2] * DEG)
    assert rs.Catalog(coord, id=[1.0, 7.0]).id.tolist() == [1, 7]
    for ids, message in (
        ([1.5, 2.0], "got numbers such as 1.5"),
        ([2.0**60, 1.0], "got numbers such as 1.15"),
        ([1.0, np.nan], "1 of 2 rows .row 2. have none"),
    ):
        refused(message, rs.Catalog, coord, id=ids)


def test_epochs_of_tables_without_proper_motions():
    """Targets without proper motions need no epoch, so that a column without years is not an error."""
    base = {"ra": [1.0, 2.0] * u.deg, "dec": [1.0, 2.0] * u.deg}
    moving = {**base, "pmra": [1.0, 2.0] * u.mas / u.yr, "pmdec": [1.0, 2.0] * u.mas / u.yr}
    assert rs.Catalog.from_table(QTable(base, meta={"REF_EPOCH": "sometime"})).epoch is None
    assert rs.Catalog.from_table(QTable({**base, "ref_epoch": ["x", "y"]})).epoch is None
    with pytest.raises(
        rs.InputError, match=r"column 'ref_epoch' \(epoch\) must be a Time, .* or a date such as .*, got 'x'"
    ):
        rs.Catalog.from_table(QTable({**moving, "ref_epoch": ["x", "y"]}))
    times = Time([2015.5, 2016.0], format="jyear")
    assert rs.Catalog.from_table(QTable({**moving, "ref_epoch": times})).epoch.jyear.tolist() == [2015.5, 2016.0]


def test_an_exception_of_another_package_names_the_frame():
    def to_arrow(self):
        raise RuntimeError("the connection is closed")

    frame = type("DataFrame", (), {"__module__": "polars.frame", "to_arrow": to_arrow})()
    refused("DataFrame.* cannot be used as a table: the connection is closed", rs.Catalog.from_table, frame)


SELECTIONS = [
    ([1800.0, 900.0, 1800.0], 1800, [1, 3]),
    ([1800.0, 900.0, 1800.0], "1800", [1, 3]),
    (np.array([0.1, 0.2, 0.1], "f4"), 0.1, [1, 3]),
    ([1, 2, 1], 1.0, [1, 3]),
    ([2**60, 2**60 + 1, 3], 2**60 + 1, [2]),
    ([True, False, True], "true", [1, 3]),
    ([True, False, True], "false", [2]),
    (["a", "b", "A"], "a", [1]),
    (MaskedColumn([1, 2, 1], mask=[False, False, True]), 1, [1]),
    ([1800.0, 900.0, 1800.0] * u.s, 1800, [1, 3]),
]


@pytest.mark.parametrize(("values", "value", "rows"), SELECTIONS)
def test_values_are_selected_as_numbers_and_flags(values, value, rows):
    """Values were compared only as text, so that 1800 selected no row of a column with 1800.0."""
    table = QTable({"id": [1, 2, 3], "ra": [1, 2, 3] * u.deg, "dec": [0, 0, 0] * u.deg})
    table["own"] = values
    assert rs.Catalog.from_table(table, select={"own": value}).id.tolist() == rows


def test_missing_values_are_not_selected():
    table = Table({"ra": [1.0, 2.0], "dec": [0.0, 0.0], "own": MaskedColumn([1, 2], mask=[False, True])})
    refused("own=--, which selects no row", rs.Catalog.from_table, table, select={"own": "--"})


def test_rows_of_a_table_are_selected(tmp_path, run):
    table = target_list(resolution=["L", "M", "L", "M"])
    catalog = rs.Catalog.from_table(table, select={"resolution": "M", "priority": 9})
    assert catalog.id.tolist() == [4003]
    assert catalog.meta["columns"].endswith("; selected: resolution=M, priority=9 (1 of 4 rows)")
    for select, message in (
        ({"resolution": "H"}, "select must leave at least one row, got resolution=H, which selects no row"),
        ({"other": 1}, "select: there is no column 'other'"),
        (["resolution"], "select must be a dict"),
    ):
        refused(message, rs.Catalog.from_table, table, select=select)
    table["ra"] += 0.2 * np.arange(4)
    table.write(tmp_path / "list.csv")
    common = "plan", tmp_path / "list.csv", "--instrument", "pfs"
    code, _, err = run(*common)
    assert (code, "--set catalog.select.resolution=M" in err) == (2, True)
    code, out, err = run(*common, "--set", "catalog.select.resolution=M")
    assert code == 0, err
    assert "selected: resolution=M (2 of 4 rows)" in " ".join(out.split())
