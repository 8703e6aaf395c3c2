"""Dates of observations in tables."""

import re
from datetime import UTC, datetime, timedelta
from functools import cache

import numpy as np
from astropy.time import Time

from rfpsurvey.errors import InputError

MJD = 40_000, 100_000
"""Range of the numbers that are modified Julian dates: the years 1968 to 2132."""


def to_date(value: object) -> str:
    """Return a date as text such as 2026-01-03; empty text for missing dates.

    Dates are text, numbers such as 20260103, times, or modified Julian dates. Times with a time zone are converted to
    UTC.
    """
    if value is None or value is np.ma.masked or (isinstance(value, int | np.integer) and value == 0):
        return ""
    if isinstance(value, bytes):
        value = value.decode("utf-8", "replace")
    if isinstance(value, int | float | np.number) and MJD[0] < value < MJD[1]:
        value = Time(float(value), format="mjd", scale="utc")
    if isinstance(value, float | np.floating) and value == np.floor(value):
        value = int(value)
    if np.shape(value) == (2,):  # Julian date in two parts, in FITS tables of astropy
        value = Time(*np.asarray(value, dtype=float), format="jd", scale="utc")
    if isinstance(value, Time):
        return value.utc.isot[:10]
    return _date_of(str(value).strip().removesuffix("Z"))


@cache
def _date_of(text: str) -> str:
    if text in ("", "nan", "NaT"):
        return ""
    if re.fullmatch(r"\d{8}", text):
        text = f"{text[:4]}-{text[4:6]}-{text[6:]}"
    if re.fullmatch(r"\d{5}(\.\d*)?", text):
        return to_date(float(text))
    try:
        if re.search(r"\d\d:\d\d.*[+-]\d\d:?\d\d$", text):
            return str(datetime.fromisoformat(text).astimezone(UTC).date())
        return Time(text, scale="tai").isot[:10]  # without warnings of future leap seconds
    except ValueError:
        raise InputError(f"date must be a date such as 2026-01-03, got {text!r}") from None


def check_not_future(dates: list[str]) -> None:
    """Raise an error if a date is later than tomorrow according to the clock, because it is probably not correct."""
    tomorrow = str((datetime.now(UTC) + timedelta(days=1)).date())
    if late := [date for date in dates if date > tomorrow]:
        raise InputError(
            f"date must not be later than tomorrow, got {max(late)}; to record it, use allow_future=True "
            "(or --allow-future)"
        )
