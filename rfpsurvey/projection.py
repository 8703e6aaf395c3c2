"""Sky to focal plane and back: a tangent plane, with an optional radial map."""

from dataclasses import dataclass, field
from functools import cached_property

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord

from rfpsurvey._kernels import sky
from rfpsurvey._units import to_direction, to_lonlat, to_mm, to_points_mm, to_radian, to_scalar, to_vectors
from rfpsurvey.errors import InputError, check_choice

__all__ = ["RadialMap", "TangentPlane"]

_FORMS = {"theta": sky.THETA, "tan_theta": sky.TAN_THETA, "sine": sky.SINE}
_SCALE = u.mm / u.rad


@dataclass(frozen=True)
class RadialMap:
    """Distance from the field center on the focal plane as a function of the field angle.

    With the odd polynomial p(t) = c0 t + c1 t^3 + c2 t^5 + ..., the three forms are

    * ``theta``: r = factor p(theta / unit_angle) mm,
    * ``tan_theta``: r = factor p(tan(theta) / unit_tangent) mm,
    * ``sine``: r = factor R sin(p(theta / unit_angle) unit_angle), R the radius of a spherical focal surface.

    Parameters
    ----------
    form : {"theta", "tan_theta", "sine"}
        The form.
    coefficients : sequence of float
        c0, c1, c2, ...
    max_angle : Quantity
        Largest field angle for which the map holds, below 90 deg; beyond it nothing has an image.
    unit_angle : Quantity, optional
        Angle that counts as 1 in the polynomial.
    unit_tangent : float, optional
        Tangent that counts as 1 in the polynomial.
    radius : Quantity, optional
        R of the form ``sine``.
    factor : float, optional
        Scale factor applied to every radius.

    Raises
    ------
    InputError
        If the map does not rise from 0 to ``max_angle``.

    Examples
    --------
    >>> import astropy.units as u
    >>> import rfpsurvey as rs
    >>> radial = rs.RadialMap("theta", [243.0, 4.05], max_angle=1.6 * u.deg)
    >>> radial.to_radius(1 * u.deg)
    <Quantity 247.05 mm>
    >>> radial.to_angle(247.05 * u.mm)
    <Quantity 1. deg>
    """

    form: str
    coefficients: tuple[float, ...]
    max_angle: u.Quantity
    unit_angle: u.Quantity = field(default=1 * u.deg)
    unit_tangent: float = 1.0
    radius: u.Quantity | None = None
    factor: float = 1.0

    def __post_init__(self):
        check_choice(self.form, _FORMS, "form of radial map")
        try:
            object.__setattr__(self, "coefficients", tuple(float(c) for c in self.coefficients))
        except (TypeError, ValueError):
            raise InputError(f"coefficients must be a sequence of numbers, got {self.coefficients!r}") from None
        c = np.array(self.coefficients)
        if c.size == 0 or not np.isfinite(c).all():
            raise InputError(f"coefficients must be finite numbers, at least one, got {self.coefficients}")
        limit = to_scalar(self.max_angle, u.rad, "max_angle", low=0, high=np.pi / 2)
        to_scalar(self.unit_angle, u.rad, "unit_angle", low=0)
        for name in ("unit_tangent", "factor"):
            try:
                number = u.Quantity(getattr(self, name))
            except (TypeError, ValueError):
                raise InputError(f"{name} must be a number, got {getattr(self, name)!r}") from None
            to_scalar(number, u.dimensionless_unscaled, name, low=0)
        if (self.form == "sine") != (self.radius is not None):
            raise InputError(f"the form 'sine' and no other needs a radius, got {self.radius} with {self.form!r}")
        if self.radius is not None:
            to_scalar(self.radius, u.mm, "radius", low=0)
        _, _, argument, inner, _, _ = self._arguments
        edge = argument * (np.tan(limit) if self.form == "tan_theta" else limit)
        # dp/dt has its zeros where a polynomial in t^2 has: none may lie inside
        roots = np.roots((c * (2 * np.arange(c.size) + 1))[::-1])
        real = roots[(np.abs(roots.imag) < 1e-12 * np.abs(roots)) & (roots.real > 0)].real
        quarter = self.form == "sine" and inner * np.polyval(c[::-1], edge**2) * edge >= np.pi / 2
        if c[0] <= 0 or (real <= edge**2).any() or quarter:
            raise InputError(f"the radial map must rise from the center to max_angle = {self.max_angle}")

    @cached_property
    def _arguments(self):
        """What the kernels take: form, coefficients, argument, inner, output, limit."""
        unit = float(to_radian(self.unit_angle, "unit_angle"))
        argument = 1 / self.unit_tangent if self.form == "tan_theta" else 1 / unit
        output = float(self.factor)
        if self.form == "sine":
            output *= float(to_mm(self.radius, "radius"))
        # a direction made to lie just at max_angle is inside, whatever its rounding
        limit = float(to_radian(self.max_angle, "max_angle")) * (1 + 1e-12)
        return _FORMS[self.form], np.array(self.coefficients), argument, unit, output, limit

    @property
    def plate_scale(self) -> u.Quantity:
        """Plate scale at the field center."""
        form, c, argument, inner, output, _ = self._arguments
        return sky.radius_and_slope(0.0, form, c, argument, inner, output)[1] * _SCALE.to(u.mm / u.deg) * (u.mm / u.deg)

    def to_radius(self, angle: u.Quantity) -> u.Quantity:
        """Return the distance from the field center of field angles.

        Parameters
        ----------
        angle : Quantity
            Field angles.

        Returns
        -------
        Quantity
            In mm; NaN beyond ``max_angle``.

        Raises
        ------
        InputError
            If what is given is not an angle.
        """
        theta = to_radian(angle, "angle")
        out = np.empty(theta.size)
        sky.radii(theta.ravel(), *self._arguments, out)
        return out.reshape(theta.shape) * u.mm

    def to_angle(self, radius: u.Quantity) -> u.Quantity:
        """Return the field angle of distances from the field center.

        Parameters
        ----------
        radius : Quantity
            Distances on the focal plane.

        Returns
        -------
        Quantity
            In deg; NaN beyond the map.

        Raises
        ------
        InputError
            If what is given is not a length.
        """
        r = to_mm(radius, "radius")
        out = np.empty(r.size)
        sky.angles(r.ravel(), *self._arguments, out)
        return np.rad2deg(out.reshape(r.shape)) * u.deg


@dataclass(frozen=True, eq=False)
class TangentPlane:
    """Projection of the sky around a field center onto the focal plane.

    +x points east and +y north; the rotation turns +y from north toward east. Without distortion the
    projection is gnomonic. What has no image (90 deg or more from the center, or outside the distortion map)
    becomes NaN. Refraction and color are not part of the model.

    Parameters
    ----------
    center : SkyCoord
        Field center, in any frame; north is that of its frame, so that a center in
        ``FK5(equinox="J2026")`` has its position angle measured from the north of that date.
    plate_scale : Quantity, optional
        Length per angle at the field center. May be left out where ``distortion`` is given, which has one.
    rotation : Quantity, optional
        Position angle of +y, from north toward east.
    distortion : RadialMap or dict of str to RadialMap, optional
        Radial map, or one for each fiber type.

    Raises
    ------
    InputError
        If neither plate scale nor distortion is given, or if they do not agree.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astropy.coordinates import SkyCoord
    >>> import rfpsurvey as rs
    >>> plane = rs.TangentPlane(SkyCoord("6h20m +23d"), 20 * u.m / u.rad)
    >>> plane.to_focal_plane(SkyCoord("6h20m +23d30m")).round(6)
    <Quantity [[  0.      , 174.537356]] mm>
    """

    center: SkyCoord
    plate_scale: u.Quantity | None = None
    rotation: u.Quantity = field(default=0 * u.deg)
    distortion: RadialMap | dict[str, RadialMap] | None = None

    def __post_init__(self):
        if not isinstance(self.center, SkyCoord) or not self.center.isscalar:
            raise InputError(f"center must be one SkyCoord, got {self.center!r}")
        maps = self.distortion.values() if isinstance(self.distortion, dict) else [self.distortion]
        if self.distortion is not None and not (maps and all(isinstance(m, RadialMap) for m in maps)):
            raise InputError(f"distortion must be a RadialMap or a dict of them by fiber type, got {self.distortion!r}")
        scale = self.plate_scale
        if scale is None:
            if self.distortion is None:
                raise InputError("a TangentPlane needs plate_scale or distortion")
            scale = next(iter(maps)).plate_scale
        number = to_scalar(scale, _SCALE, "plate_scale", low=0)
        if self.distortion is not None and not any(
            np.isclose(number, m.plate_scale.to_value(_SCALE), rtol=1e-9) for m in maps
        ):
            raise InputError(
                f"plate_scale {scale} is not that of the distortion ({next(iter(maps)).plate_scale}); give one of them"
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
            Position angle of +y.

        Returns
        -------
        TangentPlane
            With the plate scale focal_length / rad.

        Raises
        ------
        InputError
            If the center is not one direction, the focal length not one positive length, or the rotation not one angle.
        """
        return cls(center, to_mm(focal_length, "focal_length") * _SCALE, rotation)

    @cached_property
    def _basis(self) -> np.ndarray:
        """Rows: directions of +x and +y across the center, and the center; ICRS unit vectors."""
        center = to_direction(self.center, "center").icrs
        ra, dec = center.ra.rad, center.dec.rad
        east = np.array([-np.sin(ra), np.cos(ra), 0.0])
        north = np.array([-np.sin(dec) * np.cos(ra), -np.sin(dec) * np.sin(ra), np.cos(dec)])
        out = np.array([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)])
        turn = to_scalar(self.rotation, u.rad, "rotation")
        if self.center.frame.name != "icrs":
            up = to_direction(self.center).directional_offset_by(0 * u.deg, 1 * u.deg).icrs.cartesian.xyz.value
            turn += np.arctan2(up @ east, up @ north)
        x = np.cos(turn) * east - np.sin(turn) * north
        y = np.sin(turn) * east + np.cos(turn) * north
        return np.array([x, y, out])

    def to_focal_plane(self, coord: SkyCoord, fiber_type: str | np.ndarray | None = None) -> u.Quantity:
        """Return where directions fall on the focal plane.

        Parameters
        ----------
        coord : SkyCoord or Catalog
            Directions, shape (n,) or scalar. A `Catalog` keeps its unit vectors, so that many fields of one
            catalog cost little.
        fiber_type : str or array_like of str, optional
            Fiber type of each direction, where each type has a map of its own; ``""`` (and None) is the first.

        Returns
        -------
        Quantity, shape (n, 2)
            Columns x and y in mm; NaN where there is no image.

        Raises
        ------
        InputError
            If what is given are not directions on the sky, or types of fibers that have maps are others.
        """
        vectors = getattr(coord, "_vectors", None)
        if vectors is None:
            vectors = to_vectors(coord)
        return u.Quantity(self._project(vectors, fiber_type), u.mm, copy=False)

    def _project(self, vectors: np.ndarray, fiber_type=None) -> np.ndarray:
        """Project unit vectors (n, 3) to mm (n, 2)."""
        out = np.empty((len(vectors), 2))
        for rows, radial in self._map_of(fiber_type, len(vectors)):
            part = vectors if rows is None else vectors[rows]
            image = out if rows is None else np.empty((len(part), 2))
            if radial is None:
                sky.project(part, self._basis, self._focal_length, image)
            else:
                sky.project_radial(part, self._basis, *radial._arguments, image)
            if rows is not None:
                out[rows] = image
        return out

    def to_sky(self, xy: u.Quantity, fiber_type: str | np.ndarray | None = None) -> SkyCoord:
        """Return the directions that fall on points of the focal plane.

        Parameters
        ----------
        xy : Quantity, shape (n, 2)
            Points on the focal plane.
        fiber_type : str or array_like of str, optional
            Fiber type of each point, where each type has a map of its own.

        Returns
        -------
        SkyCoord, shape (n,)
            ICRS directions; NaN outside the distortion map.

        Raises
        ------
        InputError
            If the points are not lengths of this shape, or types of fibers that have maps are others.
        """
        lon, lat = to_lonlat(self._unproject(to_points_mm(xy, "xy"), fiber_type))
        return SkyCoord(lon * u.rad, lat * u.rad, frame="icrs")

    def _unproject(self, points: np.ndarray, fiber_type=None) -> np.ndarray:
        """Return the unit vectors (n, 3) of points in mm (n, 2)."""
        vectors = np.empty((len(points), 3))
        for rows, radial in self._map_of(fiber_type, len(points)):
            part = points if rows is None else points[rows]
            image = vectors if rows is None else np.empty((len(part), 3))
            if radial is None:
                sky.unproject(part, self._basis, self._focal_length, image)
            else:
                sky.unproject_radial(part, self._basis, *radial._arguments, image)
            if rows is not None:
                vectors[rows] = image
        return vectors

    @property
    def _focal_length(self) -> float:
        return to_scalar(self.plate_scale, _SCALE, "plate_scale")

    def _map_of(self, fiber_type, n):
        """Return (rows or None for all, map or None) for each map in use."""
        if not isinstance(self.distortion, dict):
            return [(None, self.distortion)]
        names = list(self.distortion)
        if fiber_type is None or isinstance(fiber_type, str):
            name = check_choice(fiber_type or names[0], names, "fiber type")
            return [(None, self.distortion[name])]
        types = np.asarray(fiber_type, dtype=str)
        if types.shape != (n,):
            raise InputError(f"fiber_type must have the shape ({n},), got {types.shape}")
        types = np.where(types == "", names[0], types)
        for name in np.unique(types):
            check_choice(str(name), names, "fiber type")
        return [(types == name, self.distortion[name]) for name in names]
