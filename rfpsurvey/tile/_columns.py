"""Columns of the tables of a tile: descriptions, and values for positioners without a target."""

import astropy.units as u
import numpy as np
from astropy.table import MaskedColumn, QTable
from astropy.utils.masked import Masked

TARGET_COLUMNS = {
    "ra": "right ascension of the target (ICRS)",
    "dec": "declination of the target (ICRS)",
    "kind": "kind of the target: science, standard or sky",
    "category": "category of the target in the catalog",
    "priority": "priority of the target; targets with larger values are more important",
}
TILE_COLUMNS = {
    "id": "identifier of the positioner",
    "spectrograph": "spectrograph that the fiber feeds",
    "x": "x coordinate of the center of the positioner in the focal plane",
    "y": "y coordinate of the center of the positioner in the focal plane",
    "status": "status of the positioner: assigned, out_of_reach, parked, recorded, idle, disabled or stuck",
    "target_id": "identifier of the target",
    **TARGET_COLUMNS,
    "fiber_type": "fiber type of the fiber on the target",
    "theta": "angle of the central arm",
    "phi": "angle of the eccentric arm",
    "elbow_x": "x coordinate of the elbow in the focal plane",
    "elbow_y": "y coordinate of the elbow in the focal plane",
    "tip_x": "x coordinate of the fiber in the focal plane",
    "tip_y": "y coordinate of the fiber in the focal plane",
    "in_collision": "whether the arm of the positioner collides",
    "colliding_with": "positioners and obstacles with which the arm collides",
    "needs_planner": "whether the arm collides if all arms unfold at the same time, or cannot turn while it is folded",
    "clearance": "distance to the nearest other arm minus the minimum separation",
    "arm_x": "x coordinate of the outer end of the arm segment that can collide",
    "arm_y": "y coordinate of the outer end of the arm segment that can collide",
}
KEPT_COLUMN = "copied from the catalog"
OUTCOMES_COLUMNS = {
    "target_id": "identifier of the target",
    **TARGET_COLUMNS,
    "x": "x coordinate of the target in the focal plane",
    "y": "y coordinate of the target in the focal plane",
    "outcome": "observed, or the reason why the target is not observed",
    "positioner": "identifier of the positioner to which the target is assigned",
}
COMPLETENESS = {
    "kind": "kind of the counted targets, or 'all' for every kind",
    "category": "category of the counted targets, or 'all' for every category",
    "priority": "priority of the counted targets, or 'all' for every priority",
    "n_in_field": "number of targets in the field, without science targets of which no visits are requested",
    "n_reachable": "number of targets in reach of a positioner",
    "n_assigned": "number of targets with a positioner",
    "n_observed": "number of targets with a positioner whose arm does not collide",
    "completeness": "n_observed divided by n_in_field",
}


def describe(table: QTable, about: dict, others: str | None = None) -> QTable:
    """Set the description of each column to its text in ``about`` or, without such a text, to ``others``.

    The function changes the table, and returns it.
    """
    for name in table.colnames:
        if name in about or others:
            table[name].info.description = about.get(name, others)
    return table


def only_with_target(values: np.ndarray, has_target: np.ndarray) -> np.ndarray | MaskedColumn:
    """Return a column in which the values of positioners without a target are NaN, empty text, False, or masked."""
    kind = values.dtype.kind
    if kind == "i":
        # the fill value differs from all values of targets, so that files preserve the values of targets
        spare = np.iinfo(np.int64).min if np.any(values[has_target] == -1) else -1
        return MaskedColumn(np.where(has_target, values, np.int64(spare)), mask=~has_target, fill_value=spare)
    if kind == "U":
        return np.where(has_target, values, "")
    return values & has_target if kind == "b" else np.where(has_target, values, np.nan)


def id_column(ids, has_target) -> MaskedColumn:
    """Return identifiers, masked for positioners without a target."""
    ids = np.ma.filled(ids, "") if ids.dtype.kind == "U" else np.asarray(ids)
    if ids.dtype.kind == "i":
        return only_with_target(ids, has_target)
    return MaskedColumn(only_with_target(ids.astype(str), has_target), mask=~has_target, fill_value="")


def with_unit(values: np.ndarray, unit: str | None) -> np.ndarray | u.Quantity:
    """Return values with a unit; return the values unchanged if ``unit`` is None."""
    return values * u.Unit(unit) if unit else values


def without_masks(table: QTable) -> QTable:
    """Replace masked values of a table from a file by NaN, empty text or False; masked integers remain masked."""
    for name in table.colnames:
        column = table[name]
        if isinstance(column, Masked):
            table[name] = column.filled(np.nan)
        elif isinstance(column, MaskedColumn) and column.dtype.kind in "fU" and name != "target_id":
            table[name] = column.filled("" if column.dtype.kind == "U" else np.nan)
        elif isinstance(column, MaskedColumn) and column.dtype.kind == "b":
            table[name] = column.filled(False)
        elif isinstance(column, MaskedColumn) and column.dtype.kind == "i":
            table[name] = only_with_target(np.asarray(column), ~column.mask)
    return table
