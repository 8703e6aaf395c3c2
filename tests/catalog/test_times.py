"""Epochs and times of observations, in every form in which they can be given."""

from datetime import UTC, date, datetime, time, timedelta, timezone

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import QTable
from astropy.time import Time
from astropy.utils.masked import Masked
from raising import refused

import rfpsurvey as rs
from rfpsurvey._sky.time import to_moment, to_time

DAY = "2026-07-01"
MOMENT = f"{DAY}T06:30:00"
DATES = {
    DAY: [DAY, date(2026, 7, 1), datetime(2026, 7, 1), np.datetime64(DAY), Time(DAY)],
    MOMENT: [
        f" {MOMENT} ",
        MOMENT.replace("T", " "),
        f"{MOMENT}Z",
        "2026-07-01T08:30:00+02:00",
        datetime(2026, 7, 1, 6, 30),
        datetime(2026, 7, 1, 6, 30, tzinfo=UTC),
        datetime(2026, 7, 1, 8, 30, tzinfo=timezone(timedelta(hours=2))),
        np.datetime64(MOMENT),
        Time(MOMENT),
    ],
}
YEARS = [2026.5, "2026.5", "J2026.5", " J2026.5 "]
NO_TIMES = ["soon", "", "26.7.2026", time(6, 30), None, 3, True, "nan", np.inf, 3 * u.mm, [], np.datetime64("NaT"), {}]
FORM = "must be a date and time (UTC) such as 2026-07-01T06:30:00"
FIELD = {"site": "xinglong", "hour_angle": 0 * u.deg}


@pytest.mark.parametrize(("expected", "value"), [(k, v) for k, values in DATES.items() for v in values])
def test_dates_are_epochs_and_times_of_observations(expected, value):
    for found in (to_time(value, "epoch", scalar=True), to_moment(value, "time")):
        assert abs((found - Time(expected)).to_value(u.s)) < 1e-6
    assert rs.ObservingConditions("xinglong", time=value).record["time"] == Time(expected).isot


@pytest.mark.parametrize("value", YEARS)
def test_julian_years_are_epochs_but_not_times_of_observations(value):
    assert to_time(value, "epoch").jyear == pytest.approx(2026.5, abs=1e-9)
    text = refused("", rs.ObservingConditions, "xinglong", time=value)
    assert text.startswith(f"time {FORM}; the Julian year 2026.5 is 2026-07-02T14:58 in this form, got ")


@pytest.mark.parametrize("value", NO_TIMES, ids=repr)
def test_other_values_are_refused_in_one_line(value):
    for convert, words in ((to_time, "epoch must be"), (to_moment, f"time {FORM}, got")):
        with pytest.raises(rs.InputError) as caught:
            convert(value, words.split()[0], **({"scalar": True} if convert is to_time else {}))
        assert str(caught.value).startswith(words)
        assert "\n" not in str(caught.value)


def test_an_epoch_to_which_targets_are_moved_is_one_time():
    """An empty list of epochs moved no target, without a message."""
    sky = rs.synthetic_catalog("uniform", SkyCoord("6h20m +23d"), 0.2 * u.deg, n_targets=60, rng=1)
    for epoch, shape in ([], r"\(0,\)"), ([2026.5, 2027.5], r"\(2,\)"), (Time([DAY]), r"\(1,\)"):
        for call in (
            lambda epoch=epoch: rs.plan_tile(sky, "moons", epoch=epoch),
            lambda epoch=epoch: rs.plan_survey(sky, "moons", sky.coord[:1], epoch=epoch),
        ):
            refused(f"epoch must be one time, got the shape {shape}", call)


FILES = [
    ("", 'must state the site, such as site = "xinglong", got none'),
    (f"time = {MOMENT}", 'must state the site, such as site = "xinglong", got time'),
    ("site = 'xinglong'\ntime = 2026.5", f": time {FORM}; the Julian year 2026.5 is 2026-07-02T14:58 in this form"),
    ("site = 'xinglong'\ntime = 'soon'", f": time {FORM}, got 'soon'"),
    ("site = 'xinglong'\ntime = 06:30:00", f": time {FORM}, got datetime.time(6, 30)"),
    ("site = 'xinglong'\nhour_angle = 3", ": hour_angle must have a unit convertible to hourangle, got <Quantity 3.>"),
    (
        "site = 'xinglong'\nhour_angle = '0 deg'\npressure = 'high'",
        ": pressure must be text such as '720 hPa', got 'hi",
    ),
    (
        "site = []\nhour_angle = '0 deg'",
        ": site must be longitude, latitude (deg) and height (m, at most 100000), got []",
    ),
]


@pytest.mark.parametrize(("text", "words"), FILES)
def test_a_bad_file_of_conditions_gives_one_sentence(tmp_path, run, text, words):
    path = tmp_path / "seen.toml"
    path.write_text(f"{text}\n")
    found = refused("", rs.ObservingConditions.read, path)
    assert found.startswith(f"{path}")
    assert words in found
    code, _, err = run("plan", "--set", f"conditions.path={path}")
    assert code == 2
    assert len(err.strip().splitlines()) == 1


@pytest.mark.parametrize("value", [MOMENT, f"'{MOMENT}'", MOMENT.replace("T", " "), "2026-07-01T08:30:00+02:00"])
def test_a_file_of_conditions_holds_a_date_of_toml_or_text(tmp_path, value):
    path = tmp_path / "seen.toml"
    path.write_text(f"site = 'xinglong'\ntime = {value}\n")
    assert rs.ObservingConditions.read(path).time.isot == f"{MOMENT}.000"


@pytest.mark.parametrize("value", ["2026.5", "J2026.5", "soon", "06:30"])
def test_the_option_time_names_itself(run, value):
    code, _, err = run("plan", "--set", "conditions.site=xinglong", "--set", f"conditions.time={value}")
    assert code == 2
    assert err.startswith(f"rfpsurvey: conditions.time {FORM}")
    assert len(err.strip().splitlines()) == 1


def test_times_of_tiles_have_the_same_forms():
    common = rs.ObservingConditions("xinglong", hour_angle=0 * u.deg)
    for value in DATES[MOMENT][3:]:
        column = np.array([value], dtype=object) if isinstance(value, datetime) else np.array([value])
        values = Time([value]) if isinstance(value, Time) else column
        table = QTable({"ra": [95.0] * u.deg, "dec": [23.0] * u.deg, "time": values})
        assert rs.Tiling.from_table(table).with_conditions(common).table["time"][0] == f"{MOMENT}.000"
    for value, words in (
        (2026.5, "; the Julian year 2026.5 is"),
        ("J2026.5", "; the Jul"),
        ("soon", ", got 'soon'"),
        (np.nan, ", got "),
    ):
        table = QTable({"ra": [95.0] * u.deg, "dec": [23.0] * u.deg, "time": [value]})
        with pytest.raises(rs.InputError, match="time of tile 0 must be a date and time") as caught:
            rs.Tiling.from_table(table).with_conditions(common)
        assert words in str(caught.value)
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["humidity", "pressure", "temperature", "exposure_time", "tolerance", "wavelength"])
def test_a_masked_or_empty_value_of_the_conditions_is_refused(name):
    """A masked humidity was read as 0."""
    unit = {"pressure": u.hPa, "temperature": u.deg_C, "exposure_time": u.s, "tolerance": u.um, "wavelength": u.um}
    one = 1 * unit.get(name, u.dimensionless_unscaled)
    for value in (Masked(one, mask=True), np.ma.masked, [] * one.unit):
        with pytest.raises(rs.InputError, match=f"{name} must"):
            rs.ObservingConditions(**FIELD, **{name: value})


@pytest.mark.parametrize("visits", [0 * u.mm, [1, 2, 3] * u.s, 1 * u.deg])
def test_numbers_of_visits_with_a_unit_are_refused(visits):
    coord = SkyCoord([95, 95.1, 95.2] * u.deg, [23, 23, 23] * u.deg)
    for call in (
        lambda: rs.plan_survey(coord, "moons", coord[:1], visits=visits),
        lambda: rs.place_tiles(coord, radius=1 * u.deg, fibers=9, visits=visits),
        lambda: rs.Catalog(coord, visits=np.ones(3) * u.Quantity(visits).unit),
    ):
        with pytest.raises(rs.InputError, match="visits must be numbers without a unit") as caught:
            call()
        assert isinstance(caught.value, u.UnitsError)
    assert rs.Catalog(coord, visits=[100, 200, 0] * u.percent).visits.tolist() == [1, 2, 0]
