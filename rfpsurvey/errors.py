"""Exceptions and warnings of rfpsurvey."""

from collections.abc import Iterable
from difflib import get_close_matches
from numbers import Integral, Number

from astropy.units import UnitsError

__all__ = [
    "InputError",
    "InputTypeError",
    "InputUnitsError",
    "RfpsurveyWarning",
    "check_choice",
    "check_switch",
    "check_whole",
    "refusal",
    "short",
]


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
        raise refusal(f"{name} must be a whole number {limits}", value, Number)


def check_choice(name: object, choices: Iterable[str], what: str) -> str:
    """Return ``name`` if it is one of ``choices``, otherwise raise an error that lists them."""
    choices = sorted(choices)
    if isinstance(name, str) and name in choices:
        return name
    if not isinstance(name, str):
        raise InputTypeError(f"unknown {what} {short(name)}; choose one of: {', '.join(choices)}.")
    close = get_close_matches(str(name).lower(), choices, n=1)
    hint = f" Did you mean {close[0]!r}?" if close else ""
    raise InputError(f"unknown {what} {name!r}; choose one of: {', '.join(choices)}.{hint}")


def check_switch(value: object, name: str) -> bool:
    """Return a truth value, or 0 or 1, as a bool."""
    if isinstance(value, Number) or type(value).__name__ == "bool":
        return bool(value)
    raise InputTypeError(f"{name} must be True or False, got {short(value)}")


def refusal(text: str, value: object, *types: type) -> InputError:
    """Return the error that something cannot be used, which is one of a wrong type unless it is of one of the types."""
    kind = InputError if isinstance(value, types) else InputTypeError
    return kind(f"{text}, got {short(value)}")


def short(value: object) -> str:
    """Return a value as text of one short line."""
    text = " ".join(repr(value).split())
    return text if len(text) < 60 else f"{type(value).__name__} {text[:40]}..."
