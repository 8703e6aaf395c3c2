"""Convert joint angles to positions of fibers, and vice versa, for all positioners of a focal plane."""

from collections.abc import Callable
from functools import partial

import astropy.units as u
import numpy as np

from rfpsurvey._kernels import arms
from rfpsurvey._units import to_plain, to_points_mm, to_radian
from rfpsurvey.errors import InputError, check_choice, check_fiber_type

MODELS = {
    "elbow_to_tip": arms.ELBOW_TO_TIP,
    "capsule": arms.CAPSULE,
    "fiber_tip": arms.FIBER_TIP,
    "outline": arms.CAPSULE,  # the core of an outline is a segment along the eccentric arm
}
"""Number by which the kernels identify each arm model."""


def forward(plane, theta, phi, fiber_type) -> u.Quantity:
    """Return the position of a fiber of each positioner; see `FocalPlane.forward`."""
    n, columns = len(plane), plane.arrays
    angles = [to_radian(value, name) for value, name in ((theta, "theta"), (phi, "phi"))]
    if any(value.shape != (n,) for value in angles):
        raise InputError(f"theta and phi must have the shape ({n},), got {' and '.join(str(v.shape) for v in angles)}")
    fiber, missing = _fibers(plane, fiber_type)
    owner, segments = np.arange(n), np.empty((4, n))
    angles = (np.ascontiguousarray(v, dtype=float) for v in columns.from_joints(*angles, owner, fiber))
    arms.pose(*angles, columns.geometry_of(owner, fiber), segments)
    segments[:, missing] = np.nan
    return segments[2:].T.copy() << u.mm


def inverse(plane, xy, fiber_type, handedness) -> tuple[u.Quantity, u.Quantity]:
    """Return the joint angles that place a fiber of each positioner at a point; see `FocalPlane.inverse`."""
    n, columns = len(plane), plane.arrays
    points = to_points_mm(xy, "xy")
    if len(points) != n:
        raise InputError(f"xy must have a row for each of the {n} positioners, got {len(points)}")
    fiber, missing = _fibers(plane, fiber_type)
    owner = np.arange(n)
    side = to_sides(columns, points, handedness, fiber)
    g, angles = columns.geometry_of(owner, fiber), np.empty((2, n))
    arms.solve(points, g, side, *angles)
    bounds = columns.bounds_of(owner, fiber, side)
    r2 = ((points - columns.xy) ** 2).sum(axis=1)
    reached = (r2 >= bounds.low) & (r2 <= bounds.high) & ~missing & columns.joints_allow(owner, points, side, fiber)
    return tuple(np.rad2deg(np.where(reached, v, np.nan)) << u.deg for v in columns.to_joints(*angles, owner, fiber))


def to_sides(columns, points: np.ndarray, handedness: object, fiber: np.ndarray | None = None) -> np.ndarray:
    """Return +1 for right-handed and -1 for left-handed arms; by default, the focal plane determines the handedness."""
    if handedness is None:
        return columns.sides(points, None, fiber)
    check = partial(check_choice, choices=("right", "left"), what="handedness of an arm")
    return np.where(_names(handedness, len(columns.plane), "handedness", check) == "left", -1.0, 1.0)


def _fibers(plane, fiber_type):
    """Return the index of the requested fiber of each positioner, and whether the positioner lacks this fiber."""
    n, columns = len(plane), plane.arrays
    fibers = columns.fibers
    names = plane.fiber_types if fibers is None else fibers.names
    if fiber_type is None:
        return columns.first_index, np.zeros(n, dtype=bool)
    types = _names(fiber_type, n, "fiber_type", partial(check_fiber_type, fiber_types=names))
    index = np.array([names.index(name) for name in types.tolist()])
    lists = [row.split("+") for row in plane.fiber_type.tolist()]
    missing = np.array([t not in row for t, row in zip(types.tolist(), lists, strict=True)])
    return index, missing if fibers is None else fibers.missing[index, np.arange(n)]


def _names(given, n: int, what: str, check: Callable) -> np.ndarray:
    """Return one name for each of n positioners, after a check of each different name."""
    names = to_plain(given, what).astype(str)
    if names.shape not in ((), (n,)):
        raise InputError(f"{what} must be one name or have the shape ({n},), got {names.shape}")
    for name in np.unique(names):
        check(str(name))
    return np.broadcast_to(names, n)
