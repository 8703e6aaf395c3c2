"""Light in the fibers of instruments, compared with ERFA, published values, and means over many moments."""

from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from raising import refused
from refracting import refraction

import rfpsurvey as rs
from rfpsurvey._instruments.light import N_POSITIONS
from rfpsurvey.observing import FiberLight, fiber_fraction, seeing_fwhm

ARCSEC, UM = u.arcsec, u.um
CENTER = SkyCoord("10h +32d")
BAND = {"BOSS": [0.36, 0.54, 1.0] * UM}
SEEING = 1.2 * ARCSEC


def conditions_at(hours, site="apache point", minutes=0, **options):
    return rs.ObservingConditions(site, hour_angle=hours * u.hourangle, exposure_time=minutes * u.min, **options)


def light_at(hours, band=BAND, minutes=0, profile="moffat", **options):
    return FiberLight(
        "sdss_apo", CENTER, conditions_at(hours, minutes=minutes, **options), SEEING, band, profile=profile
    )


@pytest.mark.parametrize("profile", ["gaussian", "moffat"])
def test_dispersion_at_the_center_of_a_field_reduces_the_light_as_erfa_predicts(profile):
    fibers = light_at(3, profile=profile)
    plane = fibers.instrument.projection(CENTER, conditions=fibers.conditions)
    zenith, weather = np.pi / 2 - plane.altitude.rad, (fibers.conditions.pressure.to_value(u.hPa), 10.0, 0.2)
    waves, apart = np.array([0.36, 0.54, 1.0]), np.zeros(3)
    for _ in range(10):  # refraction depends on the observed zenith distance
        seen = zenith - np.deg2rad(apart / 3600)
        apart = [
            refraction(w, z, *weather) - refraction(0.54, zenith, *weather) for w, z in zip(waves, seen, strict=True)
        ]
        apart = np.array(apart)
    fwhm = seeing_fwhm(SEEING, BAND["BOSS"], 1 / np.sin(plane.altitude))
    diameter = (fibers.fiber_diameter / fibers.instrument.plate_scale).to(ARCSEC)
    expected = fiber_fraction(np.abs(apart) * ARCSEC, diameter, fwhm, profile=profile)
    row = fibers._light(np.zeros(1), np.array(["BOSS"]), np.zeros((1, 2)))[0]
    np.testing.assert_allclose(row["fraction"], expected, atol=3e-6)
    centered = fiber_fraction(0 * ARCSEC, diameter, fwhm, profile=profile)
    np.testing.assert_allclose(row["relative"], expected / centered, atol=3e-6)
    assert row["relative"][0] < 0.7


def test_light_of_exposures_is_the_mean_over_many_moments(presets):
    lamost, given = presets["lamost"], {"wavelength": 0.54 * UM, "guide_wavelength": 0.7 * UM}
    fibers = FiberLight(lamost, CENTER, conditions_at(3, minutes=60, **given), SEEING, [0.36] * UM)
    table = fibers.table()[::97]
    xy, n, mean = np.column_stack([table["x"], table["y"]]).to_value(u.mm), 200, 0.0
    vectors = lamost.projection(CENTER, conditions=fibers.conditions).plain.unproject(xy)
    angle = np.arctan(np.hypot(*xy.T) / 20000)
    scale = 20 * u.m / u.rad / np.cos(angle) ** 1.5  # of a gnomonic projection, from the ratio of areas
    for seconds in 3600 * ((np.arange(n) + 0.5) / n - 0.5):
        moment = fibers.conditions.shifted(seconds * u.s).without_exposure
        image = lamost.projection(CENTER, conditions=replace(moment, wavelength=0.36 * UM)).plain.project(vectors)
        fwhm = seeing_fwhm(SEEING, 0.36 * UM, 1 / np.sin(lamost.projection(CENTER, conditions=moment).altitude))
        offset = (np.hypot(*(image - xy).T) * u.mm / scale).to(ARCSEC)
        mean += fiber_fraction(offset, (fibers.fiber_diameter / scale).to(ARCSEC), fwhm) / n
    np.testing.assert_allclose(table["fraction"][:, 0], mean, atol=1e-5)
    assert np.ptp(mean) > 0.01


def test_the_local_plate_scale_determines_the_size_of_fibers_on_the_sky(presets):
    """For DESI, the plate scale differs by 14 % in the radial direction, and by 5 % in the other direction."""
    desi = presets["desi"]
    fibers = FiberLight(desi, CENTER, conditions_at(0, "kitt peak"), SEEING, [0.6] * UM)
    table = fibers.table()
    radius = np.hypot(table["x"], table["y"]).to_value(u.mm)
    plane = desi.projection(CENTER).plain
    ring = np.column_stack([np.append(radius, radius + 1e-3), np.zeros(2 * len(radius))])
    angle, beyond = np.arccos(plane.unproject(ring) @ plane.basis[2]).reshape(2, -1)
    scale = np.sqrt(1e-3 / (beyond - angle) * radius / np.sin(angle)) * u.mm / u.rad
    fwhm = seeing_fwhm(SEEING, 0.6 * UM, 1 / np.sin(desi.projection(CENTER, conditions=fibers.conditions).altitude))
    expected = fiber_fraction(0 * ARCSEC, (fibers.fiber_diameter / scale).to(ARCSEC), fwhm)
    np.testing.assert_allclose(table["fraction"][:, 0], expected, rtol=1e-4)
    assert np.ptp(expected) > 0.02


def test_a_compensator_removes_the_dispersion_but_not_the_drift():
    assert light_at(3).smallest < 0.7
    assert light_at(3, compensator="ideal").smallest == pytest.approx(1, abs=1e-9)
    assert 0.9 < light_at(3, minutes=60, compensator="ideal").smallest < 1 - 1e-4


def test_targets_without_an_image_at_a_wavelength_lose_all_light(monkeypatch):
    """The smallest light is 0, and not that of other targets."""
    fibers = light_at(1)
    table = fibers.table()
    table["relative"][0] = np.nan
    monkeypatch.setattr(FiberLight, "_light", lambda *_: table)
    assert fibers.smallest == 0


def test_fibers_are_at_the_centers_of_the_positioners_that_have_their_type():
    both = light_at(0, [0.5] * UM)
    assert [np.sum(both.table()["fiber_type"] == name) for name in ("BOSS", "APOGEE")] == [500, 298]
    assert len(both._centers(N_POSITIONS)[0]) == 2 * N_POSITIONS


def test_errors_of_the_flux_of_quasars_are_those_of_boss():
    """BOSS placed fibers on quasars for 0.4 um, and on standard stars for 0.54 um, without a compensator.

    According to Margala et al. 2016, ApJ 831, 157, the flux of quasars was therefore 19 % too large at 0.36 um and 24 %
    too small at 1.0 um, on average; the light is computed for a typical altitude (60 deg) and seeing (1.5 arcsec).
    """
    center = SkyCoord(0 * u.deg, 32.78 * u.deg)
    placed = (
        conditions_at(2.391, minutes=15, wavelength=wave * UM, guide_wavelength=0.54 * UM) for wave in (0.4, 0.54)
    )
    band = {"BOSS": [0.36, 1.0] * UM}
    quasars, stars = (FiberLight("sdss_apo", center, each, 1.5 * ARCSEC, band) for each in placed)
    plane = stars.instrument.projection(center, conditions=stars.conditions)
    assert plane.altitude.deg == pytest.approx(60, abs=0.1)
    ratio = np.median(quasars.table()["fraction"] / stars.table()["fraction"], axis=0)
    np.testing.assert_allclose(ratio, [1.19, 0.76], atol=0.02)


@pytest.fixture(scope="module")
def planned():
    sky = rs.synthetic_catalog("uniform", CENTER, 1.3 * u.deg, n_targets=800, rng=1)
    given = {"wavelength": {"BOSS": 0.54 * UM, "APOGEE": 1.6 * UM}, "guide_wavelength": 0.6231 * UM}
    conditions = conditions_at(2, minutes=15, **given)
    return conditions, {
        model: rs.plan_tile(sky, "sdss_apo", CENTER, conditions=conditions, projection=model).table
        for model in ("full", "radial")
    }


def test_tables_of_tiles_have_a_row_for_each_assigned_fiber(planned):
    conditions, tables = planned
    fibers = FiberLight("sdss_apo", CENTER, conditions, SEEING, {"BOSS": [0.36, 0.54] * UM, "APOGEE": [1.5, 1.6] * UM})
    own = tables["full"][tables["full"]["status"] == "assigned"]
    got = fibers.table(tables["full"])
    assert len(got) > 300
    assert np.array_equal(got["positioner"], own["id"])
    assert np.array_equal(got["fiber_type"], own["fiber_type"])
    assert (got["wavelength"][:, 1] == np.where(got["fiber_type"] == "BOSS", 0.54, 1.6) * UM).all()
    assert got["relative"][:, 1].min() > 0.999
    # the positions of fibers that were placed without refraction are off by about half their diameter
    off = fibers.table(tables["radial"])["relative"][:, 1]
    assert np.median(off) < 0.9
    only = replace(fibers, wavelengths={"BOSS": [0.36] * UM}).table(tables["full"])
    assert np.array_equal(only["positioner"], own["id"][own["fiber_type"] == "BOSS"])
    np.testing.assert_array_equal(only["relative"][:, 0], got["relative"][got["fiber_type"] == "BOSS", 0])


def test_tiles_without_assigned_fibers_have_empty_tables(planned):
    parked = planned[1]["full"][planned[1]["full"]["status"] != "assigned"]
    got = light_at(1).table(parked)
    assert (len(got), got["relative"].shape) == (0, (0, 3))


def test_conditions_with_a_time_have_the_light_of_the_same_hour_angle():
    """Aberration and precession, which the conditions with a time include, displace images of all wavelengths alike."""
    conditions = rs.ObservingConditions("apache point", time="2025-02-01T05:00:00", exposure_time=15 * u.min)
    fibers = replace(light_at(0), conditions=conditions)
    plane = fibers.instrument.projection(CENTER, conditions=conditions)
    (altitude, azimuth), latitude = (plane.altitude.rad, plane.azimuth.rad), conditions.site.lat.rad
    north = np.sin(altitude) * np.cos(latitude) - np.cos(altitude) * np.cos(azimuth) * np.sin(latitude)
    hours = np.rad2deg(np.arctan2(-np.cos(altitude) * np.sin(azimuth), north)) / 15
    assert -4 < hours < -3
    expected = light_at(hours, minutes=15).table()["relative"]
    np.testing.assert_allclose(fibers.table()["relative"], expected, atol=2e-3)


def test_targets_without_coordinates_are_where_their_fibers_are_placed(planned):
    conditions, tables = planned
    fibers = FiberLight("sdss_apo", CENTER, conditions, SEEING, BAND)
    without = tables["full"].copy()
    expected = fibers.table(without)["relative"]
    without["ra"] = without["dec"] = np.nan * u.deg
    np.testing.assert_allclose(fibers.table(without)["relative"], expected, atol=1e-4)


def test_hour_angle_windows_end_where_the_light_is_at_the_limit():
    fibers = light_at(0, minutes=15)
    first, last = fibers.hour_angle_window(0.8)
    for hours in (first, last):
        conditions = fibers.conditions.at_hour_angle(hours)
        assert replace(fibers, conditions=conditions).smallest == pytest.approx(0.8, abs=2e-3)
    assert -2.5 * u.hourangle < first < -2 * u.hourangle < 2 * u.hourangle < last
    assert np.isnan(fibers.hour_angle_window(0.9999)).all()


def test_hour_angle_windows_end_at_the_horizon_or_at_twelve_hours():
    north = SkyCoord("0h +89.5d")
    fibers = FiberLight("lamost", north, conditions_at(0, "xinglong"), SEEING, [0.5] * UM)
    assert fibers.hour_angle_window(0.5).value.tolist() == [-12, 12]
    ideal = replace(fibers.conditions, compensator="ideal")
    low = replace(fibers, center=SkyCoord("0h -20d"), conditions=ideal).hour_angle_window(0.5)
    field = fibers.instrument.projection(
        SkyCoord("0h -20d"), conditions=conditions_at(low[1].value - 0.002, "xinglong")
    )
    assert field.altitude.deg == pytest.approx(fibers.instrument.field_radius.value, abs=0.2)


def test_the_best_guide_wavelength_has_the_largest_smallest_light():
    fibers = light_at(2, {"BOSS": [0.36, 1.0] * UM})
    best = fibers.best_guide_wavelength()
    assert 0.4 * UM < best < 0.6 * UM

    def smallest(wave):
        return replace(fibers, conditions=conditions_at(2, wavelength=wave, guide_wavelength=wave)).smallest

    scanned = [smallest(wave) for wave in np.arange(0.36, 1.0, 0.02) * UM]
    assert smallest(best) >= max(scanned)
    assert 0.36 * UM <= fibers.best_guide_wavelength(move_fibers=False) <= 1 * UM
    assert 1.5 * UM < light_at(2, {"APOGEE": [1.5, 1.7] * UM}).best_guide_wavelength() < 1.7 * UM


WRONG_LIGHT = [
    (
        {"instrument": "must", "wavelengths": [0.5] * UM},
        "fiber_diameter must be given for must, which does not state it, got None",
    ),
    ({"wavelengths": {"VIS": [0.5] * UM}}, "fiber type of wavelengths 'VIS'"),
    ({"wavelengths": {"BOSS": [0.5] * UM, "APOGEE": [1.5, 1.6] * UM}}, "wavelengths must be an array of the shape"),
    ({"wavelengths": {}}, "wavelengths must be an array of the shape"),
    ({"wavelengths": [] * UM}, "wavelengths must be an array of the shape"),
    ({"wavelengths": [-0.5] * UM}, "wavelengths must be finite and above 0 um, got -0.5"),
    ({"seeing": -1 * ARCSEC}, "seeing must be one finite value above 0 arcsec"),
    ({"fiber_diameter": 1 * ARCSEC}, "fiber_diameter must have a unit convertible to mm"),
    ({"conditions": None}, "conditions must be ObservingConditions"),
    ({"conditions": conditions_at(11)}, "must be above the horizon"),
]


@pytest.mark.parametrize(("given", "text"), WRONG_LIGHT)
def test_wrong_values_of_the_light_of_fibers_are_errors(given, text):
    valid = {"instrument": "sdss_apo", "center": CENTER, "conditions": conditions_at(0), "wavelengths": BAND}
    refused(text, FiberLight, **{**valid, "seeing": SEEING, **given})


def test_wrong_arguments_of_the_methods_of_the_light_of_fibers_are_errors(planned):
    for limit in (1.0, "x", None):
        refused("limit must be a number above 0 and below 1, got", light_at(0).hour_angle_window, limit)
    refused("move_fibers must be", light_at(0).best_guide_wavelength, move_fibers="no")
    refused("tile must have the column 'tip_y'", light_at(0).table, planned[1]["full"]["id", "status", "tip_x"])


def test_the_light_of_a_tile_has_its_conditions_and_the_bands_of_the_instrument(presets):
    stars = rs.synthetic_catalog("uniform", CENTER, 0.5 * u.deg, n_targets=200, rng=1)
    conditions = conditions_at(2, "kitt peak", minutes=15)
    tile = rs.plan_tile(stars, "desi", CENTER, position_angle=20 * u.deg, conditions=conditions)
    fibers = FiberLight.of_tile(tile, SEEING)
    assert fibers.wavelengths[""].value.tolist() == [0.36, 0.486, 0.98]
    table = fibers.table(tile)
    assert table["positioner"].tolist() == tile.table["id"][tile.table["status"] == "assigned"].tolist()
    assert (table["relative"] > 0.999).all()
    dispersed = FiberLight.of_tile(rs.plan_tile(stars, "lamost", CENTER, conditions=conditions), SEEING)
    assert dispersed.table()["relative"].min() < 0.99
    assert dispersed.conditions.guide_wavelength == 0.6231 * UM
    given = FiberLight.of_tile(tile, SEEING, presets["desi"], wavelengths=[0.5] * UM)
    assert given.table(tile)["fraction"].shape == (len(table), 1)


@pytest.mark.parametrize("scale", [0.9, 1.1])
def test_the_local_plate_scale_contains_the_scale_of_the_conditions(scale):
    """Regression: images did not have the scale. Fibers whose diameter has the scale collect the same light."""

    def fraction(scale):
        options = {"fiber_diameter": 0.32 * scale * u.mm, "wavelengths": [0.5] * UM}
        conditions = conditions_at(0, "xinglong", pressure=0 * u.hPa, scale=scale)
        return FiberLight("lamost", CENTER, conditions, SEEING, **options).table()["fraction"]

    np.testing.assert_allclose(fraction(scale), fraction(1), rtol=1e-3)


def test_the_guider_observes_at_one_wavelength():
    """Regression: if no guide wavelength is known, the guider followed the image at each wavelength of the light."""
    conditions = conditions_at(3, "paranal", wavelength=1.2 * UM)
    fibers = FiberLight("moons", SkyCoord("10h -25d"), conditions, SEEING, [0.65, 1.2] * UM)
    blue, placed = fibers.table()["relative"].min(axis=0)
    assert placed > 1 - 1e-6
    assert blue < 0.9


def test_tiles_without_conditions_or_with_changed_instruments_are_errors(presets):
    stars = rs.synthetic_catalog("uniform", CENTER, 0.5 * u.deg, n_targets=50, rng=1)
    refused("planned with observing conditions", FiberLight.of_tile, rs.plan_tile(stars, "lamost", CENTER), SEEING)
    refused("planned with observing conditions", FiberLight.of_tile, 3, SEEING)
    mine = replace(presets["lamost"], name="mine")
    tile = rs.plan_tile(stars, mine, CENTER, conditions=conditions_at(1, "xinglong"))
    refused("instrument must be given, because the tile was made with .* 'mine'", FiberLight.of_tile, tile, SEEING)
    values = {name: entry for name, entry in presets["lamost"].values.items() if name != "light.band"}
    bare, conditions = replace(presets["lamost"], values=values), conditions_at(1, "xinglong")
    refused("wavelengths must be given for lamost", FiberLight, bare, CENTER, conditions, SEEING)
