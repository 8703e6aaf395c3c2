"""Circles on the focal plane where fibers receive no light."""

import numpy as np

from rfpsurvey._kernels import reach
from rfpsurvey.focal_plane._reach import make_grid


class Circles:
    """Circles in mm (columns x, y and radius), with a grid of cells that makes the search for circles fast."""

    def __init__(self, rows: np.ndarray):
        self.x, self.y, self.radius = rows.T.copy()
        self._grid = make_grid(rows[:, :2], self.radius) if len(rows) else None

    def contain(self, points: np.ndarray) -> np.ndarray:
        """Return whether each point (mm) is in one of the circles or on its edge; a NaN point is in no circle."""
        if self._grid is None:
            return np.zeros(len(points), dtype=bool)
        n, (x, y) = len(self.x), points.T.copy()
        any_type = np.broadcast_to(np.int64(-1), len(points)), np.broadcast_to(np.int64(-1), n)
        start, empty = np.empty(len(points) + 1, dtype=np.int64), np.empty(0)
        circles = reach.annuli(self.x, self.y, np.zeros(n), self.radius), any_type[1].copy()
        pairs = np.empty(0, dtype=np.int64), empty, np.empty(0, dtype=np.int8)
        reach.reachable_pairs(x, y, any_type[0].copy(), *circles, *self._grid, start, *pairs)
        return np.diff(start) > 0
