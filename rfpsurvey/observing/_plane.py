"""Projection between the sky and the focal plane for given observing conditions."""

from dataclasses import dataclass
from functools import cached_property

import astropy.units as u
import numpy as np
from astropy.coordinates import Angle, Latitude, Longitude

from rfpsurvey._units import to_scalar
from rfpsurvey.errors import check_keywords
from rfpsurvey.observing._conditions import ObservingConditions, check_conditions
from rfpsurvey.observing._field import ObservedField
from rfpsurvey.projection import TangentPlane

__all__ = ["ObservedPlane"]


@check_keywords
@dataclass(frozen=True, eq=False)
class ObservedPlane(TangentPlane):
    """Projection of the sky around a field center onto the focal plane, for given observing conditions.

    The projection includes refraction and the dependence of refraction on the wavelengths of fiber types. For
    conditions with a time, the projection also includes aberration and precession. The telescope follows the field
    center at the guide wavelength.

    Parameters
    ----------
    center : SkyCoord
        Field center, as in `~rfpsurvey.TangentPlane`.
    plate_scale, rotation, distortion : optional
        Optics and orientation, as in `~rfpsurvey.TangentPlane`.
    conditions : ObservingConditions
        The observing conditions.
    field_radius : Quantity, optional
        Radius of the field; the whole field must be above the horizon.

    Raises
    ------
    InputError
        If the optics are not complete, or if the field is not above the horizon.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astropy.coordinates import SkyCoord
    >>> import rfpsurvey as rs
    >>> conditions = rs.ObservingConditions("paranal", hour_angle=2 * u.hourangle)
    >>> plane = rs.Instrument.preset("moons").projection(SkyCoord("10h -10d"), conditions=conditions)
    >>> plane.altitude.round(2), plane.parallactic_angle.round(2)
    (<Latitude 57.96 deg>, <Angle 121.05 deg>)
    """

    conditions: ObservingConditions | None = None
    field_radius: u.Quantity = 0 * u.deg

    def __post_init__(self):
        super().__post_init__()
        check_conditions(self.conditions)
        to_scalar(self.field_radius, u.deg, "field_radius", low=0, high=90, closed=True)
        _ = self.plain  # raises an error if the field is below the horizon

    @cached_property
    def plain(self) -> ObservedField:
        """The projection for arrays without units (``ObservedField``)."""
        static = TangentPlane.plain.func(self)
        return ObservedField(
            static.basis,
            static.focal_length,
            self.distortion,
            self.conditions,
            self.field_radius.to_value(u.rad),
        )

    @property
    def altitude(self) -> Latitude:
        """Observed altitude of the field center at the midpoint of the exposure."""
        return Latitude(np.arcsin(self._frame[2, 2]), u.rad).to(u.deg)

    @property
    def azimuth(self) -> Longitude:
        """Observed azimuth of the field center at the midpoint of the exposure, from north toward east."""
        return Longitude(np.arctan2(self._frame[2, 0], self._frame[2, 1]), u.rad).to(u.deg)

    @property
    def parallactic_angle(self) -> Angle:
        """Position angle of the zenith, seen from the field center, at the midpoint of the exposure."""
        return Angle(self._zenith_angles()[len(self.plain.frames) // 2], u.rad).wrap_at(180 * u.deg).to(u.deg)

    @property
    def field_rotation(self) -> Angle:
        """Change of the parallactic angle during the exposure, which the rotator of an alt-azimuth mount removes."""
        angles = np.unwrap(self._zenith_angles())
        # The change is scaled, because the exposure is longer than the interval between the first and the last instant.
        scale = 1.0 if len(angles) == 1 else 1 / 0.6**0.5
        return Angle((angles[-1] - angles[0]) * scale, u.rad).to(u.deg)

    @property
    def _frame(self) -> np.ndarray:
        return self.plain.frames[len(self.plain.frames) // 2]

    def _zenith_angles(self) -> np.ndarray:
        """Return the position angle of the zenith at each instant, in radians."""
        x, y, center = self.plain.basis
        east = np.array([-center[1], center[0], 0.0])
        of_y = np.arctan2(y @ east, x @ east)  # at a pole, both arguments are 0
        return np.array([of_y + np.arctan2(frame[0, 2], frame[1, 2]) for frame in self.plain.frames])
