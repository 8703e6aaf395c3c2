"""Signed gaps between the outlines of two positioners, with a proven error limit.

An outline consists of parts: convex polygons, each inflated by its own radius. A part moves with the eccentric arm or
with the central arm. Each polygon is processed in the coordinate frame of its own arm. The x axis of this frame points
along the arm, and its origin is the elbow (eccentric arm) or the center of the positioner (central arm). The test of a
pair of polygons requires only the relative position of the two frames. Therefore, no polygon is moved and no memory is
allocated.

In all limits of rounding errors, u = 2^-53 is the unit roundoff, and S is the largest distance between any two of the
vertices, elbows and centers of a pair of positioners. The proofs are on the accuracy page of the documentation.
"""

import math
from typing import NamedTuple

import numpy as np

from rfpsurvey._kernels.jit import inlined_kernel, kernel

UNIT = 2.0**-53
# The error of the square root of `outlines_squared` is at most this factor times (S + offset).
OUTLINE_ERROR = 1280.0 * UNIT
# The error of a separation along the normal of an edge is less than this factor times the sum of two lengths: the
# distance between the origins of the two frames, and twice the largest distance of a vertex from the origin of its
# frame.
AXIS_ERROR = 64.0 * UNIT
# Tolerance of the first test of a pair, as a fraction of `Outline.scale`. The test uses approximate directions of arms.
LOOSE = 1e-6

# Rows of a column that describes a vertex: the position of the vertex, the outward unit normal of the edge to the next
# vertex, and the length of this edge. A single vertex has an edge of length 0 with an arbitrary normal.
X, Y, NX, NY, LENGTH = range(5)
# Rows of a column that describes a part: the radius of the part, the center and radius of a circle that contains the
# part, and the column of the first vertex of the part.
RADIUS, MX, MY, MR, START = range(5)


class Outline(NamedTuple):
    """The outline that all positioners have, in mm; if it has no parts, the arms are capsules."""

    # a column for each vertex, with the rows X to LENGTH, then a column for each part, with the rows RADIUS to START;
    # all data are in one array, because numba counts references to each array that is passed to a function
    table: np.ndarray
    start: np.ndarray  # vertices of part p are start[p]:start[p + 1]; an array of one element: there is no outline
    n_vertices: int
    n_eccentric: int  # number of parts that move with the eccentric arm; all later parts move with the central arm
    offset: float  # largest possible difference between the distance of two cores and the gap of the two outlines
    inverse_length: float  # inverse of the length of the core, which is a segment along the eccentric arm
    scale: float  # twice the largest distance of a vertex from the origin of its frame, plus the offset
    # rectangles that contain the eccentric and the central parts: center and half the lengths of the sides
    eccentric_box: tuple[float, float, float, float]
    central_box: tuple[float, float, float, float]
    centers: np.ndarray  # centers of all positioners, and the inverse length of the central arm, shape (n, 3)

    @property
    def parts(self) -> np.ndarray:
        """The columns of the table that describe the parts."""
        return self.table[:, self.n_vertices : -1]


def _nothing(*shape, dtype=np.float64):
    """Return a read-only array of zeros; the arrays of all outlines are read-only, so that they have the same type."""
    array = np.zeros(shape, dtype)
    array.setflags(write=False)
    return array


NO_OUTLINE = Outline(
    _nothing(5, 1), _nothing(1, dtype=np.int64), 0, 0, 0.0, 0.0, 0.0, (0.0,) * 4, (0.0,) * 4, _nothing(0, 3)
)
"""The value for arms that have no outline."""


class Polygons(NamedTuple):
    """Convex polygons of the focal plane that no arm may touch."""

    table: np.ndarray  # a column for each vertex of the outline of the arms, then for each vertex of the polygons
    start: np.ndarray  # columns of polygon k are start[k]:start[k + 1]; an array of one element: there is no polygon


NO_POLYGONS = Polygons(_nothing(5, 0), _nothing(1, dtype=np.int64))


@kernel
def frame(x, y, toward_x, toward_y):
    """Return the origin of a frame, and the cosine and sine of the direction from the origin to another point."""
    dx, dy = toward_x - x, toward_y - y
    inverse = 1.0 / math.sqrt(dx * dx + dy * dy)
    return x, y, dx * inverse, dy * inverse


@kernel
def frames_apart(first, second):
    """Return the origin and rotation (cosine, sine) of the second frame in the coordinates of the first frame.

    The last number returned is an upper limit of the distance between the two origins.
    """
    x, y, c, s = first
    dx, dy = second[0] - x, second[1] - y
    tx, ty = c * dx + s * dy, c * dy - s * dx
    return tx, ty, c * second[2] + s * second[3], c * second[3] - s * second[2], abs(tx) + abs(ty)


@kernel
def separation_along_normals(v, p, p_end, q, q_end, tx, ty, c, s, enough):
    """Return the largest separation of polygon q from polygon p along the normals of the edges of polygon p.

    The polygons have the vertices from p to ``p_end`` and from q to ``q_end`` of the table v. In the frame of polygon
    p, the frame of polygon q has the origin (tx, ty) and the rotation (c, s). The search stops when it finds a
    separation larger than ``enough``.
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
    """Return the smallest squared distance of a vertex of polygon q from an edge of polygon p."""
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
def boxes_near(x, y, c, s, wide, high, other_x, other_y, other_c, other_s, other_wide, other_high, limit):
    """Return whether the gap between two rectangles is at most ``limit`` along the directions of all of their sides.

    The center, the direction and half the lengths of the sides of both rectangles are given.
    """
    mx, my = other_x - x, other_y - y
    along, across = abs(c * other_c + s * other_s), abs(c * other_s - s * other_c)
    return (
        (abs(c * mx + s * my) <= limit + wide + (along * other_wide + across * other_high))
        & (abs(c * my - s * mx) <= limit + high + (across * other_wide + along * other_high))
        & (abs(other_c * mx + other_s * my) <= limit + other_wide + (along * wide + across * high))
        & (abs(other_c * my - other_s * mx) <= limit + other_high + (across * wide + along * high))
    )


@kernel
def smallest_gap(v, m, n, n_eccentric, scale, limit, near, a, b, c, d):
    """Return the smallest gap between the outlines of two positioners, or infinity if it certainly exceeds ``limit``.

    ``near`` states for three groups of pairs whether parts can be near to each other: two eccentric parts; an eccentric
    part of the first and a central part of the second positioner; a central part of the first and an eccentric part of
    the second positioner. The tuples a and b contain the elbow and the end of the core of each positioner. The points
    c and d are the centers of the positioners.
    """
    # The table v has m columns of vertices and n columns of parts. This is one long function because numba counts
    # references to arrays that are passed between functions.
    gap = math.inf
    for group in range(3):
        if near[group] and gap >= 0.0:
            # the parts of one positioner, which are compared with the eccentric parts of the other positioner
            first, last = (m, m + n_eccentric) if group == 0 else (m + n_eccentric, m + n)
            if group == 0:
                between = frames_apart(frame(*a), frame(*b))
            elif group == 1:
                between = frames_apart(frame(*a), frame(d[0], d[1], b[0], b[1]))
            else:
                between = frames_apart(frame(*b), frame(c[0], c[1], a[0], a[1]))
            tx, ty, cosine, sine, distance = between
            bx, by = -(cosine * tx + sine * ty), sine * tx - cosine * ty  # the origin of the first frame in the second
            slack = AXIS_ERROR * (distance + scale)
            for q in range(first, last):
                x = tx + (cosine * v[MX, q] - sine * v[MY, q])
                y = ty + (sine * v[MX, q] + cosine * v[MY, q])
                for p in range(m, m + n_eccentric):
                    dx, dy = x - v[MX, p], y - v[MY, p]
                    # a pair is skipped if circles around its parts are too far apart, or after a certain overlap
                    far = min(gap, limit) + v[MR, p] + v[MR, q] + slack
                    if far >= 0.0 and dx * dx + dy * dy <= far * far and gap >= -slack:
                        radii = v[RADIUS, p] + v[RADIUS, q]
                        enough = min(gap, limit) + radii + slack
                        p0, p1, q0, q1 = int(v[START, p]), int(v[START, p + 1]), int(v[START, q]), int(v[START, q + 1])
                        apart = separation_along_normals(v, p0, p1, q0, q1, tx, ty, cosine, sine, enough)
                        if apart <= enough:
                            apart_q = separation_along_normals(v, q0, q1, p0, p1, bx, by, cosine, -sine, enough)
                            apart = max(apart, apart_q)
                        # polygons overlap if no normal separates them; two single vertices have arbitrary normals
                        if apart < -slack and p1 - p0 + q1 - q0 > 2:
                            gap = min(gap, apart - radii)
                        elif apart <= enough:
                            squared = vertices_squared(v, p0, p1, q0, q1, tx, ty, cosine, sine)
                            squared = min(squared, vertices_squared(v, q0, q1, p0, p1, bx, by, cosine, -sine))
                            gap = min(gap, math.sqrt(squared) - radii)
    return gap


@inlined_kernel
def outlines_squared(outline, separation, i, j, ax0, ay0, ax1, ay1, bx0, by0, bx1, by1):
    """Return (gap + offset)^2 for the signed gap between the outlines of two positioners.

    A negative sum gap + offset is replaced by 0. The sum is infinity if it certainly exceeds ``separation``, which is
    the minimum separation plus the offset. The gap is the smallest gap of two parts, or negative if the outlines
    overlap. The last eight arguments are the ends of the cores of the arms i and j. All cores have the same length.
    """
    # Rectangles that contain the parts of an arm decide most pairs. The directions of the arms are approximate here.
    cx, cy, inverse_i = outline.centers[i, 0], outline.centers[i, 1], outline.centers[i, 2]
    dx, dy, inverse_j = outline.centers[j, 0], outline.centers[j, 1], outline.centers[j, 2]
    k, limit = outline.inverse_length, separation - outline.offset
    x, y, wide, high = outline.eccentric_box
    ac, as_, bc, bs = (ax1 - ax0) * k, (ay1 - ay0) * k, (bx1 - bx0) * k, (by1 - by0) * k
    ax, ay = ax0 + (x * ac - y * as_), ay0 + (y * ac + x * as_)
    bx, by = bx0 + (x * bc - y * bs), by0 + (y * bc + x * bs)
    x, y, other_wide, other_high = outline.central_box
    cc, cs, dc, ds = (ax0 - cx) * inverse_i, (ay0 - cy) * inverse_i, (bx0 - dx) * inverse_j, (by0 - dy) * inverse_j
    px, py = cx + (x * cc - y * cs), cy + (y * cc + x * cs)
    qx, qy = dx + (x * dc - y * ds), dy + (y * dc + x * ds)
    loose = limit + LOOSE * outline.scale
    near = (
        boxes_near(ax, ay, ac, as_, wide, high, bx, by, bc, bs, wide, high, loose),
        boxes_near(ax, ay, ac, as_, wide, high, qx, qy, dc, ds, other_wide, other_high, loose),
        boxes_near(bx, by, bc, bs, wide, high, px, py, cc, cs, other_wide, other_high, loose),
    )
    if not (near[0] | near[1] | near[2]):
        return math.inf
    shape = outline.table, outline.n_vertices, outline.start.size - 1, outline.n_eccentric, outline.scale
    gap = smallest_gap(*shape, limit, near, (ax0, ay0, ax1, ay1), (bx0, by0, bx1, by1), (cx, cy), (dx, dy))
    total = max(gap + outline.offset, 0.0)
    return total * total


@kernel
def gap_to_point(outline, i, x0, y0, x1, y1, x, y):
    """Return the signed gap between a point and the outline of positioner i, whose core is given.

    The gap is negative if the point is inside the outline, and NaN if the arm is absent.
    """
    if x0 != x0:
        return math.nan
    v, start, m = outline.table, outline.start, outline.n_vertices
    gap = math.inf
    for part in range(start.size - 1):
        if part < outline.n_eccentric:
            ox, oy, c, s = frame(x0, y0, x1, y1)
        else:
            ox, oy, c, s = frame(outline.centers[i, 0], outline.centers[i, 1], x0, y0)
        dx, dy = c * (x - ox) + s * (y - oy), c * (y - oy) - s * (x - ox)
        outside, squared = -math.inf, math.inf
        for e in range(start[part], start[part + 1]):
            ex, ey = dx - v[X, e], dy - v[Y, e]
            across, along = ex * v[NX, e] + ey * v[NY, e], ey * v[NX, e] - ex * v[NY, e]
            beyond = along - min(max(along, 0.0), v[LENGTH, e])
            outside, squared = max(outside, across), min(squared, across * across + beyond * beyond)
        inside = (outside < 0.0) & (start[part + 1] - start[part] > 2)
        gap = min(gap, (outside if inside else math.sqrt(squared)) - v[RADIUS, m + part])
    return gap


@kernel
def gap_to_polygon(outline, polygons, i, x0, y0, x1, y1, k):
    """Return the signed gap between polygon k and the outline of positioner i, whose core is given (NaN: NaN)."""
    if x0 != x0:
        return math.nan
    v, start = polygons.table, outline.start
    q, q_end = polygons.start[k], polygons.start[k + 1]
    gap = math.inf
    for part in range(start.size - 1):
        if part < outline.n_eccentric:
            arm_frame = frame(x0, y0, x1, y1)
        else:
            arm_frame = frame(outline.centers[i, 0], outline.centers[i, 1], x0, y0)
        tx, ty, c, s, _ = frames_apart(arm_frame, (0.0, 0.0, 1.0, 0.0))
        bx, by = -(c * tx + s * ty), s * tx - c * ty
        p, p_end = start[part], start[part + 1]
        apart = max(
            separation_along_normals(v, p, p_end, q, q_end, tx, ty, c, s, math.inf),
            separation_along_normals(v, q, q_end, p, p_end, bx, by, c, -s, math.inf),
        )
        if apart >= 0.0:
            squared = vertices_squared(v, p, p_end, q, q_end, tx, ty, c, s)
            apart = math.sqrt(min(squared, vertices_squared(v, q, q_end, p, p_end, bx, by, c, -s)))
        gap = min(gap, apart - outline.table[RADIUS, outline.n_vertices + part])
    return gap


@kernel
def place_outline(outline, i, x0, y0, x1, y1, placed):
    """Compute the vertices of the outline of positioner i, whose core is given, as columns of ``placed``, shape (4, m).

    A column contains the origin of the frame of a vertex, and the rounded position of the vertex relative to this
    origin.
    """
    v, start = outline.table, outline.start
    eccentric = frame(x0, y0, x1, y1)
    central = frame(outline.centers[i, 0], outline.centers[i, 1], x0, y0)
    for k in range(outline.n_vertices):
        x, y, c, s = eccentric if k < start[outline.n_eccentric] else central
        placed[0, k], placed[1, k] = x, y
        placed[2, k], placed[3, k] = c * v[X, k] - s * v[Y, k], s * v[X, k] + c * v[Y, k]
