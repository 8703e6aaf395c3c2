"""The conditions of an observation: place, time, weather and wavelengths, and the coordinates of a few sites."""

import os
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property, partial
from typing import NamedTuple

import astropy.units as u
import numpy as np
from astropy.coordinates import EarthLocation
from astropy.time import Time

from rfpsurvey._common.files import to_path
from rfpsurvey._common.read_documents import read_toml
from rfpsurvey._common.settings import Settings, option
from rfpsurvey._common.units import value_of
from rfpsurvey._sky.time import any_year, to_moment
from rfpsurvey.errors import InputError, InputTypeError, check_choice, check_keywords, listed, refusing, short

HIGHEST = 1e5  # m
# Longitude (deg, east), latitude (deg), height (m). The values are taken from astropy's table of sites, which names as
# its sources the observatory database of IRAF (Apache Point, Kitt Peak, Las Campanas, Xinglong), the raw data of the
# VLTI (Paranal), and the website of the Subaru telescope (Mauna Kea).
SITES = {
    "apache point": (-105.82, 32.78, 2798.0),
    "kitt peak": (-111.6, 31.963333, 2120.0),
    "las campanas": (-70.701667, -29.003333, 2282.0),
    "mauna kea": (-155.476111, 19.825556, 4139.0),
    "paranal": (-70.404987, -24.627439, 2669.0),
    "xinglong": (117.575, 40.393333, 950.0),
}


def location(values: Sequence, what: str = "site") -> EarthLocation:
    """Return the location for longitude and latitude (deg) and height (m)."""
    with refusing(f"{what} must be longitude, latitude (deg) and height (m, at most {HIGHEST:g})", values, object):
        lon, lat, height = map(float, values)
        if not (abs(lon) <= 360 and abs(lat) <= 90 and abs(height) <= HIGHEST):
            raise ValueError
        return EarthLocation.from_geodetic(lon * u.deg, lat * u.deg, height * u.m)


def as_site(site: object) -> EarthLocation:
    """Return the location of a site, which is given as a location or as a name in `SITES` (in upper or lower case)."""
    if isinstance(site, str):
        return location(SITES[check_choice(site.strip().lower(), SITES, "site")])
    if not isinstance(site, EarthLocation) or not site.isscalar:
        raise InputTypeError(f"site must be one EarthLocation or the name of a site, got {short(site)}")
    if not np.isfinite(site.x) or abs(site.height.to_value(u.m)) > HIGHEST:
        raise InputError(
            f"site must have finite coordinates and a height from {-HIGHEST:g} to {HIGHEST:g} m, got {short(site)}"
        )
    return site


def site_name(site: EarthLocation) -> str:
    """Return the name of the site in `SITES` at a location, or empty text."""
    return next((name for name in SITES if as_site(name) == site), "")


LONGEST_S, WAVELENGTHS = 43200, {"above": 0.1, "below": 100}
RECORDED = (
    *("longitude_deg", "latitude_deg", "height_m", "guide_wavelength_um", "pressure_hpa", "temperature_c", "humidity"),
    *("exposure_time_s", "hour_angle_deg", "tolerance_mm", "time", "wavelength_um"),
    *("date", "scale", "compensator", "projection"),
)
"""Names in records, in their order; a site has the first three."""
EXACT = ("time", "wavelength_um", "date", "compensator", "projection")
"""Names of values in records that are not rounded."""
OPTIONAL = ("guide_wavelength_um", "hour_angle_deg", "tolerance_mm", *RECORDED[10:])
"""Names of values that records can lack."""
FORMER = {"scale": 1.0, "compensator": "none", "projection": "full"}
"""Values that records omit, because records of version 0.3 do not contain them."""
UTC = {"to_record": any_year()(lambda time: time.utc.isot), "sparse": True}
MODELS = {
    "tangent": "tangent plane with one plate scale",
    "radial": "radial map of the instrument",
    "refraction": "refraction at the midpoint of the exposure, at the guide wavelength",
    "dispersion": "refraction at the midpoint of the exposure, at the wavelength of each fiber type",
    "full": "refraction averaged over the exposure, at the wavelength of each fiber type",
}
EXAMPLES = {
    "humidity": "30 %",
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


def as_hour_angle(value: u.Quantity) -> u.Quantity:
    """Convert hours of time to an hour angle; return other values unchanged."""
    if isinstance(value, u.Quantity) and value.unit.is_equivalent(u.hour):
        return value.to_value(u.hour) * u.hourangle
    return value


@any_year()
def _in_known_scale(value: object, name: str = "time") -> Time:
    time = to_moment(value, name)
    if time.scale in ("ut1", "local"):
        raise InputError(f"{name} must be in a scale such as UTC, got the scale {time.scale}; give UTC")
    return time


def _celsius(value: object) -> u.Quantity:
    try:
        return value.to(u.deg_C, u.temperature())
    except (AttributeError, u.UnitConversionError):
        raise InputTypeError(f"temperature must have a unit of temperature, got {short(value)}") from None


class Numbers(NamedTuple):
    """Numbers of observing conditions without units."""

    weather: tuple[float, float, float]  # hPa, deg C, relative humidity
    place: tuple[float, float, float]  # longitude and latitude (rad), height (m)
    hour_angle: float | None  # rad
    half_exposure: float  # s
    tolerance: float | None  # mm
    wavelength: dict[str, float] | float | None
    guide_wavelength: float | None


def in_micrometers(wavelength: u.Quantity | dict[str, u.Quantity] | None) -> dict[str, float] | float | None:
    """Return a wavelength, or a dict of wavelengths, as numbers in micrometers."""
    if isinstance(wavelength, dict):
        return {name: in_micrometers(wave) for name, wave in wavelength.items()}
    return None if wavelength is None else float(wavelength.to_value(u.um))


@check_keywords
@dataclass(frozen=True, eq=False, repr=False)
class ObservingConditions(Settings):
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
        are treated as apparent places, except that ``date`` adds the aberration of light.
    date : Time, datetime, date or str, optional
        Date of the observation, for conditions with an hour angle; any date is accepted. The aberration of light on
        this date changes the scale of a field by up to 0.0001.
    wavelength : Quantity or dict of str to Quantity, optional
        Wavelength in vacuum for which the positions of fibers are computed, or a dict with one wavelength for each
        fiber type. By default, the wavelengths in the description of the instrument (`~rfpsurvey.observing.Light`);
        if there are none, 0.54 um is assumed.
    guide_wavelength : Quantity, optional
        Wavelength at which the telescope follows the field. By default, the wavelength of the guider in the description
        of the instrument or, if there is none, the wavelength of the (first) fiber type.
    compensator : {"instrument", "none", "ideal"}, optional
        Whether a compensator removes atmospheric dispersion: as the description of the instrument states, in no case,
        or in any case.
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
    scale : float, optional
        Factor by which all distances from the center of the focal plane are multiplied, such as the result of a fit to
        guide stars, or a factor for the temperature.
    projection : {"auto", "tangent", "radial", "refraction", "dispersion", "full"}, optional
        Model of the projection, as in `~rfpsurvey.instrument.compare_projections`; ``auto`` is the fastest model that
        is accurate enough.

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

    site: EarthLocation | str = option(convert=as_site, record=None)
    time: Time | None = option(None, convert=_in_known_scale, **UTC)
    hour_angle: u.Quantity[u.hourangle] | None = option(
        None, convert=as_hour_angle, above=-24, below=24, record="hour_angle_deg", unit=u.deg, sparse=True
    )
    date: Time | None = option(None, convert=partial(_in_known_scale, name="date"), **UTC)
    wavelength: u.Quantity[u.um] | dict[str, u.Quantity[u.um]] | None = option(None, sparse=True, **WAVELENGTHS)
    guide_wavelength: u.Quantity[u.um] | None = option(None, sparse=True, **WAVELENGTHS)
    compensator: str = option("instrument", choices=("instrument", "none", "ideal"))
    pressure: u.Quantity[u.hPa] | None = option(None, low=0, below=1200)
    temperature: u.Quantity[u.deg_C] = option(
        10 * u.deg_C, convert=_celsius, above=-150, below=200, record="temperature_c"
    )
    humidity: float = option(0.2, low=0, high=1)
    exposure_time: u.Quantity[u.s] = option(0 * u.s, low=0, below=LONGEST_S)
    tolerance: u.Quantity[u.mm] | None = option(None, above=0, sparse=True)
    scale: float = option(1.0, low=0.9, high=1.1)
    projection: str = option("auto", choices=("auto", *MODELS))

    def _check(self):
        if (self.time is None) == (self.hour_angle is None):
            given = "none of them" if self.time is None else "both"
            raise InputError(f"conditions must have either a time or an hour_angle, got {given}")
        waves = self.wavelength
        if isinstance(waves, dict) and not (waves and all(isinstance(name, str) for name in waves)):
            raise InputError(f"wavelength must have one value, or one for each fiber type, got {short(waves)}")
        if self.date is not None and self.time is not None:
            raise InputError("conditions with a time must have no date, which belongs to an hour_angle, got both")
        if self.pressure is None:
            height = np.clip(self.site.height.to_value(u.m), -500, 9000)
            object.__setattr__(self, "pressure", 1013.25 * (1 - 2.25577e-5 * height) ** 5.25588 * u.hPa)

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
        replaced = {"time": ("hour_angle", "date"), "hour_angle": ("time",)}
        given = {k: value for k, value in given.items() if not any(k in replaced.get(name, ()) for name in changes)}
        if "site" not in {**given, **changes}:
            raise InputError(f'{path} must state the site, such as site = "xinglong", got {listed(given)}')
        try:
            return cls(**{**given, **changes})
        except InputError as error:
            raise type(error)(f"{path}: {error}") from None

    @cached_property
    def numbers(self) -> "Numbers":
        """The conditions as numbers without units; they are converted once."""
        site, (angle, limit) = self.site.geodetic, (self.hour_angle, self.tolerance)
        return Numbers(
            (float(self.pressure.to_value(u.hPa)), float(self.temperature.to_value(u.deg_C)), float(self.humidity)),
            (site.lon.to_value(u.rad), site.lat.to_value(u.rad), site.height.to_value(u.m)),
            None if angle is None else float(angle.to_value(u.rad)),
            float(self.exposure_time.to_value(u.s)) / 2,
            None if limit is None else float(limit.to_value(u.mm)),
            in_micrometers(self.wavelength),
            in_micrometers(self.guide_wavelength),
        )

    @property
    def at_guide_wavelength(self) -> "ObservingConditions":
        """The conditions with an ideal compensator: all fibers have the positions at the guide wavelength."""
        return replace(self, compensator="ideal")

    @property
    def without_exposure(self) -> "ObservingConditions":
        """The conditions at the midpoint of the exposure, with the exposure time 0."""
        return replace(self, exposure_time=0 * u.s)

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
            return replace(self, time=self.time + time)
        angle = self.hour_angle + time.to_value(u.s) * RATE * u.rad
        return replace(self, hour_angle=angle)

    def at_hour_angle(self, hour_angle: u.Quantity) -> "ObservingConditions":
        """Return the conditions at another hour angle.

        Parameters
        ----------
        hour_angle : Quantity
            Hour angle of the field center, which replaces the time or hour angle of these conditions; a time becomes
            the date.

        Returns
        -------
        ObservingConditions
            The conditions at this hour angle.
        """
        return replace(self, time=None, date=self.date if self.time is None else self.time, hour_angle=hour_angle)

    @property
    def record(self) -> dict:
        """The conditions as plain numbers and text, for the records of results."""
        numbers = {
            "longitude_deg": self.site.lon.to_value(u.deg),
            "latitude_deg": self.site.lat.to_value(u.deg),
            "height_m": self.site.height.to_value(u.m),
            **super().record,
        }
        entries = {name: numbers[name] for name in RECORDED if name in numbers and numbers[name] != FORMER.get(name)}
        return {name: value if name in EXACT else round(float(value), 9) for name, value in entries.items()}

    def _values(self):
        record = self.record  # the location of a site is equal to that of its record only if it is rounded
        return value_of(record | {name: round(record[name], 6) for name in RECORDED[:3]})

    @classmethod
    def from_record(cls, record: dict, **others: object) -> "ObservingConditions":
        """Return the conditions whose attribute ``record`` is given.

        Parameters
        ----------
        record : dict
            Attribute ``record`` of conditions.
        **others : object
            Values of parameters, in place of those of the record.

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
            site = location([record[name] for name in RECORDED[:3]])
            _ = [record[name] for name in RECORDED if name not in OPTIONAL]
        except (KeyError, TypeError) as error:
            raise InputError(f"record must describe observing conditions, got {short(record)}: {error}") from None
        return super().from_record(FORMER | record, **{"site": site, **others})

    def __repr__(self):
        when = f"hour angle {self.hour_angle.to(u.hourangle):.4g}" if self.time is None else self.time.utc.iso
        site = site_name(self.site) or f"{self.site.lon.deg:.3f}, {self.site.lat.deg:.3f} deg"
        return f"<ObservingConditions at {site}, {when}, {self.pressure.to(u.hPa):.4g}>"


def check_conditions(conditions: object, *, optional: bool = False) -> None:
    """Raise an error unless an object is an `ObservingConditions`; if ``optional`` is true, None is also accepted."""
    if not isinstance(conditions, ObservingConditions) and not (optional and conditions is None):
        words = " or None" if optional else ""
        raise InputTypeError(f"conditions must be ObservingConditions{words}, got {short(conditions)}")


def _from_text(name: str, value: object, path: object) -> object:
    """Return the value of a parameter from a TOML file."""
    check_choice(name, [field.name for field in fields(ObservingConditions)], f"key of {path}")
    if name == "site" and isinstance(value, list):
        return location(value, f"{path}: site")
    if name not in EXAMPLES or (name == "humidity" and not isinstance(value, str)):
        return value
    with refusing(f"{path}: {name} must be text such as {EXAMPLES[name]!r}", value, object):
        if isinstance(value, dict):
            return {kind: u.Quantity(text) for kind, text in value.items()}
        return u.Quantity(value)
