"""The sky of one night at a site: hour angles and altitudes of tiles, and places of the Sun and the Moon."""

from functools import cached_property

import erfa
import numpy as np
from astropy.coordinates import EarthLocation
from astropy.time import Time

from rfpsurvey._sky.instants import earth_rotation_time, velocity_of_earth
from rfpsurvey._sky.time import any_year

TURN = 2 * np.pi
RATE = TURN * 1.00273781191135448
"""Angle by which the Earth rotates in a day of UT1, radians."""
STEP = 1 / 48
"""Step (days) of the places of the Sun and the Moon, between which cubic polynomials interpolate."""
AU_M = 149597870700.0


def noon_of(site: EarthLocation, day: int) -> float:
    """Return the modified Julian date (UTC) of the local mean noon of a day."""
    return day + 0.5 - ((site.lon.rad + np.pi) % TURN - np.pi) / TURN


class NightSky:
    """The sky at a site in the 24 hours after the local mean noon of a date.

    Precession, nutation, the aberration of light and UT1 are those at local midnight: in 12 hours, aberration changes
    by less than 0.2 arcsec. The Sun and the Moon are seen from the site.

    Parameters
    ----------
    site : EarthLocation
        The site.
    day : float
        Modified Julian date of the date, at 0 h.
    vectors : ndarray, shape (n, 3)
        ICRS unit vectors of tiles.
    """

    @any_year()
    def __init__(self, site: EarthLocation, day: int, vectors: np.ndarray):
        lon = site.lon.rad
        self.noon, self.lat = noon_of(site, day), site.lat.rad
        x, y, z = (part.to_value("m") / AU_M for part in site.geocentric)
        self._place = (
            np.hypot(x, y),
            np.arctan2(y, x) - lon,
            z,
        )  # of the site: from the axis, of the meridian, and north
        middle = Time(self.noon + 0.5, format="mjd", scale="utc")
        tt = middle.tt
        self._to_tt, self._ut1 = tt.mjd - middle.mjd, earth_rotation_time(middle) / 86400
        self.matrix = erfa.c2i06a(tt.jd1, tt.jd2)  # from GCRS to the celestial intermediate frame (CIRS)
        self.velocity = velocity_of_earth(middle)
        self._angle = erfa.era00(2400000.5, self.noon + self._ut1) + lon  # of the meridian at noon
        self._vectors = vectors

    @cached_property
    def places(self) -> np.ndarray:
        """Apparent unit vectors of the tiles in the celestial intermediate frame, shape (n, 3)."""
        factor = np.sqrt(1 - self.velocity @ self.velocity)
        along = self._vectors @ self.velocity
        seen = factor * self._vectors + np.outer(1 + along / (1 + factor), 1) * self.velocity
        seen = seen @ self.matrix.T
        return seen / np.linalg.norm(seen, axis=1)[:, None]

    @cached_property
    def ra_dec(self) -> tuple[np.ndarray, np.ndarray]:
        """Apparent right ascensions from the celestial intermediate origin, and declinations, of the tiles."""
        x, y, z = self.places.T
        return np.arctan2(y, x), np.arcsin(np.clip(z, -1, 1))

    def meridian(self, time: np.ndarray) -> np.ndarray:
        """Return the right ascension of the meridian at times (days since noon)."""
        return self._angle + RATE * time

    def hour_angle(self, tile: np.ndarray, time: np.ndarray) -> np.ndarray:
        """Return the hour angles of tiles from -pi up to pi."""
        return (self.meridian(time) - self.ra_dec[0][tile] + np.pi) % TURN - np.pi

    def altitude(self, tile: np.ndarray, time: np.ndarray) -> np.ndarray:
        """Return the altitudes of tiles."""
        return self.horizontal(tile, time)[0]

    def horizontal(self, tile: np.ndarray, time: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the altitudes, azimuths (from north toward east) and hour angles of tiles."""
        angle, dec = self.hour_angle(tile, time), self.ra_dec[1][tile]
        x, y, z = np.cos(dec) * np.cos(angle), np.cos(dec) * np.sin(angle), np.sin(dec)
        up, north = np.cos(self.lat) * x + np.sin(self.lat) * z, np.cos(self.lat) * z - np.sin(self.lat) * x
        return np.arctan2(up, np.hypot(north, y)), np.arctan2(-y, north) % TURN, angle

    @cached_property
    @any_year()
    def _bodies(self) -> np.ndarray:
        """Vectors from the center of the Earth to the Sun and to the Moon (au, CIRS), every `STEP`, shape (k, 6)."""
        time = self.noon + self._to_tt + np.arange(-1, round(1 / STEP) + 3) * STEP
        sun = -erfa.epv00(2400000.5, time)[0]["p"]
        distance = np.linalg.norm(sun, axis=1)[:, None]
        sun = sun / distance + self.velocity  # aberration; the Moon moves with the Earth
        sun *= distance / np.linalg.norm(sun, axis=1)[:, None]
        moon = erfa.moon98(2400000.5, time)["p"]
        return np.hstack([sun @ self.matrix.T, moon @ self.matrix.T])

    def _body(self, columns: slice, time: np.ndarray) -> np.ndarray:
        """Return the vector from the site to the Sun or the Moon (au)."""
        place = np.asarray(time) / STEP + 1
        first = np.clip(place.astype(int), 1, len(self._bodies) - 3)
        t = (place - first)[..., None]
        a, b, c, d = (self._bodies[first + k, columns] for k in (-1, 0, 1, 2))
        body = -t * (t - 1) * (t - 2) / 6 * a + (t + 1) * (t - 1) * (t - 2) / 2 * b
        body += -(t + 1) * t * (t - 2) / 2 * c + (t + 1) * t * (t - 1) / 6 * d
        across, turned, z = self._place[0], self.meridian(time) + self._place[1], self._place[2]
        return body - np.stack([across * np.cos(turned), across * np.sin(turned), z + 0 * turned], axis=-1)

    def sun(self, time: np.ndarray) -> np.ndarray:
        """Return vectors from the site to the Sun."""
        return self._body(slice(0, 3), time)

    def moon(self, time: np.ndarray) -> np.ndarray:
        """Return vectors from the site to the Moon."""
        return self._body(slice(3, 6), time)

    def altitude_of(self, body: np.ndarray, time: np.ndarray) -> np.ndarray:
        """Return the altitudes of vectors from the site, such as those of the Moon."""
        angle = self.meridian(time)
        up = np.cos(self.lat) * (np.cos(angle) * body[..., 0] + np.sin(angle) * body[..., 1])
        return np.arcsin((up + np.sin(self.lat) * body[..., 2]) / np.linalg.norm(body, axis=-1))

    def illumination(self, time: np.ndarray) -> np.ndarray:
        """Return the illuminated fraction of the Moon."""
        sun, moon = self.sun(time), self.moon(time)
        back = moon - sun
        return (1 + (moon * back).sum(axis=-1) / np.linalg.norm(moon, axis=-1) / np.linalg.norm(back, axis=-1)) / 2

    def separation(self, tile: np.ndarray, time: np.ndarray) -> np.ndarray:
        """Return the distances of tiles from the Moon."""
        moon, place = self.moon(time), self.places[tile]
        return np.arctan2(np.linalg.norm(np.cross(moon, place), axis=-1), (moon * place).sum(axis=-1))
