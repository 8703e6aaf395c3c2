"""Distances between arms, exact in two dimensions."""

import math

import numpy as np

from rfpsurvey._jit import kernel


@kernel
def point_segment_squared(px, py, ax, ay, bx, by):
    """Squared distance from a point to a segment (which may have no length)."""
    ux, uy = bx - ax, by - ay
    vx, vy = px - ax, py - ay
    length2 = ux * ux + uy * uy
    if length2 > 0.0:
        t = min(max((vx * ux + vy * uy) / length2, 0.0), 1.0)
        vx -= t * ux
        vy -= t * uy
    return vx * vx + vy * vy


@kernel
def turn(ax, ay, bx, by, px, py):
    """Twice the signed area of the triangle a, b, p: positive where p lies to the left of a -> b."""
    return (bx - ax) * (py - ay) - (by - ay) * (px - ax)


@kernel
def segments_squared(a, b):
    """Squared distance of two segments: 0 where they cross, else the least of four endpoint distances."""
    ax, ay, bx, by = a[0], a[1], a[2], a[3]
    cx, cy, dx, dy = b[0], b[1], b[2], b[3]
    if (
        turn(ax, ay, bx, by, cx, cy) * turn(ax, ay, bx, by, dx, dy) < 0.0
        and turn(cx, cy, dx, dy, ax, ay) * turn(cx, cy, dx, dy, bx, by) < 0.0
    ):
        return 0.0
    return min(
        min(point_segment_squared(ax, ay, cx, cy, dx, dy), point_segment_squared(bx, by, cx, cy, dx, dy)),
        min(point_segment_squared(cx, cy, ax, ay, bx, by), point_segment_squared(dx, dy, ax, ay, bx, by)),
    )


@kernel
def half_lengths(segments, out):
    """Half the length of each segment."""
    for i in range(segments.shape[0]):
        out[i] = 0.5 * math.hypot(segments[i, 2] - segments[i, 0], segments[i, 3] - segments[i, 1])


@kernel
def colliding_pairs(segments, half, pairs, separation, out, squared):
    """Those of ``pairs`` closer than ``separation``; absent arms are NaN. Returns their number."""
    n = 0
    limit = separation * separation
    for k in range(pairs.shape[0]):
        i, j = pairs[k, 0], pairs[k, 1]
        a, b = segments[i], segments[j]
        mx = 0.5 * ((a[0] + a[2]) - (b[0] + b[2]))
        my = 0.5 * ((a[1] + a[3]) - (b[1] + b[3]))
        near = (half[i] + half[j] + separation) * (1.0 + 1e-12)
        if not mx * mx + my * my <= near * near:  # also NaN
            continue
        d2 = segments_squared(a, b)
        if d2 < limit:
            out[n, 0], out[n, 1] = i, j
            squared[n] = d2
            n += 1
    return n


@kernel
def colliding_obstacles(segments, pairs, obstacles, clearance, out, distance):
    """Pairs (positioner, obstacle) whose arm comes nearer than ``clearance`` to the circle's edge."""
    n = 0
    for k in range(pairs.shape[0]):
        i, j = pairs[k, 0], pairs[k, 1]
        a = segments[i]
        d = math.sqrt(point_segment_squared(obstacles[j, 0], obstacles[j, 1], a[0], a[1], a[2], a[3]))
        if d < obstacles[j, 2] + clearance:
            out[n, 0], out[n, 1] = i, j
            distance[n] = max(0.0, d - obstacles[j, 2])
            n += 1
    return n


@kernel
def nearest_arm(segments, half, order, mid, out):
    """Distance of each arm to the nearest other one.

    ``order`` sorts the arms that are present by the x of their middles ``mid``; from each arm the search walks
    left and right until the gap in x alone exceeds the best distance. Absent: NaN; alone: infinity.
    """
    out[:] = np.nan
    longest = 0.0
    for k in range(order.size):
        longest = max(longest, half[order[k]])
    for k in range(order.size):
        i = order[k]
        best = np.inf
        for step in (-1, 1):
            m = k + step
            while 0 <= m < order.size:
                j = order[m]
                gap = abs(mid[j, 0] - mid[i, 0]) - half[i] - longest
                if gap > 0.0 and gap * gap > best:
                    break
                gap = abs(mid[j, 1] - mid[i, 1]) - half[i] - half[j]
                if gap <= 0.0 or gap * gap <= best:
                    best = min(best, segments_squared(segments[i], segments[j]))
                m += step
        out[i] = math.sqrt(best)
