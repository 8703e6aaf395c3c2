"""Means over exposures, drift and field rotation during exposures."""

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import AltAz, SkyCoord
from astropy.time import Time
from astropy.utils import iers
from raising import refused

import rfpsurvey as rs
from rfpsurvey._sky.projection import field_basis
from rfpsurvey.observing import ObservedField

MAS = np.deg2rad(1 / 3.6e6)
RATE = np.deg2rad(15 * 1.00273781191135448)  # rotation of the Earth in an hour


@pytest.fixture(autouse=True)
def offline():
    """Let also the reference implementation work without the network."""
    with iers.conf.set_temp("auto_download", False):
        yield


def images_by_astropy(conditions, basis, vectors, times):
    """Return images as complex numbers, shape (times, n), from AltAz; a fit gives the mean rotation of the field."""
    ring = 1e-4 * np.exp(1j * (2 * np.pi * np.arange(12) / 12))
    around = basis[2] + ring.real[:, None] * basis[0] + ring.imag[:, None] * basis[1]

    def observed(directions, wavelength):
        coord = SkyCoord(*directions.T, representation_type="cartesian", frame="icrs")
        frame = AltAz(
            obstime=times[:, None],
            location=conditions.site,
            pressure=conditions.pressure,
            temperature=conditions.temperature,
            relative_humidity=conditions.humidity,
            obswl=wavelength,
        )
        return np.moveaxis(coord[None].transform_to(frame).cartesian.xyz.value, 0, -1)

    near = observed(np.vstack([basis[2], around]), conditions.guide_wavelength)
    targets, found = observed(vectors, conditions.wavelength), []
    for center, ring_seen, seen in zip(near[:, 0], near[:, 1:], targets, strict=True):
        x = np.cross(center, [0.6, 0.48, 0.64])
        x /= np.linalg.norm(x)
        y = np.cross(x, center)  # AltAz is left-handed: azimuths increase from north toward east
        flat, seen = (one / (one @ center)[:, None] @ np.array([x, y]).T @ [1, 1j] for one in (ring_seen, seen))
        rotation = np.vdot(ring, flat)  # the part of the linear map that preserves angles
        found.append(seen * abs(rotation) / rotation)
    return np.array(found)


@pytest.mark.few(2)
@pytest.mark.parametrize(
    ("site", "hours", "lowest"),
    [("kitt peak", 8, 27), ("paranal", 4, 12), ("apache point", 11, 11), ("paranal", 1, 30)],
)
def test_the_mean_and_the_drift_of_long_exposures_agree_with_dense_quadrature(site, hours, lowest):
    """Regression: three instants were used for all exposures, and the drift was the distance at the two ends.

    For exposures of 4 h and more, positions were wrong by up to 12 tolerances.
    """
    time = Time("2026-01-15T06:30:00")
    conditions = rs.ObservingConditions(
        site, time=time, exposure_time=hours * u.hour, wavelength=0.4 * u.um, guide_wavelength=0.65 * u.um
    )
    zenith = SkyCoord(AltAz(az=0 * u.deg, alt=90 * u.deg, obstime=time, location=conditions.site)).icrs
    center = zenith.directional_offset_by(100 * u.deg, 90 * u.deg - hours * 7.5 * u.deg - lowest * u.deg)
    basis, turn = field_basis(center.ra.rad, center.dec.rad, 0.3), np.arange(8) * np.pi / 4
    vectors = basis[2] + 0.025 * (np.cos(turn)[:, None] * basis[0] + np.sin(turn)[:, None] * basis[1])
    vectors /= np.linalg.norm(vectors, axis=1)[:, None]
    field = ObservedField(basis, 1.0, None, conditions)
    points, weights = np.polynomial.legendre.leggauss(48)
    images = images_by_astropy(conditions, basis, vectors, time + points * hours / 2 * u.hour)
    mean = weights / 2 @ images
    np.testing.assert_allclose(field.project(vectors) @ [1, 1j], mean, rtol=0, atol=MAS)
    dense = images_by_astropy(conditions, basis, vectors, time + np.linspace(-0.5, 0.5, 81) * hours * u.hour)
    np.testing.assert_allclose(field.drift(vectors), np.abs(dense - mean).max(axis=0), rtol=2e-3, atol=MAS)


def test_short_exposures_use_three_instants():
    """More instants for exposures of 15 min would only cost time: they change positions by less than 0.2 mas."""
    basis = field_basis(0.2, 0.3, 0.0)
    for minutes, used in ((0, 1), (15, 3), (60, 3), (240, 5)):
        conditions = rs.ObservingConditions("paranal", hour_angle=2 * u.hourangle, exposure_time=minutes * u.min)
        assert np.count_nonzero(ObservedField(basis, 1e4, None, conditions).weights) == used


def parallactic_angles(latitude, dec, hour_angles):
    return np.arctan2(np.sin(hour_angles), np.tan(latitude) * np.cos(dec) - np.sin(dec) * np.cos(hour_angles))


@pytest.mark.few(4)
@pytest.mark.parametrize("pressure", [0, 720])
@pytest.mark.parametrize(
    ("dec", "hours"),
    [(60, 0.5), (35, 0.5), (33, 0.5), (32.79, 0.5), (32.78, 0.5), (32.7, 0.5), (34, 10), (32, 10), (89, 8)],
)
def test_the_field_rotation_is_the_change_of_the_parallactic_angle(dec, hours, pressure):
    """Regression: the rotation was extrapolated from three instants, which is wrong by up to 50 deg near the zenith.

    Refraction does not change the parallactic angle, because it moves the center and all directions along verticals.
    """
    sdss = rs.Instrument.preset("sdss_apo")
    for offset in (0.0, 0.1):
        conditions = rs.ObservingConditions(
            "apache point", hour_angle=offset * u.hourangle, exposure_time=hours * u.hour, pressure=pressure * u.hPa
        )
        latitude, moments = conditions.site.lat.rad, np.linspace(-0.5, 0.5, 400_001) * hours * RATE
        expected = np.unwrap(parallactic_angles(latitude, np.deg2rad(dec), np.deg2rad(15 * offset) + moments))
        plane = sdss.projection(SkyCoord(95 * u.deg, dec * u.deg), 70 * u.deg, conditions)
        change = np.rad2deg(expected[-1] - expected[0])
        np.testing.assert_allclose(plane.field_rotation.deg, change, rtol=0, atol=1e-3 if pressure else 1e-6)


def test_the_field_rotates_by_180_deg_at_the_zenith():
    conditions = rs.ObservingConditions("apache point", hour_angle=0 * u.deg, exposure_time=20 * u.min)
    center = SkyCoord(95 * u.deg, conditions.site.lat)
    rotation = rs.Instrument.preset("sdss_apo").projection(center, conditions=conditions).field_rotation
    assert abs(abs(rotation) - 180 * u.deg) < 3 * u.deg


@pytest.mark.parametrize("hours", [-4.34, 4.34])
def test_a_field_that_sets_or_rises_during_the_exposure_is_an_error(hours):
    """Regression: only instants between the start and the end of the exposure were tested."""
    center = SkyCoord(95 * u.deg, -20 * u.deg)
    at = rs.ObservingConditions("apache point", hour_angle=hours * u.hourangle, exposure_time=84 * u.min)
    low = rs.Instrument.preset("sdss_apo")
    for inside in (-0.4, 0.0, 0.4):
        low.projection(center, conditions=at.without_exposure.shifted(inside * at.exposure_time))
    refused("above the horizon, got the altitude .* during the exposure", low.projection, center, conditions=at)
