"""The projection of one field for given observing conditions, with arrays without units, and its simpler models."""

from copy import copy
from dataclasses import replace
from functools import cache

import numpy as np

from rfpsurvey._sky.conditions import ObservingConditions
from rfpsurvey._sky.instants import Instants, midpoint
from rfpsurvey._sky.projection import FieldProjection, groups_of_types
from rfpsurvey._sky.radial_map import RadialMap
from rfpsurvey._sky.wavelengths import Light, observed_light
from rfpsurvey.errors import InputError

# STEP: half the distance (rad) between the points whose images define the orientation of the field.
# MOST_STEPS: largest number of iterations of the inverse projection.
# ROUNDING: largest change of a unit vector that can be a rounding error.
STEP, MOST_STEPS, ROUNDING = 1e-4, 60, 1e-14
# FEWEST, MOST: smallest and largest number of instants from which the mean over an exposure is computed.
# CONVERGED: largest error (rad) of a mean direction. RADIUS: smallest radius (rad) of the ring whose error is tested.
FEWEST, MOST, CONVERGED, RADIUS = 3, 65, 1e-9, 0.01
TURNS = np.arange(8) * np.pi / 4
NO_LIGHT = Light()


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
    light : Light, optional
        Wavelengths of the instrument, which the conditions can replace.
    model : {"full", "dispersion", "refraction"}, optional
        Model of the projection: the mean over the exposure, its midpoint, or its midpoint at the guide wavelength.

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
    >>> conditions = rs.ObservingConditions("xinglong", hour_angle=3 * u.hourangle, compensator="ideal")
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
        light: Light = NO_LIGHT,
        model: str = "full",
    ):
        self.basis, self.focal_length, self.distortion, self.conditions = basis, focal_length, distortion, conditions
        self.model, self._optics = model, FieldProjection(np.eye(3), focal_length, distortion)
        self.light = observed_light(light, conditions)
        if model == "refraction":
            self.light = replace(self.light, compensated=True)
        self._ra = float(np.arctan2(basis[2, 1], basis[2, 0]))
        half, n = conditions.numbers.half_exposure, FEWEST
        if half == 0 or model != "full":
            self._sample(np.zeros(1), np.ones(1), radius)
            return
        while True:
            moments, few, more = moments_of_exposure(n)
            self._sample(half * moments, few, radius)
            if n >= MOST or self._error(more, max(radius, RADIUS)) <= CONVERGED:
                return
            n = 2 * n - 1

    def frames_at(self, seconds: np.ndarray) -> np.ndarray:
        """Return the frames, as in the attribute ``frames``, at times (s) since the midpoint of the exposure."""
        return self._frames(Instants(self.conditions, self._ra, seconds), 0.0)[0]

    def drift(self, vectors: np.ndarray, fiber_type: str | np.ndarray | None = None) -> np.ndarray:
        """Return the largest distance (mm) between each target and its mean position during the exposure."""
        mean, largest = self.project(vectors, fiber_type), np.zeros(len(vectors))
        for frame_weights in np.eye(len(self.frames)) if len(self.frames) > 1 else ():
            image = self._image(self._observe(vectors, fiber_type, frame_weights), fiber_type)
            largest = np.fmax(largest, np.hypot(*(image - mean).T))
        return largest

    def project(self, vectors: np.ndarray, fiber_type: str | np.ndarray | None = None) -> np.ndarray:
        """Project unit vectors (n, 3) to points (n, 2) on the focal plane in mm; NaN where there is no image."""
        return self._image(self._observe(vectors, fiber_type), fiber_type)

    def unproject(self, points: np.ndarray, fiber_type: str | np.ndarray | None = None) -> np.ndarray:
        """Convert points (n, 2) on the focal plane in mm to unit vectors (n, 3); NaN outside the radial map."""
        seen = self._optics.unproject(points / self.conditions.scale, fiber_type)
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
        if self.light.compensated or not isinstance(self.light.fibers, dict):
            return [(slice(None), self.light.of(""))]
        first = next(iter(self.distortion if isinstance(self.distortion, dict) else self.light.fibers))
        return [(rows, self.light.of(name)) for rows, name in groups_of_types(fiber_type, first, n)]

    def _image(self, seen, fiber_type):
        """Return the points on the focal plane of directions in the frame of the field."""
        return self._optics.project(seen, fiber_type) * self.conditions.scale

    def _observe(self, vectors, fiber_type, weights=None):
        """Return observed directions, averaged over the exposure, in the frame of the field, shape (n, 3)."""
        weights, groups = self.weights if weights is None else weights, self.wavelength_groups(fiber_type, len(vectors))
        if groups and isinstance(groups[0][0], slice):
            return self._instants.observe(vectors, groups[0][1], weights, self._turns)
        out = np.empty((len(vectors), 3))
        for rows, wavelength in groups:
            out[rows] = self._instants.observe(vectors[rows], wavelength, weights, self._turns)
        return out

    def _sample(self, seconds, weights, radius) -> None:
        """Set the instants of the exposure."""
        self.seconds, self.weights = seconds, weights
        single = len(seconds) == 1
        self._instants = midpoint(self.conditions, self._ra) if single else Instants(self.conditions, self._ra, seconds)
        self.frames, scale = self._frames(self._instants, radius)
        self._turns = self.frames.copy()
        if self.light.removes_scale:
            self._turns[:, :2] /= scale[:, None, None]

    def _error(self, weights: np.ndarray, radius: float) -> float:
        """Return the largest change (rad) of the mean directions at the edge if the weights of the instants change."""
        x, y, center = self.basis
        ring = np.cos(TURNS)[:, None] * x + np.sin(TURNS)[:, None] * y
        points = np.vstack([center, np.cos(radius) * center + np.sin(radius) * ring])
        waves, errors = self.light.distinct, []
        for wave in {waves[0], waves[-1], self.light.guide}:
            seen = self._instants.each(points, wave) @ self._turns.transpose(0, 2, 1)
            errors.append(np.tensordot(weights - self.weights, seen, 1))
        return np.nanmax(np.abs(errors))

    def _frames(self, instants: Instants, radius: float) -> tuple[np.ndarray, np.ndarray]:
        """Return the observed directions of +x, +y and the field center, and the scale, for each instant.

        Raise an error if the field is too low.
        """
        x, y, center = self.basis
        around = np.array([center, center + STEP * x, center - STEP * x, center + STEP * y, center - STEP * y])
        around /= np.linalg.norm(around, axis=1)[:, None]
        center, x_more, x_less, y_more, y_less = np.moveaxis(instants.each(around, self.light.guide), 1, 0)
        lowest = np.arcsin(center[:, 2]) - radius
        if not (lowest > 0).all():  # a direction below the horizon is NaN
            raise self._below_horizon(instants, radius)
        x = x_more - x_less + np.cross(y_more - y_less, center)  # the direction for which the mean rotation is 0
        x -= (x * center).sum(axis=1)[:, None] * center
        x /= np.linalg.norm(x, axis=1)[:, None]
        y = np.cross(center, x)
        scale = (((x_more - x_less) * x).sum(axis=1) + ((y_more - y_less) * y).sum(axis=1)) / (4 * STEP)
        return np.stack([x, y, center], axis=1), scale

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


@cache
def moments_of_exposure(n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return instants of an exposure from -1 to 1, and their weights in two rules of Gauss-Legendre quadrature.

    The rules have n and 2 n - 1 points. The first and the last instant are the start and the end of the exposure.
    """
    rules = [np.polynomial.legendre.leggauss(size) for size in (n, 2 * n - 1)]
    moments = np.unique(np.concatenate([[-1.0, 1.0], *(points for points, _ in rules)]))
    weights = np.zeros((2, len(moments)))
    for row, (points, values) in zip(weights, rules, strict=True):
        row[np.searchsorted(moments, points)] = values / 2
    return moments, *weights
