"""The projection of one field for given observing conditions, with arrays without units, and its simpler models.

Directions of stars as an observer sees them are computed with ERFA.
"""

from collections.abc import Sequence
from copy import copy
from functools import cache

import astropy.units as u
import erfa
import numpy as np
from astropy.time import Time
from astropy.utils import iers

from rfpsurvey._common.units import to_lonlat
from rfpsurvey._sky.conditions import RATE, ObservingConditions
from rfpsurvey._sky.projection import FieldProjection, groups_of_types
from rfpsurvey._sky.radial_map import RadialMap
from rfpsurvey.errors import InputError, check_choice, listed


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


# STEP: half the distance (rad) between the points whose images define the orientation of the field.
# MOST_STEPS: largest number of iterations of the inverse projection.
# ROUNDING: largest change of a unit vector that can be a rounding error.
STEP, MOST_STEPS, ROUNDING = 1e-4, 60, 1e-14
# FEWEST, MOST: smallest and largest number of instants from which the mean over an exposure is computed.
# CONVERGED: largest error (rad) of a mean direction. RADIUS: smallest radius (rad) of the ring whose error is tested.
FEWEST, MOST, CONVERGED, RADIUS = 3, 65, 1e-9, 0.01
TURNS = np.arange(8) * np.pi / 4


class ObservedField:
    """Projection of a field onto the focal plane for given observing conditions; arrays have no units.

    The telescope follows the field center at the guide wavelength: the image of the center is at (0, 0) mm. The rotator
    removes the rotation of the field, so that the mean rotation of directions close to the field center, relative to
    ``basis``, is 0. Refraction also compresses the field, mainly in the vertical direction. Therefore, the direction of
    north can differ from its nominal position angle, although the mean rotation is 0.

    Parameters
    ----------
    basis : ndarray, shape (3, 3)
        ICRS unit vectors as rows: the directions of +x and +y at the field center without refraction, and the center.
    focal_length : float
        Plate scale at the center, mm per radian, for a projection without a radial map.
    distortion : RadialMap, dict of str to RadialMap, or None
        Radial map, or a dict with one radial map for each fiber type.
    conditions : ObservingConditions
        The observing conditions.
    radius : float, optional
        Radius of the field (rad); the whole field must be above the horizon.

    Attributes
    ----------
    basis, focal_length, distortion, conditions
        The values of the parameters with these names.
    frames : ndarray, shape (k, 3, 3)
        Directions of +x, +y and the field center in the frame (east, north, zenith), at instants from the start to the
        end of the exposure.
    seconds : ndarray, shape (k,)
        Time of each instant since the midpoint of the exposure.
    weights : ndarray, shape (k,)
        Weight of each instant in the mean over the exposure.

    Raises
    ------
    InputError
        If the field is not above the horizon.

    Examples
    --------
    >>> import astropy.units as u
    >>> import numpy as np
    >>> import rfpsurvey as rs
    >>> lamost = rs.Instrument.preset("lamost")
    >>> conditions = rs.ObservingConditions("xinglong", hour_angle=3 * u.hourangle)
    >>> field = lamost.field_projection(ra=0.0, dec=0.5, angle=0.0, conditions=conditions)
    >>> targets = np.array([[np.cos(0.51), 0, np.sin(0.51)]])
    >>> field.project(targets).round(3)
    array([[ -0.013, 199.949]])
    >>> np.allclose(field.unproject(field.project(targets)), targets)
    True
    """

    def __init__(
        self,
        basis: np.ndarray,
        focal_length: float,
        distortion: RadialMap | dict[str, RadialMap] | None,
        conditions: ObservingConditions,
        radius: float = 0.0,
    ):
        self.basis, self.focal_length, self.distortion, self.conditions = basis, focal_length, distortion, conditions
        self._optics = FieldProjection(np.eye(3), focal_length, distortion)
        self._ra = float(np.arctan2(basis[2, 1], basis[2, 0]))
        half, n = conditions.exposure_time.to_value(u.s) / 2, FEWEST
        if half == 0:
            self._sample(np.zeros(1), np.ones(1), radius)
        while half > 0:
            moments, few, more = _moments(n)
            self._sample(half * moments, few, radius)
            if n >= MOST or self._error(more, max(radius, RADIUS)) <= CONVERGED:
                break
            n = 2 * n - 1

    def frames_at(self, seconds: np.ndarray) -> np.ndarray:
        """Return the frames, as in the attribute ``frames``, at times (s) since the midpoint of the exposure."""
        return self._frames(Instants(self.conditions, self._ra, seconds), 0.0)

    def drift(self, vectors: np.ndarray, fiber_type: str | np.ndarray | None = None) -> np.ndarray:
        """Return the largest distance (mm) between each target and its mean position during the exposure."""
        mean, largest = self.project(vectors, fiber_type), np.zeros(len(vectors))
        for frame_weights in np.eye(len(self.frames)) if len(self.frames) > 1 else ():
            image = self._optics.project(self._observe(vectors, fiber_type, frame_weights), fiber_type)
            largest = np.fmax(largest, np.hypot(*(image - mean).T))
        return largest

    def project(self, vectors: np.ndarray, fiber_type: str | np.ndarray | None = None) -> np.ndarray:
        """Project unit vectors (n, 3) to points (n, 2) on the focal plane in mm; NaN where there is no image."""
        return self._optics.project(self._observe(vectors, fiber_type), fiber_type)

    def unproject(self, points: np.ndarray, fiber_type: str | np.ndarray | None = None) -> np.ndarray:
        """Convert points (n, 2) on the focal plane in mm to unit vectors (n, 3); NaN outside the radial map."""
        seen = self._optics.unproject(points, fiber_type)
        vectors = seen @ self.basis
        last = np.inf
        for _ in range(MOST_STEPS):
            change = (seen - self._observe(vectors, fiber_type)) @ self.basis
            vectors = vectors + change
            vectors /= np.linalg.norm(vectors, axis=1)[:, None]
            largest = np.nanmax(np.abs(change), initial=0.0)
            if largest <= ROUNDING and largest > last / 2:  # rounding errors prevent further improvement
                break
            last = largest
        return vectors

    def beyond(self, factor: float) -> "ObservedField":
        """Return the projection with radial maps that are continued to a largest field angle times a factor."""
        field = copy(self)
        field._optics = self._optics.beyond(factor)
        field.distortion = field._optics.distortion
        return field

    def wavelength_groups(self, fiber_type: str | np.ndarray | None, n: int) -> list[tuple[object, float]]:
        """Return which targets are observed at which wavelength, as pairs (rows, wavelength in micrometers)."""
        waves = self.conditions.wavelengths_um
        if not isinstance(waves, dict):
            return [(slice(None), waves)]
        first = next(iter(self.distortion)) if isinstance(self.distortion, dict) else next(iter(waves))
        return [(rows, _wavelength_of(name, waves)) for rows, name in groups_of_types(fiber_type, first, n)]

    def _observe(self, vectors, fiber_type, weights=None):
        """Return observed directions, averaged over the exposure, in the frame of the field, shape (n, 3)."""
        out = np.empty((len(vectors), 3))
        weights = self.weights if weights is None else weights
        for rows, wavelength in self.wavelength_groups(fiber_type, len(vectors)):
            part = 0.0
            for k in np.flatnonzero(weights):
                seen = self._instants[k : k + 1].observe(vectors[rows], wavelength)[0]
                part = part + weights[k] * (seen @ self.frames[k].T)
            out[rows] = part / np.linalg.norm(part, axis=1)[:, None] if np.count_nonzero(weights) > 1 else part
        return out

    def _sample(self, seconds, weights, radius) -> None:
        """Set the instants of the exposure."""
        self.seconds, self.weights = seconds, weights
        self._instants = Instants(self.conditions, self._ra, seconds)
        self.frames = self._frames(self._instants, radius)

    def _error(self, weights: np.ndarray, radius: float) -> float:
        """Return the largest change (rad) of the mean directions at the edge if the weights of the instants change."""
        x, y, center = self.basis
        ring = np.cos(TURNS)[:, None] * x + np.sin(TURNS)[:, None] * y
        points = np.vstack([center, np.cos(radius) * center + np.sin(radius) * ring])
        waves = self.conditions.wavelengths_um
        waves = list(waves.values()) if isinstance(waves, dict) else [waves]
        errors = []
        for wave in {min(waves), max(waves), self._guide_um}:
            seen = self._instants.observe(points, wave) @ self.frames.transpose(0, 2, 1)
            errors.append(np.tensordot(weights - self.weights, seen, 1))
        return np.nanmax(np.abs(errors))

    @property
    def _guide_um(self) -> float:
        return self.conditions.guide_wavelength.to_value(u.um)

    def _frames(self, instants: Instants, radius: float) -> np.ndarray:
        """Return the observed directions of +x, +y and the field center; raise an error if the field is too low."""
        x, y, center = self.basis
        around = np.array([center, center + STEP * x, center - STEP * x, center + STEP * y, center - STEP * y])
        around /= np.linalg.norm(around, axis=1)[:, None]
        center, x_more, x_less, y_more, y_less = np.moveaxis(instants.observe(around, self._guide_um), 1, 0)
        lowest = np.arcsin(center[:, 2]) - radius
        if not (lowest > 0).all():  # a direction below the horizon is NaN
            raise self._below_horizon(instants, radius)
        x = x_more - x_less + np.cross(y_more - y_less, center)  # the direction for which the mean rotation is 0
        x -= (x * center).sum(axis=1)[:, None] * center
        x /= np.linalg.norm(x, axis=1)[:, None]
        return np.stack([x, np.cross(center, x), center], axis=1)

    def _below_horizon(self, instants: Instants, radius: float) -> InputError:
        """Return the error for a field that is not above the horizon."""
        conditions = self.conditions
        altitude = np.rad2deg(instants.altitudes(self.basis[2]).min())
        if conditions.time is None:
            when = f"hour angle {conditions.hour_angle.to_value('hourangle'):.4g} h"
        else:
            when = f"{conditions.time.utc.iso} UTC"
        extent = f" with its radius of {np.rad2deg(radius):.4g} deg" if radius else ""
        during = " during the exposure" if len(self.seconds) > 1 else ""
        return InputError(
            f"the whole field{extent} must be above the horizon, got the altitude {altitude:.4g} deg of its center at "
            f"{when}{during}; choose another time or hour angle, or another field"
        )


def _wavelength_of(fiber_type: str, wavelengths: dict[str, float]) -> float:
    if fiber_type not in wavelengths:
        raise InputError(
            f"wavelength must have a value for the fiber type {fiber_type!r}, got values for {listed(wavelengths)}"
        )
    return wavelengths[fiber_type]


@cache
def _moments(n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return instants of an exposure from -1 to 1, and their weights in two rules of Gauss-Legendre quadrature.

    The rules have n and 2 n - 1 points. The first and the last instant are the start and the end of the exposure.
    """
    rules = [np.polynomial.legendre.leggauss(size) for size in (n, 2 * n - 1)]
    moments = np.unique(np.concatenate([[-1.0, 1.0], *(points for points, _ in rules)]))
    weights = np.zeros((2, len(moments)))
    for row, (points, values) in zip(weights, rules, strict=True):
        row[np.searchsorted(moments, points)] = values / 2
    return moments, *weights


MODELS = {
    "tangent": "tangent plane with one plate scale",
    "radial": "radial map of the instrument",
    "refraction": "refraction at the midpoint of the exposure, at the guide wavelength",
    "dispersion": "refraction at the midpoint of the exposure, at the wavelength of each fiber type",
    "full": "refraction averaged over the exposure, at the wavelength of each fiber type",
}
STATIC = ("tangent", "radial")


def model_of(model: str | None, conditions: ObservingConditions | None) -> str:
    """Return the name of a model; the default is ``full`` if there are conditions, and ``radial`` otherwise."""
    if model is None:
        return "radial" if conditions is None else "full"
    check_choice(model, MODELS, "projection")
    if conditions is None and model not in STATIC:
        raise InputError(f"the projection {model!r} must have conditions, got none; give the argument conditions")
    return model


def field_of_model(
    model: str, basis: np.ndarray, focal_length: float, distortion: object, conditions=None, radius: float = 0.0
) -> FieldProjection | ObservedField:
    """Return the projection of a field by a model; the parameters after ``model`` are those of `ObservedField`."""
    if model in STATIC:
        return FieldProjection(basis, focal_length, None if model == "tangent" else distortion)
    if model != "full":
        conditions = conditions.without_exposure
    if model == "refraction":
        conditions = conditions.at_guide_wavelength
    return ObservedField(basis, focal_length, distortion, conditions, radius)


def displacements(
    points: np.ndarray, fiber_types: Sequence[str | None], *field: object
) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Compare the images of targets in each model with their images in the model ``full``.

    Parameters
    ----------
    points : ndarray, shape (m, n, 2)
        Positions of the images in the model ``full``, in mm, for each fiber type.
    fiber_types : sequence of str or None
        The m fiber types of the targets.
    *field : object
        All arguments of `field_of_model` except the name of the model.

    Returns
    -------
    dict of str to ndarray, shape (m, n)
        For each model, the distances (mm) from the images in the model ``full``.
    ndarray, shape (m, n)
        The largest distance (mm) between the image and its mean position during the exposure.
    """
    fields = {name: field_of_model(name, *field) for name in MODELS}
    full = fields.pop("full")
    targets = [(full.unproject(xy, kind), xy, kind) for xy, kind in zip(points, fiber_types, strict=True)]
    moved = {
        name: np.array([np.hypot(*(field.project(vectors, kind) - xy).T) for vectors, xy, kind in targets])
        for name, field in fields.items()
    }
    moved["full"] = np.zeros(points.shape[:2])
    return moved, np.array([full.drift(vectors, kind) for vectors, _, kind in targets])
