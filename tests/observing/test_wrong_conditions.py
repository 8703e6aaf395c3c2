"""Observing conditions that are not valid, and fields and targets below the horizon."""

import warnings

import astropy.units as u
import erfa
import numpy as np
import pytest
from astropy.coordinates import EarthLocation, SkyCoord
from astropy.time import Time
from raising import refused

import rfpsurvey as rs
from rfpsurvey._sky.projection import field_basis
from rfpsurvey.observing import ObservedField

TIME = Time("2024-05-10T05:00:00")
EAST = 3 * u.hourangle
WRONG_CONDITIONS = [
    ({"site": "nowhere", "time": TIME}, "unknown site 'nowhere'"),
    ({"site": 5, "time": TIME}, "site must be one EarthLocation"),
    ({"site": "paranal"}, "either a time or an hour_angle, got none"),
    ({"site": "paranal", "time": TIME, "hour_angle": EAST}, "got both"),
    ({"site": "paranal", "time": "May"}, "time must be a date and time"),
    ({"site": "paranal", "time": Time("2024-05-10", scale="ut1")}, "time must be in a scale such as UTC"),
    ({"site": "paranal", "hour_angle": 3 * u.m}, "hour_angle must have a unit"),
    ({"site": "paranal", "time": TIME, "wavelength": 540 * u.m}, "wavelength must be one finite value"),
    ({"site": "paranal", "time": TIME, "wavelength": {}}, "wavelength must have one value"),
    ({"site": "paranal", "time": TIME, "wavelength": {"BOSS": 5}}, "wavelength of BOSS must be a Quantity"),
    ({"site": "paranal", "time": TIME, "guide_wavelength": 0 * u.um}, "guide_wavelength must be"),
    ({"site": "paranal", "time": TIME, "pressure": -1 * u.hPa}, "pressure must be"),
    ({"site": "paranal", "time": TIME, "temperature": 5}, "temperature must have a unit of temperature"),
    ({"site": "paranal", "time": TIME, "humidity": 30}, "humidity must be"),
    ({"site": "paranal", "time": TIME, "humidity": "dry"}, "humidity must be"),
    ({"site": "paranal", "time": TIME, "exposure_time": 2 * u.day}, "exposure_time must be"),
]


@pytest.mark.parametrize(("given", "text"), WRONG_CONDITIONS)
def test_conditions_that_are_not_valid_are_errors(given, text):
    refused(text, lambda: rs.ObservingConditions(**given))


FIELDS_BELOW_HORIZON = [
    ({"hour_angle": 11 * u.hourangle}, "altitude -35.* deg of its center at hour angle 11 h"),
    ({"time": Time("2024-05-10T19:00:00")}, "altitude -.* deg of its center at 2024-05-10 19:00:00.000 UTC"),
    ({"hour_angle": 6.95 * u.hourangle}, r"the whole field with its radius of 2\.\d+ deg must be above the horizon"),
    ({"hour_angle": 6.5 * u.hourangle, "exposure_time": 3 * u.hour}, "during the exposure"),
]


@pytest.mark.parametrize(("conditions", "text"), FIELDS_BELOW_HORIZON)
def test_fields_below_the_horizon_are_errors(presets, conditions, text):
    with pytest.raises(rs.InputError, match=text):
        presets["lamost"].projection(
            SkyCoord("14h +20d"), conditions=rs.ObservingConditions("apache point", **conditions)
        )


def test_targets_below_the_horizon_have_no_image():
    field = ObservedField(field_basis(0, 0, 0), 1.0, None, rs.ObservingConditions("paranal", hour_angle=EAST))
    xy = field.project(np.array([[1.0, 0, 0], [np.cos(1), -np.sin(1), 0]]))
    assert np.isfinite(xy).tolist() == [[True, True], [False, False]]


@pytest.mark.parametrize("year", [1960, 2050])
def test_times_outside_the_installed_tables_are_errors(presets, year):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", erfa.ErfaWarning)
        conditions = rs.ObservingConditions("paranal", time=Time(f"{year}-01-01", scale="tai"))
    with pytest.raises(rs.InputError, match="installed tables of the Earth's rotation cover, got .* give hour_angle"):
        presets["moons"].projection(SkyCoord("14h +20d"), conditions=conditions)


def test_the_first_time_is_one_day_after_the_first_row_of_the_installed_tables(presets):
    """The first row of the tables of the IERS is that of 1973-01-02, MJD 41684."""
    early, late = (rs.ObservingConditions("paranal", time=Time(mjd, format="mjd")) for mjd in (41684.9, 41685.4))
    with pytest.raises(rs.InputError, match="time must be from 1973-01-03 to 20.*, got 1973-01-02T21:36"):
        presets["moons"].projection(SkyCoord("14h +20d"), conditions=early)
    presets["moons"].projection(SkyCoord("14h +20d"), conditions=late)


def test_wavelengths_must_include_the_fiber_types_in_use(presets):
    conditions = rs.ObservingConditions("paranal", hour_angle=EAST, wavelength={"BOSS": 0.54 * u.um})
    field = ObservedField(field_basis(0, 0, 0), 1.0, None, conditions)
    with pytest.raises(rs.InputError, match="a value for the fiber type 'APOGEE', got values for BOSS"):
        field.project(np.array([[1.0, 0, 0]]), "APOGEE")
    with pytest.raises(rs.InputError, match=r"fiber_type must have the shape \(1,\)"):
        field.project(np.array([[1.0, 0, 0]]), np.array(["BOSS", "BOSS"]))


def test_files_without_a_site_are_refused(tmp_path):
    """An empty file caused a TypeError."""
    path = tmp_path / "conditions.toml"
    for text, got in (("", "none"), ("humidity = 0.2\n", "humidity")):
        path.write_text(text)
        refused(rf"conditions\.toml must state the site, such as .*, got {got}", rs.ObservingConditions.read, path)
    assert rs.ObservingConditions.read(path, site="paranal", hour_angle=0 * u.deg).humidity == 0.2


@pytest.mark.parametrize("site", [("9" * 400, 0, 0), (0, "nan", 0), (0, 0, 1e300), (0, 0, "inf")])
def test_impossible_sites_are_refused(site):
    """The command plan accepted a site with an infinite longitude."""
    record = rs.ObservingConditions("paranal", hour_angle=0 * u.deg).record
    names = ("longitude_deg", "latitude_deg", "height_m")
    with pytest.raises(rs.InputError, match="site must be longitude, latitude"):
        rs.ObservingConditions.from_record({**record, **dict(zip(names, site, strict=True))})
    place = EarthLocation.from_geocentric(np.inf, 0, 0, unit="m")
    refused("site must have finite coordinates and a height from", rs.ObservingConditions, place, hour_angle=0 * u.deg)
