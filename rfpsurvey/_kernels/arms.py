"""Poses and shapes of arms, the targets in the patrol area of each positioner, and sky positions between targets.

A grid of cells reduces the number of pairs to test. A sky position is a point in reach of a positioner that is at least
a given distance away from all targets.

Segments are columns of an array of shape (4, n), with the rows x0, y0, x1 and y1. Compiled code processes several
positioners at a time, because segments are stored as columns and the loops have no branches.
"""

import math
from typing import NamedTuple

import numpy as np

from rfpsurvey._kernels.jit import kernel

# If the lengths of two arms differ by less than this (mm), they are treated as equal, and the fiber reaches the center.
EQUAL_ARMS = 1e-9

# Values of ``model``, which states the part of an arm that can collide.
ELBOW_TO_TIP, CAPSULE, FIBER_TIP = 0, 1, 2


class Geometry(NamedTuple):
    """Positions and arm lengths of all positioners, and the directions of the central arms in the parked pose."""

    cx: np.ndarray
    cy: np.ndarray
    l1: np.ndarray
    l2: np.ndarray
    home_x: float
    home_y: float


class Bounds(NamedTuple):
    """Squared inner and outer radius of the patrol area of each positioner, and whether the positioner is usable."""

    low: np.ndarray
    high: np.ndarray
    usable: np.ndarray


@kernel
def inner_difference(l1, l2):
    """Return the signed difference of the arm lengths, or 0 if they differ by less than ``EQUAL_ARMS``."""
    difference = l1 - l2
    return 0.0 if abs(difference) < EQUAL_ARMS else difference


@kernel
def elbow(dx, dy, l1, l2, side, home_x, home_y):
    """Return the elbow of the arm whose tip is at (dx, dy), and two numbers proportional to sin(phi) and cos(phi).

    The positions of elbow and tip are relative to the center of the positioner. The factor of proportionality is
    positive, and the same for the sine and the cosine.

    ``side`` is +1 for phi in [0, pi] ("right") and -1 for the mirror image. For a tip out of reach, the result
    is the pose at the nearest reachable point in the same direction. A tip at the center of the positioner has no
    direction; the direction (home_x, home_y) of the parked central arm is used instead. If the tip is NaN, the result
    is NaN.
    """
    total = l1 + l2
    difference = inner_difference(l1, l2)
    inner = abs(difference)
    r2 = dx * dx + dy * dy
    at_center = r2 < 1e-300  # the square of a shorter distance is imprecise because of underflow
    r = math.sqrt(r2)
    inverse = 0.0 if at_center else 1.0 / r
    ux = home_x if at_center else dx * inverse
    uy = home_y if at_center else dy * inverse
    s = r if r > inner else inner
    s = s if s < total else total
    folded = s < 1e-150
    half = 0.0 if folded else 0.5 / s
    # Sine and cosine of phi, multiplied by 2 l1 l2. This form of the sine is accurate at both edges of the annulus.
    sine = math.sqrt(((total - s) * (total + s)) * ((s - inner) * (s + inner)))
    cosine = s * s - l1 * l1 - l2 * l2
    along = l1 if folded else (s * s + difference * total) * half
    across = side * sine * half
    return along * ux + across * uy, along * uy - across * ux, sine, cosine


@kernel
def solve(tips, geometry, side, theta, phi):
    """Compute the joint angles of each positioner from the position of its tip; the angles are NaN if the tip is NaN.

    The shape of ``tips`` is (n, 2).
    """
    g = geometry
    for i in range(g.cx.size):
        dx, dy = tips[i, 0] - g.cx[i], tips[i, 1] - g.cy[i]
        ex, ey, sine, cosine = elbow(dx, dy, g.l1[i], g.l2[i], side[i], g.home_x, g.home_y)
        theta[i] = math.atan2(ey, ex)
        phi[i] = side[i] * math.atan2(sine, cosine) if ex == ex else np.nan


@kernel
def pose(theta, phi, geometry, segments):
    """Compute the positions of the elbow and tip of each positioner from its joint angles."""
    g = geometry
    for i in range(g.cx.size):
        segments[0, i] = g.cx[i] + g.l1[i] * math.cos(theta[i])
        segments[1, i] = g.cy[i] + g.l1[i] * math.sin(theta[i])
        segments[2, i] = segments[0, i] + g.l2[i] * math.cos(theta[i] + phi[i])
        segments[3, i] = segments[1, i] + g.l2[i] * math.sin(theta[i] + phi[i])


@kernel
def place(tips, geometry, side, segments):
    """Compute the elbow of each arm from its tip, and write both to ``segments``; the elbow is NaN if the tip is NaN.

    The shape of ``tips`` is (n, 2).
    """
    cx, cy, l1, l2 = geometry.cx, geometry.cy, geometry.l1, geometry.l2
    home_x, home_y = geometry.home_x, geometry.home_y
    ex, ey, x, y = segments[0], segments[1], segments[2], segments[3]
    for i in range(cx.size):
        x[i], y[i] = tips[i, 0], tips[i, 1]
    for i in range(cx.size):
        dx, dy, _, _ = elbow(x[i] - cx[i], y[i] - cy[i], l1[i], l2[i], side[i], home_x, home_y)
        ex[i], ey[i] = cx[i] + dx, cy[i] + dy


@kernel
def capsule_end(ex, ey, x, y, length, cosine, sine):
    """Return the end of a segment of the given length that starts at the elbow (ex, ey).

    The direction of the segment is the direction from the elbow to the tip (x, y), rotated counter-clockwise by the
    angle with the given cosine and sine.
    """
    ux, uy = x - ex, y - ey
    scale = length / math.sqrt(ux * ux + uy * uy)
    return ex + scale * (cosine * ux - sine * uy), ey + scale * (cosine * uy + sine * ux)


@kernel
def shape(segments, model, length, cosine, sine):
    """Replace elbows and tips, in place, by the ends of the segments that can collide."""
    if model == CAPSULE:
        ex, ey, x, y = segments[0], segments[1], segments[2], segments[3]
        for i in range(cosine.size):
            x[i], y[i] = capsule_end(ex[i], ey[i], x[i], y[i], length, cosine[i], sine[i])
    elif model == FIBER_TIP:
        for i in range(cosine.size):
            segments[0, i], segments[1, i] = segments[2, i], segments[3, i]


@kernel
def check(tips, geometry, bounds, assigned, far):
    """Mark the positioners with a target, and the tips that are out of reach; return the number of these tips."""
    n = 0
    cx, cy, low, high, usable = geometry.cx, geometry.cy, bounds.low, bounds.high, bounds.usable
    for i in range(cx.size):
        dx, dy = tips[i, 0] - cx[i], tips[i, 1] - cy[i]
        r2 = dx * dx + dy * dy
        assigned[i] = r2 < np.inf
        far[i] = (r2 < low[i]) | (r2 > high[i])
    # a single loop would take twice the time, because numbers and flags have different sizes in memory
    for i in range(cx.size):
        assigned[i] &= usable[i]
    for i in range(cx.size):
        far[i] &= usable[i]
    for i in range(cx.size):
        n += far[i]
    return n


@kernel
def fill_idle(assigned, idle, segments):
    """Replace the segment of each positioner without a target by the segment of its idle arm, in place.

    The segment of an idle arm that is not an obstacle is NaN.
    """
    for row in range(4):
        placed, parked = segments[row], idle[row]
        for i in range(assigned.size):
            a, b = placed[i], parked[i]
            placed[i] = a if assigned[i] else b


INSIDE, BORDERLINE = 1, 2
# Here, r is the distance of a target from a positioner, and R is the inner or outer radius of the patrol area. The
# rounding errors of r^2 and R^2, divided by R^2, sum to less than 5 * 2^-53. The factor 16 leaves a margin.
BAND = 16 * 2.0**-53
# Number of targets whose grid cells are determined together.
BATCH = 256


@kernel
def cell_of(value, origin, size, n):
    """Return the row or column of the grid that contains a coordinate, clipped to the grid."""
    return min(max(math.floor((value - origin) / size), 0), n - 1)


@kernel
def fill_grid(cx, cy, reach, x0, y0, size, nx, ny, start, order):
    """List the positioners that reach into each cell c as ``order[start[c]:start[c + 1]]``, in ascending order.

    If ``order`` is empty, only ``start`` is computed.
    """
    if order.size == 0:
        start[:] = 0
    fill = start[:-1].copy()
    for i in range(cx.size):
        left, right = cell_of(cx[i] - reach[i], x0, size, nx), cell_of(cx[i] + reach[i], x0, size, nx)
        for row in range(cell_of(cy[i] - reach[i], y0, size, ny), cell_of(cy[i] + reach[i], y0, size, ny) + 1):
            dy = max(y0 + row * size - cy[i], cy[i] - (y0 + (row + 1) * size), 0.0)
            for column in range(left, right + 1):
                dx = max(x0 + column * size - cx[i], cx[i] - (x0 + (column + 1) * size), 0.0)
                if dx * dx + dy * dy > reach[i] * reach[i]:
                    continue
                c = row * nx + column
                if order.size == 0:
                    start[c + 1] += 1
                else:
                    order[fill[c]] = i
                    fill[c] += 1
    if order.size == 0:
        for c in range(nx * ny):
            start[c + 1] += start[c]


def annuli(cx, cy, inner, outer):
    """Return the closed annuli of positioners, one per row.

    The columns are the center, the limits of the squared radius of points that are possibly inside, and the limits for
    points that are certainly inside. All numbers of a positioner are next to each other in memory.
    """
    low, high = inner * inner, outer * outer
    certain_low = np.where(inner == 0.0, -1.0, low * (1.0 + BAND))
    return np.column_stack([cx, cy, low * (1.0 - BAND), high * (1.0 + BAND), certain_low, high * (1.0 - BAND)])


@kernel
def reachable_pairs(tx, ty, accepts, annuli, offers, x0, y0, size, nx, ny, start, order, indptr, owner, r2, code):
    """List the pairs of positioners and targets in reach, in ascending order of the target, then of the positioner.

    Returns the number of pairs. If ``owner`` is too short for all pairs, the last pairs are counted but not stored. A
    pair is listed only if the bit masks of fiber types ``accepts`` (of the target) and ``offers`` (of the positioner)
    share a bit. ``code`` is INSIDE or BORDERLINE for each pair.
    """
    n = 0
    right, top = x0 + nx * size, y0 + ny * size
    first, last = np.empty(BATCH, np.int64), np.empty(BATCH, np.int64)
    for begin in range(0, tx.size, BATCH):
        m = min(BATCH, tx.size - begin)
        # The cells are determined in a separate loop without mispredicted branches, so that memory accesses overlap.
        for b in range(m):
            x, y = tx[begin + b], ty[begin + b]
            inside = x0 <= x <= right and y0 <= y <= top  # a coordinate that is NaN is also excluded here
            cell = cell_of(y, y0, size, ny) * nx + cell_of(x, x0, size, nx) if inside else 0
            first[b] = start[cell]
            last[b] = start[cell + 1] if inside else start[cell]
        for b in range(m):
            t = begin + b
            indptr[t] = n
            x, y = tx[t], ty[t]
            for k in range(first[b], last[b]):
                i = order[k]
                dx = x - annuli[i, 0]
                dy = y - annuli[i, 1]
                d2 = dx * dx + dy * dy
                possible = (d2 >= annuli[i, 2]) & (d2 <= annuli[i, 3])
                certain = (d2 > annuli[i, 4]) & (d2 < annuli[i, 5])
                if n < owner.size:
                    owner[n], r2[n], code[n] = i, d2, INSIDE if certain else BORDERLINE
                n += possible & (accepts[t] & offers[i] != 0)  # a branch would often be mispredicted
    indptr[tx.size] = n
    return n


@kernel
def take_pairs(indptr, owner, r2, keep, out_indptr, out_owner, out_r2):
    """Copy the pairs for which ``keep`` is true."""
    n = 0
    for t in range(indptr.size - 1):
        out_indptr[t] = n
        for k in range(indptr[t], indptr[t + 1]):
            if keep[k]:
                out_owner[n], out_r2[n] = owner[k], r2[k]
                n += 1
    out_indptr[indptr.size - 1] = n


@kernel
def transpose(indptr, owner, n_owners, out_indptr, out_target, out_source):
    """Sort pairs by positioner instead of by target; ``out_source`` is the index of each pair in the input."""
    out_indptr[:] = 0
    for k in range(owner.size):
        out_indptr[owner[k] + 1] += 1
    for i in range(n_owners):
        out_indptr[i + 1] += out_indptr[i]
    fill = out_indptr[:-1].copy()
    for t in range(indptr.size - 1):
        for k in range(indptr[t], indptr[t + 1]):
            i = owner[k]
            out_target[fill[i]] = t
            out_source[fill[i]] = k
            fill[i] += 1


@kernel
def bin_points(x, y, x0, y0, size, nx, ny, start, order):
    """Sort points into grid cells; points outside the grid are omitted.

    The indices of the points in cell c are ``order[start[c]:start[c + 1]]``.
    """
    start[:] = 0
    right, top = x0 + nx * size, y0 + ny * size
    for step in range(2):
        for k in range(x.size):
            if x0 <= x[k] <= right and y0 <= y[k] <= top:
                c = cell_of(y[k], y0, size, ny) * nx + cell_of(x[k], x0, size, nx)
                if step == 0:
                    start[c + 1] += 1
                else:
                    start[c] -= 1
                    order[start[c]] = k
        if step == 0:
            # ``start[c]`` is set to the end of cell c, because the second pass fills each cell from its end
            for c in range(nx * ny):
                start[c + 1] += start[c]
            for c in range(nx * ny):
                start[c] = start[c + 1]


@kernel
def is_clear(px, py, separation, x, y, x0, y0, size, nx, ny, start, order):
    """Return whether all points (x, y) are at least ``separation`` away from (px, py)."""
    left, right = cell_of(px - separation, x0, size, nx), cell_of(px + separation, x0, size, nx)
    for row in range(cell_of(py - separation, y0, size, ny), cell_of(py + separation, y0, size, ny) + 1):
        for k in range(start[row * nx + left], start[row * nx + right + 1]):
            dx, dy = x[order[k]] - px, y[order[k]] - py
            if dx * dx + dy * dy < separation * separation:
                return False
    return True


@kernel
def find_gaps(owners, cx, cy, inner, outer, fraction, most, separation, x, y, grid, out_owner, out_x, out_y):
    """Find up to ``most`` points without nearby targets for each positioner in ``owners``; return the total number.

    ``fraction`` contains, for each tested point, the fraction of the patrol area that is closer to the center of the
    positioner than this point. The direction from the center of the positioner rotates by the golden angle from each
    tested point to the next.
    """
    golden = math.pi * (3.0 - math.sqrt(5.0))
    n = 0
    for i in owners:
        low, high = inner[i] * inner[i], outer[i] * outer[i]
        n_points = 0
        for k in range(fraction.size):
            r = math.sqrt(low + fraction[k] * (high - low))
            px, py = cx[i] + r * math.cos(golden * k), cy[i] + r * math.sin(golden * k)
            if is_clear(px, py, separation, x, y, *grid):
                out_owner[n], out_x[n], out_y[n] = i, px, py
                n += 1
                n_points += 1
                if n_points == most:
                    break
    return n
