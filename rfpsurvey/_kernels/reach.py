"""Find the targets in the patrol area of each positioner; a grid of cells reduces the number of pairs to test."""

import math

import numpy as np

from rfpsurvey._jit import kernel

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
