"""Tiles with times: their targets are moved to this time, and positioners have their states of this time."""

import warnings
from concurrent.futures import ThreadPoolExecutor

import astropy.units as u
import erfa
import living
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.io import fits
from astropy.table import MaskedColumn, Table
from astropy.time import Time, TimeDelta
from raising import refused, warned

import rfpsurvey as rs

START = Time("2014-01-01")
YEARS = 12


def moving_targets(seed, n=80):
    """Return a catalog at the epoch 2016 whose targets move by up to 4 arcsec per year, and astropy's coordinates."""
    rng, sky = np.random.default_rng(seed), living.targets(seed, n=n)
    motion = rng.normal(0, 2000, (2, n)) * u.mas / u.yr
    coord = SkyCoord(
        sky.coord.ra,
        sky.coord.dec,
        pm_ra_cosdec=motion[0],
        pm_dec=motion[1],
        obstime=Time(2016.0, format="jyear", scale="tcb"),
    )
    return rs.Catalog(coord, id=sky.id, priority=sky.priority, visits=sky.visits), coord


def random_times(seed, n):
    """Return times within 12 years, of which some are equal."""
    rng = np.random.default_rng(seed)
    times = START + TimeDelta(rng.uniform(0, 365.25 * YEARS, n) * u.day)
    return Time(times[rng.integers(0, n, n)].isot)


def dated(seed, times, column="time", **options):
    """Return a tiling with times in one of the columns that surveys read."""
    table = living.tiling(seed, len(times), **options).table.copy()
    days = np.floor(times.mjd)
    values = {"time": times.isot, "mjd": times.mjd, "date": Time(days, format="mjd").iso.astype("U10")}
    table[column] = values[column]
    return rs.Tiling.from_table(table)


def states_by_date(seed, times):
    """Return a table of states, and a function of a row of the tiling that returns its broken or stuck positioners."""
    rng, rows, plain = np.random.default_rng(seed), [], []
    for positioner in range(7):
        limits = np.sort(rng.uniform(-1, 365.25 * YEARS + 1, 4)).tolist()
        for first, last in (limits[:2], limits[2:]):
            if rng.random() < 0.7:
                begin, end = (START + TimeDelta(days * u.day) for days in (first, last))
                is_stuck = rng.random() < 0.5
                pose = (float(rng.uniform(0, 360)), float(rng.uniform(30, 150))) if is_stuck else (np.nan, np.nan)
                rows.append((positioner, "stuck" if is_stuck else "broken", begin.isot, end.isot, *pose))
                plain.append((positioner, Time(begin.isot), Time(end.isot)))
    table = Table(rows=rows, names=["id", "state", "from", "to", "theta", "phi"])

    def unusable(row):
        return {positioner for positioner, begin, end in plain if begin <= times[row] < end}

    return table, unusable


def moved(coord, time):
    """Return the coordinates at a time, computed by astropy."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", erfa.ErfaWarning)  # the distances are unknown
        return coord.apply_space_motion(new_obstime=time)


def cards(survey, row):
    return fits.getheader(survey.folder / f"tiles/000/{row:06d}.fits", 1)


@pytest.mark.parametrize("column", ["time", "mjd", "date"])
@pytest.mark.parametrize("partitioned", [False, True])
def test_targets_are_at_the_time_of_their_tile(tmp_path, column, partitioned):
    """Regression: without observing conditions, the targets of all tiles remained at the epoch of the catalog."""
    catalog, coord = moving_targets(3)
    given = rs.catalog.partition_catalog(catalog, tmp_path / "parts", order=5) if partitioned else catalog
    times = random_times(3, 6)
    survey = rs.plan_survey(given, living.instrument(), dated(3, times, column), folder=tmp_path / "survey")
    times = Time(np.floor(times.mjd), format="mjd") if column == "date" else times
    n = 0
    for row, time in enumerate(times):
        visits, header, there = survey.tile(11 + row), cards(survey, row), moved(coord, time)
        rows = visits["target_id"] - 1000
        apart = SkyCoord(visits["ra"], visits["dec"], unit="deg").separation(there[rows])
        assert apart.max(initial=0 * u.deg) < 0.05 * u.mas
        assert abs(Time(header["TILETIME"]) - time) < 1 * u.ms
        assert float(header["REFEPOCH"][1:]) == pytest.approx(time.tcb.jyear, abs=1e-5)
        speed = np.hypot(coord.pm_ra_cosdec, coord.pm_dec)[rows].to_value("mas/yr")
        np.testing.assert_allclose(header["FASTEST"], speed.max(initial=0), rtol=1e-3)  # it changes with the position
        n += len(visits)
    assert n > 20
    assert "the times of the tiles" in survey.summary["epoch"]
    assert [Time(text).mjd for text in survey.tiles["time"]] == pytest.approx(times.mjd, abs=1e-8)


def test_no_target_in_reach_is_lost_at_the_edge_of_a_field():
    """Targets that move into the field until the time of a tile are found, although they begin outside."""
    catalog, coord = moving_targets(4, n=2000)
    times = Time(["1990-01-01", "2025-01-01"])
    tiling, small = dated(4, times), living.instrument()
    survey = rs.plan_survey(catalog, small, tiling, visits=2, allocator="nearest")
    crossing = 0
    for row, time in enumerate(times):
        center, there = tiling.coord[row], moved(coord, time)
        inside = there.separation(center) < small.field_radius
        crossing += np.count_nonzero(inside != (coord.separation(center) < small.field_radius))
        still = rs.Catalog(SkyCoord(there.ra, there.dec), id=catalog.id, priority=catalog.priority)
        tile = rs.plan_tile(still, small, center, allocator="nearest")
        assert survey.tiles["n_reachable"][row] == np.count_nonzero(tile.outcomes["outcome"] != "out of reach")
        assert survey.tiles["n_in_field"][row] == inside.sum()
    assert crossing > 20


@pytest.mark.parametrize("year", [1970, 2066])
def test_years_without_known_leap_seconds(year):
    """Regression: each conversion of the times issued a warning of ERFA."""
    catalog, coord = moving_targets(4)
    table, texts = living.tiling(4, 3).table.copy(), [f"{year}-01-0{day}T05:00:00.000" for day in (2, 3, 4)]
    table["time"] = texts
    survey = rs.plan_survey(catalog, living.instrument(), rs.Tiling.from_table(table))
    assert survey.tiles["time"].tolist() == texts
    visits, there = survey.tile(11), moved(coord, Time(texts[0], scale="tdb"))  # a minute later in UTC
    apart = SkyCoord(visits["ra"], visits["dec"], unit="deg").separation(there[visits["target_id"] - 1000])
    assert len(visits) > 3
    assert apart.max() < 0.1 * u.mas


def test_a_column_mjd_can_contain_time_objects():
    table, times = living.tiling(4, 3).table.copy(), random_times(4, 3)
    table["mjd"] = times.tdb
    assert abs(rs.Tiling.from_table(table).times - times).max() < 1 * u.ms


def test_a_column_time_with_numbers_that_can_be_dates_causes_a_warning():
    """Regression: the targets remained at the epoch of the catalog, and no warning stated this."""
    table, message = living.tiling(4, 3).table.copy(), "the column TIME of the tiles is not used, because .* {}Julian"
    for days, name in {60000.5: "modified ", 2460001.0: ""}.items():
        table["TIME"] = np.full(3, days)
        arguments = moving_targets(4)[0], living.instrument(), rs.Tiling.from_table(table)
        warned(message.format(name), rs.plan_survey, *arguments)
    table["TIME"] = np.full(3, 900.0)  # exposure times
    rs.plan_survey(moving_targets(4)[0], living.instrument(), rs.Tiling.from_table(table))


def test_a_requested_epoch_applies_to_all_tiles(tmp_path):
    catalog, coord = moving_targets(5)
    tiling = dated(5, random_times(5, 3))
    survey = rs.plan_survey(catalog, living.instrument(), tiling, epoch=2020, folder=tmp_path / "survey")
    assert survey.summary["epoch"].startswith(
        "the targets are moved to J2020.000, the requested epoch; they move by up"
    )
    there = moved(coord, Time(2020.0, format="jyear"))
    for row in range(3):
        visits = survey.tile(11 + row)
        apart = SkyCoord(visits["ra"], visits["dec"], unit="deg").separation(there[visits["target_id"] - 1000])
        assert apart.max(initial=0 * u.deg) < 0.05 * u.mas
        assert "TILETIME" not in cards(survey, row)


def test_times_have_no_effect_without_proper_motions_and_states(tmp_path):
    """Also a column that contains no times is then not read."""
    times = random_times(6, 6)
    tables = [rs.Tiling.from_table(living.tiling(6, 6).table), dated(6, times), dated(6, times)]
    tables[2].table["time"] = "later"
    contents = []
    for k, tiling in enumerate(tables):
        survey = rs.plan_survey(living.targets(6), living.instrument(), tiling, folder=tmp_path / str(k))
        contents.append({name: text for name, text in living.content(survey.folder).items() if "inputs" not in name})
        del contents[-1]["plan.toml"]
    assert contents[0] == contents[1] == contents[2]


def test_tiles_are_added_only_if_targets_are_moved_to_a_requested_epoch(tmp_path):
    """Regression: the message stated only that the catalog or the epoch differs."""
    times = Time(["2020-01-01", "2020-02-01", "2020-03-01", "2021-01-01"])
    catalog, model, table = moving_targets(9)[0], living.instrument(), dated(9, times).table
    message = "the targets must be moved to the same times: .* only with an epoch= "
    first, every = rs.Tiling(table[:3]), rs.Tiling(table)
    options = {"order": "given", "folder": tmp_path / "moved"}
    rs.plan_survey(catalog, model, first, **options)
    refused(message, rs.plan_survey, catalog, model, every, resume=True, **options)
    rs.Survey.read(tmp_path / "moved").record(Table({"tile": [11], "state": ["done"]}))
    refused(message, rs.Survey.read(tmp_path / "moved").replan, tiles=every)
    options = {"order": "given", "folder": tmp_path / "epoch", "epoch": 2020}
    rs.plan_survey(catalog, model, first, **options)
    assert len(rs.plan_survey(catalog, model, every, resume=True, **options)) == 4


WRONG = [
    ("time", ["2026-01-01", "soon"], "time of tile 12 must be a date and time .* got 'soon'"),
    ("date", MaskedColumn(["2026-01-01", ""], mask=[0, 1]), "time of tile 12 must be a date and time .* got ''"),
    ("mjd", [60000.0, np.nan], "the mjd of each tile must be a modified Julian date .* got nan for tile 12"),
    ("MJD", [60000.0, 2460000.5], "the MJD of each tile must be a modified Julian date .* got 2.46e.06 for tile 12"),
    ("mjd", [60000.0, 0.0], "the mjd of each tile must be a modified Julian date .* got 0 for tile 12; rename"),
    ("mjd", ["a", "b"], "the mjd of tiles must be numbers of days, got"),
    ("mjd", [1, 2] * u.mm, "the mjd of tiles must be numbers of days, got"),
    ("mjd", np.full((2, 2), 60000.0), r"the mjd of tiles must be one value for each tile, got the shape \(2, 2\)"),
    ("date", [["2026-01-01"] * 2] * 2, r"the date of tiles must be one value for each tile, got the shape \(2, 2\)"),
    (
        "time",
        Time([6e4, 6e4], format="mjd", scale="local"),
        "time of tile 11 must be a date .* got <Time object: scale",
    ),
    ("date", ["2026-01-01", "0206-01-01"], "the date of each tile must be a date from 1968 to 2132, got 206-01-01"),
    ("date", [61041, 61042], "time of tile 11 must be a date and time .* got '61041'"),
]


@pytest.mark.parametrize(("column", "values", "message"), WRONG)
def test_invalid_times_are_refused(column, values, message):
    table = living.tiling(0, 2).table.copy()
    table[column] = values
    refused(message, rs.plan_survey, moving_targets(0)[0], living.instrument(), rs.Tiling.from_table(table))


def test_numbers_in_a_column_time_are_not_dates():
    table = living.tiling(0, 2).table.copy()
    table["time"], table["date"] = [900.0, 1200.0] * u.s, [20260103, 20260104]
    tiling = rs.Tiling.from_table(table)
    assert tiling.times.isot.tolist() == ["2026-01-03T00:00:00.000", "2026-01-04T00:00:00.000"]
    table.remove_column("date")
    assert rs.Tiling.from_table(table).times is None


@pytest.mark.parametrize("ending", ["ecsv", "fits", "csv", "parquet"])
@pytest.mark.parametrize("column", ["time", "mjd", "date"])
def test_times_are_read_from_files(tmp_path, column, ending):
    times, path = random_times(1, 4), tmp_path / f"tiles.{ending}"
    table = Table(dated(1, times, column).table["tile", "ra", "dec", column], meta={})
    table["ra"].unit = table["dec"].unit = None
    table.write(path)
    read = rs.Tiling.read(path, units={"ra": "deg", "dec": "deg"}).times
    assert read.mjd == pytest.approx(np.floor(times.mjd) if column == "date" else times.mjd, abs=1e-8)


def test_dates_of_observations_are_not_times_of_tiles(tmp_path):
    """The table of tiles of a survey with recorded events can be the list of tiles of another survey."""
    catalog, folder = moving_targets(7)[0], tmp_path / "survey"
    survey = rs.plan_survey(catalog, living.instrument(), living.tiling(7), folder=folder)
    survey.record(living.events(tile=[11], date="2026-01-03", state="done"))
    table = rs.Survey.read(folder).replan().tiles
    assert table["date"].tolist()[:2] == ["2026-01-03", ""]
    again = rs.plan_survey(catalog, living.instrument(), table, folder=tmp_path / "again")
    assert "at the epoch of the catalog" in again.summary["epoch"]
    again.record(living.events(tile=[12], date="2026-01-03", state="done"))
    assert len(rs.Survey.read(tmp_path / "again").replan()) == 6


def test_states_by_date_need_times_of_tiles():
    table = Table({"id": [1], "from": ["2026-02-01"]})
    worn = living.instrument().with_states(table, time=Time(["2026-01-01", "2026-03-01"]))
    refused("tiles must have times", rs.plan_survey, living.targets(), worn, living.tiling())
    refused("must be those of one time", rs.plan_tile, living.targets(), worn, living.CENTER)
    refused("time must be one time", worn.at_time, Time(["2026-01-01", "2026-03-01"]))
    refused("time must be one time", worn.at_time, None)
    assert rs.plan_tile(living.targets(), worn.at_time("2026-03-01"), living.CENTER).table["status"][1] == "disabled"


@pytest.mark.few(8)
@pytest.mark.parametrize("seed", range(100))
def test_positioners_have_the_states_of_the_time_of_each_tile(seed, tmp_path):
    """No tile uses a positioner that is broken or stuck at its time; replans, joint plans and counts agree."""
    times, folder = random_times(seed, 5), tmp_path / "survey"
    catalog = moving_targets(seed)[0] if seed % 2 else living.targets(seed, n=80)
    tiling, (table, unusable) = dated(seed, times, size=0.1), states_by_date(seed, times)
    worn = living.instrument().with_states(table, time=tiling.times)
    allocator = ("nearest", "repair", "optimal", "joint")[seed % 4]
    survey = rs.plan_survey(catalog, worn, tiling, allocator=allocator, folder=folder, lost_in_collision=False)
    assert survey.summary["n_fibers"] == sum(7 - len(unusable(row)) for row in range(5))
    for row in range(5):
        used = {*survey.tile(11 + row)["positioner"].tolist()}
        assert not used & unusable(row)
        np.testing.assert_allclose(survey.tiles["fiber_use"][row], len(used) / max(7 - len(unusable(row)), 1))
    survey.record(living.events(tile=[11], state="done"))
    before = [survey.tile(11 + row) for row in range(5)]
    again = rs.Survey.read(folder).replan(allocator=allocator)
    if allocator != "joint":  # a joint search begins from another plan
        assert all((again.tile(11 + row) == before[row]).all() for row in range(5))
    assert not any({*again.tile(11 + row)["positioner"].tolist()} & unusable(row) for row in range(1, 5))
    assert len(rs.survey.verify_survey(folder)) == 0


@pytest.mark.parametrize("moves", [False, True])
def test_a_survey_is_continued_only_with_the_same_times(tmp_path, moves):
    times, folder = random_times(8, 5), tmp_path / "survey"
    catalog = moving_targets(8)[0] if moves else living.targets(8)
    worn = living.instrument().with_states(states_by_date(8, times)[0], time=times)
    survey = rs.plan_survey(catalog, worn, dated(8, times), folder=folder)
    before = living.content(folder)
    (folder / "outcomes.fits").unlink()
    other = Time([*times[:-1].isot, times[0].isot])
    refused("tiles differs", rs.plan_survey, catalog, worn, dated(8, other), folder=folder, resume=True)
    with ThreadPoolExecutor(2) as executor:
        rs.plan_survey(catalog, worn, dated(8, times), folder=folder, resume=True, executor=executor)
    assert living.content(folder) == before
    survey.record(living.events(tile=[11], state="done"))
    state = survey.state(catalog)
    options = {"visits": state, "folder": folder, "resume": True}
    refused("tiles differs", rs.plan_survey, catalog, worn, dated(8, other), **options)


@pytest.mark.few(3)
@pytest.mark.parametrize("seed", range(12))
def test_probabilities_and_counts_use_the_states_of_each_tile(seed):
    times = random_times(seed, 4)
    catalog, tiling = moving_targets(seed)[0], dated(seed, times)
    table, unusable = states_by_date(seed, times)
    worn = living.instrument().with_states(table, time=tiling.times)
    result = rs.selection_probabilities(catalog, worn, tiling, n_realizations=3, allocator="nearest", rng=seed)
    options = rs.AllocationOptions("nearest", subpriority=int(result.realizations["seed"][0]))
    survey = rs.plan_survey(catalog, worn, tiling, allocator=options)
    assert result.realizations["n_assigned"][0] == survey.summary["n_assigned"]
    assert result.summary["n_fibers"] == survey.summary["n_fibers"]
    again = rs.selection_probabilities(catalog, worn, survey, n_realizations=3, allocator="nearest", rng=seed)
    np.testing.assert_array_equal(again.probability, result.probability)
    pairs = rs.selection.potential_assignments(catalog, worn, tiling).table
    for row in range(4):
        owners = {*np.asarray(pairs["positioner"])[np.asarray(pairs["tile"]) == 11 + row].tolist()}
        assert not owners & unusable(row)
