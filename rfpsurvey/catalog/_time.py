"""Convert epochs to Time objects."""

from numbers import Number

import astropy.units as u
import numpy as np
from astropy.time import Time

from rfpsurvey.errors import refusal

__all__ = ["to_time"]

FIRST, LAST = 1700, 2300


def to_time(value: object, name: str) -> Time:
    """Convert a Time, a Julian year or text to a Time."""
    if isinstance(value, Time):
        return value
    try:
        if isinstance(value, str):
            text = value.strip()
            try:
                value = float(text.removeprefix("J"))
            except ValueError:
                return Time(text)
        if isinstance(value, u.Quantity):
            value = value.to_value(u.yr)
        years = np.asarray(value, dtype=float)
        if not ((years > FIRST) & (years < LAST)).all():
            raise ValueError
        return Time(years, format="jyear", scale="tcb")
    except (ValueError, TypeError, u.UnitConversionError) as error:
        text = f"{name} must be a Time, a Julian year from {FIRST} to {LAST} such as 2026.5, or a date"
        raise refusal(text, value, Number, str, u.Quantity, np.ndarray, list) from error
