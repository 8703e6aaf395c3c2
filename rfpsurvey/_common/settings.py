"""Settings: frozen dataclasses whose fields are options, each of which is described once, at its field.

The annotation of a field states the type and the unit of an option, and `option` states its limits or choices, its name
in records, and how it is converted. The help is the documentation of the parameter in the docstring of the class. The
check of each value with its error message, records, comparisons, texts, and the keys of commands follow from these.
"""

from collections.abc import Callable, Collection, Mapping
from dataclasses import MISSING, dataclass, field, fields
from functools import cache, cached_property
from inspect import cleandoc
from re import MULTILINE, findall, sub
from types import NoneType, UnionType
from typing import Annotated, Any, ClassVar, Union, get_args, get_origin

import astropy.units as u
import numpy as np

from rfpsurvey._common.descriptions import to_html
from rfpsurvey._common.units import ByValue, to_scalar, to_unit, value_of
from rfpsurvey.errors import (
    LARGEST,
    InputError,
    InputTypeError,
    InputUnitsError,
    brief,
    check_choice,
    check_switch,
    check_whole,
    listed,
    refusal,
    refusing,
    short,
)

# ``repr`` shortens lists of more than this number of values.
MOST_SHOWN = 20
# Significant digits of numbers that are compared.
DIGITS = 13


@dataclass(frozen=True)
class Option:
    """The description of an option, apart from its type, its unit and its help."""

    # limits of a number, or of a quantity in the unit of the annotation; ``low`` and ``high`` are valid values, and are
    # the only limits of whole numbers, whose ``low`` is 1 by default
    above: float | None = None
    low: float | None = None
    below: float | None = None
    high: float | None = None
    choices: Collection[str] = ()
    what: str = ""  # name of the option in error messages; by default, the name of its field
    words: str = ""  # text that states which values are valid, for error messages about objects of other types
    convert: Callable | None = None  # checks and converts a value, in place of all checks but limits of quantities
    record: str | None = ""  # name in records, by default that of the field with the unit; None: not in records
    unit: u.UnitBase | None = None  # unit of the number in records, if it differs from the unit of the annotation
    to_record: Callable | str | None = None  # function, or name of the attribute, that gives the value in records
    from_record: Callable | None = None  # function that converts the value in records back
    by_record: bool = False  # whether values are compared as in records, after ``to_record``
    sparse: bool = False  # whether records omit the default value
    text: str = ""  # text for readers who do not know the name of the option; ``{:g}`` stands for the number

    def contains(self, number: float) -> bool:
        """Return whether a number is finite and within the limits."""
        inside = (self.above is None or number > self.above) and (self.below is None or number < self.below)
        inside &= (self.low is None or number >= self.low) and (self.high is None or number <= self.high)
        return inside and abs(number) <= LARGEST

    def limits(self, unit: object = "") -> str:
        """Return text with the limits and their unit, to be used after a noun such as "number"."""
        if self.low is not None and self.high is not None:
            return f" from {self.low:g} to {self.high:g} {unit}".rstrip()
        words = {"above": self.above, "of at least": self.low, "below": self.below, "up to": self.high}
        texts = [f"{word} {limit:g} {unit}".rstrip() for word, limit in words.items() if limit is not None]
        return " " * bool(texts) + " and ".join(texts)


ANY_NUMBER = Option()


def option(default: Any = MISSING, *, compare: bool = True, **description: Any) -> Any:
    """Return a field of a dataclass of settings with a default value and the values of `Option`."""
    return field(default=default, compare=compare, metadata={"option": Option(**description)})


def number_within(value: object, what: str, limits: Option = ANY_NUMBER) -> int | float:
    """Return a number within limits as a Python number; raise an error for any other value, such as a boolean."""
    is_plain = isinstance(value, u.Quantity) and value.unit.is_equivalent(u.dimensionless_unscaled)
    number = to_scalar(value, u.dimensionless_unscaled, what) if is_plain else value
    if isinstance(number, np.integer | np.floating):
        number = number.item()
    if isinstance(number, int | float) and not isinstance(number, bool) and limits.contains(number):
        return number
    raise refusal(f"{what} must be a number{limits.limits()}", value, int, float, np.number)


def members_of(hint: object) -> list:
    """Return the members of a union of types, without annotations."""
    if get_origin(hint) is Annotated:
        return members_of(get_args(hint)[0])
    if get_origin(hint) in (Union, UnionType):
        return [kind for member in get_args(hint) for kind in members_of(member)]
    return [hint]


def extra_of(hint: object) -> list:
    """Return the annotations of a type, and of the members of a union of types."""
    if get_origin(hint) is Annotated:
        inside, *extra = get_args(hint)
        return [*extra, *extra_of(inside)]
    return [extra for member in get_args(hint) for extra in extra_of(member)]


@dataclass(frozen=True)
class OptionField:
    """An option of a class: its field, the types of its annotation, its unit and its description."""

    name: str
    hint: object
    default: object
    compare: bool
    option: Option
    named: str  # name in error messages

    @cached_property
    def kinds(self) -> dict[type, tuple]:
        """The types of the annotation, with the arguments of types such as ``list[int]``."""
        return {get_origin(member) or member: get_args(member) for member in members_of(self.hint)}

    @cached_property
    def units(self) -> tuple[u.UnitBase, ...]:
        """The units of the annotation, of which the value has one; none if the value is no quantity."""
        return tuple(dict.fromkeys(unit for unit in extra_of(self.hint) if isinstance(unit, u.UnitBase)))

    @cached_property
    def records(self) -> dict[str, u.UnitBase | None]:
        """The name in records and its unit; several names if the value can have different units."""
        if self.option.record:
            return {self.option.record: self.option.unit or next(iter(self.units), None)}
        return {f"{self.name}_{unit}".lower(): unit for unit in self.units} or {self.name: None}

    def unit_of(self, value: object) -> u.UnitBase | None:
        """Return the unit in records of a value; the last unit if the value has none."""
        given = getattr(value, "unit", None)
        fits = [unit for unit in self.records.values() if given is not None and given.is_equivalent(unit)]
        return [*self.records.values(), *fits[:1]][-1]

    def valid(self, value: object) -> object:
        """Return a value after its check."""
        option, what = self.option, self.named
        kinds = [kind for kind in self.kinds if kind is not NoneType]
        if value is None and (NoneType in self.kinds or self.default is None) and self.default in (None, MISSING):
            return None
        if option.convert is not None:
            value = option.convert(value)
            return self._quantity(value, what) if self.units else value
        if option.choices:
            return check_choice(value, option.choices, what)
        if self.units and isinstance(value, dict) and dict in kinds:
            return {name: self._quantity(inside, f"{what} of {name}") for name, inside in value.items()}
        if self.units:
            return self._quantity(value, what)
        if kinds == [bool]:
            return check_switch(value, what)
        if kinds == [float]:
            return number_within(value, what, option)
        if kinds == [int]:
            return check_whole(value, what, 1 if option.low is None else option.low, option.high)
        types = tuple(kind for kind in kinds if isinstance(kind, type))
        # text can be empty only if this is the default value
        is_blank = kinds == [str] and self.default != "" and isinstance(value, str) and not value.strip()
        if object in kinds or (isinstance(value, types) and not is_blank):
            return value
        words = option.words or ("text" if kinds == [str] else listed(kind.__name__ for kind in types))
        raise refusal(f"{what} must be {words}", value, *types)

    def _quantity(self, value: object, what: str) -> object:
        option, unit = self.option, self.units[0]
        if len(self.units) > 1:
            given = getattr(value, "unit", None)
            unit = next((unit for unit in self.units if given is not None and given.is_equivalent(unit)), None)
            if unit is None:
                kind = InputTypeError if given is None else InputUnitsError
                raise kind(f"{what} must be {option.words}, got {short(value)}{' without a unit' * (given is None)}")
        number = to_unit(value, unit, what)
        if number.shape != ():
            raise InputError(f"{what} must be one value, got the shape {number.shape}")
        if not option.contains(number):
            raise InputError(f"{what} must be one finite value{option.limits(unit)}, got {value}")
        return value

    def plain(self, value: object, settings: object = None) -> object:
        """Return a value, which is that of an object of settings, as it is written to records."""
        convert = self.option.to_record
        if value is None or convert is not None:
            return None if value is None else getattr(settings, convert) if isinstance(convert, str) else convert(value)
        if isinstance(value, dict):
            return {name: self.plain(item) for name, item in value.items()}
        return float(value.to_value(self.unit_of(value))) if isinstance(value, u.Quantity) else value

    def restored(self, value: object, name: str = "") -> object:
        """Return the value of the option for a value in a record; by default, its name is the first of ``records``."""
        if value is None:
            return None
        if self.option.from_record is not None:
            with refusing(f"{self.named} must be a value of a record", value, object):
                return self.option.from_record(value)
        if isinstance(value, dict):
            return {key: self.restored(item, name) for key, item in value.items()}
        unit = self.records.get(name, next(iter(self.records.values())))
        return value if unit is None else number_within(value, self.named) * unit

    def compared(self, value: object, settings: object = None) -> object:
        """Return an object that can be compared and hashed, and that is equal for equal values."""
        by_record = self.option.to_record is None or self.option.by_record
        plain = value_of(_rounded(self.plain(value, settings)) if by_record else value)
        return (plain, str(self.unit_of(value))) if len(self.units) > 1 else plain

    def is_default(self, settings: object) -> bool:
        """Return whether the value of an object of settings is the default value."""
        value = getattr(settings, self.name)
        if value is None or self.default in (None, MISSING):
            return value is self.default
        return self.compared(value, settings) == self.compared(self.default)


def _rounded(value: object) -> object:
    """Return a number, or the numbers of a dict, without the errors of conversions from other units."""
    if isinstance(value, dict):
        return {name: _rounded(number) for name, number in value.items()}
    return float(f"{value:.{DIGITS}g}") if isinstance(value, float) else value


def not_invertible(text: str) -> Callable:
    """Return a function in place of ``from_record`` that raises an error, because records do not determine a value."""

    def refuse(value: object) -> None:
        raise InputError(f"{text}, got {short(value)}")

    return refuse


@cache
def options_of(cls: type) -> tuple[OptionField, ...]:
    """Return the options of a dataclass, in the order of its fields; the annotation can contain the description."""
    options = []
    for f in fields(cls):
        given = (f.metadata.get("option"), *(extra for extra in extra_of(f.type) if isinstance(extra, Option)))
        described = next((extra for extra in given if extra is not None), Option())
        if f.init:
            named = described.what or getattr(cls, "_what", "{}").format(f.name)
            options.append(OptionField(f.name, f.type, f.default, f.compare, described, named))
    return tuple(options)


@cache
def help_texts(cls: type) -> dict[str, str]:
    """Return the documentation of each parameter in the docstrings of a class and its bases, as plain text."""
    texts = {}
    for base in reversed(cls.__mro__):
        section = cleandoc(base.__doc__ or "").partition("Parameters\n----------\n")[2].partition("\n\n")[0]
        for names, text in findall(r"^(\w[\w, ]*) : .*\n((?:    .*(?:\n|$))+)", section, MULTILINE):
            plain = sub(r"`+~?([^`]*)`+", r"\1", " ".join(text.split()))
            texts |= dict.fromkeys(names.split(", "), plain)
    return texts


class Checked:
    """Base class of frozen dataclasses whose fields are options, which are checked when an object is made."""

    _what: ClassVar[str] = "{}"
    """Text that names an option in error messages; braces stand for its name."""

    def __post_init__(self):
        for setting in options_of(type(self)):
            value = getattr(self, setting.name)
            checked = setting.valid(value)
            if checked is not value:
                object.__setattr__(self, setting.name, checked)
        self._check()

    def _check(self) -> None:
        """Raise an error if options do not fit each other; classes override this method."""


class Settings(Checked, ByValue):
    """Base class of frozen dataclasses whose fields are options, with records and texts.

    Objects are equal if the values of their options are equal, in whatever units they are given.
    """

    _order: ClassVar[tuple[str, ...]] = ()
    """Names of records that precede the others, which have the order of the fields."""

    @property
    def record(self) -> dict:
        """The options as text and numbers, in the form in which files store them."""
        record = {}
        for setting in options_of(type(self)):
            if setting.option.record is not None and not (setting.option.sparse and setting.is_default(self)):
                value = getattr(self, setting.name)
                unit = setting.unit_of(value)
                record |= {name: setting.plain(value, self) for name, given in setting.records.items() if given is unit}
        return {name: record.pop(name) for name in self._order if name in record} | record

    @classmethod
    def from_record(cls, record: dict, **others: object) -> Any:
        """Return the object whose attribute ``record`` is given.

        Parameters
        ----------
        record : dict
            Attribute ``record`` of an object; further entries are ignored.
        **others : object
            Values of parameters, in place of those of the record.

        Returns
        -------
        object
            An object that is equal to the object of the record.

        Raises
        ------
        InputError
            If a value is missing or not valid, or if the record does not determine it.
        """
        if not isinstance(record, Mapping):
            raise InputTypeError(f"a record of {cls.__name__} must be a dict, got {short(record)}")
        given = {*others}
        for setting in options_of(cls):
            name = next((name for name in setting.records if name in record), None)
            if setting.name in others:
                continue
            if name is not None and setting.option.record is not None:
                others[setting.name] = setting.restored(record[name], name)
            elif setting.default is MISSING:
                names = listed(setting.records)
                raise InputError(f"a record of {cls.__name__} must contain {names}, got {short(record)}")
        return cls(**others)._completed(record, given)

    def _completed(self, record: dict, given: Collection[str]) -> Any:
        """Return the object with values that depend on several entries of its record and are not ``given``."""
        return self

    def _values(self) -> tuple:
        return tuple(f.compared(getattr(self, f.name), self) for f in options_of(type(self)) if f.compare)

    def changed(self) -> list[str]:
        """Return the names of the options, except the first, that do not have their default values.

        Returns
        -------
        list of str
            The names.
        """
        return [setting.name for setting in options_of(type(self))[1:] if not setting.is_default(self)]

    def _repr_html_(self) -> str:
        return to_html(self, {setting.name: _shown(getattr(self, setting.name)) for setting in options_of(type(self))})

    def __repr__(self):
        first = getattr(self, options_of(type(self))[0].name)
        texts = [f"{name}={_shown(getattr(self, name))}" for name in self.changed()]
        first = getattr(first, "__qualname__", first) if callable(first) else first
        return f"{type(self).__name__}({', '.join([*([] if first is None else [repr(first)]), *texts])})"


def _shown(value: object) -> str:
    """Return the text of a value, with only the first values of a long list."""
    return f"({brief(value)})" if isinstance(value, tuple) and len(value) > MOST_SHOWN else repr(value)
