"""Records of methods: the function of a method, the options that it uses, and properties of its results."""

import re
import textwrap
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import TypeVar

T = TypeVar("T")
WIDTH = 120


@dataclass(frozen=True)
class Method:
    """One of several methods for the same task. The docstring of the function describes the method to users."""

    name: str
    function: Callable
    options: Collection[str] | None = ()  # names of the options that not all methods use; None if it may use any option
    summary: str = ""  # a few words for the help of a command; empty if the name is clear

    def uses(self, option: str) -> bool:
        """Return whether the method may use an option."""
        return self.options is None or option in self.options


def table_of(*methods: Method) -> dict:
    """Return methods by their names."""
    return {method.name: method for method in methods}


def help_of(methods: Mapping[str, Method]) -> str:
    """Return the names and summaries of methods, for the help of a command."""
    return ", ".join(name + (f" ({method.summary})" if method.summary else "") for name, method in methods.items())


def describe_methods(methods: Mapping[str, Method]) -> Callable[[T], T]:
    """Return a decorator that replaces the line ``{methods}`` of a docstring by the descriptions of methods."""

    def fill(match):
        about = {name: method.function.__doc__.partition("Parameters\n")[0] for name, method in methods.items()}
        texts = " ".join(f"``{name}``: {text}" for name, text in about.items())
        return textwrap.fill(" ".join(texts.split()), WIDTH, initial_indent=match[1], subsequent_indent=match[1])

    def decorate(documented):
        if documented.__doc__:  # the option -OO of Python removes docstrings
            documented.__doc__ = re.sub(r"^( *)\{methods\}$", fill, documented.__doc__, flags=re.MULTILINE)
        return documented

    return decorate
