"""Fractions of light in fibers and widths of images, compared with numerical integration and published values."""

import astropy.units as u
import numpy as np
import pytest
from raising import refused
from refracting import refraction
from scipy.stats import ncx2

from rfpsurvey._sky import light
from rfpsurvey.observing import fiber_fraction, seeing_fwhm

ARCSEC, UM = u.arcsec, u.um
PROFILES = ("gaussian", "moffat")


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
        return np.array([light.fraction_within(o, 1.0, f, beta) for o, f in zip(offset, fwhm, strict=True)])

    few = each()
    monkeypatch.setattr(light, "EXPONENT", 80.0)
    assert np.abs(few - each()).max() < 1e-8


def test_fractions_of_large_arrays_do_not_depend_on_their_other_values():
    """The number of points of the quadrature is that of the most difficult value."""
    fwhm = [1.5, 2e-4] * ARCSEC
    together = fiber_fraction(0.75 * ARCSEC, 1.5 * ARCSEC, fwhm)
    assert together[0] == pytest.approx(fiber_fraction(0.75 * ARCSEC, 1.5 * ARCSEC, fwhm[0]), abs=1e-7)
    assert together[1] == pytest.approx(0.5, abs=1e-4)  # the edge of the fiber is almost a line


def test_extreme_lengths_have_fractions():
    """Half the width contains 1 - 2^((1 - beta) / beta) of a Moffat profile; squares of the lengths are not finite."""
    got = fiber_fraction([0, 0, 1e200] * u.mm, [1e-170, 1e170, 1] * u.mm, [1e-170, 1e170, 1] * u.mm)
    np.testing.assert_allclose(got, [1 - 2 ** (-2.5 / 3.5)] * 2 + [0], atol=1e-12)


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
    ({"beta": 1.0}, "beta must be a number above 1"),
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
    refused("airmass must be numbers", seeing_fwhm, 1 * ARCSEC, 0.5 * UM, "low")
    refused("seeing, wavelength and airmass must have shapes that", seeing_fwhm, 1 * ARCSEC, [1, 2] * UM, [1, 2, 3])
