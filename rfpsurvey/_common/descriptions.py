"""Descriptions of methods, of the columns of tables, and of the numbers of summaries, and results in notebooks.

Tables, files, reports, printed summaries and docstrings read these descriptions. This module also describes the columns
of tiles and of visits, because columns of catalogs must have other names.
"""

import re
import textwrap
from collections.abc import Callable, Collection, Iterable, Mapping
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


def facts_of(facts: Iterable[Fact], summary: Mapping) -> dict[str, object]:
    """Return the labels and values that are shown of a summary; the labels of details begin with spaces."""
    labeled = {}

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


def _coordinates(prefix: str, place: str, points: Callable) -> tuple[Column, Column]:
    """Return the columns of the coordinates x and y of points, which are a function of the data of the table."""
    text = f"coordinate of {place}"
    return (
        Column(f"{prefix}x", f"x {text}", "mm", lambda t: points(t)[:, 0]),
        Column(f"{prefix}y", f"y {text}", "mm", lambda t: points(t)[:, 1]),
    )


TARGET_ID = Column("target_id", "identifier of the target", value=lambda t: t.target_id)
TARGET_COLUMNS = (
    Column("ra", "right ascension of the target (ICRS)", "deg", lambda t: t.place_deg[0]),
    Column("dec", "declination of the target (ICRS)", "deg", lambda t: t.place_deg[1]),
    Column("kind", "kind of the target: science, standard or sky"),
    Column("category", "category of the target in the catalog"),
    Column("priority", "priority of the target; targets with larger values are more important"),
)
STATUS = "status of the positioner: assigned, out_of_reach, parked, recorded, idle, disabled or stuck"
PLANNER = "whether the arm collides if all arms unfold at the same time, or cannot turn while it is folded"
TILE_COLUMNS = table_of(
    Column("id", "identifier of the positioner", value=lambda t: t.plane.id),
    Column("spectrograph", "spectrograph that the fiber feeds", value=lambda t: t.spectrograph),
    *_coordinates("", "the center of the positioner in the focal plane", lambda t: t.plane.arrays.xy),
    Column("status", STATUS, value=lambda t: t.status),
    TARGET_ID,
    *TARGET_COLUMNS,
    Column("fiber_type", "fiber type of the fiber on the target", value=lambda t: t.fiber_type_of_target),
    Column("theta", "angle of the central arm", "deg", lambda t: np.rad2deg(t.posed.theta)),
    Column("phi", "angle of the eccentric arm", "deg", lambda t: np.rad2deg(t.posed.phi)),
    *_coordinates("elbow_", "the elbow in the focal plane", lambda t: t.posed.elbow),
    *_coordinates("tip_", "the fiber in the focal plane", lambda t: t.posed.tip),
    Column("in_collision", "whether the arm of the positioner collides", value=lambda t: t.report.in_collision),
    Column("colliding_with", "positioners and obstacles with which the arm collides", value=lambda t: t.partners),
    Column("needs_planner", PLANNER, value=lambda t: t.report.motion and t.report.motion.needs_planner),
    Column("clearance", "distance to the nearest other arm minus the minimum separation", "mm", lambda t: t.clearance),
    *_coordinates("arm_", "the outer end of the arm segment that can collide", lambda t: t.posed.segments[:, 2:]),
)
"""Columns of the table of a tile, which is made from a `TableOfTile`."""
OUTCOMES_COLUMNS = table_of(
    TARGET_ID,
    *TARGET_COLUMNS,
    *_coordinates("", "the target in the focal plane", lambda t: t.xy_mm),
    Column("outcome", "observed, or the reason why the target is not observed", value=lambda t: t.outcome_names),
    Column(
        "positioner", "identifier of the positioner to which the target is assigned", value=lambda t: t.positioner_id
    ),
)
"""Columns of the outcomes of a tile, which are made from `TargetsOfField`."""
VISITS_COLUMNS = table_of(
    TARGET_ID,
    Column("target_row", "row in the catalog, -1 for blank sky"),
    Column("positioner", "identifier of the positioner"),
    Column("in_collision", TILE_COLUMNS["in_collision"].text),
    Column("observed", "whether the visit counts as an observation"),
    TILE_COLUMNS["fiber_type"],
    *TARGET_COLUMNS,
)
"""Columns of the visits of a tile of a survey."""


DECIMALS = {u.deg: 6, u.mm: 4, u.arcsec: 3}


def to_html(result: object, facts: dict, table: object = None) -> str:
    """Return HTML that shows a result: a heading, properties of the result, and the first rows of a table.

    Parameters
    ----------
    result : object
        The result; its ``repr`` is the heading.
    facts : dict
        Names and values of properties of the result. Values that are not numbers or short text are omitted.
    table : QTable, optional
        Table whose first rows are shown.

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
    return f"<p>{escape(repr(result).strip('<>'))}</p><table>{rows}</table>{shown}"


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
