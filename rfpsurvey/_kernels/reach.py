"""Which positioner reaches which target: a grid of positioners, then exact annulus tests."""

import math

from rfpsurvey._jit import kernel

OUTSIDE, INSIDE, BORDERLINE = 0, 1, 2
# Relative error of r^2 - R^2 as computed below is under 5 units of rounding (2^-53); 16 leaves room.
BAND = 16 * 2.0**-53


@kernel
def cell_of(value, origin, size, n):
    """Index of the grid cell of a coordinate, clipped to the grid."""
    return min(max(math.floor((value - origin) / size), 0), n - 1)


@kernel
def fill_grid(cx, cy, x0, y0, size, nx, ny, start, order):
    """Sort positioners into cells: those of cell c are ``order[start[c]:start[c + 1]]``, in ascending order."""
    start[:] = 0
    for i in range(cx.size):
        start[cell_of(cy[i], y0, size, ny) * nx + cell_of(cx[i], x0, size, nx) + 1] += 1
    for c in range(nx * ny):
        start[c + 1] += start[c]
    fill = start[:-1].copy()
    for i in range(cx.size):
        c = cell_of(cy[i], y0, size, ny) * nx + cell_of(cx[i], x0, size, nx)
        order[fill[c]] = i
        fill[c] += 1


@kernel
def annulus(r2, inner, outer):
    """Is the squared radius in the closed annulus? BORDERLINE where rounding could decide."""
    outer2 = outer * outer
    inner2 = inner * inner
    if r2 > outer2 * (1.0 + BAND) or r2 < inner2 * (1.0 - BAND):
        return OUTSIDE
    if r2 < outer2 * (1.0 - BAND) and (inner == 0.0 or r2 > inner2 * (1.0 + BAND)):
        return INSIDE
    return BORDERLINE


@kernel
def reachable_pairs(
    tx, ty, accepts, cx, cy, inner, outer, offers, x0, y0, size, nx, ny, start, order, indptr, owner, r2, code
):
    """Pairs (target, positioner), targets ascending, positioners ascending within a target.

    Returns the number of pairs; where it exceeds the room in ``owner``, the surplus is not stored. ``accepts``
    and ``offers`` are bit masks of fiber types. ``code`` is INSIDE or BORDERLINE.
    """
    n = 0
    reach = 0.0
    for i in range(outer.size):
        reach = max(reach, outer[i])
    reach *= 1.0 + 1e-6
    low_x, high_x = x0 - reach, x0 + nx * size + reach
    low_y, high_y = y0 - reach, y0 + ny * size + reach
    for t in range(tx.size):
        indptr[t] = n
        x, y = tx[t], ty[t]
        if not (low_x <= x <= high_x and low_y <= y <= high_y):  # also NaN
            continue
        first = n
        for row in range(cell_of(y - reach, y0, size, ny), cell_of(y + reach, y0, size, ny) + 1):
            for column in range(cell_of(x - reach, x0, size, nx), cell_of(x + reach, x0, size, nx) + 1):
                cell = row * nx + column
                for k in range(start[cell], start[cell + 1]):
                    i = order[k]
                    dx = x - cx[i]
                    dy = y - cy[i]
                    d2 = dx * dx + dy * dy
                    verdict = annulus(d2, inner[i], outer[i])
                    if verdict == OUTSIDE or accepts[t] & offers[i] == 0:
                        continue
                    if n < owner.size:
                        j = n
                        while j > first and owner[j - 1] > i:
                            owner[j], r2[j], code[j] = owner[j - 1], r2[j - 1], code[j - 1]
                            j -= 1
                        owner[j], r2[j], code[j] = i, d2, verdict
                    n += 1
    indptr[tx.size] = n
    return n


@kernel
def transpose(indptr, owner, n_owners, out_indptr, out_target, out_source):
    """Turn rows of targets into rows of owners; ``out_source`` is the position of each pair in the input."""
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
