"""Radial maps: the distance from the field center on the focal plane as a function of the field angle."""

from dataclasses import dataclass, field
from functools import cached_property
from numbers import Number

import astropy.units as u
import numpy as np

from rfpsurvey._common.units import to_mm, to_radian, to_scalar
from rfpsurvey._kernels import sky
from rfpsurvey.errors import INCONVERTIBLE, InputError, check_choice, check_keywords, refusal

_FORMS = {"theta": sky.THETA, "tan_theta": sky.TAN_THETA, "sine": sky.SINE}
# Ratio of two coefficients of the derivative below which the smaller one does not change its zeros.
NEGLIGIBLE = 1e-200
_SCALE = u.mm / u.rad


@check_keywords
@dataclass(frozen=True)
class RadialMap:
    """Distance from the field center on the focal plane as a function of the field angle.

    Let r be the distance, theta the field angle, and p(t) = c0 t + c1 t^3 + c2 t^5 + ... an odd polynomial. The three
    forms of the function are

    * ``theta``: r = factor p(theta / unit_angle) mm,
    * ``tan_theta``: r = factor p(tan(theta) / unit_tangent) mm,
    * ``sine``: r = factor R sin(p(theta / unit_angle) unit_angle), where R is the radius of a spherical focal surface.

    Parameters
    ----------
    form : {"theta", "tan_theta", "sine"}
        Form of the map.
    coefficients : sequence of float
        Coefficients c0, c1, c2, ... of the polynomial.
    max_angle : Quantity
        Largest field angle for which the map is valid, below 90 deg. Directions beyond this angle have no image.
    unit_angle : Quantity, optional
        Angle for which the argument of the polynomial is 1; used by the forms ``theta`` and ``sine``.
    unit_tangent : float, optional
        Tangent for which the argument of the polynomial is 1; used by the form ``tan_theta``.
    radius : Quantity, optional
        Radius R of the focal surface; required for the form ``sine`` and only for this form.
    factor : float, optional
        Scale factor that multiplies every distance r.

    Raises
    ------
    InputError
        If r does not increase with theta from 0 to ``max_angle``, or if a parameter is invalid.

    Examples
    --------
    >>> import astropy.units as u
    >>> import rfpsurvey as rs
    >>> radial = rs.projection.RadialMap("theta", [243.0, 4.05], max_angle=1.6 * u.deg)
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
            if isinstance(self.coefficients, str):
                raise TypeError
            object.__setattr__(self, "coefficients", tuple(float(c) for c in self.coefficients))
        except INCONVERTIBLE:
            raise refusal(
                "coefficients must be a sequence of numbers", self.coefficients, list, tuple, np.ndarray
            ) from None
        c = np.array(self.coefficients)
        if c.size == 0 or not np.isfinite(c).all():
            raise InputError(f"coefficients must be one or more finite numbers, got {self.coefficients}")
        limit = to_scalar(self.max_angle, u.rad, "max_angle", low=0, high=np.pi / 2)
        to_scalar(self.unit_angle, u.rad, "unit_angle", low=0)
        for name in ("unit_tangent", "factor"):
            try:
                number = u.Quantity(getattr(self, name))
            except INCONVERTIBLE:
                raise refusal(f"{name} must be a number", getattr(self, name), Number, list) from None
            to_scalar(number, u.dimensionless_unscaled, name, low=0)
        if (self.form == "sine") != (self.radius is not None):
            raise InputError(
                f"radius must be given for the form 'sine' and only for this form, got {self.radius} with {self.form!r}"
            )
        if self.radius is not None:
            to_scalar(self.radius, u.mm, "radius", low=0)
        _, _, argument, inner, _, _ = self.arguments
        edge = argument * (np.tan(limit) if self.form == "tan_theta" else limit)
        # The derivative dp/dt is a polynomial in t^2, which must have no zeros within the limit.
        slope = c * (2 * np.arange(c.size) + 1)
        slope[np.abs(slope) < NEGLIGIBLE * np.abs(slope).max()] = 0  # the ratios of coefficients must be finite
        roots = np.roots(slope[::-1])
        real = roots[(np.abs(roots.imag) < 1e-12 * np.abs(roots)) & (roots.real > 0)].real
        quarter = self.form == "sine" and inner * np.polyval(c[::-1], edge**2) * edge >= np.pi / 2
        if c[0] <= 0 or (real <= edge**2).any() or quarter:
            raise InputError(f"the radial map must increase from the center to max_angle = {self.max_angle}")

    @cached_property
    def arguments(self) -> tuple:
        """Arguments of the kernels, without units: form, coefficients, argument, inner, output, limit.

        Three of the arguments are factors: ``argument`` multiplies theta (or tan(theta)) to give the argument of p,
        ``inner`` multiplies p in the argument of the sine, and ``output`` multiplies the result.
        """
        unit = float(to_radian(self.unit_angle, "unit_angle"))
        argument = 1 / self.unit_tangent if self.form == "tan_theta" else 1 / unit
        output = float(self.factor)
        if self.form == "sine":
            output *= float(to_mm(self.radius, "radius"))
        # With this factor, a direction at max_angle is within the limit in spite of rounding.
        limit = float(to_radian(self.max_angle, "max_angle")) * (1 + 1e-12)
        return _FORMS[self.form], np.array(self.coefficients), argument, unit, output, limit

    @property
    def plate_scale(self) -> u.Quantity:
        """Plate scale at the field center."""
        form, c, argument, inner, output, _ = self.arguments
        return sky.radius_and_slope(0.0, form, c, argument, inner, output)[1] * _SCALE.to(u.mm / u.deg) * (u.mm / u.deg)

    def to_radius(self, angle: u.Quantity) -> u.Quantity:
        """Return the distance from the field center on the focal plane for each field angle.

        Parameters
        ----------
        angle : Quantity
            Field angles.

        Returns
        -------
        Quantity
            Distances in mm; NaN for angles larger than ``max_angle``.

        Raises
        ------
        InputError
            If ``angle`` is not an angle.
        """
        theta = to_radian(angle, "angle")
        out = np.empty(theta.size)
        sky.radii(theta.ravel(), *self.arguments, out)
        return out.reshape(theta.shape) * u.mm

    def to_angle(self, radius: u.Quantity) -> u.Quantity:
        """Return the field angle for each distance from the field center on the focal plane.

        Parameters
        ----------
        radius : Quantity
            Distances from the field center on the focal plane.

        Returns
        -------
        Quantity
            Field angles in deg; NaN for distances outside the range of the map.

        Raises
        ------
        InputError
            If ``radius`` is not a length.
        """
        r = to_mm(radius, "radius")
        out = np.empty(r.size)
        sky.angles(r.ravel(), *self.arguments, out)
        return np.rad2deg(out.reshape(r.shape)) * u.deg
