"""What a night needs to know of an instrument: site, limits, exposure times and overheads, for each program."""

from collections.abc import Mapping
from dataclasses import dataclass

import astropy.units as u
import numpy as np
from astropy.coordinates import EarthLocation

from rfpsurvey._common.settings import Option, number_within
from rfpsurvey._common.units import to_scalar
from rfpsurvey._instruments.description import NIGHT
from rfpsurvey._instruments.entries import select_entries, value_of
from rfpsurvey._instruments.instrument import Instrument, as_instrument
from rfpsurvey._sky.conditions import as_site
from rfpsurvey._survey.night.limits import NightLimits, limits_of
from rfpsurvey.errors import InputError

TIMES = ("exposure_time", "overhead", "airmass_exponent")
ZERO = {"overhead": 0 * u.s, "airmass_exponent": 0.0}


@dataclass(frozen=True)
class NightSettings:
    """Site, and limits, exposure times (s), overheads (s) and exponents of the airmass, by program."""

    site: EarthLocation
    limits: dict[str, NightLimits]
    times: dict[str, dict[str, float]]

    def of(self, name: str, programs: np.ndarray) -> np.ndarray:
        """Return the exposure time, the overhead or the exponent of tiles of programs; NaN if it is not known."""
        values = self.times[name]
        return np.array([values.get(program, values.get("", np.nan)) for program in programs.tolist()], dtype=float)


def settings_of(instrument: Instrument | None, site: object, limits: object, **times: object) -> NightSettings:
    """Return the settings that are given, and those in the description of the instrument where none is given."""
    entries = {} if instrument is None else select_entries(instrument.values, NIGHT)
    known = {name: value_of(entry) for name, entry in entries.items()}
    named = known.pop("site", None)
    if site is None and named is None:
        raise InputError("site must be given, because the description of the instrument has none")
    own = {name: known.pop(name, ZERO.get(name)) for name in TIMES}
    used = {name: own[name] if times[name] is None else times[name] for name in TIMES}
    return NightSettings(
        as_site(named if site is None else site),
        _limits_by_program(known) if limits is None else limits_of(limits),
        {name: _numbers(value, name) for name, value in used.items()},
    )


def night_limits(instrument: Instrument | str) -> dict[str, NightLimits]:
    """Return the limits in the description of an instrument, by program.

    Parameters
    ----------
    instrument : Instrument or str
        Instrument, name of a preset, or path of a TOML file.

    Returns
    -------
    dict of str to NightLimits
        Limits of each program; the key ``""`` contains those of all other tiles, which are those of the first program.

    Raises
    ------
    InputError
        If the instrument is not known.

    Examples
    --------
    >>> from rfpsurvey.night import night_limits
    >>> night_limits("sdss_apo")["bright"].max_airmass
    2.0
    """
    entries = select_entries(as_instrument(instrument).values, NIGHT)
    return _limits_by_program({k: value_of(v) for k, v in entries.items() if k not in ("site", *TIMES)})


def _limits_by_program(values: dict) -> dict[str, NightLimits]:
    names = list(dict.fromkeys(name for value in values.values() if isinstance(value, dict) for name in value))
    first = names[0] if names else ""
    return {
        program.lower(): NightLimits(**{k: _of(value, program or first) for k, value in values.items()})
        for program in ("", *names)
    }


def _of(value: object, program: str) -> object:
    return value.get(program, next(iter(value.values()))) if isinstance(value, dict) else value


def _numbers(value: object, name: str) -> dict[str, float]:
    """Return a value, or the values of programs, as numbers (s); a missing value is left out."""
    if value is None:
        return {}
    if not isinstance(value, Mapping):
        value = {"": value}
    elif "" not in value:
        value = {"": next(iter(value.values())), **value}
    low = {"low": 0} if name in ZERO else {"above": 0}
    if name == "airmass_exponent":
        return {key.lower(): float(number_within(part, name, Option(**low, high=10))) for key, part in value.items()}
    limits = Option(**low, high=86400)
    return {key.lower(): float(number_within(to_scalar(part, u.s, name), name, limits)) for key, part in value.items()}
