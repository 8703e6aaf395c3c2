"""The projection of one field for arrays without units: unit vectors to points in mm, and points to unit vectors."""

from dataclasses import replace

import numpy as np

from rfpsurvey._kernels import sky
from rfpsurvey.errors import InputError, check_choice
from rfpsurvey.projection._distortion_map import DistortionMap
from rfpsurvey.projection._radial_map import RadialMap


class FieldProjection:
    """The projection of a field onto the focal plane, for arrays without units.

    Parameters
    ----------
    basis : ndarray, shape (3, 3)
        ICRS unit vectors as rows: the directions of +x and +y at the field center, and the direction of the center.
    focal_length : float
        Plate scale at the field center, in mm per radian; used only if ``distortion`` is None.
    distortion : RadialMap, DistortionMap, dict of str to one of them, or None
        Radial map or distortion map, or a dict with one map for each fiber type.

    Attributes
    ----------
    basis, focal_length, distortion
        The values of the parameters with these names.

    Examples
    --------
    >>> import numpy as np
    >>> import rfpsurvey as rs
    >>> lamost = rs.Instrument.preset("lamost")
    >>> field = lamost.field_projection(ra=0.0, dec=0.0, angle=0.0)
    >>> target = np.array([[np.cos(0.01), np.sin(0.01), 0.0]])
    >>> field.project(target).round(3)
    array([[200.007,   0.   ]])
    >>> np.allclose(field.unproject(field.project(target)), target)
    True
    """

    def __init__(
        self, basis: np.ndarray, focal_length: float, distortion: RadialMap | dict[str, RadialMap] | None = None
    ):
        self.basis, self.focal_length, self.distortion = basis, focal_length, distortion

    def project(self, vectors: np.ndarray, fiber_type: str | np.ndarray | None = None) -> np.ndarray:
        """Project unit vectors (n, 3) to points (n, 2) on the focal plane in mm; NaN for vectors without an image."""
        return self._apply(sky.project, sky.project_radial, vectors, fiber_type, 2)

    def unproject(self, points: np.ndarray, fiber_type: str | np.ndarray | None = None) -> np.ndarray:
        """Convert points (n, 2) on the focal plane in mm to unit vectors (n, 3); NaN outside the range of the map."""
        return self._apply(sky.unproject, sky.unproject_radial, points, fiber_type, 3)

    def beyond(self, factor: float) -> "FieldProjection":
        """Return the projection with radial maps that are continued to a largest field angle times a factor."""
        return FieldProjection(self.basis, self.focal_length, continued(self.distortion, factor))

    def _apply(self, gnomonic, radial, values, fiber_type, width):
        """Project or unproject values with the map of their fiber type or, without a map, with the kernel ``gnomonic``.

        The kernel ``radial`` is used for radial maps.
        """
        out = np.empty((len(values), width))
        for rows, distortion in self._map_of(fiber_type, len(values)):
            part = values[rows]
            image = np.empty((len(part), width))
            if distortion is None:
                gnomonic(part, self.basis, self.focal_length, image)
            elif isinstance(distortion, DistortionMap) and width == 2:
                gnomonic(part, self.basis, 1.0, image)
                image = distortion.project(image)
            elif isinstance(distortion, DistortionMap):
                gnomonic(distortion.unproject(part), self.basis, 1.0, image)
            else:
                radial(part, self.basis, *distortion.arguments, image)
            if isinstance(rows, slice):
                return image
            out[rows] = image
        return out

    def _map_of(self, fiber_type, n):
        """Return the rows that use each map, as pairs (rows, map or None)."""
        if not isinstance(self.distortion, dict):
            return [(slice(None), self.distortion)]
        names = list(self.distortion)
        if fiber_type is None or isinstance(fiber_type, str):
            name = check_choice(fiber_type or names[0], names, "fiber type")
            return [(slice(None), self.distortion[name])]
        types = np.asarray(fiber_type, dtype=str)
        if types.shape != (n,):
            raise InputError(f"fiber_type must have the shape ({n},), got {types.shape}")
        types = np.where(types == "", names[0], types)
        for name in np.unique(types):
            check_choice(str(name), names, "fiber type")
        return [(types == name, self.distortion[name]) for name in names]


def continued(distortion: object, factor: float) -> object:
    """Return maps of a field, in which radial maps are continued, if they then still increase from the center."""
    if isinstance(distortion, dict):
        return {name: continued(one, factor) for name, one in distortion.items()}
    if not isinstance(distortion, RadialMap):
        return distortion
    try:
        return replace(distortion, max_angle=factor * distortion.max_angle)
    except InputError:
        return distortion


def field_basis(ra: float, dec: float, angle: float) -> np.ndarray:
    """Return the directions of +x and +y at a field center, and the center, as ICRS unit vectors, shape (3, 3).

    The center is at ``ra`` and ``dec`` (rad); ``angle`` (rad) is the position angle of +y, from north toward east.
    """
    east = np.array([-np.sin(ra), np.cos(ra), 0.0])
    north = np.array([-np.sin(dec) * np.cos(ra), -np.sin(dec) * np.sin(ra), np.cos(dec)])
    out = np.array([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)])
    x = np.cos(angle) * east - np.sin(angle) * north
    y = np.sin(angle) * east + np.cos(angle) * north
    return np.array([x, y, out])
