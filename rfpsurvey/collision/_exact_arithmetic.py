"""The test of a pair of arms in exact arithmetic, for distances at which rounding errors could change the result."""

from fractions import Fraction
from math import lcm, sqrt

__all__ = ["closer_exactly", "distance_exactly"]


def closer_exactly(first, second, separation: float | Fraction) -> bool:
    """Return whether two segments (x0, y0, x1, y1) are closer than ``separation``, without rounding.

    All numbers are converted to a common denominator. The test needs no division after this conversion, so that all
    arithmetic uses integers.
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
