"""Fractions of a focal plane that exactly 0, 1, 2, ... positioners reach."""

import numpy as np
import scipy  # its subpackages are imported on first use

from rfpsurvey._units import to_generator
from rfpsurvey.errors import InputError, check_whole


def footprint_of(plane) -> "scipy.spatial.ConvexHull":
    """Return the footprint of a focal plane in mm, the convex hull of the centers of the positioners."""
    try:
        return scipy.spatial.ConvexHull(plane.arrays.xy)
    except (scipy.spatial.QhullError, ValueError):
        raise InputError(
            f"the footprint must have at least three centers that are not on a line, got {len(plane)} centers"
        ) from None


def on_footprint(plane, points: np.ndarray) -> np.ndarray:
    """Return whether points (mm) are inside the footprint; points with NaN are outside."""
    hull = footprint_of(plane)
    inside = np.isfinite(points).all(axis=1)
    inside[inside] = scipy.spatial.Delaunay(hull.points[hull.vertices]).find_simplex(points[inside]) >= 0
    return inside


def find_coverage(plane, n_points, rng) -> np.ndarray:
    """Return the fractions of the footprint that exactly 0, 1, 2, ... positioners reach.

    One random point is drawn in each cell of a square grid. If the points were on a regular grid, the result would
    depend on the alignment of the grid with the lattice of the positioners.
    """
    check_whole(n_points, "n_points", 1, 2**26)
    hull = footprint_of(plane)
    corners = hull.points[hull.vertices]
    n = int(np.ceil(np.sqrt(n_points)))
    cells = np.stack(np.meshgrid(np.arange(n), np.arange(n)), axis=-1).reshape(-1, 2)
    points = corners.min(axis=0) + (cells + to_generator(rng).random((n * n, 2))) / n * np.ptp(corners, axis=0)
    inside = points[on_footprint(plane, points)]
    if len(inside) == 0:
        raise InputError(f"n_points must be so large that at least one point is in the footprint, got {n_points}")
    return np.bincount(np.diff(plane.arrays.reach(inside).indptr)) / len(inside)
