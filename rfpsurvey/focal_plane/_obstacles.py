"""Fixed obstacles (circles and convex polygons), the minimum separation of arms, and limits of rounding errors."""

from copy import copy
from functools import cached_property

import astropy.units as u
import numpy as np
import scipy  # its subpackages are imported on first use

from rfpsurvey._kernels import arms, collisions
from rfpsurvey._kernels.outlines import NO_POLYGONS, OUTLINE_ERROR, Polygons
from rfpsurvey._units import locked
from rfpsurvey.positioner import convex_polygon, make_outline, with_normals


def to_polygons(given) -> tuple[np.ndarray, ...]:
    """Return the vertices of each polygon (mm) in counter-clockwise order."""
    return tuple(locked(convex_polygon(polygon, f"obstacle_polygons[{k}]")) for k, polygon in enumerate(given or ()))


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
    table = np.hstack([first, *(with_normals(polygon) for polygon in polygons)])
    return Polygons(locked(np.ascontiguousarray(table)), locked(start))


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


class FixedObstacles:
    """Properties that `FocalPlaneArrays` inherits: pairs of positioners and obstacles, and limits for collisions."""

    @cached_property
    def obstacle_pairs(self) -> np.ndarray:
        circles = self.obstacles
        if self.obstacle_polygons:
            around = [(*p.mean(axis=0), np.hypot(*(p - p.mean(axis=0)).T).max()) for p in self.obstacle_polygons]
            circles = np.vstack([circles, around])
        if len(circles) == 0:
            return locked(np.empty((0, 2), dtype=np.int64))
        most = (self.arm_reach.max() + circles[:, 2] + self.clearance) * 1.001 + 1
        near = scipy.spatial.cKDTree(self.xy).query_ball_point(circles[:, :2], most)
        owner = np.concatenate([np.array(rows, dtype=np.int64) for rows in near])
        obstacle = np.repeat(np.arange(len(circles)), list(map(len, near)))
        apart = np.hypot(*(self.xy[owner] - circles[obstacle, :2]).T)
        limit = self.arm_reach[owner] + circles[obstacle, 2] + self.clearance
        keep = apart < limit * (1 + 1e-12) + self.touch_slack
        pairs = np.column_stack([owner, obstacle])[keep]
        return locked(np.ascontiguousarray(pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]))

    @cached_property
    def limits(self) -> collisions.Limits:
        """Minimum separation of arms and limits of rounding errors, in the form that the collision kernels require."""
        return self.limits_with()

    def limits_with(self, extra: float = 0.0) -> collisions.Limits:
        """Return `limits` for a minimum separation that is increased by ``extra`` (mm)."""
        separation = self.separation + extra
        extent = np.hypot(*self.xy.T) + self.arm_reach
        size = float(extent.max()) + self.reach_slack + arms.EQUAL_ARMS
        shape, polygons = self.plane.positioner.outline, find_polygons(self)
        if shape is None:
            return collisions.limits(separation, self.longest, size, polygons=polygons)
        outline = make_outline(shape, self.xy, self.central_arm)
        # ``largest`` is an upper limit of the distance between a point of one arm and a point of another arm, if the
        # two arms are at the minimum separation
        arms_apart = self.longest + outline.offset + float(self.central_arm.max())
        largest = separation + outline.offset + 2 * arms_apart
        error = 1.2 * OUTLINE_ERROR * (largest + outline.offset)
        return collisions.limits(separation + outline.offset, self.longest, size, outline, error, polygons)

    @cached_property
    def obstacle_slack(self) -> float:
        """Upper limit (mm) of the rounding error of the distance between an arm and an obstacle that it touches."""
        size = float(self.obstacles[:, 2].max(initial=0.0)) + self.clearance + self.longest
        for polygon in self.obstacle_polygons:  # the vertices of a polygon can be far from the arms
            size = max(size, 2 * float(np.hypot(*polygon.T).max()) + self.longest)
        outline = self.limits.outline
        if outline.start.size == 1:
            return 1.2 * collisions.DISTANCE_ERROR * size
        return 1.2 * OUTLINE_ERROR * (size + 2 * float(self.arm_reach.max()) + outline.offset)
