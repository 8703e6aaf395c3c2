"""Projection of the sky onto the focal plane and back, by a gnomonic projection or by a map of the distortion."""

from dataclasses import dataclass, field, replace
from functools import cached_property

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord

from rfpsurvey._common.units import (
    ByValue,
    to_axes,
    to_center,
    to_direction,
    to_lonlat,
    to_points_mm,
    to_scalar,
    to_vectors,
)
from rfpsurvey._kernels import sky
from rfpsurvey._sky.distortion_map import DistortionMap
from rfpsurvey._sky.radial_map import RadialMap
from rfpsurvey.errors import InputError, check_choice, check_keywords, refusal


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
        groups = groups_of_types(fiber_type, next(iter(self.distortion)), n)
        return [(rows, self.distortion[check_choice(name, self.distortion, "fiber type")]) for rows, name in groups]


def groups_of_types(fiber_type: str | np.ndarray | None, first: str, n: int) -> list[tuple[object, str]]:
    """Return which of n targets have which fiber type, as pairs (rows, type); ``first`` replaces None and ``""``."""
    if fiber_type is None or isinstance(fiber_type, str):
        return [(slice(None), fiber_type or first)]
    types = np.asarray(fiber_type, dtype=str)
    if types.shape != (n,):
        raise InputError(f"fiber_type must have the shape ({n},), got {types.shape}")
    types = np.where(types == "", first, types)
    return [(types == name, str(name)) for name in np.unique(types)]


def continued(distortion: object, factor: float) -> object:
    """Return maps of a field, in which radial maps are continued, if they then still increase from the center."""
    if isinstance(distortion, dict):
        return {name: continued(optics, factor) for name, optics in distortion.items()}
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
    out, east, north = to_axes(ra, dec)
    x = np.cos(angle) * east - np.sin(angle) * north
    y = np.sin(angle) * east + np.cos(angle) * north
    return np.array([x, y, out])


_SCALE = u.mm / u.rad


@check_keywords
@dataclass(frozen=True, eq=False)
class TangentPlane(ByValue):
    """Projection of the sky around a field center onto the focal plane.

    Without rotation, +x points east and +y points north; a rotation moves +y from north toward east. Without
    distortion, the projection is gnomonic. Directions that are 90 deg or more from the center, or outside the range of
    the distortion, have no image; their positions are NaN. Refraction and chromatic effects are not modeled.

    Parameters
    ----------
    center : SkyCoord
        Field center in any frame. The frame also defines north: for a center in ``FK5(equinox="J2026")``, position
        angles are measured from north at that equinox.
    plate_scale : Quantity, optional
        Length on the focal plane per angle on the sky, at the field center. The plate scale can be omitted if
        ``distortion`` is given, because the distortion determines the plate scale.
    rotation : Quantity, optional
        Position angle of the +y axis of the focal plane, from north toward east.
    distortion : RadialMap, DistortionMap, or dict of str to one of them, optional
        Radial map or distortion map, or a dict with one map for each fiber type.

    Raises
    ------
    InputError
        If neither plate scale nor distortion is given, or if both are given and do not agree.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astropy.coordinates import SkyCoord
    >>> import rfpsurvey as rs
    >>> plane = rs.projection.TangentPlane(SkyCoord("6h20m +23d"), 20 * u.m / u.rad)
    >>> plane.to_focal_plane(SkyCoord("6h20m +23d30m")).round(6)
    <Quantity [[  0.      , 174.537356]] mm>
    """

    center: SkyCoord
    plate_scale: u.Quantity | None = None
    rotation: u.Quantity = field(default=0 * u.deg)
    distortion: RadialMap | dict[str, RadialMap] | None = None

    def __post_init__(self):
        object.__setattr__(self, "center", to_center(self.center))
        maps = self.distortion.values() if isinstance(self.distortion, dict) else [self.distortion]
        if self.distortion is not None and not (maps and all(isinstance(m, RadialMap | DistortionMap) for m in maps)):
            raise refusal(
                "distortion must be a RadialMap, a DistortionMap, or a dict from fiber types to such maps",
                self.distortion,
                dict,
            )
        scale = self.plate_scale
        if scale is None:
            if self.distortion is None:
                raise InputError("a TangentPlane requires plate_scale or distortion")
            scale = next(iter(maps)).plate_scale
        number = to_scalar(scale, _SCALE, "plate_scale", low=0)
        if self.distortion is not None and not any(
            np.isclose(number, m.plate_scale.to_value(_SCALE), rtol=1e-9) for m in maps
        ):
            raise InputError(
                f"plate_scale must be the plate scale of the distortion ({next(iter(maps)).plate_scale}), "
                f"or be omitted, got {scale}"
            )
        object.__setattr__(self, "plate_scale", scale)
        to_scalar(self.rotation, u.deg, "rotation", low=-3600, high=3600)

    @classmethod
    def from_focal_length(
        cls, center: SkyCoord, focal_length: u.Quantity, rotation: u.Quantity = 0 * u.deg
    ) -> "TangentPlane":
        """Make an undistorted projection from a focal length.

        Parameters
        ----------
        center : SkyCoord
            Field center.
        focal_length : Quantity
            Focal length of the telescope.
        rotation : Quantity, optional
            Position angle of the +y axis of the focal plane, from north toward east.

        Returns
        -------
        TangentPlane
            The projection, with the plate scale focal_length / rad.

        Raises
        ------
        InputError
            If the center is not one direction, if the focal length is not one positive length, or if the rotation is
            not one angle.
        """
        return cls(center, to_scalar(focal_length, u.mm, "focal_length", low=0) * _SCALE, rotation)

    @cached_property
    def plain(self) -> FieldProjection:
        """The projection for arrays without units (``FieldProjection``)."""
        center = to_direction(self.center, "center").icrs
        ra, dec = center.ra.rad, center.dec.rad
        angle = to_scalar(self.rotation, u.rad, "rotation")
        if self.center.frame.name != "icrs":
            east, north, _ = field_basis(ra, dec, 0.0)
            up = to_direction(self.center).directional_offset_by(0 * u.deg, 1 * u.deg).icrs.cartesian.xyz.value
            angle += np.arctan2(up @ east, up @ north)
        focal_length = to_scalar(self.plate_scale, _SCALE, "plate_scale")
        return FieldProjection(field_basis(ra, dec, angle), focal_length, self.distortion)

    def to_focal_plane(self, coord: SkyCoord, fiber_type: str | np.ndarray | None = None) -> u.Quantity:
        """Return the focal-plane positions of directions on the sky.

        Parameters
        ----------
        coord : SkyCoord or Catalog
            Directions, shape (n,) or scalar. A `~rfpsurvey.Catalog` stores its unit vectors, so that it can be
            projected rapidly for many fields.
        fiber_type : str or array_like of str, optional
            Fiber type of each direction, if fiber types have different maps; ``""`` and None denote the first fiber
            type in ``distortion``.

        Returns
        -------
        Quantity, shape (n, 2)
            Positions x and y in mm; NaN for directions without an image.

        Raises
        ------
        InputError
            If ``coord`` is not a direction on the sky, or if a fiber type has no map.
        """
        vectors = getattr(getattr(coord, "arrays", None), "vectors", None)  # only catalogs have this attribute
        vectors = to_vectors(coord) if vectors is None else vectors
        return u.Quantity(self.plain.project(vectors, fiber_type), u.mm, copy=False)

    def to_sky(self, xy: u.Quantity, fiber_type: str | np.ndarray | None = None) -> SkyCoord:
        """Return the sky directions of points on the focal plane.

        Parameters
        ----------
        xy : Quantity, shape (n, 2)
            Points on the focal plane.
        fiber_type : str or array_like of str, optional
            Fiber type of each point, if fiber types have different maps; ``""`` and None denote the first fiber type in
            ``distortion``.

        Returns
        -------
        SkyCoord, shape (n,)
            ICRS directions; NaN for points outside the range of the distortion.

        Raises
        ------
        InputError
            If ``xy`` is not a Quantity of lengths with the shape (n, 2), or if a fiber type has no map.
        """
        lon, lat = to_lonlat(self.plain.unproject(to_points_mm(xy, "xy"), fiber_type))
        return SkyCoord(lon * u.rad, lat * u.rad, frame="icrs")
