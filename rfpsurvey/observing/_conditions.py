"""The conditions of an observation: place, time, weather and wavelengths."""

import os
from dataclasses import dataclass, fields, replace
from functools import cached_property
from numbers import Number

import astropy.units as u
import numpy as np
from astropy.coordinates import EarthLocation
from astropy.time import Time

from rfpsurvey._io import to_path
from rfpsurvey._readers import read_toml
from rfpsurvey._units import ByValue, to_scalar
from rfpsurvey.catalog import to_moment
from rfpsurvey.errors import (
    INCONVERTIBLE,
    InputError,
    InputTypeError,
    check_choice,
    check_keywords,
    listed,
    refusal,
    short,
)
from rfpsurvey.observing._sites import as_site, location

LONGEST_DAYS = 0.5
EXAMPLES = {
    "hour_angle": "-1.5 hourangle",
    "pressure": "720 hPa",
    "temperature": "10 deg_C",
    "exposure_time": "30 min",
    "tolerance": "10 um",
    **dict.fromkeys(("wavelength", "guide_wavelength"), "0.54 um"),
}
"""Values in TOML files, for error messages."""
# Angle by which the Earth rotates in a second of time (UT1), radians.
RATE = 1.00273781191135448 * 2 * np.pi / 86400


@check_keywords
@dataclass(frozen=True, eq=False)
class ObservingConditions(ByValue):
    """Place, time, weather and wavelengths of an observation, from which refraction is computed.

    Parameters
    ----------
    site : EarthLocation or str
        Location of the telescope, or one of ``apache point``, ``kitt peak``, ``las campanas``, ``mauna kea``,
        ``paranal`` and ``xinglong``.
    time : Time, datetime, date or str, optional
        Midpoint of the exposure. Text such as ``"2026-07-01T06:30:00"``, a datetime without a time zone and a date are
        in UTC. With a time, the projection includes precession, nutation, aberration, and the deflection of light by
        the Sun. No file is downloaded: the time must be covered by the tables of the Earth's rotation that are
        installed with astropy.
    hour_angle : Quantity, optional
        Hour angle of the field center at the midpoint of the exposure, positive west of the meridian, as an angle or as
        hours of time. Exactly one of ``time`` and ``hour_angle`` must be given. With an hour angle, catalog positions
        are treated as apparent places, and differential aberration is not included.
    wavelength : Quantity or dict of str to Quantity, optional
        Wavelength in vacuum for which the positions of fibers are computed, or a dict with one wavelength for each
        fiber type. By default, all fibers are assumed to observe at 0.54 um; presets contain no wavelengths.
    guide_wavelength : Quantity, optional
        Wavelength at which the telescope follows the field. By default, ``wavelength`` or, if it is a dict, the
        wavelength of the first fiber type in the dict.
    pressure : Quantity, optional
        Pressure at the site; 0 means no refraction. By default, the pressure of the standard atmosphere at the height
        of the site.
    temperature : Quantity, optional
        Temperature at the site.
    humidity : float, optional
        Relative humidity, from 0 to 1.
    exposure_time : Quantity, optional
        Duration of the exposure. Fibers are placed at the mean positions of their targets during the exposure.
    tolerance : Quantity, optional
        Largest negligible position error on the focal plane. A model of the projection is accurate enough if its
        position errors do not exceed this tolerance. By default, a tenth of the diameter of the instrument's fibers.

    Raises
    ------
    InputError
        If the site is unknown, if not exactly one of time and hour angle is given, if a value has a wrong unit or is
        impossible, or if the tables of the Earth's rotation do not cover the time.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astropy.coordinates import SkyCoord
    >>> import rfpsurvey as rs
    >>> conditions = rs.ObservingConditions("xinglong", hour_angle=30 * u.deg, wavelength=0.55 * u.um)
    >>> conditions.pressure.round()
    <Quantity 904. hPa>
    >>> lamost = rs.Instrument.preset("lamost")
    >>> plane = lamost.projection(SkyCoord("6h20m +23d"), conditions=conditions)
    >>> plane.altitude.round(2)
    <Latitude 59.36 deg>
    """

    site: EarthLocation | str
    time: Time | None = None
    hour_angle: u.Quantity[u.hourangle] | None = None
    wavelength: u.Quantity[u.um] | dict[str, u.Quantity[u.um]] = 0.54 * u.um
    guide_wavelength: u.Quantity[u.um] | None = None
    pressure: u.Quantity[u.hPa] | None = None
    temperature: u.Quantity[u.deg_C] = 10 * u.deg_C
    humidity: float = 0.2
    exposure_time: u.Quantity[u.s] = 0 * u.s
    tolerance: u.Quantity[u.mm] | None = None

    def __post_init__(self):
        name = self.site if isinstance(self.site, str) else ""
        object.__setattr__(self, "site", as_site(self.site))
        object.__setattr__(self, "_name", name)
        if (self.time is None) == (self.hour_angle is None):
            both = "none of them" if self.time is None else "both"
            raise InputError(f"conditions must have either a time or an hour_angle, got {both}")
        if self.time is not None:
            object.__setattr__(self, "time", to_moment(self.time, "time"))
        if self.time is not None and self.time.scale in ("ut1", "local"):
            raise InputError(f"time must be in a scale such as UTC, got the scale {self.time.scale}; give UTC")
        if self.hour_angle is not None:
            angle = as_hour_angle(self.hour_angle)
            to_scalar(angle, u.deg, "hour_angle", low=-360, high=360)
            object.__setattr__(self, "hour_angle", angle)
        waves = self.wavelength
        if isinstance(waves, dict):
            if not waves or not all(isinstance(name, str) for name in waves):
                raise InputError(f"wavelength must have one value, or one for each fiber type, got {short(waves)}")
            for name, wave in waves.items():
                _check_wavelength(wave, f"wavelength of {name}")
        else:
            _check_wavelength(waves, "wavelength")
        if self.guide_wavelength is None:
            object.__setattr__(
                self, "guide_wavelength", next(iter(waves.values())) if isinstance(waves, dict) else waves
            )
        _check_wavelength(self.guide_wavelength, "guide_wavelength")
        if self.pressure is None:
            height = np.clip(self.site.height.to_value(u.m), -500, 9000)
            object.__setattr__(self, "pressure", 1013.25 * (1 - 2.25577e-5 * height) ** 5.25588 * u.hPa)
        to_scalar(self.pressure, u.hPa, "pressure", low=0, high=1200, closed=True)
        try:
            celsius = self.temperature.to(u.deg_C, u.temperature())
        except (AttributeError, u.UnitConversionError):
            raise InputTypeError(
                f"temperature must have a unit of temperature, got {short(self.temperature)}"
            ) from None
        to_scalar(celsius, u.deg_C, "temperature", low=-150, high=200)
        object.__setattr__(self, "temperature", celsius)
        if np.any(getattr(self.humidity, "mask", False)):
            raise InputError("humidity must have a value, got a masked value; leave it out to use the default value")
        try:
            humidity = u.Quantity(self.humidity)
        except INCONVERTIBLE:
            raise refusal("humidity must be a number from 0 to 1", self.humidity, Number, list) from None
        to_scalar(humidity, u.dimensionless_unscaled, "humidity", low=0, high=1 + 1e-12, closed=True)
        object.__setattr__(self, "humidity", float(humidity))
        to_scalar(self.exposure_time, u.day, "exposure_time", low=0, high=LONGEST_DAYS, closed=True)
        if self.tolerance is not None:
            to_scalar(self.tolerance, u.mm, "tolerance", low=0)

    @classmethod
    def read(cls, path: str | os.PathLike, **changes: object) -> "ObservingConditions":
        """Read conditions from a TOML file.

        Parameters
        ----------
        path : str or path-like
            File with parameters of this class as keys. Values with a unit are text, such as ``"720 hPa"``, and ``site``
            is a name or a list of longitude (deg), latitude (deg) and height (m). If ``wavelength`` is a table, it has
            a value for each fiber type.
        **changes : object
            Parameters that replace the parameters of the file.

        Returns
        -------
        ObservingConditions
            The conditions.

        Raises
        ------
        InputError
            If the file does not exist, or if a key or value is not valid.
        """
        path = to_path(path)
        given = {name: _from_text(name, value, path) for name, value in read_toml(path).items()}
        if {"time", "hour_angle"} & set(changes):
            given = {name: value for name, value in given.items() if name not in ("time", "hour_angle")}
        if "site" not in {**given, **changes}:
            raise InputError(f'{path} must state the site, such as site = "xinglong", got {listed(given)}')
        try:
            return cls(**{**given, **changes})
        except InputError as error:
            raise type(error)(f"{path}: {error}") from None

    @property
    def at_guide_wavelength(self) -> "ObservingConditions":
        """The conditions with the guide wavelength for all fibers, so that there is no dispersion."""
        return replace(self, site=self._name or self.site, wavelength=self.guide_wavelength)

    @property
    def without_exposure(self) -> "ObservingConditions":
        """The conditions at the midpoint of the exposure, with the exposure time 0."""
        return replace(self, site=self._name or self.site, exposure_time=0 * u.s)

    def shifted(self, time: u.Quantity) -> "ObservingConditions":
        """Return the conditions at a later time.

        Parameters
        ----------
        time : Quantity
            Time to add; a negative value gives an earlier time.

        Returns
        -------
        ObservingConditions
            The conditions with the later time or hour angle.
        """
        if self.time is not None:
            return replace(self, site=self._name or self.site, time=self.time + time)
        angle = self.hour_angle + time.to_value(u.s) * RATE * u.rad
        return replace(self, site=self._name or self.site, hour_angle=angle)

    def at_hour_angle(self, hour_angle: u.Quantity) -> "ObservingConditions":
        """Return the conditions at another hour angle.

        Parameters
        ----------
        hour_angle : Quantity
            Hour angle of the field center, which replaces the time or hour angle of these conditions.

        Returns
        -------
        ObservingConditions
            The conditions at this hour angle.
        """
        return replace(self, site=self._name or self.site, time=None, hour_angle=hour_angle)

    @cached_property
    def wavelengths_um(self) -> dict[str, float] | float:
        """Wavelength of the fibers in micrometers, or a dict with one wavelength for each fiber type."""
        if isinstance(self.wavelength, dict):
            return {name: float(wave.to_value(u.um)) for name, wave in self.wavelength.items()}
        return float(self.wavelength.to_value(u.um))

    @property
    def not_included(self) -> tuple[str, ...]:
        """Effects on the positions of fibers that these conditions do not include, each with the reason in parentheses.

        Differential aberration changes the scale of a field by up to 0.0001.
        """
        waves = self.wavelength.values() if isinstance(self.wavelength, dict) else [self.wavelength]
        one = all(wave == self.guide_wavelength for wave in waves)
        dispersion = (
            f"dispersion (all fibers and the guide camera are assumed to observe at {self.guide_wavelength.to(u.um):g})"
        )
        aberration = "differential aberration (the conditions have an hour angle instead of a time)"
        return (dispersion,) * one + (aberration,) * (self.time is None)

    @property
    def record(self) -> dict:
        """The conditions as plain numbers and text, for the records of results."""
        numbers = {
            "longitude_deg": self.site.lon.to_value(u.deg),
            "latitude_deg": self.site.lat.to_value(u.deg),
            "height_m": self.site.height.to_value(u.m),
            "guide_wavelength_um": self.guide_wavelength.to_value(u.um),
            "pressure_hpa": self.pressure.to_value(u.hPa),
            "temperature_c": self.temperature.to_value(u.deg_C),
            "humidity": self.humidity,
            "exposure_time_s": self.exposure_time.to_value(u.s),
        }
        if self.time is None:
            numbers["hour_angle_deg"] = self.hour_angle.to_value(u.deg)
        when = {} if self.time is None else {"time": self.time.utc.isot}
        if self.tolerance is not None:
            numbers["tolerance_mm"] = self.tolerance.to_value(u.mm)
        return {
            **{name: round(float(value), 9) for name, value in numbers.items()},
            **when,
            "wavelength_um": self.wavelengths_um,
        }

    @classmethod
    def from_record(cls, record: dict) -> "ObservingConditions":
        """Make conditions from the attribute ``record`` of earlier conditions.

        Parameters
        ----------
        record : dict
            A dict with the entries of the attribute ``record``.

        Returns
        -------
        ObservingConditions
            The conditions.

        Raises
        ------
        InputError
            If a value is missing or not valid.
        """
        try:
            waves = record["wavelength_um"]
            given = {
                "site": location([record[name] for name in ("longitude_deg", "latitude_deg", "height_m")]),
                "wavelength": {k: v * u.um for k, v in waves.items()} if isinstance(waves, dict) else waves * u.um,
                "guide_wavelength": record["guide_wavelength_um"] * u.um,
                "pressure": record["pressure_hpa"] * u.hPa,
                "temperature": record["temperature_c"] * u.deg_C,
                "humidity": record["humidity"],
                "exposure_time": record["exposure_time_s"] * u.s,
            }
            if "time" in record:
                given["time"] = record["time"]
            if "hour_angle_deg" in record:
                given["hour_angle"] = record["hour_angle_deg"] * u.deg
            if "tolerance_mm" in record:
                given["tolerance"] = record["tolerance_mm"] * u.mm
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise InputError(f"record must describe observing conditions, got {short(record)}: {error}") from None
        return cls(**given)

    def __repr__(self):
        when = f"hour angle {self.hour_angle.to(u.hourangle):.4g}" if self.time is None else self.time.utc.iso
        site = self._name or f"{self.site.lon.deg:.3f}, {self.site.lat.deg:.3f} deg"
        return f"<ObservingConditions at {site}, {when}, {self.pressure.to(u.hPa):.4g}>"


def check_conditions(conditions: object, *, optional: bool = False) -> None:
    """Raise an error unless an object is an `ObservingConditions`; if ``optional`` is true, None is also accepted."""
    if not isinstance(conditions, ObservingConditions) and not (optional and conditions is None):
        words = " or None" if optional else ""
        raise InputTypeError(f"conditions must be ObservingConditions{words}, got {short(conditions)}")


def as_hour_angle(value: u.Quantity) -> u.Quantity:
    """Convert hours of time to an hour angle; return other values unchanged."""
    if isinstance(value, u.Quantity) and value.unit.is_equivalent(u.hour):
        return value.to_value(u.hour) * u.hourangle
    return value


def _from_text(name: str, value: object, path: object) -> object:
    """Return the value of a parameter from a TOML file."""
    check_choice(name, [one.name for one in fields(ObservingConditions)], f"key of {path}")
    if name == "site" and isinstance(value, list):
        return location(value, f"{path}: site")
    if name in ("site", "humidity", "time"):
        return value
    try:
        if isinstance(value, dict):
            return {kind: u.Quantity(text) for kind, text in value.items()}
        return u.Quantity(value)
    except INCONVERTIBLE:
        raise InputError(f"{path}: {name} must be text such as {EXAMPLES[name]!r}, got {short(value)}") from None


def _check_wavelength(value, name: str) -> None:
    to_scalar(value, u.um, name, low=0.1, high=100)
