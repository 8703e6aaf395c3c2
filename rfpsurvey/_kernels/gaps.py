"""Find sky positions: points in reach of a positioner that are at least a given distance away from all targets."""

import math

from rfpsurvey._jit import kernel
from rfpsurvey._kernels.reach import cell_of


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
