"""A focal plane as a table: a row for each positioner, each circular obstacle and each circle that hides fibers."""

from dataclasses import fields

import astropy.units as u
import numpy as np
from astropy.table import QTable, Table

from rfpsurvey._units import to_mm, to_plain, to_radian
from rfpsurvey.errors import InputError, InputTypeError, close_to, listed, warn
from rfpsurvey.focal_plane._margins import Margins
from rfpsurvey.positioner import ArmOutline, Positioner

JOINTS = {
    "zero_points": ("theta_zero", "phi_zero"),
    "theta_range": ("theta_min", "theta_max"),
    "phi_range": ("phi_min", "phi_max"),
}
"""Names of the columns with the zero points and the limits of joints."""
PLAIN, LENGTHS = ("id", "spectrograph", "fiber_type", "disabled"), ("central_arm", "eccentric_arm")
"""Names of columns that have the name of an argument of `FocalPlane`: columns without units, and lengths."""
PAIRS = {"stuck": ("stuck_theta", "stuck_phi"), **JOINTS}
"""Names of the two columns of each argument of `FocalPlane` that has two angles per positioner."""
CIRCLES = {"obstacles": "obstacle_radius", "hidden": "hidden_radius"}
"""Names of the columns with the radii of circles; each circle has its own row."""
POLYGONS = "obstacle_polygons_mm"
"""Key under which the ``meta`` of a table contains the vertices of polygonal obstacles."""
MARGINS = "margins"
"""Key under which the ``meta`` of a table contains the margins, as numbers by name, lengths in mm."""


def read_columns(table: Table, positioner: Positioner | None) -> dict:
    """Return the arguments of `FocalPlane` that a table contains."""
    if not isinstance(table, Table):
        raise InputTypeError(f"table must be an astropy Table or QTable, got {type(table).__name__}")
    names = table.colnames
    for name in ("x", "y"):
        if name not in names:
            raise InputError(f"there is no column {name!r}; the columns are: {listed(names)}")
    xy = np.column_stack([_quantity(table, "x", u.mm), _quantity(table, "y", u.mm)])
    is_positioner, columns = np.ones(len(xy), dtype=bool), {}
    for name, column in CIRCLES.items():
        if column in names:
            radius = _quantity(table, column, u.mm)
            rows = np.isfinite(radius) & is_positioner
            is_positioner &= ~rows
            if rows.any():
                columns[name] = np.column_stack([xy[rows], radius[rows]])
    columns |= {name: to_plain(table[name][is_positioner], f"column {name!r}") for name in PLAIN if name in names}
    columns |= {name: _quantity(table, name, u.mm)[is_positioner] for name in LENGTHS if name in names}
    for name, pair in PAIRS.items():
        if {*pair} <= {*names}:
            columns[name] = np.column_stack([_quantity(table, part, u.deg)[is_positioner] for part in pair])
    places = {}
    for column in names:
        y_column = column.replace("fiber_x", "fiber_y", 1)
        if column.startswith("fiber_x") and y_column in names:
            pair = [_quantity(table, part, u.mm)[is_positioner] for part in (column, y_column)]
            places[column.removeprefix("fiber_x").removeprefix("_")] = np.column_stack(pair)
    if places:
        columns["fiber_xy"] = places
    if POLYGONS in table.meta:
        columns["obstacle_polygons"] = [polygon * u.mm for polygon in table.meta[POLYGONS]]
    columns["groups"] = {name: values for name in names if (values := _group(table, name, is_positioner)) is not None}
    _warn_of_ignored(names)
    if MARGINS in table.meta:
        columns["margins"] = Margins.from_numbers(table.meta[MARGINS])
    if positioner is None:
        positioner = _positioner_from_meta(table.meta.get("positioner"))
    return {"xy": xy[is_positioner], "positioner": positioner, **columns}


def is_group(name: str) -> bool:
    """Return whether a column of this name is a group, which requirements such as ``sky=5/petal`` can name."""
    known = {
        "",
        "tile",
        "x",
        "y",
        *PLAIN,
        *LENGTHS,
        *CIRCLES.values(),
        *(name for pair in PAIRS.values() for name in pair),
    }
    is_plain = " ".join(name.split()) == name and "/" not in name
    return is_plain and name not in known and not name.startswith(("fiber_x", "fiber_y"))


def _group(table, name, rows):
    """Return the values of a column that is a group; None unless all of them are integers."""
    column = table[name][rows]
    if not is_group(name) or column.ndim != 1 or column.dtype.kind not in "iuf":
        return None
    values = to_plain(column)
    is_whole = (np.abs(values) < 2**53).all() and (values == np.rint(values)).all()
    return values.astype(np.int64) if is_whole and getattr(column, "unit", None) is None else None


def _warn_of_ignored(names):
    """Issue a warning for each ignored column whose name is, or resembles, the name of a column that can be read."""
    pairs = [*PAIRS.values(), *((name, name.replace("_x", "_y", 1)) for name in names if name.startswith("fiber_x"))]
    pairs += [(name.replace("_y", "_x", 1), name) for name in names if name.startswith("fiber_y")]
    partner = {name: paired for pair in pairs for name, paired in (pair, pair[::-1])}
    known = {"x", "y", *PLAIN, *LENGTHS, *CIRCLES.values(), *partner}
    for name in names:
        if name in partner and partner[name] not in names:
            warn(f"the column {name!r} is ignored, because there is no column {partner[name]!r}")
        elif name not in known and (hint := close_to(name, known - {*names}, 0.85)):
            warn(f"the column {name!r} is ignored; {hint}")


def to_table(plane) -> QTable:
    """Return a table with the columns of a focal plane and with the positioner in its ``meta``."""
    n, k = len(plane), len(plane.arrays.obstacles)
    circles = np.vstack([plane.arrays.obstacles, plane.arrays.hidden])
    m = len(circles)
    table = QTable({"id": np.concatenate([plane.id, _spare_names(plane.id, m)])})
    table["x"], table["y"] = np.vstack([plane.arrays.xy, circles[:, :2]]).T * u.mm
    width = plane.spectrograph.shape[1:]
    table["spectrograph"] = np.concatenate([plane.spectrograph, np.zeros((m, *width), int)])
    table["fiber_type"] = np.concatenate([plane.fiber_type, np.full(m, "")])
    for name, values in (plane.groups or {}).items():
        table[name] = np.append(values, np.full(m, -1))
    table["disabled"] = np.append(plane.disabled, np.zeros(m, bool))
    lengths = {"central_arm": plane.arrays.central_arm}
    if plane.fiber_xy is None:
        lengths["eccentric_arm"] = plane.arrays.eccentric_arm
    for name, places in (plane.fiber_xy or {}).items():
        lengths |= {
            f"fiber_{axis}" + (f"_{name}" if name else ""): v
            for axis, v in zip("xy", to_mm(places, name).T, strict=True)
        }
    angles = {"stuck_theta": plane.arrays.stuck[:, 0], "stuck_phi": plane.arrays.stuck[:, 1]}
    for name, values in lengths.items():
        table[name] = np.append(values, np.full(m, np.nan)) * u.mm
    for name, (low, high) in JOINTS.items():
        if getattr(plane, name) is not None:
            angles |= dict(zip((low, high), to_radian(getattr(plane, name), name).T, strict=True))
    for name, values in angles.items():
        table[name] = np.rad2deg(np.append(values, np.full(m, np.nan))) * u.deg
    for name, rows in {"obstacles": slice(n, n + k), "hidden": slice(n + k, n + m)}.items():
        if name == "obstacles" or plane.hidden is not None:
            radius = np.full(n + m, np.nan)
            radius[rows] = getattr(plane.arrays, name)[:, 2]
            table[CIRCLES[name]] = radius * u.mm
    table.meta["positioner"] = _positioner_to_meta(plane.positioner)
    if plane.obstacle_polygons:
        table.meta[POLYGONS] = [polygon.tolist() for polygon in plane.arrays.obstacle_polygons]
    if plane.margins:
        table.meta[MARGINS] = plane.margins.numbers
    return table


def _quantity(table, name, unit):
    column, given = table[name], getattr(table[name], "unit", None)
    if given is None or not given.is_equivalent(unit):
        got = "none" if given is None else given
        raise InputError(f"column {name!r} must have a unit convertible to {unit}, got {got}")
    values = to_plain(column, f"column {name!r}")
    if values.ndim != 1:
        raise InputError(f"column {name!r} must have one value per row, got the shape {values.shape}")
    try:
        return u.Quantity(values.astype(float), given).to(unit)
    except ValueError as error:
        raise InputError(f"column {name!r} must hold numbers: {error}") from None


def _spare_names(ids, m):
    """Return identifiers for obstacles that differ from the identifiers of all positioners."""
    if ids.dtype.kind == "i":
        return ids.max() + 1 + np.arange(m)
    taken, prefix = set(ids.tolist()), "obstacle-"
    while any(f"{prefix}{k}" in taken for k in range(m)):
        prefix += "-"
    return np.array([f"{prefix}{k}" for k in range(m)], dtype=str)


def _positioner_to_meta(positioner) -> dict:
    """Return the arguments of a Positioner as text that represents the numbers exactly."""

    def text(value):
        if isinstance(value, u.Quantity):
            return f"{float(value.value)!r} {value.unit}" if value.isscalar else [text(v) for v in value]
        if isinstance(value, ArmOutline):
            return value.to_dict()
        return {k: text(v) for k, v in value.items()} if isinstance(value, dict) else value

    return {f.name: text(v) for f in fields(positioner) if (v := getattr(positioner, f.name)) is not None}


def _positioner_from_meta(meta) -> Positioner:
    if not isinstance(meta, dict):
        raise InputError(
            "without the argument positioner, the meta of the table must have an entry 'positioner', such as "
            f"{{'central_arm': '8.25 mm', ...}}, got {meta!r}"
        )
    unknown = [name for name in meta if name not in {f.name for f in fields(Positioner)}]
    if unknown:
        raise InputError(f"the positioner in the table's meta has unknown entries: {', '.join(map(str, unknown))}")

    def quantity(value):
        if isinstance(value, list):
            return u.Quantity([u.Quantity(v) for v in value])
        return {k: quantity(v) for k, v in value.items()} if isinstance(value, dict) else u.Quantity(value)

    try:
        given = {n: v if n in ("handedness", "arm_model", "outline") else quantity(v) for n, v in meta.items()}
        if given.get("outline") is not None:
            given["outline"] = ArmOutline.from_dict(given["outline"])
        return Positioner(**given)
    except InputError:
        raise
    except (TypeError, ValueError) as error:
        raise InputError(f"the positioner in the table's meta cannot be read: {error}") from None
