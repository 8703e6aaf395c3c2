"""Signed gaps between the outlines of two positioners, with a proven error limit.

An outline consists of convex polygons, each inflated by its own radius, which move with the eccentric arm or with the
central arm. Each polygon is processed in the frame of its own arm: the x axis points along the arm, and the origin is
the elbow (eccentric arm) or the center of the positioner (central arm). A pair of polygons requires the relative
position of their frames only, so that no polygon is moved and no memory is allocated.

In all bounds, u = 2^-53 is the unit roundoff, and S is the largest distance between any two of the points of a pair:
vertices, elbows, centers of the positioners, and the ends of the cores. The proofs are on the accuracy page of the
documentation.
"""

import math
from typing import NamedTuple

import numpy as np

from rfpsurvey._jit import inlined_kernel, kernel
from rfpsurvey._kernels.collisions import UNIT

# The error of the square root of `outlines_squared` is at most this factor times (S + offset).
OUTLINE_ERROR = 256.0 * UNIT
# The error of a separation along the normal of an edge is less than this factor times S, but also less than the factor
# times the size that `frames_apart` returns.
AXIS_ERROR = 48.0 * UNIT

# Allowance (mm) for the directions of arms in the first test of a pair, which are approximate.
LOOSE = 1e-6

# Rows of the table of vertices: the vertex, the unit outward normal of the edge to the next vertex, and its length. A
# single vertex has an edge of length 0 with an arbitrary normal.
X, Y, NX, NY, LENGTH = range(5)
# Rows of the table of parts: the radius, and a circle that contains the part.
RADIUS, MX, MY, MR = range(4)


class Outline(NamedTuple):
    """The outline of all positioners, in mm; without any parts, the arms are capsules."""

    vertices: np.ndarray
    """Array of shape (5, m); see X, Y, NX, NY and LENGTH."""
    start: np.ndarray
    """Part p has the vertices ``start[p]:start[p + 1]``; an array with one element means that there is no outline."""
    parts: np.ndarray
    """Array of shape (4, k); see RADIUS, MX, MY and MR."""
    n_eccentric: int
    """The first parts move with the eccentric arm, the others with the central arm."""
    offset: float
    """Difference between the distance of two cores, and the smallest possible gap of their outlines."""
    inverse_length: float
    """Inverse length of the cores."""
    size: float
    """Largest distance of a vertex from the origin of its frame."""
    eccentric_box: tuple[float, float, float, float]
    """Center and half the lengths of the sides of a rectangle that contains the eccentric parts."""
    central_box: tuple[float, float, float, float]
    """The same for the central parts."""
    centers: np.ndarray
    """Centers of all positioners, and the inverse length of the central arm, shape (3, n)."""


@kernel
def frame(x, y, toward_x, toward_y):
    """Return the origin of a frame, and the cosine and sine of the direction from it to another point."""
    dx, dy = toward_x - x, toward_y - y
    inverse = 1.0 / math.sqrt(dx * dx + dy * dy)
    return x, y, dx * inverse, dy * inverse


@kernel
def frames_apart(first, second):
    """Return the origin of the second frame in the first frame, the cosine and sine of the rotation, and a size."""
    x, y, c, s = first
    dx, dy = second[0] - x, second[1] - y
    tx, ty = c * dx + s * dy, c * dy - s * dx
    return tx, ty, c * second[2] + s * second[3], c * second[3] - s * second[2], abs(tx) + abs(ty)


@kernel
def separation_along_normals(v, p, p_end, q, q_end, tx, ty, c, s, enough):
    """Return the largest separation of polygon q from polygon p along the normals of the edges of polygon p.

    The polygons have the vertices from p to ``p_end`` and from q to ``q_end`` of the table v. The frame of q has the
    origin t and the rotation (c, s) in the frame of p. The search stops at a separation of more than ``enough``.
    """
    best, e = -math.inf, p
    while e < p_end and best <= enough:
        nx, ny = v[NX, e], v[NY, e]
        mx, my = c * nx + s * ny, c * ny - s * nx  # the normal in the frame of q
        least = math.inf
        for k in range(q, q_end):
            least = min(least, mx * v[X, k] + my * v[Y, k])
        best = max(best, least + (nx * (tx - v[X, e]) + ny * (ty - v[Y, e])))
        e += 1
    return best


@kernel
def vertices_squared(v, p, p_end, q, q_end, tx, ty, c, s):
    """Return the least squared distance of a vertex of polygon q from an edge of polygon p; see above."""
    best = math.inf
    for k in range(q, q_end):
        x, y = tx + (c * v[X, k] - s * v[Y, k]), ty + (s * v[X, k] + c * v[Y, k])
        for e in range(p, p_end):
            dx, dy = x - v[X, e], y - v[Y, e]
            across = dx * v[NX, e] + dy * v[NY, e]
            along = dy * v[NX, e] - dx * v[NY, e]
            beyond = along - min(max(along, 0.0), v[LENGTH, e])
            best = min(best, across * across + beyond * beyond)
    return best


@kernel
def boxes_apart(first, second, between):
    """Return the largest separation of two boxes along their sides: a lower limit of the signed gap of their contents.

    A box is the center and half the lengths of the sides of a rectangle that is aligned with its frame.
    """
    tx, ty, c, s, _ = between
    x, y, wide, high = first
    qx, qy, other_wide, other_high = second
    mx, my = tx + (c * qx - s * qy) - x, ty + (s * qx + c * qy) - y
    ac, as_ = abs(c), abs(s)
    return max(
        max(abs(mx) - wide - (ac * other_wide + as_ * other_high), abs(my) - high - (as_ * other_wide + ac * other_high)),
        max(
            abs(c * mx + s * my) - other_wide - (ac * wide + as_ * high),
            abs(c * my - s * mx) - other_high - (as_ * wide + ac * high),
        ),
    )


@kernel
def polygons_apart(v, p, p_end, q, q_end, between, limit, slack):
    """Return the signed gap of two polygons, or infinity if it certainly exceeds ``limit``."""
    tx, ty, c, s, _ = between
    enough = limit + slack
    apart = separation_along_normals(v, p, p_end, q, q_end, tx, ty, c, s, enough)
    if apart <= enough:
        bx, by = -(c * tx + s * ty), s * tx - c * ty  # the origin of the frame of p in the frame of q
        apart = max(apart, separation_along_normals(v, q, q_end, p, p_end, bx, by, c, -s, enough))
        overlap = apart < -slack and p_end - p + q_end - q > 2  # points have no normals
        if apart <= enough and not overlap:
            squared = vertices_squared(v, p, p_end, q, q_end, tx, ty, c, s)
            apart = math.sqrt(min(squared, vertices_squared(v, q, q_end, p, p_end, bx, by, c, -s)))
    return math.inf if apart > enough else apart


@kernel
def groups_apart(v, start, parts, n_eccentric, first, last, between, limit, slack):
    """Return the least signed gap of eccentric parts and parts from ``first`` to ``last``, or infinity above ``limit``.

    ``between`` is the position of the frame of the latter in the frame of the former. If parts certainly overlap, the
    gap of any such parts is returned.
    """
    tx, ty, c, s, _ = between
    gap = math.inf
    for q in range(first, last):
        x, y = tx + (c * parts[MX, q] - s * parts[MY, q]), ty + (s * parts[MX, q] + c * parts[MY, q])
        for p in range(n_eccentric):
            far = limit + parts[MR, p] + parts[MR, q] + slack
            dx, dy = x - parts[MX, p], y - parts[MY, p]
            if far >= 0.0 and dx * dx + dy * dy <= far * far and gap >= -slack:
                radii = parts[RADIUS, p] + parts[RADIUS, q]
                ends = start[p], start[p + 1], start[q], start[q + 1]
                gap = min(gap, polygons_apart(v, *ends, between, limit + radii, slack) - radii)
                limit = min(limit, gap)
    return gap


@kernel
def smallest_gap(v, start, parts, n_eccentric, size, limit, near, a, b, c, d):
    """Return the smallest gap of the outlines of two positioners, or infinity if it certainly exceeds ``limit``.

    ``near`` states which groups of parts can be near to each other: the eccentric parts, the eccentric parts of the
    first and the central parts of the second positioner, and vice versa. The points a and b are the elbows and the ends
    of the cores, and c and d are the centers.
    """
    n = start.size - 1
    first, second = frame(*a), frame(*b)
    gap = math.inf
    if near[0]:
        between = frames_apart(first, second)
        slack = AXIS_ERROR * (between[4] + 2.0 * size)
        gap = groups_apart(v, start, parts, n_eccentric, 0, n_eccentric, between, limit, slack)
    if near[1] and gap >= 0.0:
        between = frames_apart(first, frame(d[0], d[1], b[0], b[1]))
        slack = AXIS_ERROR * (between[4] + 2.0 * size)
        gap = min(gap, groups_apart(v, start, parts, n_eccentric, n_eccentric, n, between, min(gap, limit), slack))
    if near[2] and gap >= 0.0:
        between = frames_apart(second, frame(c[0], c[1], a[0], a[1]))
        slack = AXIS_ERROR * (between[4] + 2.0 * size)
        gap = min(gap, groups_apart(v, start, parts, n_eccentric, n_eccentric, n, between, min(gap, limit), slack))
    return gap


@inlined_kernel
def outlines_squared(outline, separation, i, j, ax0, ay0, ax1, ay1, bx0, by0, bx1, by1):
    """Return the squared sum of the signed gap of two positioners and the offset of the outline.

    The sum of gap and offset is at least 0, and infinity if it certainly exceeds ``separation``, which is the minimum
    separation plus the offset. The gap is the smallest gap of two parts, or negative if the outlines overlap. The cores
    of the arms i and j follow; their length is that of the outline.
    """
    # Rectangles that contain the parts of an arm decide most pairs. The directions of the arms are approximate here.
    cx, cy, shorter = outline.centers[0, i], outline.centers[1, i], outline.centers[2, i]
    dx, dy, other = outline.centers[0, j], outline.centers[1, j], outline.centers[2, j]
    k = outline.inverse_length
    a = ax0, ay0, (ax1 - ax0) * k, (ay1 - ay0) * k
    b = bx0, by0, (bx1 - bx0) * k, (by1 - by0) * k
    c = cx, cy, (ax0 - cx) * shorter, (ay0 - cy) * shorter
    d = dx, dy, (bx0 - dx) * other, (by0 - dy) * other
    limit = separation - outline.offset
    loose = limit + LOOSE
    near = (
        boxes_apart(outline.eccentric_box, outline.eccentric_box, frames_apart(a, b)) <= loose,
        boxes_apart(outline.eccentric_box, outline.central_box, frames_apart(a, d)) <= loose,
        boxes_apart(outline.eccentric_box, outline.central_box, frames_apart(b, c)) <= loose,
    )
    if not (near[0] | near[1] | near[2]):
        return math.inf
    parts = outline.vertices, outline.start, outline.parts, outline.n_eccentric, outline.size
    gap = smallest_gap(*parts, limit, near, (ax0, ay0, ax1, ay1), (bx0, by0, bx1, by1), (cx, cy), (dx, dy))
    total = max(gap + outline.offset, 0.0)
    return total * total


@kernel
def place_outline(outline, i, x0, y0, x1, y1, placed):
    """Compute the positions of all vertices of positioner i as rows of ``placed``, shape (2, m)."""
    v, start = outline.vertices, outline.start
    eccentric = frame(x0, y0, x1, y1)
    central = frame(outline.centers[0, i], outline.centers[1, i], x0, y0)
    for k in range(v.shape[1]):
        x, y, c, s = eccentric if k < start[outline.n_eccentric] else central
        placed[0, k] = x + (c * v[X, k] - s * v[Y, k])
        placed[1, k] = y + (s * v[X, k] + c * v[Y, k])
