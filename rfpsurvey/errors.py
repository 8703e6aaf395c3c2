"""Exceptions and warnings of rfpsurvey."""

import inspect
import re
import warnings
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from difflib import get_close_matches
from functools import wraps
from numbers import Integral, Number, Real
from typing import TypeVar

from astropy.units import UnitsError

__all__ = ["InputError", "InputTypeError", "InputUnitsError", "RfpsurveyWarning"]

INCONVERTIBLE = TypeError, ValueError, OverflowError
"""Exceptions of Python, NumPy and astropy for values that they cannot convert; floats cannot contain all integers."""
T = TypeVar("T", bound=Callable)
LONGEST = 60
# Of a word that has more than three times this number of characters, a message contains the beginning and the end.
WORD = 100
LONG_GAP = re.compile(r"\s{9,}")
LONG_WORD = re.compile(rf"[^\s/\\]{{{3 * WORD + 1},}}")  # paths are divided into the names of folders
MOST_CHOICES = 60
LARGEST = 1.7e308
MOST_WHOLE = 2**53
# Renamed parameters of earlier versions. Each entry contains the old name, the name of a present parameter, and the
# text that the error message suggests if the function has the present parameter.
RENAMED = (
    ("tiling", "tiles", "tiles=..."),
    ("points", "catalog", "catalog=..."),
    ("field", "catalog", "catalog=..."),
    ("focal_plane", "instrument", "instrument=..."),
    ("method", "allocator", "allocator=..."),
    ("l1", "central_arm", "central_arm=..."),
    ("seed", "rng", "rng=..."),
    ("n_targets", "targets", "targets=RandomTargets(number=...)"),
    ("target_radius", "targets", "targets=RandomTargets(radius=...)"),
    ("min_separation", "targets", "targets=RandomTargets(min_separation=...)"),
    ("min_separation", "fibers", "fibers=Fibers(min_separation=...)"),
    *((name, "precision", f"precision=Precision({name}=...)") for name in ("max_iterations", "confidence", "interval")),
    *(
        (name, "loss", f"loss=LossOptions({name}=...)")
        for name in ("estimand", "method", "targets_per_positioner", "target_density", "n_skies", "time_limit")
    ),
    *(
        (name, parameter, f"{parameter}=AllocationOptions({name}=...)")
        for name in (
            "constraints",
            "keep_out",
            "objective",
            "parked_obstacles",
            "required",
            "requirements",
            "sky_separation",
            "start",
            "subpriority",
            "time_limit",
        )
        for parameter in ("allocator", "options")
    ),
)


class InputError(ValueError):
    """An input is not valid; the message states what the input must be and what was given.

    If the type is wrong, the error is also a `TypeError`. If the unit is wrong, the error is also an
    `~astropy.units.UnitsError`. The message is one line: control characters and long words of files are not repeated.
    """

    def __init__(self, text: object = ""):
        super().__init__(one_line(str(text)))


class InputTypeError(InputError, TypeError):
    """An input has a wrong type; this error is also a `TypeError`."""


class InputUnitsError(InputError, UnitsError):
    """An input has a wrong unit; this error is also an `~astropy.units.UnitsError`."""


class RfpsurveyWarning(UserWarning):
    """Warning that input was ignored, that a value was assumed for missing input, or that a goal was not reached."""


def check_whole(value: object, name: str, low: int = 1, high: int | None = None) -> int:
    """Return a whole number from ``low`` to ``high``; raise an error for any other value, such as a boolean."""
    whole = isinstance(value, Integral) and not isinstance(value, bool)
    if not (whole and low <= value <= (MOST_WHOLE if high is None else high)):
        wide = high is None and whole and value > MOST_WHOLE
        limits = f"from {low} to 2^53" if wide else f"of at least {low}" if high is None else f"from {low} to {high}"
        raise refusal(f"{name} must be a whole number {limits}", value, Number)
    return int(value)


def is_real(value: object) -> bool:
    """Return whether a value is a number, but not a boolean, that is not too large for a float; NaN is a number."""
    return isinstance(value, Real) and not isinstance(value, bool) and not LARGEST < abs(value) < float("inf")


def items_of(value: object, text: str, *single: type) -> list:
    """Return the items of a list, or a list of one item if this item has one of the types ``single``.

    ``text`` is the beginning of the error message for objects that have no items.
    """
    if isinstance(value, single):
        return [value]
    try:
        return list(value)
    except TypeError:
        raise refusal(text, value, list) from None


def warn(text: str) -> None:
    """Issue an `RfpsurveyWarning` that points to the first caller outside rfpsurvey."""
    level, frame = 2, inspect.currentframe().f_back
    while frame.f_back is not None and frame.f_globals.get("__name__", "").partition(".")[0] == "rfpsurvey":
        level, frame = level + 1, frame.f_back
    warnings.warn(one_line(text), RfpsurveyWarning, stacklevel=level)


def one_line(text: str) -> str:
    """Return text without line breaks, control characters and very long words or gaps, which files could contain."""
    if not text.isprintable():
        text = re.sub(r"\s*\n\s*", " ", text.strip())
        text = "".join(c if c.isprintable() else repr(c)[1:-1] for c in text)
    text = LONG_GAP.sub(" ", text)
    return LONG_WORD.sub(lambda match: f"{match[0][:WORD]}...{match[0][-WORD:]}", text)


# Options that cause no warning in `warn_no_effect`, because the caller uses them; None stands for all options.
_used_elsewhere: ContextVar[frozenset[str] | None] = ContextVar("used_elsewhere", default=frozenset())


@contextmanager
def used_elsewhere(*names: str) -> Iterator[None]:
    """Issue no warnings that options have no effect, because the caller also uses them; without names, all options."""
    before = _used_elsewhere.get()
    token = _used_elsewhere.set(None if before is None or not names else before | {*names})
    try:
        yield
    finally:
        _used_elsewhere.reset(token)


def warn_no_effect(name: str, why: str) -> None:
    """Issue a warning that an option was given although it has no effect; ``why`` completes the sentence."""
    silent = _used_elsewhere.get()
    if silent is not None and name not in silent:
        warn(f"{name} has no effect {why}")


def warn_of_unused(given: Iterable[str], chosen: Collection, methods: Iterable, what: str) -> None:
    """Issue a warning for each given option that none of the chosen methods uses, although other methods use it.

    Parameters
    ----------
    given : iterable of str
        Names of the options whose values differ from the default values.
    chosen : collection of Method
        The methods that are used.
    methods : iterable of Method
        All built-in methods.
    what : str
        Noun for a method, such as "allocator".
    """
    for name in given:
        users = [method.name for method in methods if method.options is not None and name in method.options]
        if users and not any(method.uses(name) for method in chosen):
            who = f"{', '.join(users[:-1])} and {users[-1]} use" if len(users) > 1 else f"{users[0]} uses"
            names = dict.fromkeys(repr(method.name) for method in chosen)
            plural = "s" if len(names) > 1 else ""
            warn_no_effect(name, f"with the {what}{plural} {' and '.join(names)}; only {who} it")


def close_to(name: object, choices: Iterable[str], cutoff: float = 0.6) -> str:
    """Return a question that names the choice most similar to ``name``, or empty text if no choice is similar."""
    lower = {str(choice).lower(): str(choice) for choice in choices}
    close = get_close_matches(str(name).lower(), sorted(lower), n=1, cutoff=cutoff)
    return f"did you mean {lower[close[0]]!r}?" if close else ""


def number_of(n: int, noun: str, plural: str = "") -> str:
    """Return a number with its noun, such as "1 target" or "2 targets"; an irregular plural must be given."""
    return f"{n} {noun if n == 1 else plural or noun + 's'}"


def listed(values: Iterable, most: int | None = None) -> str:
    """Return values separated by commas, or "none"; if there are more than ``most``, the number of others follows."""
    texts = [str(value) for value in values]
    shown = ", ".join(texts[:most]) or "none"
    return f"{shown} and {len(texts) - most} more" if most is not None and len(texts) > most else shown


def brief(values: tuple) -> str:
    """Return text with the first five values of a list and the total number of values."""
    return f"{listed(values[:5])} ({len(values)} in all)"


def check_choice(name: object, choices: Iterable[str], what: str, *, also: str = "") -> str:
    """Return ``name`` if it is one of ``choices``; otherwise, raise an error that lists all choices."""
    choices = sorted(choices)
    if isinstance(name, str) and name in choices:
        return name
    known = listed(filter(None, choices), MOST_CHOICES) + also
    if not isinstance(name, str):
        raise InputTypeError(f"unknown {what} {short(name)}; choose one of: {known}.")
    hint = close_to(name, choices).replace("did", " Did", 1)
    raise InputError(f"unknown {what} {name!r}; choose one of: {known}.{hint}")


def check_fiber_type(name: str, fiber_types: Iterable[str], what: str = "fiber type") -> None:
    """Raise an error unless ``name`` is one of the fiber types of a focal plane, ``("",)`` if it has no fiber types."""
    if name not in fiber_types and not any(fiber_types):
        raise InputError(
            f"unknown {what} {name!r}: the positioners have no fiber types; the column fiber_type of a focal plane "
            "states the fiber types of its positioners"
        )
    check_choice(name, fiber_types, what)


def check_switch(value: object, name: str) -> bool:
    """Convert a boolean or a number to a bool; raise an error for other values."""
    if isinstance(value, Number) or type(value).__name__ == "bool":
        return bool(value)
    raise InputTypeError(f"{name} must be True or False, got {short(value)}")


def refusal(text: str, value: object, *types: type) -> InputError:
    """Return the error for an invalid value: an InputError if it has one of ``types``, otherwise an InputTypeError."""
    kind = InputError if isinstance(value, types) else InputTypeError
    return kind(f"{text}, got {short(value)}")


@contextmanager
def refusing(text: str, value: object, *types: type) -> Iterator[None]:
    """Convert exceptions for a value that Python, NumPy or astropy cannot convert to the error of `refusal`."""
    try:
        yield
    except InputError:
        raise
    except INCONVERTIBLE:
        raise refusal(text, value, *types) from None


def short(value: object) -> str:
    """Return one short line of text for a value; the text for a table states its type and length.

    The text for a class, which could be given in place of an object of the class, is its name.
    """
    name = type(value).__name__
    if hasattr(value, "columns") or hasattr(value, "colnames"):  # a table, possibly of another package
        return f"a {name} of {number_of(len(value), 'row')}"
    if isinstance(value, type):
        return f"the class {value.__name__}"
    try:
        text = " ".join(repr(value).split())
    except ValueError:  # Python does not print integers with thousands of digits
        return f"{name} with too many digits"
    return text if len(text) < LONGEST else f"{name} {text[:40]}..."


def check_keywords(function: T) -> T:
    """Decorate a function or class such that the error for an unknown parameter suggests a similar parameter."""
    if inspect.isclass(function):
        function.__init__ = _checked(function.__init__, function.__qualname__)
        return function
    return _checked(function, function.__qualname__)


def _checked(function, title):
    parameters = inspect.signature(function).parameters

    @wraps(function)
    def checked(*args, **kwargs):
        for name in kwargs.keys() - parameters.keys():
            raise InputTypeError(f"{title} has no parameter {name!r}; {_instead_of(name, [*parameters])}")
        return function(*args, **kwargs)

    return checked


def _instead_of(name, parameters):
    """Return a hint for an unknown parameter: its replacement, a similar parameter, or a list of all parameters."""
    for old, needed, new in RENAMED:
        if old == name and needed in parameters:
            return f"write {new}"
    names = [name for name in parameters if name not in ("self", "cls")]
    return close_to(name, names) or f"its parameters are: {', '.join(names)}"
