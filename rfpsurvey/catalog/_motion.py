"""Compute the motion of stars along straight lines, without parallax and radial velocity."""

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord

from rfpsurvey._units import to_lonlat


def moving(coord: SkyCoord) -> np.ndarray:
    """Return whether each target has a known proper motion that differs from 0."""
    motion = coord.data.differentials.get("s")
    if motion is None:
        return np.zeros(len(coord), dtype=bool)
    motion = np.array([part.value for part in (motion.d_lon_coslat, motion.d_lat)])
    return np.isfinite(motion).all(axis=0) & (motion != 0).any(axis=0)


def move_coordinates(coord: SkyCoord, years: np.ndarray) -> SkyCoord:
    """Return ICRS coordinates after the given numbers of years; targets without both proper motions do not move."""
    icrs = coord.icrs
    lon, lat = icrs.ra.rad, icrs.dec.rad
    motion = np.column_stack([pm.to_value(u.rad / u.yr) for pm in (icrs.pm_ra_cosdec, icrs.pm_dec)])
    known = np.isfinite(motion).all(axis=1)
    moved = move(lon[known], lat[known], motion[known], years[known])
    lon, lat, motion = lon.copy(), lat.copy(), np.where(known[:, None], motion, np.nan)
    lon[known], lat[known], motion[known] = moved
    pm_ra, pm_dec = (motion.T * u.rad / u.yr).to(u.mas / u.yr)
    return SkyCoord(lon * u.rad, lat * u.rad, pm_ra_cosdec=pm_ra, pm_dec=pm_dec)


def move(lon: np.ndarray, lat: np.ndarray, motion: np.ndarray, years: np.ndarray) -> tuple:
    """Return the positions and proper motions of stars after the given numbers of years.

    The motion is computed with unit vectors, so the poles need no special treatment. A star that does not move
    keeps its position.

    Parameters
    ----------
    lon, lat : ndarray, shape (n,)
        Longitudes and latitudes, in radians.
    motion : ndarray, shape (n, 2)
        Proper motions in longitude (with the cosine of the latitude) and in latitude, in radians per year.
    years : ndarray, shape (n,)
        Time during which each star moves, in years.

    Returns
    -------
    lon, lat : ndarray, shape (n,)
        New longitudes (from 0 to 2 pi) and latitudes, in radians.
    motion : ndarray, shape (n, 2)
        New proper motions, in radians per year.
    """
    place, east, north = _axes(lon, lat)
    velocity = motion[:, :1] * east + motion[:, 1:] * north
    new = place + years[:, None] * velocity
    distance = np.linalg.norm(new, axis=1)[:, None]
    new_lon, new_lat = to_lonlat(new)
    still = (motion == 0).all(axis=1) | (years == 0)
    new_lon, new_lat = np.where(still, lon, new_lon % (2 * np.pi)), np.where(still, lat, new_lat)
    _, east, north = _axes(new_lon, new_lat)
    velocity = velocity / distance
    across = np.column_stack([(velocity * east).sum(axis=1), (velocity * north).sum(axis=1)])
    return new_lon, new_lat, np.where(still[:, None], motion, across)


def move_vectors(vectors: np.ndarray, motion: np.ndarray, years: float) -> np.ndarray:
    """Return unit vectors after a number of years; ``motion`` is the same as in `move`, and NaN is no motion."""
    _, east, north = _axes(*to_lonlat(vectors))
    motion = np.where(np.isfinite(motion).all(axis=1)[:, None], motion, 0.0)
    new = vectors + years * (motion[:, :1] * east + motion[:, 1:] * north)
    return new / np.linalg.norm(new, axis=1)[:, None]


def _axes(lon, lat):
    """Return unit vectors of positions, and of the directions east and north at these positions, shape (n, 3) each."""
    zero = np.zeros_like(lon)
    place = np.column_stack([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])
    east = np.column_stack([-np.sin(lon), np.cos(lon), zero])
    north = np.column_stack([-np.sin(lat) * np.cos(lon), -np.sin(lat) * np.sin(lon), np.cos(lat)])
    return place, east, north
