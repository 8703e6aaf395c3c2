"""The GPU's side of `find_collisions` and `count_collisions`."""

import numpy as np

from rfpsurvey.errors import InputError

try:
    from numba import cuda

    from rfpsurvey._kernels import gpu
except ImportError as error:
    raise InputError(
        f"the method 'cuda' needs the package numba-cuda, as in pip install 'rfpsurvey[cuda]' ({error})"
    ) from None

__all__ = ["count_tips", "find_pairs"]


def find_pairs(segments, pairs, limits):
    """Return first, second and squared distance of the pairs closer than the safe distance or in the band about it."""
    _require_device()
    first, second = (cuda.to_device(np.ascontiguousarray(p)) for p in pairs.T)
    found, squared = cuda.device_array(len(pairs), np.int64), cuda.device_array(len(pairs), np.float64)
    n = cuda.to_device(np.zeros(1, dtype=np.int64))
    blocks = -(-len(pairs) // gpu.THREADS)
    reject2, limit = (limits.separation + limits.slack) ** 2, limits.separation**2 + limits.band
    gpu.list_pairs[blocks, gpu.THREADS](cuda.to_device(segments), first, second, reject2, limit, found, squared, n)
    n = int(n.copy_to_host()[0])
    rows = found.copy_to_host()[:n]
    return pairs[rows, 0], pairs[rows, 1], squared.copy_to_host()[:n]


def count_tips(points, plane, stage, side):
    """Return counts, times, and the number of tips that are out of reach; arguments as in the kernels' ``batch``."""
    _require_device()
    m, n = points.shape[:2]
    columns = plane._scene.geometry
    points = np.where(columns.usable[None, :, None], points, np.nan)
    points[np.isnan(points).any(axis=2)] = np.nan
    tips = cuda.to_device(points)
    geometry = np.array([columns.cx, columns.cy, columns.l1, columns.l2, columns.low, columns.high])
    segments, far = cuda.device_array((m, 4, n)), cuda.to_device(np.zeros(1, dtype=np.int64))
    counts, times = cuda.to_device(np.zeros((m, 7), np.int64)), cuda.to_device(np.zeros(n, np.int64))
    grid = -(-n // gpu.THREADS), m
    angles = np.array([stage.cosine, stage.sine])
    gpu.stand[grid, gpu.THREADS](
        tips, cuda.to_device(geometry), cuda.to_device(side), columns.home_x, columns.home_y,
        cuda.to_device(stage.idle), stage.model, stage.length, cuda.to_device(angles), segments, far,
    )  # fmt: skip
    limits = stage.limits
    indptr, neighbor = plane._scene.both_ways
    hurdle_indptr = np.searchsorted(stage.obstacle_pairs[:, 0], np.arange(n + 1))
    hurdles = np.vstack([stage.obstacles[stage.obstacle_pairs[:, 1]], np.zeros((1, 3))])  # never empty
    gpu.count[grid, gpu.THREADS](
        tips, segments, cuda.to_device(indptr), cuda.to_device(neighbor), (limits.separation + limits.slack) ** 2,
        limits.separation**2, limits.band, cuda.to_device(stage.parked), cuda.to_device(hurdle_indptr),
        cuda.to_device(hurdles), stage.clearance, counts, times,
    )  # fmt: skip
    return counts.copy_to_host(), times.copy_to_host(), int(far.copy_to_host()[0])


def _require_device():
    if not cuda.is_available():
        raise InputError(
            "the method 'cuda' needs a GPU that numba can use, and found none; with NUMBA_ENABLE_CUDASIM=1 in the "
            "environment a small one is simulated"
        )
