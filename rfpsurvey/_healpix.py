"""Functions for HEALPix pixels (in the nested order) and unit vectors; astropy-healpix is imported on first use."""

from collections.abc import Callable
from numbers import Number

import numpy as np

from rfpsurvey.errors import refusal

MOST_NSIDE = 2**20


def check_nside(nside: object) -> int:
    """Return the resolution ``nside`` as an integer; raise an error unless it is a power of two."""
    good = isinstance(nside, int | np.integer) and not isinstance(nside, bool) and 1 <= nside <= MOST_NSIDE
    if not good or int(nside) & (int(nside) - 1):
        raise refusal(f"nside must be a power of two from 1 to {MOST_NSIDE}", nside, Number)
    return int(nside)


def centers(nside: int, pixels: np.ndarray) -> np.ndarray:
    """Return the unit vectors of the centers of pixels, shape (n, 3)."""
    from astropy_healpix import healpy

    xyz = healpy.pix2vec(nside, np.asarray(pixels, dtype=np.int64), nest=True)
    return np.ascontiguousarray(np.column_stack([np.atleast_1d(c) for c in xyz]), dtype=np.float64).reshape(-1, 3)


def pixels_of(nside: int, vectors: np.ndarray) -> np.ndarray:
    """Return the number of the pixel that contains each unit vector."""
    from astropy_healpix import healpy

    if len(vectors) == 0:
        return np.empty(0, dtype=np.int64)
    return np.atleast_1d(healpy.vec2pix(nside, *vectors.T, nest=True)).astype(np.int64)


def pixels_near(nside: int, distance: Callable, margin: float) -> np.ndarray:
    """Return the pixels whose centers are at most ``margin`` away from an object on the sky.

    The search begins with the twelve pixels of ``nside = 1``. If a pixel is too far away, the search also excludes all
    smaller pixels inside this pixel.

    Parameters
    ----------
    nside : int
        Resolution of the pixels.
    distance : callable
        Function that returns the distances (radians) of unit vectors from the object.
    margin : float
        Largest distance of a pixel center from the object, in radians.

    Returns
    -------
    ndarray of int
        Numbers of the pixels, in increasing order.
    """
    pixels, level = np.arange(12), 1
    while True:
        allowance = margin if level == nside else margin + pixel_radius(level)
        pixels = pixels[distance(centers(level, pixels)) <= allowance + 1e-12]
        if level == nside:
            return pixels
        pixels, level = (4 * pixels[:, None] + np.arange(4)).ravel(), 2 * level


def to_nested(nside: int, pixels: np.ndarray) -> np.ndarray:
    """Convert pixel numbers in the ring order to the nested order."""
    from astropy_healpix import healpy

    return np.atleast_1d(healpy.ring2nest(nside, pixels)).astype(np.int64)


def pixel_radius(nside: int) -> float:
    """Return an upper limit of the distance (radians) from the center of a pixel to its corners."""
    # According to measurements, nside times the largest distance increases with nside from 0.84 toward 1.07.
    return 1.07 / nside


def nside_for(radius_rad: float) -> int:
    """Return the lowest ``nside`` for which the radius of a pixel is about ``radius_rad`` (radians) or smaller."""
    return int(min(2 ** max(np.ceil(np.log2(1.0 / radius_rad)), 0), MOST_NSIDE))
