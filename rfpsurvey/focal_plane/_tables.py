"""A focal plane as a table: what an instrument team keeps, a row a positioner or obstacle."""

import astropy.units as u
import numpy as np
from astropy.table import QTable, Table

from rfpsurvey._units import to_mm
from rfpsurvey.errors import InputError
from rfpsurvey.positioner import Positioner

__all__ = ["read_columns", "to_table"]


def read_columns(table: Table, positioner: Positioner | None) -> dict:
    """Return the arguments of a FocalPlane that a table describes."""
    names = table.colnames

    def quantity(name, unit):
        column = table[name]
        if getattr(column, "unit", None) is None:
            raise InputError(f"column {name!r} must have a unit convertible to {unit}, got none")
        values = u.Quantity(np.ma.filled(np.ma.asarray(getattr(column, "value", column)), np.nan), column.unit)
        if not values.unit.is_equivalent(unit):
            raise InputError(f"column {name!r} must have a unit convertible to {unit}, got {column.unit}")
        return values

    for name in ("x", "y"):
        if name not in names:
            raise InputError(f"there is no column {name!r}; the columns are: {', '.join(names) or 'none'}")
    xy = np.column_stack([quantity("x", u.mm).to(u.mm), quantity("y", u.mm).to(u.mm)])
    radius = quantity("obstacle_radius", u.mm) if "obstacle_radius" in names else np.full(len(xy), np.nan) * u.mm
    unit = ~np.isfinite(radius)
    columns = {n: np.asarray(table[n])[unit] for n in ("id", "spectrograph", "fiber_type", "disabled") if n in names}
    for name in ("central_arm", "eccentric_arm"):
        if name in names:
            columns[name] = quantity(name, u.mm)[unit]
    if "theta" in names and "phi" in names:
        columns["stuck"] = np.column_stack([quantity("theta", u.deg), quantity("phi", u.deg)])[unit]
    if not unit.all():
        columns["obstacles"] = np.column_stack([xy[~unit], radius[~unit]])
    if positioner is None:
        if not {"central_arm", "eccentric_arm"} <= set(names) or "clearance" not in table.meta:
            raise InputError(
                "without a positioner the table must have the columns central_arm and eccentric_arm "
                "and its meta must have a clearance"
            )
        positioner = Positioner(
            np.median(columns["central_arm"]),
            np.median(columns["eccentric_arm"]),
            to_mm(table.meta["clearance"], "clearance") * u.mm,
        )
    return {"xy": xy[unit], "positioner": positioner, **columns}


def to_table(plane) -> QTable:
    """Return the columns of a focal plane."""
    n, m = len(plane), len(plane._obstacles_mm)
    circles = plane._obstacles_mm
    x, y = np.vstack([plane._xy_mm, circles[:, :2]]).T
    is_text = plane.id.dtype.kind in "US"
    spare = [f"obstacle-{k}" for k in range(m)] if is_text else plane.id.max(initial=0) + 1 + np.arange(m)
    table = QTable({"id": np.concatenate([plane.id, np.asarray(spare, dtype=None if is_text else plane.id.dtype)])})
    table["x"], table["y"] = x * u.mm, y * u.mm
    table["spectrograph"] = np.concatenate([plane.spectrograph, np.zeros((m, *plane.spectrograph.shape[1:]), int)])
    table["fiber_type"] = np.concatenate([plane.fiber_type, np.full(m, "")])
    table["central_arm"] = np.append(plane._l1_mm, np.full(m, np.nan)) * u.mm
    table["eccentric_arm"] = np.append(plane._l2_mm, np.full(m, np.nan)) * u.mm
    table["disabled"] = np.append(plane.disabled, np.zeros(m, bool))
    for k, name in enumerate(("theta", "phi")):
        table[name] = np.append(np.rad2deg(plane._stuck_rad[:, k]), np.full(m, np.nan)) * u.deg
    table["obstacle_radius"] = np.append(np.full(n, np.nan), circles[:, 2]) * u.mm
    table.meta["clearance"] = str(plane.positioner.clearance)
    return table
