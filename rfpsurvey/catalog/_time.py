"""Convert epochs and times of observations to Time objects."""

from datetime import date, datetime
from numbers import Number

import astropy.units as u
import numpy as np
from astropy.time import Time
from astropy.utils.masked import Masked

from rfpsurvey._readers import parse_number
from rfpsurvey._units import rows_of
from rfpsurvey.errors import INCONVERTIBLE, InputError, is_real, refusal, short

FIRST, LAST = 1700, 2300
DATED = Time, date, np.datetime64


def to_time(value: object, name: str, *, gaps: bool = False, one: bool = False) -> Time:
    """Convert a Time, a date, a Julian year, or text with a date or a Julian year, to a Time.

    With ``gaps``, some times may be masked. With ``one``, the value must be a single time.
    """
    try:
        found = _of_date(value)
        found = _of_years(_as_number(value)) if found is None else found
    except INCONVERTIBLE:
        text = (
            f"{name} must be a Time, a Julian year from {FIRST} to {LAST} such as 2026.5, or a date such as 2026-07-01"
        )
        raise refusal(text, value, Number, str, u.Quantity, np.ndarray, list) from None
    if one and not found.isscalar:
        raise InputError(f"{name} must be one time, got the shape {found.shape}")
    if not gaps and np.any(found.mask):
        raise InputError(f"{name} must not have masked values, got {short(value)}")
    return found


def to_moment(value: object, name: str) -> Time:
    """Convert a Time, or a date and time (UTC) as a datetime or as text, to one Time."""
    text = f"{name} must be a date and time (UTC) such as 2026-07-01T06:30:00"
    try:
        found = _of_date(value)
        found = None if isinstance(value, str) and found.format == "byear_str" else found
    except (ValueError, TypeError, AttributeError):
        found = None
    if found is None:
        year = _as_number(value)
        known = is_real(year) and FIRST < year < LAST
        remedy = f"; the Julian year {year} is {_of_years(year).utc.isot[:16]} in this form" if known else ""
        raise refusal(f"{text}{remedy}", value, Number, str)
    if not found.isscalar or found.mask:
        what = "a masked value" if found.isscalar else f"the shape {found.shape}"
        raise InputError(f"{text}, got {what}")
    return found


def _of_date(value: object) -> Time | None:
    """Return the Time for a Time, for dates, or for text in ISO 8601; None for a number, also as text."""
    if isinstance(value, Time):
        return value
    if isinstance(value, date) and not isinstance(value, datetime):
        value = value.isoformat()
    if isinstance(value, DATED) or np.asarray(value).dtype.kind == "M":
        return Time(value)
    if not isinstance(value, str) or isinstance(_as_number(value), float):
        return None
    try:
        return Time(value.strip())
    except ValueError:
        return Time(datetime.fromisoformat(value.strip()))  # with a time zone


def _as_number(value: object) -> object:
    """Return the number of a text such as "2026.5" or "J2026.5"; return other values unchanged."""
    try:
        return parse_number(value.strip().removeprefix("J")) if isinstance(value, str) else value
    except ValueError:
        return value


def _of_years(value: object) -> Time:
    """Return the Time for Julian years; masked years become masked times."""
    if isinstance(value, u.Quantity):
        value = value.to_value(u.yr)
    missing = np.asarray(getattr(value, "mask", False))
    years = np.asarray(getattr(value, "unmasked", value), dtype=float)
    if not ((years > FIRST) & (years < LAST) | missing).all():
        raise ValueError
    years = Masked(np.where(missing, 2000.0, years), mask=missing) if missing.any() else years
    return Time(years, format="jyear", scale="tcb")


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
