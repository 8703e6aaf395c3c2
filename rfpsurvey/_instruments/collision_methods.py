"""Methods that find colliding pairs: a fast exact method, methods for comparison, and exact arithmetic.

These tests are used for pairs of arms whose distance is so close to the minimum separation that rounding errors could
change the result.
"""

from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise, product
from math import lcm, sqrt
from typing import NamedTuple

import numpy as np

from rfpsurvey._common.descriptions import Method, table_of
from rfpsurvey._instruments.arms import Arms
from rfpsurvey._instruments.focal_plane import FocalPlane
from rfpsurvey._instruments.outline import convex_hull, orientation
from rfpsurvey._kernels import arms, collisions
from rfpsurvey._kernels import batch as reference
from rfpsurvey._kernels.outlines import RADIUS, Outline, place_outline


def arms_closer_exactly(columns, segments: np.ndarray, a: int, b: int, i: int, j: int) -> bool:
    """Return whether two arms are closer than the minimum separation or, if it is 0, touch, without rounding.

    Parameters
    ----------
    columns : FocalPlaneArrays
        The positioners.
    segments : ndarray, shape (4, n)
        Segments that can collide; for arms with outlines, the segments from the elbow along the eccentric arm.
    a, b : int
        Indices of the two arms along the last axis of ``segments``.
    i, j : int
        Rows of the positioners of these two arms in ``columns``.
    """
    first, second, outline = segments[:, a].tolist(), segments[:, b].tolist(), columns.limits.outline
    if outline.start.size == 1:
        return closer_exactly(first, second, columns.separation)
    return outlines_closer_exactly(outline, i, j, first, second, columns.separation)


def closer_exactly(first, second, separation: float | Fraction) -> bool:
    """Return whether two segments (x0, y0, x1, y1) are closer than ``separation`` or, if it is 0, touch or cross.

    All numbers are converted to a common denominator. The test needs no division after this conversion, so all
    arithmetic uses integers.
    """
    ratios = [Fraction(v).as_integer_ratio() for v in (*first, *second, separation)]
    common = lcm(*(q for _, q in ratios))
    *ends, limit = (p * (common // q) for p, q in ratios)
    a, b, c, d = zip(ends[::2], ends[1::2], strict=True)
    return _polygons_closer(sorted({a, b}), sorted({c, d}), limit, closed=limit == 0)


def distance_exactly(first, second) -> float:
    """Return the distance between two segments, computed from the exact squared distance."""
    a, b, c, d = ((Fraction(float(e[k])), Fraction(float(e[k + 1]))) for e in (first, second) for k in (0, 2))
    if orientation(a, b, c) * orientation(a, b, d) < 0 and orientation(c, d, a) * orientation(c, d, b) < 0:
        return 0.0
    return sqrt(min(n / m for n, m in (_squared(a, c, d), _squared(b, c, d), _squared(c, a, b), _squared(d, a, b))))


def outlines_closer_exactly(outline: Outline, i: int, j: int, first, second, separation: float | Fraction) -> bool:
    """Return whether the gap between the outlines of two positioners is less than ``separation``, without rounding.

    ``first`` and ``second`` are the segments (x0, y0, x1, y1), from the elbow along the eccentric arm, that determine
    the poses of the positioners i and j. A polygon is the convex hull of its vertices, whose positions relative to the
    elbow or center are rounded to double precision. If the separation is 0, outlines that touch collide.
    """
    placed = [_placed_vertices(outline, k, core) for k, core in ((i, first), (j, second))]
    radii = [Fraction(radius) for radius in outline.parts[RADIUS].tolist()]
    numbers = [Fraction(separation), *radii, *(v for points in placed for point in points for v in point)]
    common = lcm(*(v.denominator for v in numbers))  # so that all arithmetic uses integers
    spans = list(pairwise(outline.start.tolist()))
    whole = [[(int(x * common), int(y * common)) for x, y in points] for points in placed]
    hulls = [[convex_hull(points[a:b]) for a, b in spans] for points in whole]
    n = outline.n_eccentric
    for p, q in product(range(len(radii)), repeat=2):
        limit = int((Fraction(separation) + radii[p] + radii[q]) * common)
        if (p < n or q < n) and _polygons_closer(hulls[0][p], hulls[1][q], limit, closed=separation == 0):
            return True
    return False


def touches_exactly(columns, i: int, segment, j: int) -> bool:
    """Return whether an arm of positioner i is closer to obstacle j than the clearance, or overlaps this obstacle.

    ``segment`` (x0, y0, x1, y1) is the segment of the arm that can collide; for an arm with an outline, it is the
    segment from the elbow along the eccentric arm. Obstacles are numbered from 0: first the circles, then the polygons.
    """
    circles, outline = columns.obstacles, columns.limits.outline
    if j < len(circles):
        x, y, radius = (Fraction(v) for v in circles[j].tolist())
        obstacle, limit = [(x, y)], radius + Fraction(columns.clearance)
    else:
        points = columns.obstacle_polygons[j - len(circles)].tolist()
        obstacle, limit = convex_hull([(Fraction(x), Fraction(y)) for x, y in points]), Fraction(columns.clearance)
    if outline.start.size == 1:
        ends = [Fraction(v) for v in segment]
        parts = [(sorted({(ends[0], ends[1]), (ends[2], ends[3])}), Fraction(0))]
    else:
        placed, spans = _placed_vertices(outline, i, segment), pairwise(outline.start.tolist())
        radii = map(Fraction, outline.parts[RADIUS].tolist())
        parts = [(convex_hull(placed[a:b]), radius) for (a, b), radius in zip(spans, radii, strict=True)]
    return any(_polygons_closer(part, obstacle, limit + radius) for part, radius in parts)


def _placed_vertices(outline, i, core):
    """Return the vertices of all parts of the outline of a positioner, as points with rational coordinates."""
    placed = np.empty((4, outline.n_vertices))
    place_outline(outline, i, *map(float, core), placed)
    return [(Fraction(x) + Fraction(dx), Fraction(y) + Fraction(dy)) for x, y, dx, dy in placed.T.tolist()]


def _polygons_closer(first, second, limit, *, closed=False):
    """Return whether two convex polygons overlap or are closer than ``limit``; if ``closed``, also at the limit."""
    # the line through an edge separates two convex polygons that do not overlap; two points have no edge
    if len(first) + len(second) > 2 and not (_separated(first, second) or _separated(second, first)):
        return True
    sides = (product(first, _edges(second)), product(second, _edges(first)))
    return any(_near(point, *edge, limit, closed=closed) for side in sides for point, edge in side)


def _edges(polygon):
    """Return the edges of a convex polygon; a polygon with two vertices has two edges with opposite directions."""
    return list(zip(polygon, polygon[1:] + polygon[:1], strict=True))


def _separated(first, second):
    """Return whether the line through an edge of a convex polygon separates this polygon from another polygon."""
    if len(first) == 1:
        return False
    return any(all(orientation(a, b, point) <= 0 for point in second) for a, b in _edges(first))


def _near(p, a, b, limit, *, closed=False):
    """Return whether the point p is closer than ``limit`` to the segment a-b; if ``closed``, also at the limit."""
    numerator, denominator = _squared(p, a, b)
    most = limit**2 * denominator
    return numerator < most or (closed and numerator == most)


def _squared(p, a, b):
    """Return the numerator and the denominator of the squared distance of the point p from the segment a-b."""
    length2 = (b[0] - a[0]) ** 2 + (b[1] - a[1]) ** 2
    along = (b[0] - a[0]) * (p[0] - a[0]) + (b[1] - a[1]) * (p[1] - a[1])
    if 0 < along < length2:
        return orientation(a, b, p) ** 2, length2
    x, y = a if along <= 0 else b
    return (p[0] - x) ** 2 + (p[1] - y) ** 2, 1


@dataclass(frozen=True, eq=False)
class Configuration:
    """One configuration of all arms, in which a method finds the colliding pairs."""

    plane: FocalPlane
    segments: np.ndarray  # segments that can collide, as columns, shape (4, n)
    n_points: int
    poses: Callable[[], Arms]  # function that returns the poses of all arms; only a few methods call it


class Found(NamedTuple):
    """Colliding pairs with first < second, their distances (mm), and the number of borderline pairs."""

    first: np.ndarray
    second: np.ndarray
    distances: np.ndarray
    n_borderline: int | None = None


@dataclass(frozen=True)
class CollisionMethod(Method):
    """A method that finds colliding pairs; the function takes a `Configuration` and returns a `Found`."""

    supports_outlines: bool = False  # whether arms may have outlines
    device: str = "CPU"  # device that computes the distances
    # number of configurations per task of `count_collisions`; 0 if the method cannot count many of them; random draws
    # depend on it, but not on the number of workers; for 4000 positioners, 2048 configurations on a GPU use 256 MB
    chunk: int = 0
    numbers_of_points: tuple[int, ...] = ()  # values of ``n_points`` that a benchmark measures; empty without points


def exact(case: Configuration) -> Found:
    """Compute distances with a proven error limit; rational arithmetic decides pairs for which the error matters."""
    columns = case.plane.arrays
    halves, first, second = _scratch(case)
    squared = np.empty(len(first))
    outlined = case.plane.positioner.outline is not None
    search = collisions.colliding_outlines if outlined else collisions.colliding_pairs
    n, n_edge = search(case.segments, halves, columns.runs, columns.limits, first, second, squared)
    if n_edge == 0 and not outlined:
        return Found(first[:n], second[:n], np.sqrt(squared[:n]), 0)
    return _settle(case, first[:n], second[:n], squared[:n])


def sampled(case: Configuration) -> Found:
    """Compute the smallest distance between ``n_points`` points on one arm and ``n_points`` points on the other arm.

    The method misses some pairs that are only slightly closer than D, and also some crossings if n_points <= 1 + length
    of the arm / (sqrt(2) D).
    """
    first, second = near_pairs(case)
    squared = np.empty(len(first))
    reference.sampled(case.segments, first, second, case.n_points, squared)
    return keep_closer(case, first, second, np.sqrt(squared))


def sweep(case: Configuration) -> Found:
    """Compute the distance between the areas that two arms sweep on the way from their parked poses to the given poses.

    Each area is sampled by ``n_points`` poses. Both joints rotate at the same time, in the shorter direction
    (regardless of hard stops). There are no false negatives, but many false positives.
    """
    plane, posed = case.plane, case.poses()
    pairs = plane.arrays.neighbors[posed.present[plane.arrays.neighbors].all(axis=1)]
    first, second = pairs.T.copy()
    poses = np.empty((case.n_points, *case.segments.shape))
    # Idle arms remain parked.
    columns = plane.arrays.using(posed.fiber)
    start = np.array(columns.from_joints(*columns.home))
    end = np.array(columns.from_joints(posed.theta, posed.phi))
    move = end - start
    move -= 2 * np.pi * np.round(move / (2 * np.pi))
    angles = _capsule_angles(posed)
    for pose, part in zip(poses[:-1], np.linspace(0, 1, case.n_points), strict=False):
        arms.pose(*(start + part * move), columns.geometry, pose)
        arms.shape(pose, plane.arrays.model, plane.arrays.length, *angles)
    poses[-1] = case.segments
    squared = np.empty(len(first))
    reference.swept(poses, posed.assigned, first, second, squared)
    limits = plane.arrays.limits
    near = squared < collisions.squared_limit(limits) + limits.band  # because of this allowance, no pair is missed
    return Found(first[near], second[near], np.sqrt(squared[near]))


def scipy(case: Configuration) -> Found:
    """Minimize the distance by SciPy, with bounded least squares over two points along the two arms; slow."""
    from scipy.optimize import lsq_linear

    first, second = near_pairs(case)
    distances = np.empty(len(first))
    for k in range(len(first)):
        p, q = case.segments[:, first[k]].reshape(2, 2), case.segments[:, second[k]].reshape(2, 2)
        matrix, offset = np.column_stack([p[1] - p[0], q[0] - q[1]]), q[0] - p[0]
        solution = lsq_linear(matrix, offset, bounds=(0, 1), method="bvls", tol=1e-14)
        distances[k] = np.hypot(*(matrix @ solution.x - offset))
    return keep_closer(case, first, second, distances)


def cuda(case: Configuration) -> Found:
    """Use the method ``exact``, with distances computed on a GPU (requires ``rfpsurvey[cuda]``)."""
    from rfpsurvey._instruments import gpu as _gpu

    return _settle(case, *_gpu.find_pairs(case.segments, case.plane.arrays.neighbors, case.plane.arrays.limits))


METHODS = table_of(
    CollisionMethod("exact", exact, supports_outlines=True, chunk=64),
    CollisionMethod("sampled", sampled, numbers_of_points=(3, 5, 9, 17, 33, 65, 129)),
    CollisionMethod("sweep", sweep, numbers_of_points=(9, 65)),
    CollisionMethod("scipy", scipy),
    CollisionMethod("cuda", cuda, device="GPU", chunk=2048),
)
"""Methods by name."""
DEFAULT_METHOD = "exact"
"""The method that finds collisions unless the user chooses another one; benchmarks compare all methods with it."""


def near_pairs(case: Configuration) -> tuple[np.ndarray, np.ndarray]:
    """Return the pairs of neighbors that may be closer than the minimum separation."""
    halves, first, second = _scratch(case)
    n = collisions.near_pairs(halves, case.plane.arrays.runs, case.plane.arrays.limits, first, second)
    return first[:n], second[:n]


def keep_closer(case: Configuration, first: np.ndarray, second: np.ndarray, distances: np.ndarray) -> Found:
    """Return the pairs closer than the minimum separation."""
    near = distances < case.plane.arrays.separation
    return Found(first[near], second[near], distances[near])


def _scratch(case):
    """Return the midpoints and half vectors (from midpoint to end) of segments, and work arrays for all pairs."""
    size = len(case.plane.arrays.neighbors)
    halves = np.empty_like(case.segments)
    collisions.halve(case.segments, halves)
    return halves, np.empty(size, dtype=np.int64), np.empty(size, dtype=np.int64)


def _settle(case, first, second, squared):
    """Return the pairs that collide; exact arithmetic decides pairs for which rounding could change the result."""
    limits = case.plane.arrays.limits
    edge = np.flatnonzero(squared >= collisions.squared_limit(limits) - limits.band)
    if len(edge):
        keep = np.ones(len(squared), dtype=bool)
        for k in edge:
            keep[k] = arms_closer_exactly(case.plane.arrays, case.segments, first[k], second[k], first[k], second[k])
        first, second, squared = first[keep], second[keep], squared[keep]
    # the distances of outlines are computed with an offset; overlapping outlines have the distance 0
    return Found(first, second, np.maximum(np.sqrt(squared) - limits.outline.offset, 0.0), len(edge))


def _capsule_angles(posed):
    """Return the cosine and sine of the angle, at each elbow, from the fiber to the segment that can collide."""
    (ux, uy), (vx, vy) = (posed.tip - posed.elbow).T, (posed.segments[:, 2:] - posed.elbow).T
    scale = np.hypot(ux, uy) * np.hypot(vx, vy)
    scale[scale == 0] = 1  # capsules whose length is 0
    return (ux * vx + uy * vy) / scale, (ux * vy - uy * vx) / scale
