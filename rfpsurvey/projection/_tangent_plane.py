"""Projection of the sky onto the focal plane and back, by a gnomonic projection or by a map of the distortion."""

from dataclasses import dataclass, field
from functools import cached_property

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord

from rfpsurvey._units import ByValue, to_center, to_direction, to_lonlat, to_points_mm, to_scalar, to_vectors
from rfpsurvey.errors import InputError, check_keywords, refusal
from rfpsurvey.projection._distortion_map import DistortionMap
from rfpsurvey.projection._field import FieldProjection, field_basis
from rfpsurvey.projection._radial_map import RadialMap

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
