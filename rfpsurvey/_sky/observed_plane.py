"""Projection between the sky and the focal plane for given observing conditions."""

from dataclasses import dataclass
from functools import cached_property

import astropy.units as u
import numpy as np
from astropy.coordinates import Angle, Latitude, Longitude

from rfpsurvey._common.units import to_scalar
from rfpsurvey._sky.conditions import ObservingConditions, check_conditions
from rfpsurvey._sky.observed_field import NO_LIGHT, ObservedField
from rfpsurvey._sky.projection import TangentPlane
from rfpsurvey._sky.wavelengths import Light
from rfpsurvey.errors import InputTypeError, check_keywords, short

# MOST_STEP: largest change (rad) of the parallactic angle in a step. SHORTEST: shortest step (s).
MOST_STEP, SHORTEST = np.pi / 6, 1e-6


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
        Field center, as in `~rfpsurvey.projection.TangentPlane`.
    plate_scale, rotation, distortion : optional
        Optics and orientation, as in `~rfpsurvey.projection.TangentPlane`.
    conditions : ObservingConditions
        The observing conditions.
    field_radius : Quantity, optional
        Radius of the field; the whole field must be above the horizon.
    light : Light, optional
        Wavelengths that the instrument observes, which the conditions can replace.

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
    light: Light = NO_LIGHT

    def __post_init__(self):
        super().__post_init__()
        check_conditions(self.conditions)
        if not isinstance(self.light, Light):
            raise InputTypeError(f"light must be a Light, got {short(self.light)}")
        to_scalar(self.field_radius, u.deg, "field_radius", low=0, high=90, closed=True)
        _ = self.plain  # raises an error if the field is below the horizon

    @cached_property
    def plain(self) -> ObservedField:
        """The projection for arrays without units (``ObservedField``)."""
        static = TangentPlane.plain.func(self)
        radius = self.field_radius.to_value(u.rad)
        return ObservedField(static.basis, static.focal_length, self.distortion, self.conditions, radius, self.light)

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
        return Angle(self._zenith_angles(self._frame[None])[0], u.rad).wrap_at(180 * u.deg).to(u.deg)

    @property
    def field_rotation(self) -> Angle:
        """Change of the parallactic angle during the exposure, which the rotator of an alt-azimuth mount removes."""
        seconds, frames = self.plain.seconds, self.plain.frames
        while True:
            angles = self._zenith_angles(frames)
            steps = np.mod(np.diff(angles) + np.pi, 2 * np.pi) - np.pi
            # Near the zenith, the parallactic angle changes rapidly: halve intervals with large changes.
            wide = np.flatnonzero((np.abs(steps) > MOST_STEP) & (np.diff(seconds) > SHORTEST))
            if len(wide) == 0:
                return Angle(steps.sum(), u.rad).to(u.deg)
            new = (seconds[wide] + seconds[wide + 1]) / 2
            frames = np.insert(frames, wide + 1, self.plain.frames_at(new), axis=0)
            seconds = np.insert(seconds, wide + 1, new)

    @property
    def _frame(self) -> np.ndarray:
        return self.plain.frames[len(self.plain.frames) // 2]

    def _zenith_angles(self, frames: np.ndarray) -> np.ndarray:
        """Return the position angle of the zenith in each frame, in radians."""
        x, y, center = self.plain.basis
        east = np.array([-center[1], center[0], 0.0])
        of_y = np.arctan2(y @ east, x @ east)  # at a pole, both arguments are 0
        return of_y + np.arctan2(frames[:, 0, 2], frames[:, 1, 2])
