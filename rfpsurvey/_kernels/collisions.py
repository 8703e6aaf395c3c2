"""Find arms that are closer than the minimum separation, from distances with a proven limit of rounding errors.

Segments are columns of an array of shape (4, n), with the rows x0, y0, x1 and y1; the column of an absent arm is NaN.

In all limits of rounding errors, u = 2^-53 is the unit roundoff, and S is the largest of the six distances between the
four ends of a pair of segments. The proofs are on the accuracy page of the documentation.
"""

import math
from typing import NamedTuple

import numpy as np

from rfpsurvey._kernels.jit import inlined_kernel, kernel
from rfpsurvey._kernels.outlines import (
    NO_OUTLINE,
    NO_POLYGONS,
    UNIT,
    Outline,
    Polygons,
    X,
    Y,
    gap_to_point,
    gap_to_polygon,
    outlines_squared,
)

# The error of the computed distance of a pair is at most this factor times S.
DISTANCE_ERROR = 20.0 * UNIT
# An orientation is the sign of the difference of two products. The sign is certain if the magnitude of the difference
# exceeds this factor times the sum of the magnitudes of the two products.
ORIENTATION_ERROR = 4.0 * UNIT
# The rounding error of the preselection of pairs is less than this factor times (largest coordinate + S). The
# preselection keeps pairs whose distance exceeds the minimum separation by less than this error.
REJECT_ERROR = 64.0 * UNIT
# The search for the nearest arm skips arms that are farther away than the nearest arm found, by at least this length
# (mm), which exceeds all rounding errors.
MARGIN = 1e-9
# If the minimum separation is 0, arms collide if their squared distance (mm2) is less than this number; the distance of
# arms that cross is 0.
CROSSING = 1e-300
# The loop over a run of neighbors is not vectorized if the run contains fewer pairs than this number.
SHORT_RUN = 8


class Limits(NamedTuple):
    """The minimum separation, and limits of rounding errors for segments of limited length near the origin.

    If arms have outlines, each segment is the core of an arm (a segment along the eccentric arm), and the separation
    is the minimum separation of two cores.
    """

    separation: float
    slack: float  # distance that is added to the minimum separation when pairs are preselected
    near: float  # largest distance between the midpoints of a pair that can collide, including the slack
    band: float  # largest difference of a squared distance from separation^2 that rounding could explain
    outline: Outline  # outline of the arms; it has no parts if the arms are capsules
    polygons: Polygons  # polygons of the focal plane that no arm may touch


def limits(separation, length, extent, outline=NO_OUTLINE, outline_error=0.0, polygons=NO_POLYGONS):
    """Return the `Limits` for segments of at most ``length`` (mm) whose ends are within ``extent`` (mm) of the origin.

    If arms have outlines, ``separation`` is the minimum separation of two cores, and ``outline_error`` (mm) is the
    limit of the rounding errors of `outlines_squared`.
    """
    size = 2.0 * length + separation  # S of a pair at the minimum separation; pairs with a larger S are farther apart
    slack = REJECT_ERROR * (extent + size)
    error = 1.2 * DISTANCE_ERROR * size  # the factor 1.2 covers the rounding of separation^2 and of the comparison
    error += outline_error
    return Limits(separation, slack, length + separation + slack, 2.0 * error * (separation + error), outline, polygons)


@kernel
def squared_limit(limits):
    """Return the squared distance below which two arms collide; if the minimum separation is 0, arms that cross do."""
    return limits.separation**2 if limits.separation > 0.0 else CROSSING


@kernel
def point_segment_squared(px, py, ax, ay, bx, by):
    """Return the squared distance from a point to a segment; the length of the segment may be 0."""
    ux, uy = bx - ax, by - ay
    vx, vy = px - ax, py - ay
    length2 = ux * ux + uy * uy
    if length2 > 0.0:
        t = min(max((vx * ux + vy * uy) / length2, 0.0), 1.0)
        vx -= t * ux
        vy -= t * uy
    return vx * vx + vy * vy


@kernel
def orientation(ax, ay, bx, by, px, py):
    """Return on which side of the line from a to b the point p is: 1 for left, -1 for right, 0 if uncertain."""
    left = (bx - ax) * (py - ay)
    right = (by - ay) * (px - ax)
    slack = ORIENTATION_ERROR * (abs(left) + abs(right))
    return int(left - right > slack) - int(right - left > slack)


@kernel
def endpoints_squared(ax, ay, bx, by, cx, cy, dx, dy):
    """Return the smallest of the squared distances from an end of one segment to the other segment.

    This is the squared distance between the segments, unless they cross.
    """
    return min(
        min(point_segment_squared(ax, ay, cx, cy, dx, dy), point_segment_squared(bx, by, cx, cy, dx, dy)),
        min(point_segment_squared(cx, cy, ax, ay, bx, by), point_segment_squared(dx, dy, ax, ay, bx, by)),
    )


@kernel
def segments_squared(ax, ay, bx, by, cx, cy, dx, dy):
    """Return the squared distance of the segments a-b and c-d; the error of the distance is at most DISTANCE_ERROR * S.

    The result is 0 if the segments certainly cross. If rounding makes it uncertain whether the segments cross, the
    result is the smallest squared distance from an end of one segment to the other segment, which is accurate enough.
    """
    crossing = (orientation(ax, ay, bx, by, cx, cy) * orientation(ax, ay, bx, by, dx, dy) < 0) & (
        orientation(cx, cy, dx, dy, ax, ay) * orientation(cx, cy, dx, dy, bx, by) < 0
    )
    squared = endpoints_squared(ax, ay, bx, by, cx, cy, dx, dy)
    return 0.0 if crossing else squared


@kernel
def pair_squared(segments, i, j):
    """Return the squared distance of the arms i and j."""
    first = segments[0, i], segments[1, i], segments[2, i], segments[3, i]
    return segments_squared(*first, segments[0, j], segments[1, j], segments[2, j], segments[3, j])


@kernel
def outlined_squared(segments, a, b, limits, i, j):
    """Return (gap + offset)^2 for the gap between the outlines of positioners i and j, whose cores are a and b.

    The cores are the columns a and b of ``segments``, and the offset is defined in `Outline`.
    """
    ax, ay, bx, by = segments[0, a], segments[1, a], segments[2, a], segments[3, a]
    cx, cy, dx, dy = segments[0, b], segments[1, b], segments[2, b], segments[3, b]
    return outlines_squared(limits.outline, limits.separation, i, j, ax, ay, bx, by, cx, cy, dx, dy)


@kernel
def outline_gaps(segments, pairs, limits, out):
    """Compute the distance between the outlines of each pair of positioners; it is 0 if they overlap."""
    limits = Limits(math.inf, limits.slack, limits.near, limits.band, limits.outline, limits.polygons)
    for k in range(pairs.shape[0]):
        i, j = pairs[k, 0], pairs[k, 1]
        out[k] = max(math.sqrt(outlined_squared(segments, i, j, limits, i, j)) - limits.outline.offset, 0.0)


@kernel
def apart(mx, my, ax, ay, bx, by, squared):
    """Return whether two segments, projected on at least one of three axes, are farther apart than sqrt(``squared``).

    The vector m connects the midpoints, and a and b are half the vectors from end to end. The axes tested are m and the
    normals of both segments. In the projection on any axis, the largest distance of a point of a segment from its
    midpoint is the length of the projected half vector. The normal of a segment is ignored if the segment is so short
    that its squared length could underflow.
    """
    # There are no branches, because a mispredicted branch takes longer than the tests of all three axes.
    m2 = mx * mx + my * my
    along = max(m2 - abs(ax * mx + ay * my) - abs(bx * mx + by * my), 0.0)
    wide = abs(ax * by - ay * bx)
    across_a = max(abs(ax * my - ay * mx) - wide, 0.0)
    across_b = max(abs(bx * my - by * mx) - wide, 0.0)
    a2, b2 = ax * ax + ay * ay, bx * bx + by * by
    return (
        (along * along > squared * m2)
        | ((across_a * across_a > squared * a2) & (a2 > 1e-280))
        | ((across_b * across_b > squared * b2) & (b2 > 1e-280))
    )


@kernel
def near_squared(ax, ay, bx, by, cx, cy, dx, dy, squared):
    """Return the squared distance of the segments a-b and c-d, or infinity if `apart` is true for these segments."""
    mx, my = 0.5 * ((cx + dx) - (ax + bx)), 0.5 * ((cy + dy) - (ay + by))
    if apart(mx, my, 0.5 * (bx - ax), 0.5 * (by - ay), 0.5 * (dx - cx), 0.5 * (dy - cy), squared):
        return math.inf
    return segments_squared(ax, ay, bx, by, cx, cy, dx, dy)


@kernel
def halve(segments, halves):
    """Compute the midpoint (mx, my) and half vector (hx, hy) of each segment, as rows of ``halves``."""
    for k in range(2):
        first, second, midpoint, half = segments[k], segments[k + 2], halves[k], halves[k + 2]
        for i in range(first.size):
            midpoint[i] = 0.5 * (first[i] + second[i])
            half[i] = 0.5 * (second[i] - first[i])


@kernel
def keep_near(halves, m, squared, first, second):
    """Test the first m pairs, and remove those for which `apart` is true; return the number of remaining pairs."""
    n = 0
    for k in range(m):
        i, j = first[k], second[k]
        mx, my = halves[0, j] - halves[0, i], halves[1, j] - halves[1, i]
        first[n], second[n] = i, j
        n += not apart(mx, my, halves[2, i], halves[3, i], halves[2, j], halves[3, j], squared)
    return n


@inlined_kernel
def project(segments, a0, a1, b0, b1, geometry, i, j, ahead):
    """Project segments on the line from the center of positioner i to that of positioner j, and return two extremes.

    ``ahead`` receives the foremost coordinate of the segments from a0 to a1, which belong to positioner i, and the
    hindmost coordinate of the segments from b0 to b1, of positioner j. The result is the largest of the foremost
    coordinates, and the smallest of the hindmost coordinates; their difference is a lower limit of all distances.
    """
    x0, y0, x1, y1 = segments[0], segments[1], segments[2], segments[3]
    ux, uy = geometry.cx[j] - geometry.cx[i], geometry.cy[j] - geometry.cy[i]
    inverse = 1.0 / math.sqrt(ux * ux + uy * uy)
    ux, uy = ux * inverse, uy * inverse
    foremost, hindmost = -math.inf, math.inf
    for a in range(a0, a1):
        ahead[a] = max(x0[a] * ux + y0[a] * uy, x1[a] * ux + y1[a] * uy)
        foremost = max(foremost, ahead[a])
    for b in range(b0, b1):
        ahead[b] = min(x0[b] * ux + y0[b] * uy, x1[b] * ux + y1[b] * uy)
        hindmost = min(hindmost, ahead[b])
    return foremost, hindmost


@kernel
def near_pairs(halves, runs, limits, first, second):
    """Write pairs that may be closer than the minimum separation to ``first`` and ``second``, and return their number.

    Each row (i, j, n) of ``runs`` stands for n pairs of neighbors: i and j, i + 1 and j + 1, and so on. Pairs of arms
    are omitted if their midpoints are too far apart or if `apart` is true for them.
    """
    m = np.int64(0)  # for a literal 0, numba would compile `keep_near` again
    words = np.empty(halves.shape[1] // 8 + 1, np.uint64)
    marks = words.view(np.uint8)
    near2, limit2 = limits.near**2, (limits.separation + limits.slack) ** 2
    for r in range(runs.shape[0]):
        i, j, n = runs[r, 0], runs[r, 1], runs[r, 2]
        if n < SHORT_RUN:
            for k in range(n):
                dx, dy = halves[0, j + k] - halves[0, i + k], halves[1, j + k] - halves[1, i + k]
                first[m], second[m] = i + k, j + k
                m += dx * dx + dy * dy <= near2
            continue
        xi, yi, xj, yj = halves[0, i : i + n], halves[1, i : i + n], halves[0, j : j + n], halves[1, j : j + n]
        for k in range(n):
            dx, dy = xj[k] - xi[k], yj[k] - yi[k]
            marks[k] = dx * dx + dy * dy <= near2  # false for NaN
        for w in range((n + 7) // 8):
            if words[w] != 0:  # most groups of eight pairs have no mark
                for k in range(8 * w, min(8 * w + 8, n)):
                    first[m], second[m] = i + k, j + k
                    m += marks[k]
    return keep_near(halves, m, limit2, first, second)


@kernel
def colliding_pairs(segments, halves, runs, limits, first, second, squared):
    """List the pairs of segments that are closer than the minimum separation, and the borderline pairs.

    For a borderline pair, rounding could change the result. Returns the number of listed pairs, and the number of
    borderline pairs among them.
    """
    n = borderline = 0
    limit, band = squared_limit(limits), limits.band
    for k in range(near_pairs(halves, runs, limits, first, second)):
        i, j = first[k], second[k]
        d2 = pair_squared(segments, i, j)
        if d2 < limit + band:
            first[n], second[n], squared[n] = i, j, d2
            n += 1
            borderline += d2 >= limit - band
    return n, borderline


@kernel
def colliding_outlines(segments, halves, runs, limits, first, second, squared):
    """List the colliding and the borderline pairs of arms with outlines, as `colliding_pairs` does for segments.

    This function is separate from `colliding_pairs`, because it takes longer to compile.
    """
    n = borderline = 0
    limit, band = squared_limit(limits), limits.band
    for k in range(near_pairs(halves, runs, limits, first, second)):
        i, j = first[k], second[k]
        d2 = outlined_squared(segments, i, j, limits, i, j)
        if d2 < limit + band:
            first[n], second[n], squared[n] = i, j, d2
            n += 1
            borderline += d2 >= limit - band
    return n, borderline


@kernel
def find_colliding(segments, halves, runs, limits, first, second, squared):
    """Call `colliding_outlines` if the arms have outlines, and `colliding_pairs` otherwise; return the result."""
    if limits.outline.start.size > 1:
        return colliding_outlines(segments, halves, runs, limits, first, second, squared)
    return colliding_pairs(segments, halves, runs, limits, first, second, squared)


@kernel
def segment_to_polygon(polygons, k, x0, y0, x1, y1):
    """Return the distance between a segment and polygon k, or a negative number if they overlap."""
    v, start = polygons.table, polygons.start
    squared, inside = math.inf, True
    for e in range(start[k], start[k + 1]):
        f = e + 1 if e + 1 < start[k + 1] else start[k]
        squared = min(squared, segments_squared(x0, y0, x1, y1, v[X, e], v[Y, e], v[X, f], v[Y, f]))
        inside &= orientation(v[X, e], v[Y, e], v[X, f], v[Y, f], x0, y0) > 0
    return -1e-300 if inside or squared == 0.0 else math.sqrt(squared)


@kernel
def obstacle_distance(limits, obstacles, i, x0, y0, x1, y1, j):
    """Return the distance from the arm of positioner i to obstacle j: to the center of a circle, or to a polygon.

    The distance is negative if the center is inside an outline, or if the arm and the polygon overlap.
    """
    outlined, n = limits.outline.start.size > 1, obstacles.shape[0]
    if j >= n:
        if outlined:
            return gap_to_polygon(limits.outline, limits.polygons, i, x0, y0, x1, y1, j - n)
        return segment_to_polygon(limits.polygons, j - n, x0, y0, x1, y1)
    x, y = obstacles[j, 0], obstacles[j, 1]
    if outlined:
        return gap_to_point(limits.outline, i, x0, y0, x1, y1, x, y)
    return math.sqrt(point_segment_squared(x, y, x0, y0, x1, y1))


@kernel
def colliding_obstacles(segments, owner, limits, pairs, obstacles, clearance, slack, out, distance):
    """List the pairs (arm, obstacle) closer than ``clearance + slack``, measured to the edge of the obstacle.

    Returns the number of pairs. Obstacles are numbered from 0: first the circles in ``obstacles``, then the polygons in
    ``limits``. The distance of each listed pair, as returned by `obstacle_distance`, is written to ``distance``.
    ``owner`` contains the positioner of each arm; this array is used only if arms have outlines.
    """
    n = 0
    for k in range(pairs.shape[0]):
        i, j = pairs[k, 0], pairs[k, 1]
        ends = segments[0, i], segments[1, i], segments[2, i], segments[3, i]
        d = obstacle_distance(limits, obstacles, owner[i], *ends, j)
        radius = obstacles[j, 2] if j < obstacles.shape[0] else 0.0
        if d < radius + clearance + slack:
            out[n, 0], out[n, 1] = i, j
            distance[n] = d
            n += 1
    return n


@kernel
def nearest_arm(segments, halves, x0, y0, size, nx, ny, start, order, out):
    """Compute the distance from each arm to the nearest other arm.

    The distance is NaN for an absent arm, and infinity if there is no other arm. The midpoints of the arms in
    ``order[start[c]:start[c + 1]]`` are in the cell c of a grid of nx columns and ny rows of squares. Around each arm,
    one ring of cells after the other is searched, until no arm in the next ring can be closer than the nearest arm
    found.
    """
    out[:] = np.nan
    longest = 0.0
    half = np.empty(out.size)
    for i in range(out.size):
        half[i] = math.sqrt(halves[2, i] * halves[2, i] + halves[3, i] * halves[3, i])
    for i in order:
        longest = max(longest, half[i])
    for i in order:
        column = min(int((halves[0, i] - x0) / size), nx - 1)
        row = min(int((halves[1, i] - y0) / size), ny - 1)
        best, near = np.inf, np.inf  # the smallest squared distance found, and its square root
        for ring in range(max(nx, ny)):
            if (ring - 1) * size - half[i] - longest > near + MARGIN:
                break
            for y in range(max(row - ring, 0), min(row + ring, ny - 1) + 1):
                # all cells of the first and the last row of the ring, and two cells of each other row
                step = 1 if abs(y - row) == ring or ring == 0 else 2 * ring
                for x in range(column - ring, column + ring + 1, step):
                    if x < 0 or x >= nx:
                        continue
                    for k in range(start[y * nx + x], start[y * nx + x + 1]):
                        j = order[k]
                        dx, dy = halves[0, j] - halves[0, i], halves[1, j] - halves[1, i]
                        far = near + half[i] + half[j] + MARGIN
                        if j != i and dx * dx + dy * dy <= far * far:
                            best = min(best, pair_squared(segments, i, j))
                            near = math.sqrt(best)
        out[i] = near
