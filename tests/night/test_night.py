"""Plans of nights: times within windows, exposure times by astropy, states of surveys, merits, and wrong input."""

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import AltAz, SkyCoord
from astropy.table import QTable, Table
from astropy.time import Time
from cadence_program import random_survey
from naive_cadences import TABLE

import rfpsurvey as rs
from rfpsurvey._sky.conditions import as_site
from rfpsurvey.night import Night, NightLimits, night_limits, observing_windows, plan_night
from rfpsurvey.survey import Cadences

DEG, DATE = u.deg, "2027-01-03"
GIVEN = {"site": "kitt peak", "exposure_time": 900 * u.s, "overhead": 120 * u.s}


def table_of(seed, n=60):
    rng = np.random.default_rng(seed)
    table = QTable({"tile": np.arange(n) + 7, "ra": rng.uniform(0, 200, n) * DEG, "dec": rng.uniform(-30, 80, n) * DEG})
    table["merit"] = rng.uniform(0.5, 2, n)
    table["program"] = rng.choice(["DARK", "bright"], n)
    table["start"] = Time(61408 + rng.uniform(0, 0.3, n), format="mjd")
    return table


@pytest.mark.few(4)
@pytest.mark.parametrize("seed", range(24))
@pytest.mark.parametrize("method", ["greedy", "exact"])
def test_tiles_are_observed_within_their_windows(seed, method):
    table, limits = table_of(seed), {"dark": NightLimits(max_airmass=1.6), "": NightLimits(sun_altitude=-12 * DEG)}
    given = {"limits": limits, "exposure_time": {"dark": 1200 * u.s, "bright": 500 * u.s}, "airmass_exponent": 1.5}
    night = plan_night(table, DATE, **GIVEN | given, method=method, time_limit=10 * u.s)
    windows, found = observing_windows(table, "kitt peak", DATE, limits, shortest=0 * u.s), night.table
    start, end, tiles = found["start"].utc.mjd, found["end"].utc.mjd, np.asarray(found["tile"])
    rows = tiles - 7
    assert len(found) > 20
    assert len(np.unique(tiles)) == len(tiles)
    inside = [
        ((windows.arrays.tile == row) & (windows.arrays.start <= a + 1e-7) & (windows.arrays.end >= b - 1e-7)).any()
        for row, a, b in zip(rows, start, end, strict=True)
    ]
    assert all(inside)
    assert (start[1:] - end[:-1] >= 120 / 86400 - 1e-7).all()
    frame = AltAz(obstime=Time((start + end) / 2, format="mjd"), location=as_site("kitt peak"))
    airmass = 1 / np.sin(SkyCoord(table["ra"], table["dec"])[rows].transform_to(frame).alt)
    np.testing.assert_allclose(found["airmass"], airmass, rtol=1e-3)
    usual = np.where(np.char.lower(table["program"][rows]) == "dark", 1200, 500)
    np.testing.assert_allclose(found["exposure_time"].to_value(u.s), usual * airmass**1.5, rtol=1e-3)
    np.testing.assert_array_equal(found["merit"], table["merit"][rows])
    others = {str(name) for name in night.not_observed["tile"]}
    assert others | {str(name) for name in tiles} == {str(name) for name in table["tile"]}
    for begin, names in zip(start, found["backups"], strict=True):
        for name in names.split():
            of = windows.arrays.tile == int(name) - 7
            assert name in others
            assert (of & (windows.arrays.start <= begin + 1e-7) & (windows.arrays.end > begin)).any()
    assert sum(found["merit"]) == pytest.approx(night.summary["merit"])
    assert night.summary["merit"] <= night.summary["bound"] * (1 + 1e-9)


def test_a_night_on_which_nothing_can_be_observed():
    tiles = SkyCoord([10, 20] * DEG, [-80, -85] * DEG)
    night = plan_night(tiles, DATE, **GIVEN)
    assert (len(night), night.summary["merit"], night.summary["is_optimum"]) == (0, 0, True)
    assert night.not_observed["reason"].tolist() == ["too low"] * 2
    assert "0 tiles" in repr(night)
    long = plan_night(SkyCoord([60] * DEG, [30] * DEG), DATE, **GIVEN | {"exposure_time": 20 * u.h})
    assert long.not_observed["reason"].tolist() == ["exposure longer than the window"]


@pytest.fixture
def survey(tmp_path):
    """Return a survey of two passes of five tiles of MOONS in a folder."""
    sky = rs.synthetic_catalog("uniform", SkyCoord("6h20m +23d"), 0.5 * DEG, n_targets=900, rng=1)
    sky = rs.Catalog(sky.coord, priority=np.arange(900) % 3)
    ra, number = 95 + np.array([-0.4, -0.2, 0, 0.2, 0.4] * 2), np.repeat([1, 2], 5)
    tiles = QTable({"tile": np.arange(10) + 1, "ra": ra * DEG, "dec": [23.0] * 10 * DEG, "pass": number})
    return rs.plan_survey(sky, "moons", rs.Tiling.from_table(tiles), folder=tmp_path / "plan", visits=2)


HERE = {"site": "mauna kea", "exposure_time": 1500 * u.s}


def test_the_tiles_of_a_survey_that_remain_are_candidates(survey):
    night = plan_night(survey, DATE, **HERE)
    planned = [int(np.sum(np.asarray(survey._visits(k)["observed"]))) for k in range(10)]
    assert dict(zip(night.table["tile"], night.table["merit"], strict=True)) == dict(
        zip(range(1, 11), planned, strict=True)
    )
    survey.record(Table({"tile": [3, 4], "date": ["2026-01-03"] * 2, "state": ["done", "dropped"]}))
    with pytest.raises(rs.InputError, match="must be planned with all events that were recorded"):
        plan_night(survey, DATE, **HERE)
    survey = survey.replan()
    night = plan_night(survey, DATE, **HERE, method="exact")
    assert {*night.table["tile"].tolist()} == {*range(1, 11)} - {3, 4}
    reasons = dict(zip(night.not_observed["tile"], night.not_observed["reason"], strict=True))
    assert reasons == {"3": "observed", "4": "dropped"}


def test_surveys_with_conditions_and_without_priorities(tmp_path):
    sky = rs.synthetic_catalog("uniform", SkyCoord("6h20m +23d"), 0.5 * DEG, n_targets=300, rng=1)
    tiles = rs.Tiling.from_table(
        QTable({"ra": [95, 95.1] * DEG, "dec": [23, 23] * DEG, "hour_angle": [0, 1] * u.hourangle})
    )
    tiles = tiles.with_conditions(rs.ObservingConditions("mauna kea", hour_angle=0 * u.hourangle))
    survey = rs.plan_survey(sky, "moons", tiles, folder=tmp_path / "plan")
    night = plan_night(survey, DATE, **HERE, merit="classes")
    assert night.table["merit"].sum() == survey.summary["n_visits_observed"]


def test_tiles_wait_for_earlier_passes_that_overlap(survey):
    night = plan_night(survey, DATE, **HERE, in_passes=True)
    assert {*night.table["tile"].tolist()} == {1, 2, 3, 4, 5}
    assert {*night.not_observed["reason"].tolist()} == {"waits for an earlier pass"}
    survey.record(Table({"tile": [1, 2, 3], "date": ["2026-01-03"] * 3}))
    survey = survey.replan()
    radius, place = 2 * survey.provenance["parameters"]["radius_deg"] * DEG, rs.Tiling(survey.tiles).coord
    free = {k + 1 for k in range(5, 10) if not (place[3:5].separation(place[k]) < radius).any()}
    assert free
    night = plan_night(survey, DATE, **HERE, in_passes=True)
    assert {*night.table["tile"].tolist()} == {4, 5} | free


def test_merits(survey, install):
    def by_class(tiles):
        return tiles["n_by_class"] @ [1, 0.1, 0.01]

    own = plan_night(survey, DATE, **HERE, merit=by_class).table
    known = plan_night(survey, DATE, **HERE, merit="classes").table
    np.testing.assert_allclose(own["merit"], known["merit"])
    visits = survey._visits(int(known["tile"][0]) - 1)
    counts = [np.sum(np.asarray(visits["priority"])[np.asarray(visits["observed"])] == value) for value in (2, 1, 0)]
    assert known["merit"][0] == pytest.approx(counts @ np.array([1, 0.1, 0.01]))
    install("mine", "def north(tiles):\n    return tiles['dec'].value\n", merits={"north": "north"})
    assert plan_night(survey, DATE, **HERE, merit="north").table["merit"].tolist() == [23.0] * 10
    with pytest.raises(rs.InputError, match=r"it must return 10 finite numbers of at least 0"):
        plan_night(survey, DATE, **HERE, merit=lambda _: -1.0)


def test_tiles_of_surveys_with_cadences_are_observed_on_their_dates(tmp_path):
    instrument, tiling, catalog, options = random_survey(1)
    given = {"visits": Cadences(TABLE), "allocator": options, "folder": tmp_path / "plan"}
    survey = rs.plan_survey(catalog, instrument, tiling, **given)
    day = int(tiling.table["mjd"][0])
    place = rs.Tiling(survey.tiles).coord[0]
    # a site at which the tiles are high during the night, so that only their dates decide
    sidereal = Time(day, format="mjd").sidereal_time("mean", "greenwich").deg
    lon = (place.ra.deg - sidereal) % 360
    site = rs.ObservingConditions(site=as_site_at(lon, place.dec.deg), hour_angle=0 * u.hourangle).site
    limits = NightLimits(min_altitude=-90 * DEG, sun_altitude=90 * DEG)
    given = {"site": site, "exposure_time": 60 * u.s, "limits": limits}
    night = plan_night(survey, Time(day, format="mjd"), **given, instrument=instrument)
    noon = day + 0.5 - ((site.lon.deg + 180) % 360 - 180) / 360
    due = (tiling.table["mjd"] >= noon) & (tiling.table["mjd"] < noon + 1)
    others = dict(zip(night.not_observed["tile"], night.not_observed["reason"], strict=True))
    late = {name for name, reason in others.items() if reason == "planned for another date"}
    assert late == {str(name) for name in tiling.table["tile"][~due]}


def as_site_at(lon, lat):
    from astropy.coordinates import EarthLocation

    return EarthLocation.from_geodetic(lon * DEG, lat * DEG)


@pytest.mark.parametrize("name", rs.available_instruments())
def test_the_descriptions_of_instruments_determine_a_night(name, presets):
    limits, values = night_limits(name), presets[name].values
    assert all(isinstance(value, NightLimits) for value in limits.values())
    assert {"night.exposure_time", "night.overhead", "night.airmass_exponent"} <= {*values}
    site = {} if "night.site" in values else {"site": "kitt peak"}
    night = plan_night(SkyCoord([60, 100] * DEG, [10, -20] * DEG), DATE, instrument=name, **site)
    assert isinstance(night, Night)


def with_column(**columns):
    table = table_of(1)
    table.update(columns)
    return table


WRONG = [
    ({"date": "tomorrow"}, "date must be a Time"),
    ({"site": None}, "site must be given"),
    ({"site": "moon"}, "unknown site 'moon'"),
    ({"exposure_time": None}, "exposure_time must be from above 0 to 86400 s for every tile, got none for tile 7"),
    ({"exposure_time": 0 * u.s}, "exposure_time must be a number above 0"),
    ({"exposure_time": 3 * u.m}, "exposure_time must have a unit"),
    ({"overhead": -1 * u.s}, "overhead must be a number from 0"),
    ({"airmass_exponent": -1}, "airmass_exponent must be a number from 0 to 10"),
    ({"limits": 30}, "limits must be NightLimits, or a dict of them by program, got 30"),
    ({"limits": {"dark": NightLimits()}}, "limits must be given for the program 'bright', or for the program ''"),
    ({"merit": "visits"}, "merit must be a column or a function for tiles without a survey, got 'visits'"),
    ({"in_passes": True}, "instrument must be given for tiles in passes"),
    ({"in_passes": "yes"}, "in_passes must be True or False"),
    ({"method": "best"}, "unknown method 'best'"),
    ({"slot": 0 * u.s}, "slot"),
    ({"backups": -1}, "backups must be a whole number from 0 to 100"),
    ({"time_limit": -1 * u.s}, "time_limit"),
    ({"tiles": 3}, "tiles must be a Tiling"),
    (
        {"tiles": rs.Tiling.from_table(QTable({"ra": [1] * DEG, "dec": [2] * DEG, "merit": [-1.0]}))},
        "merit must be one finite number of at least 0 for every tile",
    ),
    ({"tiles": with_column(merit=np.ones((60, 2)))}, "merit must be one finite number of at least 0 for every tile"),
    ({"tiles": with_column(exposure_time=np.full(60, np.inf) * u.s)}, "got inf for tile 7"),
    ({"tiles": with_column(exposure_time=np.full(60, -1) * u.s)}, "got -1 for tile 7"),
]


@pytest.mark.parametrize(("changed", "text"), WRONG, ids=lambda value: str(value)[:40])
def test_wrong_values_are_refused(changed, text):
    given = {"tiles": table_of(1), "date": DATE, **GIVEN} | changed
    with pytest.raises(rs.InputError) as refusal:
        plan_night(given.pop("tiles"), given.pop("date"), **given)
    assert text in str(refusal.value)


WRONG_LIMITS = [
    ({"min_altitude": 30 * DEG, "max_airmass": 2.0}, "limits must have either min_altitude or max_airmass, got both"),
    ({"max_airmass": 0.5}, "max_airmass must be a number from 1 to 40"),
    ({"hour_angle": 13 * u.hour}, "hour_angle must"),
    ({"moon_illumination": 2}, "moon_illumination must be a number from 0 to 1"),
    ({"horizon": [1, 2]}, "horizon must be a table with azimuth and altitude, or pairs of both (deg)"),
    ({"horizon": [[0, 95]]}, "horizon must have finite azimuths and altitudes from -90 to 90 deg"),
    ({"horizon": QTable({"azimuth": [1] * DEG})}, "horizon must have the columns azimuth and altitude"),
    ({"moon": 3}, "moon"),
]


@pytest.mark.parametrize(("given", "text"), WRONG_LIMITS, ids=lambda value: str(value)[:40])
def test_wrong_limits_are_refused(given, text):
    with pytest.raises((rs.InputError, TypeError)) as refusal:
        NightLimits(**given)
    assert text in str(refusal.value)


def test_a_survey_without_a_folder_is_refused():
    survey = rs.plan_survey(SkyCoord([95.01] * DEG, [23] * DEG), "moons", SkyCoord([95] * DEG, [23] * DEG))
    with pytest.raises(rs.InputError, match="a survey in a folder"):
        plan_night(survey, DATE, **HERE)


def test_nights_are_written_with_times_as_text(tmp_path):
    night = plan_night(table_of(2), DATE, **GIVEN)
    for name in ("night.fits", "night.ecsv"):
        night.write(tmp_path / name)
        read = Table.read(tmp_path / name)
        assert read["start"].astype(str).tolist() == night.table["start"].isot.tolist()
        assert read["merit"].tolist() == night.table["merit"].tolist()
    with pytest.raises(rs.InputError, match="exists"):
        night.write(tmp_path / "night.fits")
