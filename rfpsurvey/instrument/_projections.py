"""Methods of `Instrument` that return the projection of a field."""

from functools import cached_property

import astropy.units as u
from astropy.coordinates import SkyCoord

from rfpsurvey._units import to_scalar
from rfpsurvey.observing import ObservedField, ObservedPlane, ObservingConditions
from rfpsurvey.projection import FieldProjection, TangentPlane, field_basis


class Projections:
    """Methods that `Instrument` inherits, which return projections between sky and focal plane."""

    def projection(
        self,
        center: SkyCoord,
        position_angle: u.Quantity = 0 * u.deg,
        conditions: ObservingConditions | None = None,
    ) -> TangentPlane:
        """Return the projection of a field onto the focal plane.

        Parameters
        ----------
        center : SkyCoord
            Field center.
        position_angle : Quantity, optional
            Position angle of the +y axis of the focal plane, from north toward east.
        conditions : ObservingConditions, optional
            Observing conditions. If None, refraction and dispersion are neglected.

        Returns
        -------
        TangentPlane
            The projection; with conditions, an `~rfpsurvey.observing.ObservedPlane`.

        Raises
        ------
        InputError
            If the center is not one direction, if the position angle is not one angle, or if the field is not above the
            horizon.
        """
        to_scalar(position_angle, u.deg, "position_angle", low=-3600, high=3600)
        if conditions is None:
            return TangentPlane(center, self.plate_scale, position_angle, self.distortion)
        radius = self.field_radius
        return ObservedPlane(center, self.plate_scale, position_angle, self.distortion, conditions, radius)

    def field_projection(
        self, ra: float, dec: float, angle: float, conditions: ObservingConditions | None = None
    ) -> FieldProjection | ObservedField:
        """Return the projection of a field for arrays without units.

        Parameters
        ----------
        ra, dec : float
            Right ascension and declination (ICRS) of the field center, in radians.
        angle : float
            Position angle of the +y axis of the focal plane, from ICRS north toward east, in radians.
        conditions : ObservingConditions, optional
            Observing conditions. If None, refraction and dispersion are neglected.

        Returns
        -------
        FieldProjection or ObservedField
            The projection; it equals ``projection(...).plain`` and is computed faster.

        Raises
        ------
        InputError
            If the field is not above the horizon.
        """
        basis = field_basis(ra, dec, angle)
        if conditions is None:
            return FieldProjection(basis, self._focal_length, self.distortion)
        return ObservedField(basis, self._focal_length, self.distortion, conditions, self.field_radius.to_value(u.rad))

    @cached_property
    def _focal_length(self) -> float:
        """Focal length in mm."""
        return self.plate_scale.to_value(u.mm / u.rad)
