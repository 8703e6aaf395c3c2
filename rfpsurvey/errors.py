"""Exceptions and warnings of rfpsurvey."""

from collections.abc import Iterable
from difflib import get_close_matches
from numbers import Integral

from astropy.units import UnitsError

__all__ = ["InputError", "InputTypeError", "InputUnitsError", "RfpsurveyWarning", "check_choice", "check_whole"]


class InputError(ValueError):
    """What was given cannot be used; the message says what must be what, and what was given.

    An error that is due to a wrong type is a `TypeError` too, and one due to a wrong unit an
    `~astropy.units.UnitsError`.
    """


class InputTypeError(InputError, TypeError):
    """What was given is of another type than it must be; also a `TypeError`."""


class InputUnitsError(InputError, UnitsError):
    """What was given has another unit than it must have; also an `~astropy.units.UnitsError`."""


class RfpsurveyWarning(UserWarning):
    """Something was left out or assumed; the message says what, and how much of it."""


def check_whole(value: object, name: str, low: int = 1, high: int | None = None) -> None:
    """Raise an error unless ``value`` is a whole number from ``low`` to ``high``; booleans are none."""
    whole = isinstance(value, Integral) and not isinstance(value, bool)
    if not (whole and low <= value and (high is None or value <= high)):
        limits = f"of at least {low}" if high is None else f"from {low} to {high}"
        raise InputError(f"{name} must be a whole number {limits}, got {value!r}")


def check_choice(name: object, choices: Iterable[str], what: str) -> str:
    """Return ``name`` if it is one of ``choices``, otherwise raise an error that lists them."""
    choices = sorted(choices)
    if isinstance(name, str) and name in choices:
        return name
    close = get_close_matches(str(name).lower(), choices, n=1)
    hint = f" Did you mean {close[0]!r}?" if close else ""
    raise InputError(f"unknown {what} {name!r}; choose one of: {', '.join(choices)}.{hint}")
