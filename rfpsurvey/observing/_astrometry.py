"""Directions of stars as an observer sees them, computed with ERFA on arrays without units."""

from copy import copy
from functools import cache

import astropy.units as u
import erfa
import numpy as np
from astropy.time import Time
from astropy.utils import iers

from rfpsurvey._units import to_lonlat
from rfpsurvey.errors import InputError
from rfpsurvey.observing._conditions import RATE, ObservingConditions


class Instants:
    """The sky at k instants: conversion of ICRS directions to observed directions.

    Parameters
    ----------
    conditions : ObservingConditions
        The observing conditions.
    ra_rad : float
        Right ascension of the field center (rad); it is used only if the conditions have an hour angle.
    seconds : ndarray, shape (k,)
        Time of each instant since the midpoint of the exposure.
    """

    def __init__(self, conditions: ObservingConditions, ra_rad: float, seconds: np.ndarray):
        pressure, temperature = conditions.pressure.to_value(u.hPa), conditions.temperature.to_value(u.deg_C)
        self.weather, site = (pressure, temperature, conditions.humidity), conditions.site.to_geodetic()
        self.place = site.lon.to_value(u.rad), site.lat.to_value(u.rad), site.height.to_value(u.m)
        self.apparent = conditions.time is None
        if self.apparent:
            theta = ra_rad + conditions.hour_angle.to_value(u.rad) + RATE * seconds
            self.astrom = erfa.apio(0.0, theta - self.place[0], *self.place, 0.0, 0.0, 0.0, 0.0)
            self.astrom["diurab"] = 0.0
        else:
            _check_covered(conditions.time)
            utc = conditions.time.utc + seconds * u.s
            difference, x, y = _earth_rotation(utc)
            self.astrom, _ = erfa.apco13(utc.jd1, utc.jd2, difference, *self.place, x, y, 0.0, 0.0, 0.0, 0.5)

    def __getitem__(self, index: slice | list[int]) -> "Instants":
        """Return some of the instants."""
        some = copy(self)
        some.astrom = self.astrom[index]
        return some

    def observe(self, vectors: np.ndarray, wavelength_um: float) -> np.ndarray:
        """Return observed directions, shape (k, n, 3), in the frame east, north, zenith; NaN below the horizon."""
        azimuth, zenith = self._horizontal(vectors, *erfa.refco(*self.weather, wavelength_um))
        zenith = np.where(zenith < np.pi / 2, zenith, np.nan)
        sine = np.sin(zenith)
        return np.stack([sine * np.sin(azimuth), sine * np.cos(azimuth), np.cos(zenith)], axis=-1)

    def altitudes(self, vector: np.ndarray) -> np.ndarray:
        """Return the altitude (rad) of one ICRS unit vector at each instant, without refraction."""
        return np.pi / 2 - self._horizontal(vector[None], 0.0, 0.0)[1][:, 0]

    def _horizontal(self, vectors, a, b):
        """Return azimuths and zenith distances (rad), shape (k, n), for the coefficients a and b of the refraction."""
        lon, lat = to_lonlat(vectors)
        astrom = self.astrom[:, None]
        if not self.apparent:
            lon, lat = erfa.atciqz(lon, lat, astrom)
        astrom = astrom.copy()
        astrom["refa"], astrom["refb"] = a, b
        return erfa.atioq(lon, lat, astrom)[:2]


@cache
def _tables():
    """Return the tables of the Earth's rotation that are installed with astropy."""
    return iers.IERS_A.read(iers.IERS_A_FILE)


def _earth_rotation(utc: Time) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return UT1 - UTC (s) and the position of the pole (rad); no file is downloaded."""
    table = _tables()
    x, y = table.pm_xy(utc)
    return table.ut1_utc(utc).to_value(u.s), x.to_value(u.rad), y.to_value(u.rad)


def _check_covered(time: Time) -> None:
    """Raise an error unless the installed tables cover a time, with a margin of one day before and after it."""
    days = _tables()["MJD"].value
    if not days[0] + 1 <= time.mjd <= days[-1] - 1:
        first, last = (Time(day, format="mjd").isot[:10] for day in (days[0] + 1, days[-1] - 1))
        # TAI is used, because astropy warns about UTC dates that are long after the last known leap second
        given = Time(time.mjd, format="mjd", scale="tai").isot
        raise InputError(
            f"time must be from {first} to {last}, which the installed tables of the Earth's rotation cover, got "
            f"{given}; give hour_angle, or install a newer version of astropy-iers-data"
        )
