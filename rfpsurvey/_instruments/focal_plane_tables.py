"""A focal plane as a table, and checks of its columns.

The table has a row for each positioner, each circular obstacle and each circle that hides fibers.
"""

from collections.abc import Iterator, Sequence
from dataclasses import fields

import astropy.units as u
import numpy as np
from astropy.table import QTable, Table

from rfpsurvey._common.descriptions import to_html
from rfpsurvey._common.small_figures import BLUE, RED, dots
from rfpsurvey._common.units import check_unique, to_flags, to_labels, to_mm, to_plain, to_points_mm, to_unit
from rfpsurvey._instruments.margins import Margins, check_margins, to_polygons
from rfpsurvey._instruments.outline import ArmOutline
from rfpsurvey._instruments.positioner import Positioner
from rfpsurvey.errors import InputError, InputTypeError, close_to, listed, refusal, short, warn


def check_columns(plane) -> None:
    """Check the columns of a focal plane, and convert columns that have no unit to arrays."""
    if not isinstance(plane.positioner, Positioner):
        raise InputTypeError(f"positioner must be a Positioner, got {type(plane.positioner).__name__}")
    xy = to_points_mm(plane.xy, "xy")
    n = len(xy)
    if n == 0:
        raise InputError("a focal plane must have at least one positioner, got none")
    if not np.isfinite(xy).all():
        raise InputError(f"xy must be finite, got {int((~np.isfinite(xy)).any(axis=1).sum())} rows that are not finite")
    if len(np.unique(xy, axis=0)) < n:
        raise InputError("xy must be different for all positioners, but two positioners have the same center")
    _check_labels(plane, n)
    _check_lengths(plane, n)
    _check_fibers(plane, n)
    _check_joints(plane, n)
    _check_obstacles(plane)
    check_margins(plane)


def _check_labels(plane, n):
    """Check the identifiers, spectrographs, fiber types and flags of all positioners, and convert them to arrays."""
    spectrograph, fiber_type = plane.spectrograph, plane.fiber_type
    columns = {
        "id": np.arange(n) if plane.id is None else to_labels(plane.id, "id"),
        "spectrograph": np.zeros(n, int) if spectrograph is None else to_labels(spectrograph, "spectrograph"),
        "fiber_type": np.full(n, "") if fiber_type is None else to_plain(fiber_type, "fiber_type").astype(str),
        "disabled": np.zeros(n, bool) if plane.disabled is None else to_flags(plane.disabled, "disabled"),
    }
    for name, value in columns.items():
        if np.ndim(value) == 0 or len(value) != n or (value.ndim != 1 and name != "spectrograph"):
            raise InputError(f"{name} must have one value per positioner, shape ({n},), got {value.shape}")
        object.__setattr__(plane, name, value)
    check_unique(columns["id"], "id")
    _check_groups(plane, n)
    for name in columns["id"].tolist():
        if isinstance(name, str) and len(name.split()) != 1:
            raise InputError(f"id must be text without blanks, because tables separate ids by blanks, got {name!r}")
    names = ["+".join(part.strip() for part in row.split("+")) for row in columns["fiber_type"].tolist()]
    object.__setattr__(plane, "fiber_type", np.array(names))
    if len(plane.fiber_types) > 1 and "" in plane.fiber_types:
        raise InputError("fiber_type must contain a type for every positioner, or for no positioner")
    if len(plane.fiber_types) > 62:
        raise InputError(f"fiber_type must have at most 62 types, got {len(plane.fiber_types)}")
    width = columns["spectrograph"].shape[1:]
    if width not in ((), (len(plane.fiber_types),)):
        raise InputError(
            f"spectrograph must have the shape ({n},) or ({n}, {len(plane.fiber_types)}), "
            f"got {columns['spectrograph'].shape}"
        )


def _check_groups(plane, n):
    """Check the groups of all positioners, and convert them to arrays of integers."""
    if not isinstance(plane.groups, dict | None):
        raise refusal("groups must be a dict of arrays of integers, one per positioner", plane.groups, dict)
    columns = {name: to_labels(value, f"groups[{name!r}]") for name, value in (plane.groups or {}).items()}
    for name, value in columns.items():
        if not (isinstance(name, str) and is_group(name)):
            text = "names of groups must be text without / that is not tile or the name of another column"
            raise InputError(f"{text}, got {name!r}")
        if value.shape != (n,) or value.dtype.kind != "i":
            text = f"groups[{name!r}] must contain an integer for each positioner, shape ({n},)"
            raise InputError(f"{text}, got {short(plane.groups[name])}")
    object.__setattr__(plane, "groups", columns or None)


def _numbers(plane, unit: u.UnitBase, *names: str) -> Iterator[tuple[str, u.Quantity, np.ndarray]]:
    """Yield the name, the values and the numbers in a unit of each of the given columns that a focal plane has."""
    for name in names:
        if getattr(plane, name) is not None:
            yield name, getattr(plane, name), to_unit(getattr(plane, name), unit, name)


def _check_lengths(plane, n):
    """Check the lengths of the arms of all positioners."""
    for name, _, lengths in _numbers(plane, u.mm, "central_arm", "eccentric_arm"):
        if lengths.shape != (n,):
            raise InputError(f"{name} must be {n} positive lengths, got the shape {lengths.shape}")
        for strange in lengths[~((lengths > 0) & (lengths < 1e6))]:
            raise InputError(f"{name} must be {n} positive lengths below 1 km, got {strange:g} mm")


def _check_obstacles(plane):
    """Check circles and polygons that are obstacles, and circles that hide fibers."""
    for name, _, circles in _numbers(plane, u.mm, "obstacles", "hidden"):
        what = f"{name} must have rows (x, y, radius) of finite values with radius >= 0"
        if circles.ndim != 2 or circles.shape[1] != 3:
            raise InputError(f"{what}, got the shape {circles.shape}")
        for strange in circles[~(np.isfinite(circles).all(axis=1) & (circles[:, 2] >= 0))]:
            raise InputError(f"{what}, got {strange.tolist()} mm")
    polygons = plane.obstacle_polygons
    if polygons is not None:
        if isinstance(polygons, u.Quantity) or not isinstance(polygons, Sequence):
            raise InputTypeError(f"obstacle_polygons must be a list of polygons, got {short(polygons)}")
        object.__setattr__(plane, "obstacle_polygons", tuple(polygons))
        for k, polygon in enumerate(to_polygons(polygons)):
            if len(polygon) < 3:
                raise InputError(f"obstacle_polygons[{k}] must have at least three vertices, got {short(polygons[k])}")


def _check_fibers(plane, n):
    """Check the positions of fibers relative to the elbows, and convert them to a dict."""
    places = plane.fiber_xy
    if places is None:
        return
    if plane.eccentric_arm is not None:
        raise InputError(
            "fiber_xy must be given without eccentric_arm, because fiber_xy already contains the distances "
            "from elbows to fibers"
        )
    if not isinstance(places, dict):
        if len(plane.fiber_types) > 1:
            raise InputError(
                f"fiber_xy must be a dict with the fiber types {', '.join(plane.fiber_types)}, got one array"
            )
        places = {plane.fiber_types[0]: places}
    places = dict(places)
    object.__setattr__(plane, "fiber_xy", places)
    for name in plane.fiber_types:
        if name not in places:
            raise InputError(f"fiber_xy must have the fiber type {name!r}, got {listed(map(repr, places))}")
    for name, value in places.items():
        points = to_points_mm(value, f"fiber_xy of {name!r}")
        if len(points) != n:
            raise InputError(f"fiber_xy of {name!r} must have the shape ({n}, 2), got {points.shape}")
        has = np.array([name in row.split("+") for row in plane.fiber_type.tolist()])
        length = np.hypot(*points.T)
        for k in np.flatnonzero(np.where(has, ~((length > 0) & (length < 1e6)), length >= 1e6)):
            raise InputError(
                f"fiber_xy of {name!r} must be finite, not (0, 0) mm and within 1 km of the elbow for each "
                f"positioner with this fiber, got {points[k].tolist()} mm for positioner {plane.id[k]}"
            )


def _check_joints(plane, n):
    """Check the zero points, the joint limits and the angles of stuck joints of all positioners."""
    for name, value, angles in _numbers(plane, u.rad, "zero_points", "theta_range", "phi_range", "stuck"):
        if angles.shape != (n, 2):
            raise InputError(f"{name} must have the shape ({n}, 2), got {angles.shape}")
        low, high = angles.T
        if name == "zero_points":
            good, what = np.isfinite(angles).all(axis=1), "be two finite angles for each positioner"
        elif name == "stuck":
            good, what = np.isfinite(low) == np.isfinite(high), "contain both theta and phi of a positioner, or neither"
        else:
            good = (low < high) & np.isfinite(high - low) | np.isnan(low) & np.isnan(high)
            what = "be (low, high) with low < high, or (NaN, NaN), for each positioner"
        for k in np.flatnonzero(~good):
            raise InputError(f"{name} must {what}, got {value[k]} for positioner {plane.id[k]}")


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
    angles = dict(zip(("stuck_theta", "stuck_phi"), np.rad2deg(plane.arrays.stuck).T, strict=True))
    for name, values in lengths.items():
        table[name] = np.append(values, np.full(m, np.nan)) * u.mm
    for name, (low, high) in JOINTS.items():
        if getattr(plane, name) is not None:
            angles |= dict(zip((low, high), to_unit(getattr(plane, name), u.deg, name).T, strict=True))
    for name, values in angles.items():  # angles that were given in degrees are stored exactly
        table[name] = np.append(values, np.full(m, np.nan)) * u.deg
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


def figure_of(plane) -> str:
    """Return a small figure of the positioners of a `FocalPlane` for notebooks."""
    disabled = np.zeros(len(plane), dtype=bool) if plane.disabled is None else np.asarray(plane.disabled)
    groups = {"positioners": (BLUE, ~disabled)} | ({"disabled": (RED, disabled)} if disabled.any() else {})
    return dots(plane.arrays.xy, groups)


def html_of(plane) -> str:
    """Return the representation of a `FocalPlane` in notebooks."""
    return to_html(plane, {"positioner": repr(plane.positioner).strip("<>")}, figure=figure_of(plane))
