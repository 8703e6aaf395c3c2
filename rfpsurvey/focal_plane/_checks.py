"""Checks of the columns of a focal plane."""

from collections.abc import Iterator, Sequence

import astropy.units as u
import numpy as np

from rfpsurvey._units import check_unique, to_flags, to_labels, to_plain, to_points_mm, to_unit
from rfpsurvey.errors import InputError, InputTypeError, listed, refusal, short
from rfpsurvey.focal_plane._margins import check_margins
from rfpsurvey.focal_plane._obstacles import to_polygons
from rfpsurvey.focal_plane._tables import is_group
from rfpsurvey.positioner import Positioner


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
