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

from rfpsurvey._jit import kernel

UNIT = 2.0**-53
# The error of the square root of `outlines_squared` is at most this factor times (S + offset).
OUTLINE_ERROR = 256.0 * UNIT
# The error of a separation along the normal of an edge is less than this factor times S, but also less than the factor
# times the size that `frames_apart` returns.
AXIS_ERROR = 48.0 * UNIT

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
    size: float
    """Largest distance of a vertex from the origin of its frame."""
    eccentric_box: tuple[float, float, float, float]
    """Center and half the lengths of the sides of a rectangle that contains the eccentric parts."""
    central_box: tuple[float, float, float, float]
    """The same for the central parts."""
    eccentric_circle: tuple[float, float, float]
    """Center in units of the length of the core, and radius in mm, of a circle that contains the eccentric parts."""
    central_circle: tuple[float, float, float]
    """Center and radius in mm of a circle that contains the central parts."""
    centers: np.ndarray
    """Centers of all positioners, and the inverse length of the central arm, shape (3, n)."""


def _nothing(*shape, dtype=np.float64):
    """Return an array of zeros that is read-only, as the arrays of all outlines."""
    array = np.zeros(shape, dtype)
    array.setflags(write=False)
    return array


NO_OUTLINE = Outline(
    _nothing(5, 0),
    _nothing(1, dtype=np.int64),
    _nothing(4, 0),
    0,
    0.0,
    0.0,
    (0.0,) * 4,
    (0.0,) * 4,
    (0.0,) * 3,
    (0.0,) * 3,
    _nothing(3, 0),
)
"""The value for arms that are segments."""


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
def separation_along_normals(outline, p, q, tx, ty, c, s, enough):
    """Return the largest separation of part q from part p along the normals of the edges of part p, without radii.

    The frame of q has the origin t and the rotation (c, s) in the frame of p. The search stops at a separation of more
    than ``enough``.
    """
    v = outline.vertices
    best = -math.inf
    for e in range(outline.start[p], outline.start[p + 1]):
        nx, ny = v[NX, e], v[NY, e]
        mx, my = c * nx + s * ny, c * ny - s * nx  # the normal in the frame of q
        least = math.inf
        for k in range(outline.start[q], outline.start[q + 1]):
            least = min(least, mx * v[X, k] + my * v[Y, k])
        best = max(best, least + (nx * (tx - v[X, e]) + ny * (ty - v[Y, e])))
        if best > enough:
            break
    return best


@kernel
def vertices_squared(outline, p, q, tx, ty, c, s):
    """Return the least squared distance of a vertex of part q from an edge of part p; the frames are as above."""
    v = outline.vertices
    best = math.inf
    for k in range(outline.start[q], outline.start[q + 1]):
        x, y = tx + (c * v[X, k] - s * v[Y, k]), ty + (s * v[X, k] + c * v[Y, k])
        for e in range(outline.start[p], outline.start[p + 1]):
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
        max(
            abs(mx) - wide - (ac * other_wide + as_ * other_high),
            abs(my) - high - (as_ * other_wide + ac * other_high),
        ),
        max(
            abs(c * mx + s * my) - other_wide - (ac * wide + as_ * high),
            abs(c * my - s * mx) - other_high - (as_ * wide + ac * high),
        ),
    )


@kernel
def parts_apart(outline, p, q, between, limit, slack):
    """Return the signed gap of part p and part q, or infinity if it certainly exceeds ``limit``."""
    tx, ty, c, s, _ = between
    parts, start = outline.parts, outline.start
    dx = tx + (c * parts[MX, q] - s * parts[MY, q]) - parts[MX, p]
    dy = ty + (s * parts[MX, q] + c * parts[MY, q]) - parts[MY, p]
    far = limit + parts[MR, p] + parts[MR, q] + slack
    if far < 0.0 or dx * dx + dy * dy > far * far:
        return math.inf
    radii = parts[RADIUS, p] + parts[RADIUS, q]
    enough = limit + radii + slack
    apart = separation_along_normals(outline, p, q, tx, ty, c, s, enough)
    if apart > enough:
        return math.inf
    bx, by = -(c * tx + s * ty), s * tx - c * ty  # the origin of the frame of p in the frame of q
    apart = max(apart, separation_along_normals(outline, q, p, bx, by, c, -s, enough))
    if apart > enough:
        return math.inf
    if apart < -slack and start[p + 1] - start[p] + start[q + 1] - start[q] > 2:
        return apart - radii  # the polygons certainly overlap
    squared = min(
        vertices_squared(outline, p, q, tx, ty, c, s),
        vertices_squared(outline, q, p, bx, by, c, -s),
    )
    return math.sqrt(squared) - radii


@kernel
def groups_apart(outline, first, last, between, limit):
    """Return the least signed gap of eccentric parts and parts from ``first`` to ``last``, or infinity above ``limit``.

    ``between`` is the position of the frame of the latter in the frame of the former. If parts certainly overlap, the
    gap of any such parts is returned.
    """
    slack = AXIS_ERROR * (between[4] + 2.0 * outline.size)
    box = outline.eccentric_box if first == 0 else outline.central_box
    if boxes_apart(outline.eccentric_box, box, between) > limit + slack:
        return math.inf
    gap = math.inf
    for p in range(outline.n_eccentric):
        for q in range(first, last):
            gap = min(gap, parts_apart(outline, p, q, between, min(gap, limit), slack))
            if gap < -slack:
                return gap
    return gap


@kernel
def circles_near(x, y, radius, other_x, other_y, other_radius, limit):
    """Return whether the gap between two circles is at most ``limit``."""
    dx, dy, far = other_x - x, other_y - y, radius + other_radius + limit
    return dx * dx + dy * dy <= far * far


@kernel
def outlines_squared(outline, separation, i, j, ax0, ay0, ax1, ay1, bx0, by0, bx1, by1):
    """Return the squared sum of the signed gap of two positioners and the offset of the outline.

    The sum of gap and offset is at least 0, and infinity if it certainly exceeds ``separation``, which is the minimum
    separation plus the offset. The gap is the smallest gap of two parts, or negative if the outlines overlap. The cores
    of the arms i and j follow; their length is that of the outline.
    """
    limit = separation - outline.offset
    n_eccentric, n = outline.n_eccentric, outline.start.size - 1
    x, y, r = outline.eccentric_circle
    ux, uy, vx, vy = ax1 - ax0, ay1 - ay0, bx1 - bx0, by1 - by0
    ax, ay = ax0 + (x * ux - y * uy), ay0 + (y * ux + x * uy)
    bx, by = bx0 + (x * vx - y * vy), by0 + (y * vx + x * vy)
    arms = circles_near(ax, ay, r, bx, by, r, limit)
    if n_eccentric == n:
        if not arms:
            return math.inf
        gap = groups_apart(outline, 0, n, frames_apart(frame(ax0, ay0, ax1, ay1), frame(bx0, by0, bx1, by1)), limit)
    else:
        centers = outline.centers
        x, y, rc = outline.central_circle
        cx, cy, dx, dy = centers[0, i], centers[1, i], centers[0, j], centers[1, j]
        ux, uy = (ax0 - cx) * centers[2, i], (ay0 - cy) * centers[2, i]
        vx, vy = (bx0 - dx) * centers[2, j], (by0 - dy) * centers[2, j]
        first = circles_near(ax, ay, r, dx + (x * vx - y * vy), dy + (y * vx + x * vy), rc, limit)
        second = circles_near(bx, by, r, cx + (x * ux - y * uy), cy + (y * ux + x * uy), rc, limit)
        if not (arms | first | second):
            return math.inf
        gap = math.inf
        a, b = frame(ax0, ay0, ax1, ay1), frame(bx0, by0, bx1, by1)
        if arms:
            gap = groups_apart(outline, 0, n_eccentric, frames_apart(a, b), limit)
        if first and gap >= 0.0:
            between = frames_apart(a, frame(dx, dy, bx0, by0))
            gap = min(gap, groups_apart(outline, n_eccentric, n, between, min(gap, limit)))
        if second and gap >= 0.0:
            between = frames_apart(b, frame(cx, cy, ax0, ay0))
            gap = min(gap, groups_apart(outline, n_eccentric, n, between, min(gap, limit)))
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
