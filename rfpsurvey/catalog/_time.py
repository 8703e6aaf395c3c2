"""Convert epochs to Time objects."""

from numbers import Number

import astropy.units as u
import numpy as np
from astropy.time import Time
from astropy.utils.masked import Masked

from rfpsurvey._units import rows_of
from rfpsurvey.errors import InputError, refusal, short

__all__ = ["known_epochs", "to_time"]

FIRST, LAST = 1700, 2300


def to_time(value: object, name: str, *, gaps: bool = False) -> Time:
    """Convert a Time, a Julian year or text to a Time; with ``gaps``, some times may be masked."""
    if isinstance(value, Time):
        if not gaps and np.any(value.mask):
            raise InputError(f"{name} must not have masked values, got {short(value)}")
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
        missing = np.asarray(getattr(value, "mask", False))
        years = np.asarray(getattr(value, "unmasked", value), dtype=float)
        if not ((years > FIRST) & (years < LAST) | missing).all():
            raise ValueError
        years = Masked(np.where(missing, 2000.0, years), mask=missing) if missing.any() else years
        return to_time(Time(years, format="jyear", scale="tcb"), name, gaps=gaps)
    except InputError:
        raise
    except (ValueError, TypeError, u.UnitConversionError) as error:
        text = f"{name} must be a Time, a Julian year from {FIRST} to {LAST} such as 2026.5, or a date"
        raise refusal(text, value, Number, str, u.Quantity, np.ndarray, list) from error


def known_epochs(epoch: Time, moves: np.ndarray) -> Time | None:
    """Return epochs without masked values; ``moves`` states which targets have a proper motion and need an epoch."""
    missing = np.broadcast_to(np.asarray(epoch.mask), moves.shape)
    if not missing.any():
        return epoch
    if (missing & moves).any():
        lacking = rows_of(missing & moves)
        raise InputError(f"epoch must be a time for every target with a proper motion, but {lacking} have none")
    rows = np.arange(len(moves))
    return None if missing.all() else epoch[np.where(missing, rows[~missing][0], rows)]
