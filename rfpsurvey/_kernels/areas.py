"""Areas of patrol annuli and of their overlaps."""

import math

import numpy as np

from rfpsurvey._jit import kernel


@kernel
def half_angle(r, d, radius):
    """Return half the central angle of the arc of one circle that lies inside another circle.

    The circle of the arc has the radius ``r``, and the other circle has the radius ``radius``. The distance between
    their centers is ``d``.
    """
    if r + d <= radius:
        return math.pi
    if abs(r - d) >= radius:
        return 0.0
    return math.acos(min(max((r * r + d * d - radius * radius) / (2.0 * r * d), -1.0), 1.0))


@kernel
def covered(i, indptr, neighbor, cx, cy, inner, outer, n_steps, begin, end):
    """Return the fraction of the patrol area of positioner i that the patrol area of at least one neighbor covers.

    The patrol area is divided into rings of equal area. One circle in each ring represents the ring. The arcs of the
    circle that lie in the patrol areas of neighbors are computed exactly.
    """
    total = 0.0
    low2, high2 = inner[i] ** 2, outer[i] ** 2
    for step in range(n_steps):
        r = math.sqrt(low2 + (high2 - low2) * (step + 0.5) / n_steps)
        n = 0
        for k in range(indptr[i], indptr[i + 1]):
            j = neighbor[k]
            dx, dy = cx[j] - cx[i], cy[j] - cy[i]
            d = math.sqrt(dx * dx + dy * dy)
            wide, narrow = half_angle(r, d, outer[j]), half_angle(r, d, inner[j])
            if wide <= narrow:
                continue
            direction = math.atan2(dy, dx)
            for sign in (-1.0, 1.0):  # the two arcs are symmetric about the direction of the neighbor
                a = direction + sign * (wide if sign < 0.0 else narrow)
                a -= 2.0 * math.pi * math.floor(a / (2.0 * math.pi))
                b = a + wide - narrow
                begin[n], end[n] = a, min(b, 2.0 * math.pi)
                n += 1
                if b > 2.0 * math.pi:
                    begin[n], end[n] = 0.0, b - 2.0 * math.pi
                    n += 1
        order = np.argsort(begin[:n])
        reached = 0.0
        for k in range(n):
            a, b = begin[order[k]], end[order[k]]
            if b > reached:
                total += b - max(a, reached)
                reached = b
    return total / (2.0 * math.pi * n_steps)


@kernel
def covered_parts(indptr, neighbor, cx, cy, inner, outer, n_steps, out):
    """Compute the fraction of the patrol area of each positioner that its neighbors cover, with `covered`."""
    size = 1
    for i in range(out.size):
        size = max(size, 4 * (indptr[i + 1] - indptr[i]))
    begin, end = np.empty(size), np.empty(size)
    for i in range(out.size):
        out[i] = covered(i, indptr, neighbor, cx, cy, inner, outer, n_steps, begin, end)
