"""The test of a pair of arms in exact arithmetic, for distances at which rounding errors could change the result."""

from fractions import Fraction
from itertools import product
from math import lcm, sqrt

import numpy as np

from rfpsurvey._kernels.outlines import RADIUS, Outline, place_outline

__all__ = ["arms_closer_exactly", "closer_exactly", "distance_exactly", "outlines_closer_exactly"]


def arms_closer_exactly(columns, segments: np.ndarray, a: int, b: int, i: int, j: int) -> bool:
    """Return whether two arms are closer than the minimum separation, without rounding.

    Parameters
    ----------
    columns : FocalPlaneArrays
        The positioners.
    segments : ndarray, shape (4, n)
        Segments that can collide, or cores of outlines.
    a, b : int
        Columns of the two arms in ``segments``.
    i, j : int
        Rows of their positioners.
    """
    first, second, outline = segments[:, a].tolist(), segments[:, b].tolist(), columns.limits.outline
    if outline.start.size == 1:
        return closer_exactly(first, second, columns.separation)
    return outlines_closer_exactly(outline, i, j, first, second, columns.separation)


def outlines_closer_exactly(outline: Outline, i: int, j: int, first, second, separation: float) -> bool:
    """Return whether the outlines of two positioners with given cores are closer than ``separation``, or overlap.

    The vertices are placed in floating-point numbers, and compared without rounding. Central parts do not collide with
    each other.
    """
    placed = []
    for k, core in ((i, first), (j, second)):
        points = np.empty((2, outline.vertices.shape[1]))
        place_outline(outline, k, *core, points)
        exact = [(Fraction(x), Fraction(y)) for x, y in points.T.tolist()]
        placed.append(
            [exact[p:q] for p, q in zip(outline.start[:-1].tolist(), outline.start[1:].tolist(), strict=True)]
        )
    radii, n = [Fraction(r) for r in outline.parts[RADIUS].tolist()], outline.n_eccentric
    return any(
        _parts_closer(placed[0][p], placed[1][q], Fraction(separation) + radii[p] + radii[q])
        for p, q in product(range(len(radii)), repeat=2)
        if p < n or q < n
    )


def _parts_closer(p: list, q: list, limit: Fraction) -> bool:
    """Return whether two convex polygons are closer than a limit; for a limit of 0, whether their interiors overlap."""
    if limit == 0:
        return min(len(p), len(q)) > 2 and not _separated(p, q) and not _separated(q, p)
    if any(_contains(p, x) for x in q) or any(_contains(q, x) for x in p):
        return True
    return any(closer_exactly((*a, *b), (*c, *d), limit) for (a, b), (c, d) in product(_edges(p), _edges(q)))


def _edges(p):
    """Return the edges of a polygon; a single point is an edge of length 0."""
    return list(zip(p, p[1:] + p[:1], strict=True))[: 1 if len(p) < 3 else None]


def _separated(p, q):
    """Return whether the line through an edge of p has no point of q on its inner side."""
    return any(all(_orientation(a, b, x) <= 0 for x in q) for a, b in _edges(p))


def _contains(p, x):
    """Return whether a point is in a closed polygon of at least three vertices in counter-clockwise order."""
    return len(p) > 2 and all(_orientation(a, b, x) >= 0 for a, b in _edges(p))


def closer_exactly(first, second, separation: float | Fraction) -> bool:
    """Return whether two segments (x0, y0, x1, y1) are closer than ``separation``, without rounding.

    All numbers are converted to a common denominator. No division follows, so that all arithmetic uses integers.
    """
    ratios = [Fraction(v).as_integer_ratio() for v in (*first, *second, separation)]
    common = lcm(*(q for _, q in ratios))
    *ends, limit = (p * (common // q) for p, q in ratios)
    a, b, c, d = zip(ends[::2], ends[1::2], strict=True)
    if limit <= 0:
        return False
    if _orientation(a, b, c) * _orientation(a, b, d) < 0 and _orientation(c, d, a) * _orientation(c, d, b) < 0:
        return True
    return _near(a, c, d, limit) or _near(b, c, d, limit) or _near(c, a, b, limit) or _near(d, a, b, limit)


def distance_exactly(first, second) -> float:
    """Return the distance between two segments; the squared distance is computed exactly before it is rounded."""
    a, b, c, d = ((Fraction(float(e[k])), Fraction(float(e[k + 1]))) for e in (first, second) for k in (0, 2))
    if _orientation(a, b, c) * _orientation(a, b, d) < 0 and _orientation(c, d, a) * _orientation(c, d, b) < 0:
        return 0.0
    return sqrt(min(n / m for n, m in (_squared(a, c, d), _squared(b, c, d), _squared(c, a, b), _squared(d, a, b))))


def _orientation(a, b, p):
    """Return twice the signed area of the triangle a, b, p."""
    return (b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0])


def _near(p, a, b, limit):
    """Return whether the point p is closer than ``limit`` to the segment a-b."""
    numerator, denominator = _squared(p, a, b)
    return numerator < limit**2 * denominator


def _squared(p, a, b):
    """Return the numerator and the denominator of the squared distance of the point p from the segment a-b."""
    length2 = (b[0] - a[0]) ** 2 + (b[1] - a[1]) ** 2
    along = (b[0] - a[0]) * (p[0] - a[0]) + (b[1] - a[1]) * (p[1] - a[1])
    if 0 < along < length2:
        return _orientation(a, b, p) ** 2, length2
    x, y = a if along <= 0 else b
    return (p[0] - x) ** 2 + (p[1] - y) ** 2, 1
