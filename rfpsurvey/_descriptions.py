"""Descriptions of the columns of tables, and of the numbers of summaries.

Tables, files, reports, printed summaries and docstrings read these descriptions. This module also describes the columns
of tiles and of visits, because columns of catalogs must have other names.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

import astropy.units as u
import numpy as np
from astropy.table import QTable

from rfpsurvey._methods import table_of

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
