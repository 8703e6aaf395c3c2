"""Compute observed directions of stars, and bounds of what simpler models of the projection neglect.

The quantities that are common to all stars are computed with ERFA. For each star, the steps are those of ERFA's
functions ``ldsun``, ``ab`` and ``atioq``, without the conversions between angles and vectors.
"""

import math

import numpy as np

from rfpsurvey._kernels.jit import kernel

# Schwarzschild radius of the Sun in astronomical units (IAU 2015 nominal solar mass parameter, 2 GM / c2).
SUN = 1.97412574336e-8
# Smallest sine of the altitude, and of the zenith distance, for which refraction is computed (values of ERFA).
LOWEST, NEAREST = 0.05, 1e-6
N_TURNS = 24


@kernel
def observe(vectors, sun, motion, before, diurnal, after, refraction, turn, weights, out):
    """Compute the mean of the observed directions of stars over instants, in the frame of the field.

    Parameters
    ----------
    vectors : ndarray, shape (n, 3)
        Directions of the stars (unit vectors).
    sun : ndarray, shape (k, 4)
        At each instant, the direction from the Sun to the observer, and its distance (au); the deflection of light is
        not computed if the distance is 0.
    motion : ndarray, shape (k, 4)
        Velocity of the observer in units of the speed of light, and its reciprocal Lorentz factor.
    before, after : ndarray, shapes (k, 3, 3) and (3, 3)
        Rotation of stars to hour angle (toward west) and declination, and from there to the directions east, north and
        zenith. Between them, diurnal aberration is added.
    diurnal : ndarray, shape (k,)
        Diurnal aberration.
    refraction : ndarray, shape (2,)
        Coefficients A and B of refraction (rad).
    turn : ndarray, shape (k, 3, 3)
        Matrices that are applied to the observed directions.
    weights : ndarray, shape (k,)
        Weight of each instant.
    out : ndarray, shape (n, 3)
        The mean directions (unit vectors); NaN for stars that are below the horizon at an instant.
    """
    a, b = refraction
    p = np.empty(3)
    for i in range(vectors.shape[0]):
        total_x = total_y = total_z = 0.0
        for k in range(weights.size):
            if weights[k] == 0.0:
                continue
            for m in range(3):
                p[m] = vectors[i, m]
            if sun[k, 3] > 0.0:
                _deflect(p, sun[k])
            if motion[k, 3] < 1.0:
                _aberrate(p, motion[k])
            x = before[k, 0, 0] * p[0] + before[k, 0, 1] * p[1] + before[k, 0, 2] * p[2]
            y = before[k, 1, 0] * p[0] + before[k, 1, 1] * p[1] + before[k, 1, 2] * p[2]
            z = before[k, 2, 0] * p[0] + before[k, 2, 1] * p[1] + before[k, 2, 2] * p[2]
            factor = 1.0 - diurnal[k] * y
            x, y, z = factor * x, factor * (y + diurnal[k]), factor * z
            east = after[0, 0] * x + after[0, 1] * y + after[0, 2] * z
            north = after[1, 0] * x + after[1, 1] * y + after[1, 2] * z
            up = after[2, 0] * x + after[2, 1] * y + after[2, 2] * z
            across, height = max(math.hypot(east, north), NEAREST), max(up, LOWEST)
            tangent = across / height
            w = b * tangent * tangent
            angle = (a + w) * tangent / (1.0 + (a + 3.0 * w) / (height * height))
            cosine = 1.0 - angle * angle / 2.0
            factor = cosine - angle * height / across
            east, north, up = factor * east, factor * north, cosine * up + angle * across
            scale = weights[k] / math.sqrt(east * east + north * north + up * up) if up > 0.0 else np.nan
            total_x += scale * (turn[k, 0, 0] * east + turn[k, 0, 1] * north + turn[k, 0, 2] * up)
            total_y += scale * (turn[k, 1, 0] * east + turn[k, 1, 1] * north + turn[k, 1, 2] * up)
            total_z += scale * (turn[k, 2, 0] * east + turn[k, 2, 1] * north + turn[k, 2, 2] * up)
        norm = math.sqrt(total_x * total_x + total_y * total_y + total_z * total_z)
        out[i, 0], out[i, 1], out[i, 2] = total_x / norm, total_y / norm, total_z / norm


@kernel
def _deflect(p, sun):
    """Add the deflection of light by the Sun to a direction."""
    cosine = p[0] * sun[0] + p[1] * sun[1] + p[2] * sun[2]
    limit = 1e-6 / max(sun[3] * sun[3], 1.0)
    w = SUN / sun[3] / max(1.0 + cosine, limit)
    x, y, z = p[0], p[1], p[2]
    p[0] = x + w * (sun[0] - cosine * x)
    p[1] = y + w * (sun[1] - cosine * y)
    p[2] = z + w * (sun[2] - cosine * z)


@kernel
def _aberrate(p, motion):
    """Add the aberration of light to a direction; the term of the Sun's potential (0.4 microarcsec) is omitted."""
    along = p[0] * motion[0] + p[1] * motion[1] + p[2] * motion[2]
    factor = 1.0 + along / (1.0 + motion[3])
    norm = 0.0
    for m in range(3):
        p[m] = motion[3] * p[m] + factor * motion[m]
        norm += p[m] * p[m]
    norm = math.sqrt(norm)
    for m in range(3):
        p[m] /= norm


@kernel
def displacements(zenith, weights, center, radius, guide, fibers, removes_scale, out):
    """Compute how far targets at the edge of a field are displaced by refraction, and by single parts of it.

    Refraction is A tan z, to first order in A. The gnomonic coordinates about the field center are those of the
    telescope, which follows the center at the guide wavelength.

    Parameters
    ----------
    zenith : ndarray, shape (k, 2)
        Gnomonic coordinates of the zenith about the field center, at instants of the exposure.
    weights : ndarray, shape (k,)
        Weight of each instant in the mean over the exposure.
    center : int
        Index of the midpoint of the exposure.
    radius : float
        Tangent of the radius of the field.
    guide : float
        Coefficient A (rad) at the guide wavelength.
    fibers : ndarray, shape (m,)
        Coefficients A (rad) at wavelengths of fibers.
    removes_scale : bool
        Whether the guider removes the mean scale at the field center.
    out : ndarray, shape (4,)
        Largest displacements (gnomonic coordinates) of the mean position relative to no refraction, to the midpoint at
        the guide wavelength, and to the midpoint at the wavelength of the fiber, and those of the position at single
        instants relative to the mean.
    """
    out[:] = 0.0
    at = np.empty((zenith.shape[0], 2))
    for turn in range(N_TURNS):
        angle = 2.0 * math.pi * turn / N_TURNS
        dx, dy = radius * math.cos(angle), radius * math.sin(angle)
        for m in range(fibers.size):
            mean_x = mean_y = guided_x = guided_y = 0.0
            for k in range(zenith.shape[0]):
                wx, wy = zenith[k, 0], zenith[k, 1]
                along = wx * dx + wy * dy
                scale = (1.0 + radius * radius) / (1.0 + along)
                x, y = scale * (wx - dx), scale * (wy - dy)
                removed = along - (1.0 + (wx * wx + wy * wy) / 2.0 if removes_scale else 0.0)
                center_x, center_y = guide * (wx + removed * dx), guide * (wy + removed * dy)
                at[k, 0], at[k, 1] = fibers[m] * x - center_x, fibers[m] * y - center_y
                mean_x += weights[k] * at[k, 0]
                mean_y += weights[k] * at[k, 1]
                if k == center:
                    guided_x, guided_y = guide * x - center_x, guide * y - center_y
            out[0] = max(out[0], math.hypot(mean_x, mean_y))
            out[1] = max(out[1], math.hypot(mean_x - guided_x, mean_y - guided_y))
            out[2] = max(out[2], math.hypot(mean_x - at[center, 0], mean_y - at[center, 1]))
            for k in range(zenith.shape[0]):
                out[3] = max(out[3], math.hypot(at[k, 0] - mean_x, at[k, 1] - mean_y))
