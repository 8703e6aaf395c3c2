"""The sky at instants of an exposure: observed directions of stars, with refraction, from the coefficients of ERFA."""

from functools import cache, lru_cache

import astropy.units as u
import erfa
import numpy as np
from astropy.time import Time
from astropy.utils import iers

from rfpsurvey._kernels import refraction
from rfpsurvey._sky.conditions import RATE, ObservingConditions
from rfpsurvey._sky.time import any_year
from rfpsurvey.errors import InputError

AU_PER_DAY = 1 / (86400 * 299792458.0 / 149597870700.0)  # in units of the speed of light


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
        numbers, k = conditions.numbers, len(seconds)
        self.weather, place = numbers.weather, numbers.place
        self.sun, self.motion, self.diurnal = np.zeros((k, 4)), np.zeros((k, 4)), np.zeros(k)
        if conditions.time is None:
            self.before = _rotations(ra_rad + numbers.hour_angle + RATE * seconds)
            self.motion[:, :3] = velocity_of_earth(conditions.date)
            self.motion[:, 3] = np.sqrt(1 - (self.motion[:, :3] ** 2).sum(axis=1))
        else:
            _check_covered(conditions.time)
            utc = conditions.time.utc + seconds * u.s
            difference, x, y = _earth_rotation(utc)
            astrom, _ = erfa.apco13(utc.jd1, utc.jd2, difference, *place, x, y, 0.0, 0.0, 0.0, 0.5)
            self.sun[:, :3], self.sun[:, 3] = astrom["eh"], astrom["em"]
            self.motion[:, :3], self.motion[:, 3], self.diurnal[:] = astrom["v"], astrom["bm1"], astrom["diurab"]
            self.before = _polar(astrom["xpl"], astrom["ypl"]) @ _rotations(astrom["eral"]) @ astrom["bpn"]
        sine, cosine = np.sin(place[1]), np.cos(place[1])
        self.after = np.array([[0.0, 1.0, 0.0], [-sine, 0.0, cosine], [cosine, 0.0, sine]])
        self.unturned = np.broadcast_to(np.eye(3), (k, 3, 3)).copy()

    def observe(self, vectors: np.ndarray, wavelength_um: float, weights: np.ndarray, turn: np.ndarray) -> np.ndarray:
        """Return the mean of the observed directions (n, 3) over the instants, after matrices ``turn`` (k, 3, 3).

        Without matrices, the frame is east, north, zenith. Directions below the horizon are NaN.
        """
        out = np.empty((len(vectors), 3))
        arrays = self.sun, self.motion, self.before, self.diurnal, self.after
        a_and_b = np.array(coefficients(*self.weather, wavelength_um))
        refraction.observe(np.ascontiguousarray(vectors), *arrays, a_and_b, turn, weights, out)
        return out

    def each(self, vectors: np.ndarray, wavelength_um: float) -> np.ndarray:
        """Return the observed directions (k, n, 3) at each instant in the frame east, north, zenith."""
        return np.array([self.observe(vectors, wavelength_um, row, self.unturned) for row in np.eye(len(self.before))])

    def altitudes(self, vector: np.ndarray) -> np.ndarray:
        """Return the altitude (rad) of one ICRS unit vector at each instant, without refraction."""
        seen = vector + self.motion[:, :3]
        up = np.einsum("kj,kj->k", self.after[2] @ self.before, seen) / np.linalg.norm(seen, axis=1)
        return np.arcsin(up)

    def zeniths(self, seconds: np.ndarray) -> np.ndarray:
        """Return the ICRS direction of the zenith (k, 3) at times (s) since the first instant, without aberration."""
        return self.after[2] @ _rotations(RATE * seconds) @ self.before[0]


def midpoint(conditions: ObservingConditions, ra_rad: float) -> Instants:
    """Return the sky at the midpoint of the exposure; for conditions with a time, it is computed only once."""
    if conditions.time is None:
        return Instants(conditions, ra_rad, np.zeros(1))
    made = vars(conditions)
    if "_midpoint" not in made:
        made["_midpoint"] = Instants(conditions, ra_rad, np.zeros(1))
    return made["_midpoint"]


@lru_cache(maxsize=1024)
def coefficients(pressure: float, temperature: float, humidity: float, wavelength_um: float) -> tuple[float, float]:
    """Return the coefficients A and B (rad) of refraction, for weather in hPa and deg C."""
    a, b = erfa.refco(pressure, temperature, humidity, wavelength_um)
    return float(a), float(b)


@any_year()
def velocity_of_earth(time: Time | None) -> np.ndarray:
    """Return the barycentric velocity of the Earth in units of the speed of light, shape (3,); zeros without a time."""
    if time is None:
        return np.zeros(3)
    return erfa.epv00(time.tdb.jd1, time.tdb.jd2)[1]["v"] * AU_PER_DAY


def _rotations(angles: np.ndarray) -> np.ndarray:
    """Return matrices (k, 3, 3) that rotate the frame about the pole by angles (rad)."""
    cosine, sine, zero = np.cos(angles), np.sin(angles), np.zeros(len(angles))
    rows = [[cosine, sine, zero], [-sine, cosine, zero], [zero, zero, zero + 1]]
    return np.ascontiguousarray(np.moveaxis(np.array(rows), 2, 0))


def _polar(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the matrices (k, 3, 3) of the motion of the pole for its coordinates x and y (rad)."""
    sx, cx, sy, cy = np.sin(x), np.cos(x), np.sin(y), np.cos(y)
    return np.moveaxis(np.array([[cx, 0 * x, sx], [sx * sy, cy, -cx * sy], [-sx * cy, sy, cx * cy]]), 2, 0)


@cache
def _tables():
    """Return the tables of the Earth's rotation that are installed with astropy."""
    return iers.IERS_A.read(iers.IERS_A_FILE)


def _earth_rotation(utc: Time) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return UT1 - UTC (s) and the position of the pole (rad); no file is downloaded."""
    table = _tables()
    x, y = table.pm_xy(utc)
    return table.ut1_utc(utc).to_value(u.s), x.to_value(u.rad), y.to_value(u.rad)


def earth_rotation_time(utc: Time) -> float:
    """Return UT1 - UTC (s) at a time; 0, an error below 0.9 s, if the installed tables do not cover the time."""
    difference, status = _tables().ut1_utc(utc, return_status=True)
    return float(difference.to_value(u.s)) if status >= 0 else 0.0


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
