"""Circles on the focal plane where fibers receive no light."""

from itertools import chain

import numpy as np
from scipy.spatial import cKDTree

__all__ = ["Circles"]


class Circles:
    """Circles (x, y, radius) in mm, with an index of their centers."""

    def __init__(self, rows: np.ndarray):
        self.rows = rows
        self._tree = cKDTree(rows[:, :2]) if len(rows) else None

    def contain(self, points: np.ndarray) -> np.ndarray:
        """Return whether each point (mm) is inside or on the edge of a circle; the result is False for NaN."""
        found = np.zeros(len(points), dtype=bool)
        if self._tree is not None:
            finite = np.flatnonzero(np.isfinite(points).all(axis=1))
            near = self._tree.query_ball_point(points[finite], self.rows[:, 2].max())
            size = np.fromiter(map(len, near), dtype=np.int64, count=len(finite))
            point = np.repeat(finite, size)
            circle = self.rows[np.fromiter(chain.from_iterable(near), dtype=np.int64, count=size.sum())]
            found[point[((points[point] - circle[:, :2]) ** 2).sum(axis=1) <= circle[:, 2] ** 2]] = True
        return found
