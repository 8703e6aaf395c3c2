"""Validate the docstrings of all public objects; print the problems, and exit with 1 if there are any.

All docstrings must follow the numpydoc standard. Functions and classes must have an example, which the tests run. If a
function, or a function of the package that it calls, can raise an InputError, the docstring must state this.
"""

import ast
import inspect
import re
import sys
import textwrap
import tomllib
from functools import cached_property
from operator import attrgetter
from pathlib import Path

from numpydoc.docscrape import get_doc_object
from numpydoc.validate import ERROR_MSGS, validate

import rfpsurvey

CONFIG = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text())["tool"]["numpydoc_validation"]
CHECKS = set(CONFIG["checks"])
CHECKS = set(ERROR_MSGS) - CHECKS if "all" in CHECKS else CHECKS
OTHERS = (property, cached_property, classmethod, staticmethod)


def public_names():
    """Yield the dotted names of public objects and of their public methods and properties, and the objects."""
    listed = re.findall(r"^    ([\w.]+)$", (Path(__file__).parent / "api.rst").read_text(), re.MULTILINE)
    for name in listed:
        thing = attrgetter(name)(rfpsurvey)
        if name.startswith("_") or (inspect.isclass(thing) and issubclass(thing, Exception)):
            continue
        yield f"rfpsurvey.{name}", thing
        # classes of plain arrays describe their columns under Attributes
        if inspect.isclass(thing) and "    Attributes\n" not in (thing.__doc__ or ""):
            for member, value in vars(thing).items():
                documented = callable(value) or isinstance(
                    value, property | cached_property | classmethod | staticmethod
                )
                if documented and not member.startswith("_"):
                    yield f"rfpsurvey.{name}.{member}", getattr(thing, member)


def raises(thing, owner=None, seen=None):
    """Return whether a function, or a function of the package that it calls, can raise an InputError."""
    seen = set() if seen is None else seen
    if inspect.isclass(thing):
        thing, owner = getattr(thing, "__post_init__", None), thing
    thing = inspect.unwrap(getattr(thing, "__func__", thing)) if thing else None
    if not inspect.isfunction(thing) or not thing.__module__.startswith("rfpsurvey") or thing in seen:
        return False
    seen.add(thing)
    for node in ast.walk(ast.parse(textwrap.dedent(inspect.getsource(thing)))):
        if isinstance(node, ast.Raise) and "InputError" in ast.dump(node):
            return True
        if isinstance(node, ast.Call) and raises(*called(node.func, thing, owner), seen):
            return True
    return False


def called(node, function, owner):
    """Return the function that a call refers to, and the class if it is a method; None if unknown."""
    match node:
        case ast.Name(id=name):
            return function.__globals__.get(name), None
        case ast.Attribute(value=ast.Name(id="self" | "cls"), attr=name):
            return getattr(owner, name, None), owner
        case ast.Attribute(value=ast.Name(id=module), attr=name):
            return getattr(function.__globals__.get(module), name, None), None
    return None, None


def problems(name, thing):
    """Yield the problems of one docstring."""
    yield from (f"{code} {text}" for code, text in validate(name)["errors"] if code in CHECKS)
    doc = get_doc_object(thing)
    owner = getattr(rfpsurvey, name.split(".")[1])
    if name.count(".") == 1 and ">>> " not in "".join(doc["Examples"]):
        yield "no example"
    if not isinstance(thing, property | cached_property) and raises(thing, owner) and not doc["Raises"]:
        yield "can raise an InputError and does not say when"


if __name__ == "__main__":
    found = [f"{name}: {problem}" for name, thing in public_names() for problem in problems(name, thing)]
    print("\n".join(found) or "docstrings: all well")
    sys.exit(bool(found))
