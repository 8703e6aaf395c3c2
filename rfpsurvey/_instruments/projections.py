"""Projections of an instrument between the sky and its focal plane, and the light that it observes."""

from functools import cached_property

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord

from rfpsurvey._common.units import to_scalar
from rfpsurvey._instruments.entries import select_entries, value_of
from rfpsurvey._sky.conditions import ObservingConditions
from rfpsurvey._sky.models import FieldOptics, ModelChoice, choose_model, field_of_model
from rfpsurvey._sky.observed_field import ObservedField
from rfpsurvey._sky.observed_plane import ObservedPlane
from rfpsurvey._sky.projection import FieldProjection, TangentPlane, field_basis
from rfpsurvey._sky.wavelengths import Light

LIGHT = "light."
# Default tolerance, as a fraction of the fiber diameter.
FRACTION = 0.1


def light_of(values: dict) -> Light:
    """Return the light that the entries of a description state."""
    return Light(**{name: value_of(entry) for name, entry in select_entries(values, LIGHT).items()})


class Projections:
    """The members that `Instrument` inherits: its light, its optics, and its projections."""

    def __getstate__(self) -> dict:
        return {name: value for name, value in vars(self).items() if name not in ("light", "optics")}

    @cached_property
    def light(self) -> Light:
        """The wavelengths in the description of the instrument, on which only plans with conditions depend."""
        return light_of(self.values)

    @cached_property
    def optics(self) -> FieldOptics:
        """The optics for arrays without units, with the default tolerance of positions."""
        diameter = self.values.get("optics.fiber_diameter")
        return FieldOptics(
            self.plate_scale.to_value(u.mm / u.rad),
            self.distortion,
            float(self.field_radius.to_value(u.rad)),
            self.light,
            None if diameter is None else float(FRACTION * value_of(diameter).to_value(u.mm)),
            tuple(map(str, self.focal_plane.fiber_types)),
        )

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
            The projection; with conditions, an `~rfpsurvey.observing.ObservedPlane` with the model ``full``.

        Raises
        ------
        InputError
            If the center is not one direction, if the position angle is not one angle, or if the field is not above the
            horizon.
        """
        to_scalar(position_angle, u.deg, "position_angle", low=-3600, high=3600)
        if conditions is None:
            return TangentPlane(center, self.plate_scale, position_angle, self.distortion)
        optics = self.plate_scale, position_angle, self.distortion
        return ObservedPlane(center, *optics, conditions, self.field_radius, self.light)

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
            The projection by the model of the conditions.

        Raises
        ------
        InputError
            If the field is not above the horizon, or if the wavelength of a fiber type is not known.
        """
        basis = field_basis(ra, dec, angle)
        if conditions is None:
            return FieldProjection(basis, self.optics.focal_length, self.distortion)
        return field_of_model(choose_model(self.optics, basis, conditions).model, basis, self.optics, conditions)

    def model_choice(self, place: np.ndarray, conditions: ObservingConditions) -> ModelChoice:
        """Return the model of the projection of a field, at right ascension, declination and position angle (rad)."""
        return choose_model(self.optics, field_basis(*place), conditions)
