"""Keys of commands: fields of dataclasses, which a plan file, the option --set, or another option sets.

The name of a key is the name of its table, a dot, and the name of the field, such as ``joint.time_limit``. Its help is
the documentation of the parameter in the docstring of the class. The field states its unit, its limits and its choices.
The value of a key is kept as in TOML, with paths relative to the current folder, until `build` converts it.
"""

import os
import re
from collections.abc import Callable
from dataclasses import dataclass, is_dataclass
from datetime import date, datetime
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import astropy.units as u
import numpy as np
from astropy.time import Time

from rfpsurvey._common.read_tables import has_other_digits
from rfpsurvey._common.settings import OptionField, extra_of, help_texts, members_of, options_of
from rfpsurvey._sky.region import Region
from rfpsurvey.errors import INCONVERTIBLE, InputError, InputTypeError, close_to, listed, short

# Types in annotations, in the order in which messages name them, with the types of their values in TOML.
KINDS: dict[Any, tuple] = {
    bool: ("true or false", (bool,)),
    int: ("a whole number", (int,)),
    float: ("a number", (int, float)),
    u.Quantity: ("a number", (int, float, str)),
    Path: ("a path", (str,)),
    os.PathLike: ("a path", (str,)),
    Region: ("a region", (str,)),
    Time: ("a date and time (UTC) such as 2026-07-01T06:30:00", (date, datetime, str)),
    str: ("text", (str,)),
    list: ("a list", (list,)),
    dict: ("a table", (dict,)),
    object: ("a value", (object,)),
}


EXACT_TIME = re.compile(rf"({'|'.join(Time.FORMATS)}) ({'|'.join(Time.SCALES)}) (\d+\.\d+) (-?[\d.e-]+\d)")


class Located:
    """Annotation of text that is a path if a file of this name exists, and otherwise the name of an object."""


@dataclass(frozen=True)
class Part:
    """Annotation of a table whose keys are parameters of a class of the library; its value is a dict of arguments."""

    cls: type
    more: type | None = None
    """Dataclass with further keys."""
    omit: tuple[str, ...] = ()
    from_text: Callable[[str], dict] | None = None
    """Function that returns the values by key for a text that is given in place of a table."""


@dataclass(frozen=True)
class Key:
    """A key, with the description of its field and its help."""

    name: str
    field: OptionField
    text: str

    @cached_property
    def kinds(self) -> dict:
        """The types of the key that values in TOML can have, with the arguments of types such as ``list[int]``."""
        insides = {list if kind in (tuple, np.ndarray) else kind: inside for kind, inside in self.field.kinds.items()}
        return {kind: insides[kind] for kind in KINDS if kind in insides}

    def inside(self, kind: type) -> tuple:
        """Return the types of the values inside a list or a table, which are the value of this key."""
        return tuple(member for hint in self.kinds.get(kind, ())[-1:] for member in members_of(hint) if member in KINDS)

    def texts_only(self, *, entry: bool) -> bool:
        """Return whether a single value, or the value of an ``entry`` of a table, must be text."""
        kinds = self.inside(dict) if entry else (*self.kinds, *self.inside(list))
        return {kind for kind in kinds if kind not in (list, dict)} <= {str, Path, os.PathLike, Region}

    @property
    def unit(self) -> u.UnitBase | None:
        """The unit of numbers without a unit; None if the value is no quantity."""
        return next(iter(self.field.units), None)

    @property
    def is_located(self) -> bool:
        """Whether text is the path of a file if this file exists, and otherwise the name of an object."""
        return Located in extra_of(self.field.hint)

    @property
    def is_path(self) -> bool:
        """Whether text can be the path of a file."""
        return self.is_located or not {Path, os.PathLike}.isdisjoint(self.kinds)

    @property
    def words(self) -> str:
        """Text that states which values are valid."""
        if self.field.option.choices:
            return f"one of {listed(self.field.option.choices)}"
        words = [KINDS[kind][0] for kind in self.kinds if kind not in (u.Quantity, list)]
        if self.unit is not None:
            words.insert(0, f"a number ({self.unit}) or text with a unit")
        if list in self.kinds:
            inside = [re.sub(r"^an? (.*)", r"\1s", KINDS[kind][0]) for kind in self.inside(list)]
            words.append(" of ".join(filter(None, ("a list", " or ".join(inside)))))
            words[-1] += ", such as [1, 2]" if inside in (["whole numbers"], ["numbers"]) else ""
        return " or ".join(dict.fromkeys(words))


@cache
def keys_of(cls: type, prefix: str = "", omit: tuple[str, ...] = (), *, brief: bool = False) -> dict[str, Key | Part]:
    """Return the keys of a dataclass by name, and the parts by the names of their tables.

    If ``brief``, the help of a key contains only the first sentence of the documentation of its parameter.
    """
    keys: dict[str, Key | Part] = {}
    texts = help_texts(cls)
    for option_field in options_of(cls):
        name, extra = prefix + option_field.name, extra_of(option_field.hint)
        part = next((x for x in extra if isinstance(x, Part)), None)
        if part is not None:
            more = {} if part.more is None else keys_of(part.more, f"{name}.")
            keys |= {name: part} | keys_of(part.cls, f"{name}.", part.omit, brief=True) | more
        elif is_dataclass(option_field.hint):
            keys |= keys_of(option_field.hint, f"{name}.")
        elif option_field.name not in omit:
            text = texts.get(option_field.name) or next((x for x in extra if isinstance(x, str)), "")
            text = re.split(r"(?<=\.)\s+(?=[A-Z`])", text)[0] if brief else text
            key = Key(name, option_field, text)
            keys |= {name: key} if key.kinds else {}
    return keys


def find(keys: dict[str, Key | Part], name: str) -> tuple[Key | Part, str]:
    """Return the key of a name, and the rest of the name if it is the name of an entry of a table, such as a column."""
    if name in keys:
        return keys[name], ""
    head, _, entry = name.partition(".")
    while entry:
        key = keys.get(head)
        if isinstance(key, Key) and dict in key.kinds:
            return key, entry
        more, _, entry = entry.partition(".")
        head = f"{head}.{more}"
    inside = next((key_name for key_name in keys if key_name.startswith(f"{name}.")), None)
    if inside is not None:
        raise InputError(f"{name} must be a table, whose keys are set one by one, such as {inside}")
    last = {key_name.rpartition(".")[2]: key_name for key_name in reversed(keys)}
    known = {*keys, *(key_name.rpartition(".")[0] for key_name in keys if "." in key_name)}
    hint = close_to(last.get(name.rpartition(".")[2], name), known)
    raise InputError(f"unknown key {name!r}; {hint or '--help-keys lists all keys'}")


def add(keys: dict[str, Key | Part], values: dict, name: str, value: object, base: Path | None = None) -> None:
    """Add the value of a key, or the values of a table, to ``values``; paths are relative to the folder ``base``."""
    is_table = isinstance(value, dict) and any(key_name.startswith(f"{name}." if name else "") for key_name in keys)
    if name in keys or not is_table:
        key, entry_name = find(keys, name)
        if isinstance(key, Key):
            _add_one(key, values, {entry_name: value} if entry_name else value, base)
            return
        if isinstance(value, str) and key.from_text is not None:
            value = key.from_text(value)
        if not isinstance(value, dict):
            raise InputTypeError(f"{name} must be a table{' or text' * bool(key.from_text)}, got {short(value)}")
    for entry_name, entry in value.items():
        add(keys, values, f"{name}.{entry_name}" if name else entry_name, entry, base)


def _add_one(key: Key, values: dict, value: object, base: Path | None) -> None:
    if isinstance(value, date) and str in key.kinds:
        value = value.isoformat()
    if list in key.kinds and not isinstance(value, list) and not {str, object} & set(key.kinds):
        value = [value]
    _check(key, value, tuple(key.kinds))
    for kind in (list, dict):
        if isinstance(value, kind) and (inside := key.inside(kind)):
            for entry in value.values() if kind is dict else value:
                _check(key, entry, inside)
    for entry in value if isinstance(value, list) else [value]:
        if isinstance(entry, str) and not entry.strip():
            raise InputError(f"{key.name} must be {key.words}, got {entry!r}; leave it out to use the default value")
    if key.is_path and isinstance(value, str) and base is not None:
        value = located(value, base, always=not key.is_located)
    entries = values.get(key.name)
    values[key.name] = {**entries, **value} if isinstance(entries, dict) and isinstance(value, dict) else value


def _check(key: Key, value: object, kinds: tuple) -> None:
    """Raise an error if the type of a value is not one of the given types."""
    types = tuple(toml_type for kind in kinds for toml_type in KINDS[kind][1])
    # in Python, True and False are also integers
    valid = bool in kinds if isinstance(value, bool) else isinstance(value, types)
    valid |= u.Quantity in kinds and isinstance(value, list | dict)
    if not valid and object not in kinds:
        raise InputTypeError(f"{key.name} must be {key.words}, got {short(value)}")


def located(text: str, base: Path, *, always: bool) -> str:
    """Return a path in the folder ``base`` as a path from the current folder; names of objects are not changed."""
    path = base / text
    is_name = text.startswith("example:") or not (always or path.exists())
    return text if is_name else str(path)


def build(cls: type, values: dict, prefix: str = "") -> Any:
    """Return an object of a dataclass of keys with the given values; all other fields have their default values."""
    given, keys = {}, keys_of(cls, prefix)
    for option_field in options_of(cls):
        name = prefix + option_field.name
        key = keys.get(name)
        if isinstance(key, Part):
            inside = {k: v for k, v in keys.items() if k.startswith(f"{name}.") and k in values}
            given[option_field.name] = {k.removeprefix(f"{name}."): _convert(v, values[k]) for k, v in inside.items()}
        elif is_dataclass(option_field.hint):
            given[option_field.name] = build(option_field.hint, values, f"{name}.")
        elif name in values:
            given[option_field.name] = _convert(key, values[name])
    return cls(**given)


def _convert(key: Key, value: object) -> object:
    """Convert a value from TOML to the type of the field."""
    if key.field.option.low is not None and [*key.kinds] == [int]:
        key.field.valid(value)
    if key.unit is not None:
        return _to_quantity(key, value)
    if isinstance(value, str) and Path in key.kinds:
        return Path(value)
    if isinstance(value, str) and Time in key.kinds and (match := EXACT_TIME.fullmatch(value)):
        time = Time(float(match[3]), float(match[4]), format="jd", scale=match[2])
        time.format = match[1]
        return time
    if Region in key.kinds or Region in key.inside(list):
        return [Region.parse(text) for text in value] if isinstance(value, list) else Region.parse(value)
    return value


def time_text(time: Time) -> str:
    """Return the text from which `build` restores exactly this time: its format and scale, and two Julian dates."""
    return f"{time.format} {time.scale} {float(time.jd1)!r} {float(time.jd2)!r}"


def _to_quantity(key: Key, value: object) -> object:
    """Convert numbers in the unit of a key, or text with a unit, to quantities; a list or a table contains several."""
    if isinstance(value, dict):
        return {name: _to_quantity(key, entry) for name, entry in value.items()}
    try:
        if isinstance(value, str) and has_other_digits(value):
            raise ValueError(value)
        quantity = u.Quantity([_to_quantity(key, entry) for entry in value] if isinstance(value, list) else value)
    except INCONVERTIBLE:
        raise InputError(f"{key.name} must be {key.words}, such as '2.5 {key.unit}', got {short(value)}") from None
    if isinstance(value, list):
        return quantity
    return quantity.value * key.unit if quantity.unit == u.dimensionless_unscaled else quantity
