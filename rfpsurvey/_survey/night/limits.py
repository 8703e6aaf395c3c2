"""The limits within which tiles can be observed: altitudes, hour angles, the Sun, the Moon, and the horizon."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, partial
from typing import NamedTuple

import astropy.units as u
import numpy as np
from astropy.table import Table

from rfpsurvey._common.settings import Settings, option
from rfpsurvey._common.units import to_unit
from rfpsurvey._sky.conditions import as_hour_angle
from rfpsurvey.errors import INCONVERTIBLE, InputError, InputTypeError, check_keywords, short

HIGHEST = {"low": -90, "high": 90}
# The altitude at which rays of the center of the Sun and the Moon are horizontal is not corrected for refraction.
DEFAULT_ALTITUDE = 30 * u.deg


def _to_horizon(value: object) -> tuple[tuple[float, float], ...] | None:
    """Return azimuths and altitudes (deg) of a horizon, in the order of the azimuths."""
    if value is None:
        return None
    if isinstance(value, Table):
        if lacking := [name for name in ("azimuth", "altitude") if name not in value.colnames]:
            raise InputError(
                f"horizon must have the columns azimuth and altitude, got {value.colnames}: no {lacking[0]}"
            )
        value = [to_unit(value[name], u.deg, name) for name in ("azimuth", "altitude")]
        value = np.column_stack(value)
    try:
        points = np.array(value, dtype=float)
    except INCONVERTIBLE:
        points = np.empty(0)
    if points.ndim != 2 or points.shape[1] != 2 or not len(points):
        raise InputTypeError(
            f"horizon must be a table with azimuth and altitude, or pairs of both (deg), got {short(value)}"
        )
    if not (np.isfinite(points).all() and (np.abs(points[:, 1]) <= 90).all()):
        raise InputError("horizon must have finite azimuths and altitudes from -90 to 90 deg")
    points[:, 0] %= 360
    return tuple(map(tuple, points[np.argsort(points[:, 0], kind="stable")].tolist()))


class Numbers(NamedTuple):
    """Limits in radians; limits that are not given are those that every tile meets."""

    lowest: float
    highest: float
    hour_angle: float
    sun: float
    moon_separation: float
    moon_illumination: float
    moon_altitude: float


@check_keywords
@dataclass(frozen=True, eq=False, repr=False)
class NightLimits(Settings):
    """Limits within which tiles can be observed.

    Altitudes are geometric, without refraction, as those of astropy's ``AltAz`` without a pressure. The airmass is the
    inverse of the sine of the altitude. All limits are for the center of a tile, and include the limit itself.

    Parameters
    ----------
    min_altitude : Quantity, optional
        Lowest altitude. By default, 30 deg, unless ``max_airmass`` is given.
    max_airmass : float, optional
        Largest airmass, in place of ``min_altitude``.
    max_altitude : Quantity, optional
        Highest altitude, for telescopes that cannot follow targets near the zenith.
    hour_angle : Quantity, optional
        Largest absolute hour angle, as an angle or as hours of time.
    sun_altitude : Quantity, optional
        Highest altitude of the center of the Sun.
    moon_separation : Quantity, optional
        Smallest distance from the center of the Moon, as seen from the site, while the Moon is above the horizon.
    moon_illumination : float, optional
        Largest illuminated fraction of the Moon, while the Moon is above ``moon_altitude``.
    moon_altitude : Quantity, optional
        Altitude of the center of the Moon up to which its light is neglected.
    horizon : QTable or array_like, shape (n, 2), optional
        Horizon at the site: columns ``azimuth`` (from north toward east) and ``altitude``, or pairs of both in deg.
        Altitudes between these points are interpolated.

    Raises
    ------
    InputError
        If a value is not valid, or if ``min_altitude`` and ``max_airmass`` are given.

    Examples
    --------
    >>> import astropy.units as u
    >>> from rfpsurvey.night import NightLimits
    >>> NightLimits(max_airmass=1.5, hour_angle=2 * u.hour, moon_separation=30 * u.deg)
    NightLimits(max_airmass=1.5, hour_angle=<Quantity 2. hourangle>, moon_separation=<Quantity 30. deg>)
    """

    min_altitude: u.Quantity[u.deg] | None = option(None, **HIGHEST)
    max_airmass: float | None = option(None, low=1, high=40)
    max_altitude: u.Quantity[u.deg] | None = option(None, **HIGHEST)
    hour_angle: u.Quantity[u.hourangle] | None = option(None, low=0, high=12, convert=as_hour_angle)
    sun_altitude: u.Quantity[u.deg] = option(-18 * u.deg, **HIGHEST)
    moon_separation: u.Quantity[u.deg] | None = option(None, low=0, high=180)
    moon_illumination: float | None = option(None, low=0, high=1)
    moon_altitude: u.Quantity[u.deg] = option(0 * u.deg, **HIGHEST)
    horizon: tuple[tuple[float, float], ...] | None = option(None, convert=_to_horizon)

    def _check(self):
        if self.min_altitude is not None and self.max_airmass is not None:
            raise InputError("limits must have either min_altitude or max_airmass, got both")

    @cached_property
    def numbers(self) -> Numbers:
        """The limits as numbers without units."""
        lowest = DEFAULT_ALTITUDE if self.min_altitude is None else self.min_altitude
        lowest = lowest.to_value(u.rad) if self.max_airmass is None else np.arcsin(1 / self.max_airmass)
        radians = partial(_radians, self)
        values = radians("max_altitude", np.inf), radians("hour_angle", np.inf), radians("sun_altitude", np.inf)
        illumination = np.inf if self.moon_illumination is None else self.moon_illumination
        return Numbers(lowest, *values, radians("moon_separation", 0.0), illumination, radians("moon_altitude", np.inf))


def _radians(limits: NightLimits, name: str, otherwise: float) -> float:
    value = getattr(limits, name)
    return otherwise if value is None else float(value.to_value(u.rad))


def limits_of(limits: object) -> dict[str, NightLimits]:
    """Return the limits of each program, in lower case; the key ``""`` is for all other tiles."""
    limits = {"": NightLimits()} if limits is None else limits
    limits = dict(limits) if isinstance(limits, Mapping) else {"": limits}
    for value in limits.values():
        if not isinstance(value, NightLimits):
            raise InputTypeError(f"limits must be NightLimits, or a dict of them by program, got {short(value)}")
    return {str(name).lower(): value for name, value in limits.items()}
