"""The projection of one field for given observing conditions; its methods use arrays without units."""

import numpy as np

from rfpsurvey.errors import InputError, check_choice
from rfpsurvey.observing._astrometry import Instant, instants_of
from rfpsurvey.observing._conditions import ObservingConditions
from rfpsurvey.projection import FieldProjection, RadialMap

__all__ = ["ObservedField"]

# STEP: half the distance (rad) between the points whose images define the orientation of the field.
# MOST_STEPS: largest number of iterations of the inverse projection.
# ROUNDING: largest change of a unit vector that can be a rounding error.
STEP, MOST_STEPS, ROUNDING = 1e-4, 60, 1e-14


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
    frames : list of ndarray, shape (3, 3)
        Directions of +x, +y and the field center at each instant of the exposure, in the frame (east, north, zenith).

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
        ra = float(np.arctan2(basis[2, 1], basis[2, 0]))
        self._instants = instants_of(conditions, ra)
        self.frames = [self._frame(instant, radius) for _, instant in self._instants]

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

    def wavelength_groups(self, fiber_type: str | np.ndarray | None, n: int) -> list[tuple[object, float]]:
        """Return which targets are observed at which wavelength, as pairs (rows, wavelength in micrometers)."""
        waves = self.conditions.wavelengths_um
        if not isinstance(waves, dict):
            return [(slice(None), waves)]
        first = next(iter(self.distortion)) if isinstance(self.distortion, dict) else next(iter(waves))
        if fiber_type is None or isinstance(fiber_type, str):
            name = check_choice(fiber_type or first, waves, "fiber type of the wavelengths")
            return [(slice(None), waves[name])]
        types = np.asarray(fiber_type, dtype=str)
        if types.shape != (n,):
            raise InputError(f"fiber_type must have the shape ({n},), got {types.shape}")
        types = np.where(types == "", first, types)
        return [
            (types == name, waves[check_choice(str(name), waves, "fiber type of the wavelengths")])
            for name in np.unique(types)
        ]

    def _observe(self, vectors, fiber_type):
        """Return observed directions, averaged over the exposure, in the frame of the field, shape (n, 3)."""
        out = np.empty((len(vectors), 3))
        for rows, wavelength in self.wavelength_groups(fiber_type, len(vectors)):
            part = 0.0
            for (weight, instant), frame in zip(self._instants, self.frames, strict=True):
                part = part + weight * (instant.observe(vectors[rows], wavelength) @ frame.T)
            out[rows] = part / np.linalg.norm(part, axis=1)[:, None] if len(self.frames) > 1 else part
        return out

    def _frame(self, instant: Instant, radius: float) -> np.ndarray:
        """Return the observed directions of +x, +y and the field center; raise an error if the field is too low."""
        x, y, center = self.basis
        around = np.array([center, center + STEP * x, center - STEP * x, center + STEP * y, center - STEP * y])
        around /= np.linalg.norm(around, axis=1)[:, None]
        seen = instant.observe(around, self.conditions.guide_wavelength.to_value("um"))
        center = seen[0]
        lowest = np.arcsin(center[2]) - radius
        if not (np.isfinite(seen).all() and lowest > 0):
            raise self._below_horizon(instant, radius)
        along_x, along_y = seen[1] - seen[2], seen[3] - seen[4]
        x = along_x + np.cross(along_y, center)  # the direction for which the mean rotation is 0
        x -= (x @ center) * center
        x /= np.linalg.norm(x)
        return np.array([x, np.cross(center, x), center])

    def _below_horizon(self, instant: Instant, radius: float) -> InputError:
        """Return the error for a field that is not above the horizon."""
        conditions = self.conditions
        altitude = np.rad2deg(instant.altitude(self.basis[2]))
        if conditions.time is None:
            when = f"hour angle {conditions.hour_angle.to_value('hourangle'):.4g} h"
        else:
            when = f"{conditions.time.utc.iso} UTC"
        extent = f" with its radius of {np.rad2deg(radius):.4g} deg" if radius else ""
        during = " during the exposure" if len(self._instants) > 1 else ""
        return InputError(
            f"the whole field{extent} must be above the horizon, got the altitude {altitude:.4g} deg of its center at "
            f"{when}{during}; choose another time or hour angle, or another field"
        )
