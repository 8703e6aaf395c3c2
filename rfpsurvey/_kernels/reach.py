"""Find pairs of positioners and targets within reach, by a grid of cells and then by a test of each annulus."""

import math

from rfpsurvey._jit import kernel

OUTSIDE, INSIDE, BORDERLINE = 0, 1, 2
# The relative error of r^2 - R^2 as computed below is less than 5 rounding units of 2^-53. The factor 16 leaves a
# margin.
BAND = 16 * 2.0**-53


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


@kernel
def annulus(r2, inner, outer):
    """Return whether a squared radius is INSIDE or OUTSIDE a closed annulus, or BORDERLINE if this is uncertain."""
    outer2 = outer * outer
    inner2 = inner * inner
    possible = (r2 <= outer2 * (1.0 + BAND)) & (r2 >= inner2 * (1.0 - BAND))
    certain = (r2 < outer2 * (1.0 - BAND)) & ((inner == 0.0) | (r2 > inner2 * (1.0 + BAND)))
    return INSIDE if certain else (BORDERLINE if possible else OUTSIDE)


@kernel
def reachable_pairs(
    tx, ty, accepts, cx, cy, inner, outer, offers, x0, y0, size, nx, ny, start, order, indptr, owner, r2, code
):
    """List the pairs within reach in ascending order of the target, then of the positioner.

    Returns the number of pairs. If ``owner`` is too short for all pairs, the last pairs are counted but not stored.
    ``accepts`` (of each target) and ``offers`` (of each positioner) are bit masks of fiber types. ``code`` is INSIDE or
    BORDERLINE for each pair.
    """
    n = 0
    right, top = x0 + nx * size, y0 + ny * size
    for t in range(tx.size):
        indptr[t] = n
        x, y = tx[t], ty[t]
        if not (x0 <= x <= right and y0 <= y <= top):  # a coordinate that is NaN is also excluded here
            continue
        cell = cell_of(y, y0, size, ny) * nx + cell_of(x, x0, size, nx)
        for k in range(start[cell], start[cell + 1]):
            i = order[k]
            dx = x - cx[i]
            dy = y - cy[i]
            d2 = dx * dx + dy * dy
            place = annulus(d2, inner[i], outer[i])
            if n < owner.size:
                owner[n], r2[n], code[n] = i, d2, place
            n += (place != OUTSIDE) & (accepts[t] & offers[i] != 0)  # a branch would often be mispredicted
    indptr[tx.size] = n
    return n


@kernel
def take_pairs(indptr, owner, r2, keep, out_indptr, out_owner, out_r2):
    """Copy the pairs that ``keep`` marks."""
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
