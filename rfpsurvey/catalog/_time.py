"""Epochs."""

import astropy.units as u
import numpy as np
from astropy.time import Time

from rfpsurvey.errors import InputError

__all__ = ["to_time"]


def to_time(value: object, name: str) -> Time:
    """Return a Time from a Time, a Julian year or text."""
    if isinstance(value, Time):
        return value
    try:
        if isinstance(value, str):
            try:
                return Time(float(value), format="jyear", scale="tcb")
            except ValueError:
                return Time(value)
        if isinstance(value, u.Quantity):
            value = value.to_value(u.yr)
        return Time(np.asarray(value, dtype=float), format="jyear", scale="tcb")
    except (ValueError, TypeError, u.UnitConversionError) as error:
        raise InputError(f"{name} must be a Time, a Julian year such as 2026.5 or a date, got {value!r}") from error
