"""The minimum separation of arms, and limits of rounding errors, in the form that the collision kernels require."""

import numpy as np

from rfpsurvey._kernels import arms, collisions
from rfpsurvey._kernels.outlines import OUTLINE_ERROR
from rfpsurvey.focal_plane._obstacles import find_polygons
from rfpsurvey.positioner import make_outline


def find_limits(columns, extra: float = 0.0) -> collisions.Limits:
    """Return the minimum separation and the limits of rounding errors that the collision kernels require.

    ``extra`` (mm) is added to the minimum separation.
    """
    separation = columns.separation + extra
    extent = np.hypot(*columns.xy.T) + columns.arm_reach
    size = float(extent.max()) + columns.reach_slack + arms.EQUAL_ARMS
    shape, polygons = columns.plane.positioner.outline, find_polygons(columns)
    if shape is None:
        return collisions.limits(separation, columns.longest, size, polygons=polygons)
    outline = make_outline(shape, columns.xy, columns.central_arm)
    # ``largest`` is an upper limit of the distance between a point of one arm and a point of another arm, if the two
    # arms are at the minimum separation
    arms_apart = columns.longest + outline.offset + float(columns.central_arm.max())
    largest = separation + outline.offset + 2 * arms_apart
    error = 1.2 * OUTLINE_ERROR * (largest + outline.offset)
    return collisions.limits(separation + outline.offset, columns.longest, size, outline, error, polygons)


def find_obstacle_slack(columns) -> float:
    """Return an upper limit (mm) of the rounding error of the distance from an arm to an obstacle that it touches."""
    size = float(columns.obstacles[:, 2].max(initial=0.0)) + columns.clearance + columns.longest
    for polygon in columns.obstacle_polygons:  # the vertices of a polygon can be far from the arms
        size = max(size, 2 * float(np.hypot(*polygon.T).max()) + columns.longest)
    outline = columns.limits.outline
    if outline.start.size == 1:
        return 1.2 * collisions.DISTANCE_ERROR * size
    return 1.2 * OUTLINE_ERROR * (size + 2 * float(columns.arm_reach.max()) + outline.offset)
