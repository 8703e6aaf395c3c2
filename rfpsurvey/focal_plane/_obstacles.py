"""Fixed obstacles of a focal plane, which no arm may touch: circles and convex polygons."""

from copy import copy

import astropy.units as u
import numpy as np
import scipy  # its subpackages are imported on first use

from rfpsurvey._kernels.outlines import NO_POLYGONS, Polygons
from rfpsurvey._units import locked
from rfpsurvey.positioner import convex_polygon, make_outline, with_normals


def to_polygons(given) -> tuple[np.ndarray, ...]:
    """Return the vertices of each polygon (mm) in counter-clockwise order."""
    return tuple(locked(convex_polygon(one, f"obstacle_polygons[{k}]")) for k, one in enumerate(given or ()))


def find_polygons(columns) -> Polygons:
    """Return the polygons of the obstacles in the form that the collision kernels require."""
    polygons, shape = columns.obstacle_polygons, columns.plane.positioner.outline
    if not polygons:
        return NO_POLYGONS
    first = np.empty((5, 0))
    if shape is not None:
        outline = make_outline(shape, columns.xy, columns.central_arm)
        first = outline.table[:, : outline.n_vertices]
    start = first.shape[1] + np.cumsum([0, *map(len, polygons)]).astype(np.int64)
    table = np.hstack([first, *(with_normals(one) for one in polygons)])
    return Polygons(locked(np.ascontiguousarray(table)), locked(start))


def find_obstacle_pairs(columns) -> np.ndarray:
    """Return the pairs (positioner, obstacle) that can touch; circles have lower numbers than polygons."""
    circles = columns.obstacles
    if columns.obstacle_polygons:
        around = [(*one.mean(axis=0), np.hypot(*(one - one.mean(axis=0)).T).max()) for one in columns.obstacle_polygons]
        circles = np.vstack([circles, around])
    if len(circles) == 0:
        return locked(np.empty((0, 2), dtype=np.int64))
    most = (columns.arm_reach.max() + circles[:, 2] + columns.clearance) * 1.001 + 1
    near = scipy.spatial.cKDTree(columns.xy).query_ball_point(circles[:, :2], most)
    own = np.concatenate([np.array(rows, dtype=np.int64) for rows in near])
    other = np.repeat(np.arange(len(circles)), list(map(len, near)))
    apart = np.hypot(*(columns.xy[own] - circles[other, :2]).T)
    limit = columns.arm_reach[own] + circles[other, 2] + columns.clearance
    keep = apart < limit * (1 + 1e-12) + columns.touch_slack
    pairs = np.column_stack([own, other])[keep]
    return locked(np.ascontiguousarray(pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]))


def with_circles(plane, circles: np.ndarray):
    """Return the focal plane with more circles (x, y, radius in mm) that no arm may touch.

    All arrays that do not depend on these circles are computed only once, for the original focal plane.
    """
    for name in ("joints", "grid", "runs", "limits", "annuli", "bounds", "angles", "offers", "n_sharing", "_idle"):
        getattr(plane.arrays, name)
    more, arrays = copy(plane), copy(plane.arrays)
    circles = locked(np.vstack([arrays.obstacles, circles]))
    for name in ("obstacle_pairs", "obstacle_slack"):
        arrays.__dict__.pop(name, None)
    arrays.__dict__.update(plane=more, obstacles=circles)
    more.__dict__.update(arrays=arrays, obstacles=circles << u.mm)
    return more
