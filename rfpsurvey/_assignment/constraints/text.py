"""Constraints from objects and from text, constraints of other packages, and the form in which results record them."""

import hashlib
import importlib
import pkgutil
from collections.abc import Callable, Iterable
from dataclasses import is_dataclass
from functools import partial
from numbers import Number
from pathlib import Path

import numpy as np

from rfpsurvey._assignment.constraints.constraint import Constraint
from rfpsurvey._assignment.constraints.requirement import FORM, Requirement
from rfpsurvey._common.plugins import Plugin, find_plugin, plugin_names
from rfpsurvey._sky.arrays import KINDS
from rfpsurvey.errors import InputError, InputTypeError, check_choice, items_of, refusal, short

GROUP = "rfpsurvey.constraints"
"""Entry-point group by which packages add constraints."""


def find_constraints(package: str, folder: Path) -> dict[str, type[Constraint]]:
    """Return the constraints that the modules of a package define, by the first word of their text."""
    modules = [importlib.import_module(f"{package}.{module.name}") for module in pkgutil.iter_modules([str(folder)])]
    classes = [(module, member) for module in modules for member in vars(module).values() if isinstance(member, type)]
    return {
        member.name: member
        for module, member in classes
        if issubclass(member, Constraint) and member.__module__ == module.__name__ and member.name
    }


BUILT_IN = find_constraints(__package__, Path(__file__).parent)
"""Built-in constraints by the first word of their text. `Requirement` has a form of its own, such as ``sky=20``."""


def answer(constraint: Constraint, ask: Callable) -> object:
    """Return the answer of a method of a constraint; an exception of the constraint becomes an error that names it."""
    try:
        return ask()
    except InputError as error:
        raise InputError(f"the constraint '{constraint}': {error}") from error
    except Exception as error:  # constraints of users can raise any exception
        raise InputError(f"the constraint '{constraint}' failed: {type(error).__name__}: {error}") from error


def as_constraints(given: object) -> tuple[Constraint, ...]:
    """Convert one or several constraints, given as objects or as text, to a tuple of constraints.

    Parameters
    ----------
    given : Constraint or str or list of these, or None
        The constraints. Text is a requirement, such as ``sky=20/spectrograph``, or the name of a constraint, a space,
        and arguments, such as ``keep_out 95.0 23.0 0.01``.

    Returns
    -------
    tuple of Constraint
        The constraints.

    Raises
    ------
    InputError
        If an object is no constraint, if text does not have one of these forms, or if the category of a requirement has
        the name of a constraint, as in ``required=1003``; write ``'required'=1003``.

    Examples
    --------
    >>> from rfpsurvey.constraints import as_constraints
    >>> as_constraints("sky=20/spectrograph")
    (Requirement('sky=20/spectrograph'),)
    """
    given = () if given is None else given
    given = items_of(given, "constraints must be a list of constraints or text", str, Constraint)
    return tuple(_as_constraint(item) for item in given)


def _as_constraint(item: object) -> Constraint:
    if isinstance(item, Constraint):
        if not is_dataclass(item) and type(item).__str__ is Constraint.__str__:  # the text consists of the fields
            raise InputTypeError(f"a constraint must be a frozen dataclass, got the class {type(item).__name__}")
        margin = answer(item, partial(getattr, item, "margin_rad"))
        if not (isinstance(margin, int | float | np.number) and 0 <= margin <= np.pi):
            raise refusal(f"margin_rad of the constraint '{item}' must be a number from 0 to pi", margin, Number)
        return item
    if not isinstance(item, str):
        text = "a constraint must be a Constraint or text such as 'sky=20/spectrograph'"
        raise InputTypeError(f"{text}, got {short(item)}")
    name, _, arguments = item.strip().partition(" ")
    if name in BUILT_IN:
        return BUILT_IN[name].parse(arguments)
    names = plugin_names(GROUP)
    word, sign, _ = name.partition("@" if "@" in name.partition("=")[0] else "=")
    if sign and word in {*BUILT_IN, *names} - {*KINDS}:
        raise InputError(
            f"the text of the constraint {word!r} must have a space after its name, got {short(item)}; to require a "
            f"number of targets of a category of this name, write the name in single quotes: '{word}'=..."
        )
    if name not in names and ("=" in item or FORM.fullmatch(item.strip())):
        return Requirement.parse(item)
    if name not in names:
        check_choice(name, {*BUILT_IN, *names}, "constraint", also=", or a requirement such as sky=20/spectrograph")
    plugin = find_plugin(GROUP, name, BUILT_IN, "constraint")
    with plugin.answering():
        return _class_of(plugin).parse(arguments)


def with_present_texts(recorded: dict, present: dict) -> dict:
    """Return a recorded request in which equal constraints have the text that they have in the present request.

    The texts of equal constraints can differ: ``magnitude h 7 13`` and ``magnitude h 7.0 13.0`` are equal.
    """
    texts, now = (record.get("constraints", []) for record in (recorded, present))
    if not texts or len(texts) != len(now):
        return recorded
    kept = [b if a != b and _are_equal(a, b) else a for a, b in zip(texts, now, strict=True)]
    return {**recorded, "constraints": kept}


def _are_equal(first: str, second: str) -> bool:
    """Return whether two texts are equal constraints; texts that contain digests of data are not constraints."""
    try:
        return as_constraints(first) == as_constraints(second)
    except InputError:
        return False


def _class_of(plugin: Plugin) -> type[Constraint]:
    value = plugin.value
    if not (isinstance(value, type) and issubclass(value, Constraint)):
        raise InputError(f"it must be a subclass of rfpsurvey.constraints.Constraint, got {short(value)}")
    if value.name != plugin.name:
        raise InputError(f"its attribute name must be {plugin.name!r}, as in the entry point, got {value.name!r}")
    return value


def named_plugins(constraints: Iterable[Constraint]) -> dict[str, str]:
    """Return the names and versions of the packages that provide constraints, in the form in which results record them.

    Parameters
    ----------
    constraints : iterable of Constraint
        The constraints.

    Returns
    -------
    dict of str to str
        Versions of packages, by the name of the package.
    """
    versions, names = {}, None
    for name in {constraint.name for constraint in constraints} - {*BUILT_IN, ""}:
        names = plugin_names(GROUP) if names is None else names
        if name in names:
            versions.update(find_plugin(GROUP, name, BUILT_IN, "constraint").software)
    return versions


# Results record lists of at most this many identifiers or circles. For a longer list, they record the length and a
# digest.
MOST_LISTED = 1000


def recorded_constraints(record: dict) -> list[str]:
    """Return the text of all constraints in a record of options, which results store."""
    texts = [*record.get("requirements", [])] if isinstance(record.get("requirements"), list) else []
    texts += [f"required {' '.join(record['required'])}"] if record.get("required") else []
    texts += [f"keep_out {text.removeprefix('cap ')}" for text in record.get("keep_out", [])]
    return [*texts, *record.get("constraints", [])]


def recorded(texts: list[str]) -> list[str]:
    """Return the list that results store for identifiers or circles; a long list becomes its length and a digest."""
    if len(texts) <= MOST_LISTED:
        return texts
    return [f"{len(texts)} in all, digest {hashlib.sha256(chr(10).join(texts).encode()).hexdigest()[:16]}"]


def listed_in(recorded: list[str]) -> list[str]:
    """Return the texts in a record; raise an error if it contains only their number and a digest."""
    if len(recorded) == 1 and " in all, digest " in recorded[0]:
        raise InputError(f"a record determines options only if it contains all texts of a list, got {recorded[0]}")
    return recorded
