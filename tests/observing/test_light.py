"""Light that enters fibers, compared with numerical integration, published values and ERFA."""

from dataclasses import replace

import astropy.units as u
import erfa
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from raising import refused
from scipy.stats import ncx2

import rfpsurvey as rs
from rfpsurvey._instruments import light
from rfpsurvey.observing import FiberLight, fiber_fraction, seeing_fwhm

ARCSEC, UM = u.arcsec, u.um
CENTER, SEEING = SkyCoord("10h +32d"), 1.2 * ARCSEC
BAND, PROFILES = {"BOSS": [0.36, 0.54, 1.0] * UM}, ("gaussian", "moffat")


def conditions_at(hours, site="apache point", minutes=0, **options):
    return rs.ObservingConditions(site, hour_angle=hours * u.hourangle, exposure_time=minutes * u.min, **options)


def light_at(hours, band=BAND, minutes=0, **options):
    return FiberLight("sdss_apo", CENTER, conditions_at(hours, minutes=minutes), band, SEEING, **options)


POINTS, WEIGHTS = np.polynomial.legendre.leggauss(12)
EDGES = np.concatenate([-(2.0 ** np.arange(7, -3, -1)), [0], 2.0 ** np.arange(-2, 8)])


def panels(edges, low, high):
    """Return points and weights of Gauss-Legendre quadrature on panels between edges from ``low`` to ``high``."""
    edges = np.unique(np.clip([low, *edges, high], low, high))
    half = np.diff(edges)[:, None] / 2
    return (edges[:-1, None] + half * (1 + POINTS)).ravel(), (half * WEIGHTS).ravel()


def integrated(offset, diameter, fwhm, intensity):
    """Return the integral of an intensity over a disk in two dimensions, with short panels near the image."""
    radius, total = diameter / 2, 0.0
    edges = np.arccos(np.clip((offset + EDGES * fwhm) / radius, -1, 1))
    for angle, weight in zip(*panels(edges, 0.0, np.pi), strict=True):
        x, chord = radius * np.cos(angle), radius * np.sin(angle)
        y, weights = panels(EDGES * fwhm, 0.0, chord)
        total += 2 * weight * chord * (weights @ intensity(np.hypot(x - offset, y)))
    return total


def intensity_of(profile, fwhm, beta):
    if profile == "gaussian":
        variance = fwhm**2 / (8 * np.log(2))
        return lambda r: np.exp(-(r**2) / (2 * variance)) / (2 * np.pi * variance)
    alpha = fwhm / (2 * np.sqrt(2 ** (1 / beta) - 1))
    return lambda r: (beta - 1) / (np.pi * alpha**2) * (1 + (r / alpha) ** 2) ** -beta


@pytest.mark.parametrize("profile", PROFILES)
def test_fractions_are_those_of_integration_in_two_dimensions(profile):
    """Fibers are from 30 times smaller to 30 times larger than the images, and up to four radii from them."""
    rng = np.random.default_rng(1)
    n = 500
    fwhm, beta = 10 ** rng.uniform(-1.5, 1.5, n), rng.uniform(1.5, 6, n)
    offset = np.where(rng.random(n) < 0.1, 0.0, 2 * rng.uniform(0, 1, n) * rng.choice([1, 2], n))
    offset[:50] = 1.0  # images on the edge of the fiber
    got, expected = np.empty(n), np.empty(n)
    for k, (o, f, b) in enumerate(zip(offset, fwhm, beta, strict=True)):
        got[k] = fiber_fraction(o * ARCSEC, 2 * ARCSEC, f * ARCSEC, profile=profile, beta=b)
        expected[k] = integrated(o, 2.0, f, intensity_of(profile, f, b))
    assert np.abs(got - expected).max() < 1e-6
    assert np.ptp(expected) > 0.99


def test_fractions_of_gaussian_images_are_those_of_the_noncentral_chi_square_distribution():
    rng = np.random.default_rng(2)
    fwhm, offset = 10 ** rng.uniform(-3.5, 3, 3000), rng.uniform(0, 3, 3000)
    sigma = fwhm / np.sqrt(8 * np.log(2))
    got = fiber_fraction(offset * u.mm, 2 * u.mm, fwhm * u.mm, profile="gaussian")
    assert np.abs(got - ncx2.cdf(1 / sigma**2, 2, (offset / sigma) ** 2)).max() < 1e-7
    assert (got.min(), got.max()) == (0, 1)


@pytest.mark.parametrize("beta", [1.1, 2.5, 3.5, 100, np.inf])
def test_more_points_of_the_quadrature_change_fractions_by_less_than_the_stated_error(monkeypatch, beta):
    rng = np.random.default_rng(3)
    fwhm = 10 ** rng.uniform(-4, 2, 300) * 2
    offset = np.abs(1 + rng.normal(size=300) * fwhm * 10 ** rng.uniform(-1, 1, 300))

    def each():
        return np.array([light._fraction(o, 1.0, f, beta) for o, f in zip(offset, fwhm, strict=True)])

    few = each()
    monkeypatch.setattr(light, "EXPONENT", 80.0)
    assert np.abs(few - each()).max() < 1e-8


def test_fractions_of_large_arrays_do_not_depend_on_their_other_values():
    """The number of points of the quadrature is that of the most difficult value."""
    fwhm = [1.5, 2e-4] * ARCSEC
    together = fiber_fraction(0.75 * ARCSEC, 1.5 * ARCSEC, fwhm)
    assert together[0] == pytest.approx(fiber_fraction(0.75 * ARCSEC, 1.5 * ARCSEC, fwhm[0]), abs=1e-7)
    assert together[1] == pytest.approx(0.5, abs=1e-4)  # the edge of the fiber is almost a line


def test_fraction_of_the_nominal_image_of_desi():
    """The constant FRACFLUX_NOMINAL_POINTSOURCE in desispec (efftime.py) is for a fiber of 1.52 arcsec."""
    assert fiber_fraction(0 * ARCSEC, 1.52 * ARCSEC, 1.1 * ARCSEC, beta=3.5) == pytest.approx(0.58176816, abs=1e-3)


def test_the_width_of_images_is_that_of_turbulence_with_the_kolmogorov_spectrum():
    """The width is proportional to wavelength / r0, and r0 to the power 6/5 of wavelength and -3/5 of airmass."""
    wave, airmass = np.array([0.36, 0.5, 1.0, 1.7])[:, None], np.array([1.0, 1.3, 2.5])
    expected = wave / 0.5 * ((wave / 0.5) ** (6 / 5) * airmass ** (-3 / 5)) ** -1
    got = seeing_fwhm(1.1 * ARCSEC, wave * UM, airmass)
    np.testing.assert_allclose(got.to_value(ARCSEC), 1.1 * expected, rtol=1e-12)


# Filippenko 1982, PASP 94, 715, Table I: refraction (arcsec) relative to 0.5 um for 600 mm Hg, 7 deg C and a vapor
# pressure of 8 mm Hg, by airmass and wavelength (um).
TABLE_UM = np.array([0.3, 0.35, 0.4, 0.45, 0.55, 0.6, 0.65, 0.7, 0.8, 1.0])
TABLE = {
    1.1: [0.97, 0.55, 0.29, 0.12, -0.09, -0.15, -0.20, -0.24, -0.30, -0.37],
    1.25: [1.59, 0.90, 0.48, 0.20, -0.14, -0.25, -0.33, -0.40, -0.50, -0.61],
    1.5: [2.37, 1.34, 0.71, 0.29, -0.21, -0.37, -0.50, -0.60, -0.74, -0.91],
}


def refraction(wave, zenith, pressure=799.93, celsius=7.0, humidity=1.0):
    """Return the refraction of ERFA (arcsec); at 7 deg C, a vapor pressure of 8 mm Hg is saturated."""
    a, b = erfa.refco(pressure, celsius, humidity, wave)
    return np.rad2deg(a * np.tan(zenith) + b * np.tan(zenith) ** 3) * 3600


def index(wave):
    """Return the refractive index of air minus 1, by equations (1) to (3) of Filippenko (1982)."""
    squared, pressure, celsius, vapor = wave**-2, 600.0, 7.0, 8.0
    dry = 64.328 + 29498.1 / (146 - squared) + 255.4 / (41 - squared)
    dry *= pressure * (1 + (1.049 - 0.0157 * celsius) * 1e-6 * pressure) / (720.883 * (1 + 0.003661 * celsius))
    return 1e-6 * (dry - (0.0624 - 0.000680 * squared) / (1 + 0.003661 * celsius) * vapor)


@pytest.mark.parametrize("airmass", TABLE)
def test_dispersion_of_erfa_is_that_of_filippenko_with_the_stated_differences(airmass):
    """ERFA's dispersion is smaller, by less than 2 % for 0.35 um and larger wavelengths, and by 2.5 % at 0.3 um."""
    zenith = np.arccos(1 / airmass)
    formula = 206265 * (index(TABLE_UM) - index(0.5)) * np.tan(zenith)
    assert np.abs(formula - TABLE[airmass]).max() < 0.0055  # the table is rounded to 0.01
    relative = np.array([refraction(wave, zenith) - refraction(0.5, zenith) for wave in TABLE_UM]) / formula - 1
    assert -0.026 < relative[0] < -0.022
    assert relative[1:].min() > -0.017
    assert relative.max() < -0.003


@pytest.mark.parametrize("profile", PROFILES)
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
    fibers = FiberLight(lamost, CENTER, conditions_at(3, minutes=60, **given), [0.36] * UM, SEEING)
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
    fibers = FiberLight(desi, CENTER, conditions_at(0, "kitt peak"), [0.6] * UM, SEEING, compensated=True)
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
    assert light_at(3, compensated=True).smallest == pytest.approx(1, abs=1e-9)
    assert 0.9 < light_at(3, minutes=60, compensated=True).smallest < 1 - 1e-4


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
    assert len(both._centers(light.N_POSITIONS)[0]) == 2 * light.N_POSITIONS


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
    quasars, stars = (FiberLight("sdss_apo", center, each, band, 1.5 * ARCSEC) for each in placed)
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
    fibers = FiberLight("sdss_apo", CENTER, conditions, {"BOSS": [0.36, 0.54] * UM, "APOGEE": [1.5, 1.6] * UM}, SEEING)
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
    fibers = FiberLight("sdss_apo", CENTER, conditions, BAND, SEEING)
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
    fibers = FiberLight("lamost", north, conditions_at(0, "xinglong"), [0.5] * UM, SEEING)
    assert fibers.hour_angle_window(0.5).value.tolist() == [-12, 12]
    low = replace(fibers, center=SkyCoord("0h -20d"), compensated=True).hour_angle_window(0.5)
    field = fibers.instrument.projection(
        SkyCoord("0h -20d"), conditions=conditions_at(low[1].value - 0.002, "xinglong")
    )
    assert field.altitude.deg == pytest.approx(fibers.instrument.field_radius.value, abs=0.2)


def test_the_best_guide_wavelength_has_the_largest_smallest_light():
    fibers = light_at(2, {"BOSS": [0.36, 1.0] * UM})
    best = fibers.best_guide_wavelength()
    assert 0.4 * UM < best < 0.6 * UM

    def smallest(wave):
        return replace(fibers, conditions=conditions_at(2, wavelength=wave)).smallest

    scanned = [smallest(wave) for wave in np.arange(0.36, 1.0, 0.02) * UM]
    assert smallest(best) >= max(scanned)
    assert 0.36 * UM <= fibers.best_guide_wavelength(move_fibers=False) <= 1 * UM
    assert 1.5 * UM < light_at(2, {"APOGEE": [1.5, 1.7] * UM}).best_guide_wavelength() < 1.7 * UM


WRONG = [
    ({"offset": -1 * ARCSEC}, "offset must be finite and at least 0 arcsec, got -1"),
    ({"offset": np.nan * ARCSEC}, "offset must be finite and at least 0 arcsec, got nan"),
    ({"offset": 1 * u.mm}, "offset must have a unit convertible to arcsec, got mm"),
    ({"offset": 1.0}, "offset must be a Quantity with a unit convertible to arcsec, got 1.0"),
    ({"diameter": 0 * ARCSEC}, "diameter must be finite and above 0 arcsec, got 0"),
    ({"diameter": [1, -2] * ARCSEC}, "diameter must be finite and above 0 arcsec, got -2"),
    ({"diameter": 1 * u.s}, "diameter must have a unit convertible to arcsec, got s"),
    ({"fwhm": np.inf * ARCSEC}, "fwhm must be finite and above 0 arcsec, got inf"),
    ({"fwhm": 1e-5 * ARCSEC}, "diameter must be at most 10000 times the fwhm, got 100000 times the fwhm"),
    ({"offset": [1, 2] * ARCSEC, "fwhm": [1, 2, 3] * ARCSEC}, "must have shapes that can be broadcast, got"),
    ({"profile": "airy"}, "unknown profile 'airy'; choose one of: gaussian, moffat"),
    ({"beta": 1.0}, "beta must be one finite value above 1"),
    ({"beta": "steep"}, "beta must be"),
]


@pytest.mark.parametrize(("given", "text"), WRONG)
def test_wrong_arguments_of_fiber_fraction_are_errors_of_one_sentence(given, text):
    valid = {"offset": 0 * ARCSEC, "diameter": 1 * ARCSEC, "fwhm": 1 * ARCSEC}
    assert "\n" not in refused(text, fiber_fraction, **{**valid, **given})


def test_wrong_arguments_of_seeing_fwhm_are_errors():
    refused("seeing must be finite and above 0 arcsec, got 0", seeing_fwhm, 0 * ARCSEC, 0.5 * UM)
    refused("wavelength must have a unit convertible to um, got arcsec", seeing_fwhm, 1 * ARCSEC, 0.5 * ARCSEC)
    refused("airmass must be finite and at least 1, got 0.9", seeing_fwhm, 1 * ARCSEC, 0.5 * UM, 0.9)
    refused("airmass must be", seeing_fwhm, 1 * ARCSEC, 0.5 * UM, "low")


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
    ({"compensated": "yes"}, "compensated must be"),
    ({"fiber_diameter": 1 * ARCSEC}, "fiber_diameter must have a unit convertible to mm"),
    ({"conditions": None}, "conditions must be ObservingConditions"),
    ({"conditions": conditions_at(11)}, "must be above the horizon"),
]


@pytest.mark.parametrize(("given", "text"), WRONG_LIGHT)
def test_wrong_values_of_the_light_of_fibers_are_errors(given, text):
    valid = {"instrument": "sdss_apo", "center": CENTER, "conditions": conditions_at(0), "wavelengths": BAND}
    refused(text, FiberLight, **{**valid, "seeing": SEEING, **given})


def test_wrong_arguments_of_the_methods_of_the_light_of_fibers_are_errors(planned):
    refused("limit must be one finite value above 0 and below 1", light_at(0).hour_angle_window, 1.0)
    refused("move_fibers must be", light_at(0).best_guide_wavelength, move_fibers="no")
    refused("tile must have the column 'tip_y'", light_at(0).table, planned[1]["full"]["id", "status", "tip_x"])
