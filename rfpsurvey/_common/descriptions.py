"""Descriptions of methods, of the columns of tables, and of the numbers of summaries, and results in notebooks.

Tables, files, reports, printed summaries and docstrings read these descriptions.
"""

import re
import textwrap
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from importlib import import_module
from typing import TypeVar

import astropy.units as u
import numpy as np
from astropy.table import QTable

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


COPIED = "copied from the catalog"
"""Description of the further columns of a catalog."""


@dataclass(frozen=True)
class Column:
    """The description of a column of a table."""

    name: str
    text: str
    unit: str = ""
    # function of the object of which `make_table` makes a table; it returns None if the table lacks the column
    value: Callable | None = None


@dataclass(frozen=True)
class Fact:
    """The description of a number of a summary, which reports and printed summaries show."""

    name: str
    label: str = ""
    of: str = ""  # name of another number, of which this number is a detail; details are indented, and are below it
    value: Callable | None = None  # function of the object; it returns None if the summary lacks the number
    shown: Callable | None = None  # function of the summary: number, text or dict of labels and values to show, or None
    zero: bool = False  # whether the number is shown if it is 0


def facts_of(facts: Iterable[Fact], summary: Mapping, names: Sequence[str] | None = None) -> dict[str, object]:
    """Return the labels and values that are shown of a summary; the labels of details begin with spaces.

    ``names`` are those of the numbers to show, in their order; by default, all numbers are shown.
    """
    labeled = {}
    if names is not None:
        facts = sorted((fact for fact in facts if fact.name in names), key=lambda fact: names.index(fact.name))

    def add(of: str, indent: str) -> None:
        for fact in (fact for fact in facts if fact.of == of):
            value = fact.shown(summary) if fact.shown else summary.get(fact.name)
            if isinstance(value, dict):  # the function has selected what is shown
                labeled.update({indent + label: number for label, number in value.items()})
            elif value or (fact.zero and value is not None):
                labeled[indent + fact.label] = value
            add(fact.name, f"{indent}  ")

    add("", "")
    return labeled


def make_table(columns: Mapping[str, Column], data: object) -> QTable:
    """Return a table of all columns for which ``data`` has values, and of the further columns ``data.columns``."""
    values = {name: column.value(data) for name, column in columns.items() if column.value}
    values = {name: with_unit(value, columns[name].unit) for name, value in values.items() if value is not None}
    return describe(QTable(values | data.columns), columns, COPIED)


def describe(table: QTable, columns: Mapping[str, Column], default: str = "") -> QTable:
    """Set the descriptions of the columns of a table, and return the table; other columns have the text ``default``."""
    for name in table.colnames:
        if text := text_of(columns, name, default):
            table[name].info.description = text
    return table


def text_of(columns: Mapping[str, Column], name: str, default: str = "") -> str:
    """Return the description of a column."""
    return columns[name].text if name in columns else default


def with_unit(values: np.ndarray, unit: str | None) -> np.ndarray | u.Quantity:
    """Return values with a unit; return the values unchanged if there is no unit."""
    return values * u.Unit(unit) if unit else values


DECIMALS = {u.deg: 6, u.mm: 4, u.arcsec: 3}


def to_html(result: object, facts: dict, table: object = None, figure: str = "") -> str:
    """Return HTML that shows a result: a heading, a figure, properties, and the first rows of a table.

    Parameters
    ----------
    result : object
        The result; its ``repr`` is the heading.
    facts : dict
        Names and values of properties of the result. Values that are not numbers or short text are omitted.
    table : QTable, optional
        Table whose first rows are shown.
    figure : str, optional
        Figure as HTML (`rfpsurvey._common.small_figures`).

    Returns
    -------
    str
        The HTML.
    """
    rows = "".join(
        f"<tr><th>{escape(str(name))}</th><td>{escape(_text(value))}</td></tr>"
        for name, value in facts.items()
        if isinstance(value, int | float | str) and len(str(value)) < 200
    )
    shown = "" if table is None else f"<div>{rounded(table)._repr_html_()}</div>"
    return f"<p>{escape(repr(result).strip('<>'))}</p>{figure}<table>{rows}</table>{shown}"


def show(result: object, **options: object) -> object:
    """Return the interactive view of a result for a notebook.

    The subpackage ``report`` imports the classes of results. To avoid a circular import, this function imports
    ``report`` only when it is called.

    Parameters
    ----------
    result : object
        The result, such as a tile or a survey.
    **options
        Passed to ``rfpsurvey.report.notebook_view``.

    Returns
    -------
    object
        An object with the HTML of the view.
    """
    return import_module("rfpsurvey.report").notebook_view(result, **options)


def plot(function: str, result: object, **options: object) -> object:
    """Draw a result with a function of the subpackage ``plot``, which is imported only when it is needed.

    Parameters
    ----------
    function : str
        Name of the function, such as ``plot_tiling``.
    result : object
        The result, such as a tile or a survey.
    **options
        Passed to the function.

    Returns
    -------
    matplotlib.axes.Axes
        The axes.
    """
    return getattr(import_module("rfpsurvey.plot"), function)(result, **options)


def rounded(table: object) -> object:
    """Return a copy of a table that is displayed with few digits; the values are not rounded."""
    table = table.copy(copy_data=False)
    for column in table.itercols():
        if getattr(column.dtype, "kind", "") == "f":
            column.info.format = f".{DECIMALS[column.unit]}f" if getattr(column, "unit", None) in DECIMALS else ".4g"
    return table


def _text(value) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
