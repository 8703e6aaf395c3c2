"""Count and list the collisions of configurations on a GPU. This module is imported only if a GPU is requested.

The poses of arms and the distance of a pair are computed by the same functions as on the CPU, compiled for the GPU.
Each thread tests one positioner of one configuration against all neighbors of this positioner, including neighbors with
lower indices. Therefore, no thread waits for the results of other threads.
"""

import math

from numba import cuda, int32

from rfpsurvey._kernels.arms import CAPSULE, FIBER_TIP, capsule_end, elbow
from rfpsurvey._kernels.batch import ASSIGNED, BORDERLINE, COLLIDING, COLLIDING_ASSIGNED, COUNTED, OBSTACLE_PAIRS, PAIRS
from rfpsurvey._kernels.collisions import near_squared, point_segment_squared

__all__ = ["THREADS", "count", "list_pairs", "pose_tips"]

THREADS = 128
"""Number of threads per block."""


@cuda.jit
def pose_tips(tips, geometry, side, home_x, home_y, idle, model, length, angles, segments, far):
    """Compute the segments of arms from their tips, and add the number of tips out of reach to ``far[0]``.

    For m configurations of n positioners, the shape of ``tips`` is (m, n, 2), and the shape of ``segments`` is
    (m, 4, n). A tip is NaN for a positioner without a target. The rows of ``geometry`` are cx, cy, l1, l2, and the
    squared inner and outer radius of the patrol area. ``angles`` contains the cosine and sine of the angle of the
    capsule.
    """
    c, i = cuda.blockIdx.y, cuda.grid(1)
    if i >= tips.shape[1]:
        return
    x, y, cx, cy = tips[c, i, 0], tips[c, i, 1], geometry[0, i], geometry[1, i]
    r2 = (x - cx) * (x - cx) + (y - cy) * (y - cy)
    if r2 == r2:
        if r2 < geometry[4, i] or r2 > geometry[5, i]:
            cuda.atomic.add(far, 0, 1)
        row = c if side.shape[0] > 1 else 0
        dx, dy, _, _ = elbow(x - cx, y - cy, geometry[2, i], geometry[3, i], side[row, i], home_x, home_y)
        ex, ey = cx + dx, cy + dy
    else:
        ex, ey, x, y = idle[0, i], idle[1, i], idle[2, i], idle[3, i]
    if model == CAPSULE:
        x, y = capsule_end(ex, ey, x, y, length, angles[0, i], angles[1, i])
    elif model == FIBER_TIP:
        ex, ey = x, y
    segments[c, 0, i], segments[c, 1, i], segments[c, 2, i], segments[c, 3, i] = ex, ey, x, y


@cuda.jit
def count(
    tips, segments, indptr, neighbor, reject2, limit, band, parked, circle_indptr, circles, clearance, counts, times
):
    """Count the collisions of each configuration and, for each positioner, the configurations in which it collides.

    ``indptr`` and ``neighbor`` list all neighbors of each positioner. ``circle_indptr`` and ``circles`` list the
    obstacles (x, y, radius) that each positioner can touch.
    """
    c, i = cuda.blockIdx.y, cuda.grid(1)
    inside = i < parked.size
    pairs = borderline = touched = 0
    hit = assigned = counted = False
    if inside:
        assigned = tips[c, i, 0] == tips[c, i, 0] and tips[c, i, 1] == tips[c, i, 1]
        counted = assigned or parked[i]
        ax, ay, bx, by = segments[c, 0, i], segments[c, 1, i], segments[c, 2, i], segments[c, 3, i]
        for k in range(indptr[i], indptr[i + 1]):
            j = neighbor[k]
            px, py, qx, qy = segments[c, 0, j], segments[c, 1, j], segments[c, 2, j], segments[c, 3, j]
            d2 = near_squared(ax, ay, bx, by, px, py, qx, qy, reject2)
            if d2 < limit:
                hit = True
                pairs += j > i
            if j > i and abs(d2 - limit) <= band:
                borderline += 1
        for k in range(circle_indptr[i], circle_indptr[i + 1]):
            d2 = point_segment_squared(circles[k, 0], circles[k, 1], ax, ay, bx, by)
            if math.sqrt(d2) < circles[k, 2] + clearance:
                hit = True
                touched += 1
        if hit:
            cuda.atomic.add(times, i, 1)
        if pairs > 0:
            cuda.atomic.add(counts, (c, PAIRS), pairs)
        if borderline > 0:
            cuda.atomic.add(counts, (c, BORDERLINE), borderline)
        if touched > 0:
            cuda.atomic.add(counts, (c, OBSTACLE_PAIRS), touched)
    # all threads of a block must call this function, including those without a positioner
    n_assigned = cuda.syncthreads_count(int32(assigned))
    n_counted = cuda.syncthreads_count(int32(counted))
    n_hit = cuda.syncthreads_count(int32(hit and counted))
    n_both = cuda.syncthreads_count(int32(hit and assigned))
    if cuda.threadIdx.x == 0:
        cuda.atomic.add(counts, (c, ASSIGNED), n_assigned)
        cuda.atomic.add(counts, (c, COUNTED), n_counted)
        cuda.atomic.add(counts, (c, COLLIDING), n_hit)
        cuda.atomic.add(counts, (c, COLLIDING_ASSIGNED), n_both)


@cuda.jit
def list_pairs(segments, first, second, reject2, limit, kept, squared, n):
    """List the index k of each pair (``first[k]``, ``second[k]``) whose squared distance is below ``limit``."""
    k = cuda.grid(1)
    if k >= first.size:
        return
    i, j = first[k], second[k]
    ax, ay, bx, by = segments[0, i], segments[1, i], segments[2, i], segments[3, i]
    px, py, qx, qy = segments[0, j], segments[1, j], segments[2, j], segments[3, j]
    d2 = near_squared(ax, ay, bx, by, px, py, qx, qy, reject2)
    if d2 < limit:
        row = cuda.atomic.add(n, 0, 1)
        kept[row], squared[row] = k, d2
