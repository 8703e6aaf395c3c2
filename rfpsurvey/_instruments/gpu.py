"""Run `find_collisions` and `count_collisions` on a GPU."""

import numpy as np

from rfpsurvey._kernels import collisions
from rfpsurvey._kernels.batch import N_COUNTS
from rfpsurvey.errors import InputError

try:
    from numba import cuda

    from rfpsurvey._kernels import gpu
except ImportError as error:
    raise InputError(
        f"the method 'cuda' needs the package numba-cuda; use pip install 'rfpsurvey[cuda]' ({error})"
    ) from None


def find_pairs(segments, pairs, limits):
    """Return (first, second, squared distance) of all pairs of arms that collide or are borderline."""
    _require_device()
    first, second = (cuda.to_device(np.ascontiguousarray(p)) for p in pairs.T)
    kept, squared = cuda.device_array(len(pairs), np.int64), cuda.device_array(len(pairs), np.float64)
    n = cuda.to_device(np.zeros(1, dtype=np.int64))
    blocks = -(-len(pairs) // gpu.THREADS)
    reject2, limit = (limits.separation + limits.slack) ** 2, collisions.squared_limit(limits) + limits.band
    gpu.list_pairs[blocks, gpu.THREADS](cuda.to_device(segments), first, second, reject2, limit, kept, squared, n)
    n = int(n.copy_to_host()[0])
    rows = kept.copy_to_host()[:n]
    return pairs[rows, 0], pairs[rows, 1], squared.copy_to_host()[:n]


def make_scorer(columns, setup):
    """Return a function that counts the collisions of configurations on a GPU and keeps its data in GPU memory.

    The arguments of the function are the positions of the tips (mm) and the sides of the elbows (+1 or -1). It returns
    the counts of each configuration, the number of configurations in which each positioner is in collision, and the
    number of tips out of reach.
    """
    _require_device()
    n, limits = len(columns.plane), setup.limits
    g, bounds = columns.geometry, columns.bounds
    geometry = cuda.to_device(np.array([g.cx, g.cy, g.l1, g.l2, bounds.low, bounds.high]))
    idle, angles = cuda.to_device(setup.idle), cuda.to_device(np.array([setup.cosine, setup.sine]))
    shape = g.home_x, g.home_y, idle, setup.model, setup.length, angles
    *neighbors, parked = (cuda.to_device(v) for v in (*columns.both_ways, setup.parked))
    near = (limits.separation + limits.slack) ** 2, collisions.squared_limit(limits), limits.band
    circle_indptr = cuda.to_device(np.searchsorted(setup.obstacle_pairs[:, 0], np.arange(n + 1)))
    circles = np.vstack([setup.obstacles[setup.obstacle_pairs[:, 1]], np.zeros((1, 3))])  # never empty
    obstacles = circle_indptr, cuda.to_device(circles), setup.clearance

    def score(points, side):
        m = len(points)
        tips = cuda.to_device(np.where(bounds.usable[None, :, None], points, np.nan))
        segments, far = cuda.device_array((m, 4, n)), cuda.to_device(np.zeros(1, dtype=np.int64))
        counts, times = cuda.to_device(np.zeros((m, N_COUNTS), np.int64)), cuda.to_device(np.zeros(n, np.int64))
        launch = (-(-n // gpu.THREADS), m), gpu.THREADS
        gpu.pose_tips[launch](tips, geometry, cuda.to_device(side), *shape, segments, far)
        gpu.count[launch](tips, segments, *neighbors, *near, parked, *obstacles, counts, times)
        return counts.copy_to_host(), times.copy_to_host(), int(far.copy_to_host()[0])

    return score


def _require_device():
    if not cuda.is_available():
        raise InputError(
            "the method 'cuda' needs a GPU and numba-cuda (pip install 'rfpsurvey[cuda]'), but there is no "
            "working GPU; with NUMBA_ENABLE_CUDASIM=1 in the environment, numba simulates a small GPU"
        )
