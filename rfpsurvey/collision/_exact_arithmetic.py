"""Test in exact arithmetic whether arms collide.

These tests are used for pairs of arms whose distance is so close to the minimum separation that rounding errors could
change the result.
"""

from fractions import Fraction
from itertools import pairwise, product
from math import lcm, sqrt

import numpy as np

from rfpsurvey._kernels.outlines import RADIUS, Outline, place_outline
from rfpsurvey.positioner import convex_hull, orientation


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
