"""Fractions of the light of point sources that enter round fibers, and the widths of images."""

import astropy.units as u
import numpy as np

from rfpsurvey._common.settings import Option, number_within
from rfpsurvey._common.units import to_numbers, to_unit
from rfpsurvey.errors import InputError, check_choice, check_keywords, refusing

PROFILES = ("gaussian", "moffat")
# EXPONENT: the error of the quadrature is a small factor times exp(-EXPONENT). FEWEST: smallest number of its points.
# WIDEST: largest diameter of a fiber in units of the FWHM, so that the number of points is limited. FARTHEST: offset in
# units of the FWHM, at which no such fiber receives more than 1e-9 of the light.
EXPONENT, FEWEST, WIDEST, FARTHEST, TINY = 20.0, 4, 1e4, 1e8, 1e-300


def checked(value: object, unit: object, name: str, low: float = 0.0, closed: bool = False) -> np.ndarray:
    """Return finite numbers in ``unit`` above ``low``; with ``closed``, ``low`` itself is allowed."""
    values = to_unit(value, unit, name) if unit else to_numbers(value, name, unitless=True)
    if not (valid := np.isfinite(values) & ((values > low) | (closed & (values == low)))).all():
        limits = f"{'at least' if closed else 'above'} {low:g} {unit}".rstrip()
        raise InputError(f"{name} must be finite and {limits}, got {values[~valid].flat[0]:g}")
    return values


def _broadcast(names: str, *arrays: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return arrays of the same shape."""
    with refusing(f"{names} must have shapes that can be broadcast", [array.shape for array in arrays], list):
        return np.broadcast_arrays(*arrays)


def to_number(value: object, name: str, low: float, high: float) -> float:
    """Return one number between two limits."""
    return float(number_within(value, name, Option(above=low, below=high)))


def exponent_of(profile: str, beta: float) -> float:
    """Return the exponent of a Moffat profile; it is infinite for a Gaussian profile."""
    check_choice(profile, PROFILES, "profile")
    beta = to_number(beta, "beta", 1, 1e4)
    return beta if profile == "moffat" else np.inf


@check_keywords
def fiber_fraction(
    offset: u.Quantity, diameter: u.Quantity, fwhm: u.Quantity, *, profile: str = "moffat", beta: float = 3.5
) -> np.ndarray:
    """Return the fraction of the light of a point source that enters a round fiber.

    Parameters
    ----------
    offset : Quantity
        Distance between the center of the fiber and the center of the image, as an angle or as a length on the focal
        plane.
    diameter, fwhm : Quantity
        Diameter of the fiber, and full width at half maximum of the image, with units of the same kind. The three
        arrays are broadcast. The diameter must be at most 10,000 times the full width.
    profile : {"moffat", "gaussian"}, optional
        Profile of the image.
    beta : float, optional
        Exponent of the Moffat profile, above 1. The default value is that of simulations of DESI.

    Returns
    -------
    ndarray
        Fraction of the light, with an absolute error of at most 1e-7 from the quadrature.

    Raises
    ------
    InputError
        If a value is negative or not finite, if units or shapes do not match, or if the profile is unknown.

    Notes
    -----
    By the divergence theorem, the fraction is the mean of E(r) over the directions from the image to the edge of the
    fiber, where E(r) is the fraction of the light within the distance r. The integrand is periodic and analytic, so
    that the trapezoid rule converges exponentially (:ref:`light`).

    Examples
    --------
    >>> import astropy.units as u
    >>> import rfpsurvey as rs
    >>> rs.observing.fiber_fraction([0, 0.2, 1.0] * u.arcsec, 1.5 * u.arcsec, 1.1 * u.arcsec).round(4)
    array([0.5743, 0.5524, 0.1936])
    """
    beta = exponent_of(profile, beta)
    unit = u.mm if isinstance(diameter, u.Quantity) and diameter.unit.is_equivalent(u.mm) else u.arcsec
    offset = checked(offset, unit, "offset", closed=True)
    diameter, fwhm = checked(diameter, unit, "diameter"), checked(fwhm, unit, "fwhm")
    offset, diameter, fwhm = _broadcast("offset, diameter and fwhm", offset, diameter, fwhm)
    if (wide := diameter > WIDEST * fwhm).any():
        ratio = (diameter[wide] / fwhm[wide]).flat[0]
        raise InputError(f"diameter must be at most {WIDEST:g} times the fwhm, got {ratio:g} times the fwhm")
    return fraction_within(np.minimum(offset, FARTHEST * fwhm) / fwhm, diameter / fwhm / 2, 1.0, beta)


def fraction_within(offset: np.ndarray, radius: np.ndarray, fwhm: np.ndarray, beta: float) -> np.ndarray:
    """Return the fraction of the light in fibers; the arrays have the same unit, and NaN remains NaN."""
    # With q = (r / scale)^2, the light within r is 1 - (1 + q)^(1 - beta), or 1 - exp(-q) for an infinite beta.
    gaussian = np.isinf(beta)
    area = fwhm**2 / (4 * np.log(2)) if gaussian else fwhm**2 / (4 * np.expm1(np.log(2) / beta))
    near = area if gaussian else area / (1 + beta)
    gap, product = radius - offset, radius * offset
    # Points on the edge have the angle s from the point that is closest to the image. The substitution tan(s / 2) =
    # stretch tan(t / 2) makes the strip |Im t| < 2 artanh(stretch) the largest one in which Re(r^2) > -near.
    squared = np.sqrt((gap**2 + near) / ((radius + offset) ** 2 + near))
    least = min(np.sqrt(np.nanmin(squared, initial=1.0)), 0.99)
    n = max(FEWEST, int(np.ceil(EXPONENT / (4 * np.arctanh(least)))))
    total = 0.0
    for half in (np.arange(n) + 0.5) * np.pi / (2 * n):
        sine, cosine = squared * np.sin(half) ** 2, np.cos(half) ** 2
        where = sine / (sine + cosine)
        q = np.maximum((gap**2 + 4 * product * where) / area, TINY)
        within = -np.expm1(-q if gaussian else (1 - beta) * np.log1p(q))
        total = total + within / q * (gap + 2 * offset * where) / (sine + cosine)
    return np.clip(total * np.sqrt(squared) * radius / (n * area), 0.0, 1.0)


@check_keywords
def seeing_fwhm(seeing: u.Quantity, wavelength: u.Quantity, airmass: float = 1.0) -> u.Quantity:
    """Return the full width at half maximum of images for a wavelength and an airmass.

    Parameters
    ----------
    seeing : Quantity
        Full width at half maximum at the zenith and at 0.5 um.
    wavelength : Quantity
        Wavelength.
    airmass : float or array_like, optional
        Airmass, at least 1. The three arrays are broadcast.

    Returns
    -------
    Quantity
        Full width at half maximum, in the unit of ``seeing``.

    Raises
    ------
    InputError
        If a value has a wrong unit, is not finite or is out of range.

    Notes
    -----
    Fried (1966, J. Opt. Soc. Am. 56, 1372) derived for turbulence with the Kolmogorov spectrum that images are
    proportional to the power -1/5 of the wavelength and 3/5 of the airmass.

    Examples
    --------
    >>> import astropy.units as u
    >>> import rfpsurvey as rs
    >>> rs.observing.seeing_fwhm(1.2 * u.arcsec, [0.36, 0.5, 1.6] * u.um, 1.4).round(3)
    <Quantity [1.568, 1.468, 1.164] arcsec>
    """
    width, wave = checked(seeing, u.arcsec, "seeing"), checked(wavelength, u.um, "wavelength")
    airmass = checked(airmass, "", "airmass", 1.0, closed=True)
    width, wave, airmass = _broadcast("seeing, wavelength and airmass", width, wave, airmass)
    return (width * (wave / 0.5) ** -0.2 * airmass**0.6 * u.arcsec).to(seeing.unit)
