"""Find pairs of neighbors, and convert them to the forms that the kernels read."""

from functools import cached_property

import numpy as np

from rfpsurvey._units import locked
from rfpsurvey.focal_plane._reach import make_grid


def pairs_within(xy: np.ndarray, limit: float) -> np.ndarray:
    """Return the pairs (i, j) of centers whose distance is at most ``limit``, with i < j, sorted."""
    x0, y0, size, nx, ny, start, order = make_grid(xy, np.full(len(xy), limit))
    column, row = np.floor((xy - (x0, y0)) / size).astype(np.int64).clip(0, (nx - 1, ny - 1)).T
    cell = row * nx + column
    n_near = np.diff(start)[cell]
    i = np.repeat(np.arange(len(xy)), n_near)
    j = order[np.arange(len(i)) + np.repeat(start[cell] - (np.cumsum(n_near) - n_near), n_near)]
    near = (i < j) & (((xy[i] - xy[j]) ** 2).sum(axis=1) <= limit**2)
    return np.column_stack([i[near], j[near]])


def nearest_within(xy: np.ndarray, limit: float) -> np.ndarray:
    """Return the distance from each center to the nearest other center; infinity if no center is within ``limit``."""
    pairs = pairs_within(xy, limit)
    distance = np.hypot(*(xy[pairs[:, 0]] - xy[pairs[:, 1]]).T)
    nearest = np.full(len(xy), np.inf)
    for rows in pairs.T:
        np.minimum.at(nearest, rows, distance)
    return nearest


class Neighbors:
    """Properties that `FocalPlaneArrays` inherits: the pairs of positioners whose arms may collide."""

    @cached_property
    def neighbors(self) -> np.ndarray:
        pairs = pairs_within(self.xy, 2 * self.arm_reach.max() + self.separation + self.touch_slack)
        return locked(pairs[self.can_touch(pairs, self.touch_slack)] if np.ptp(self.arm_reach) else pairs)

    def can_touch(self, pairs: np.ndarray, slack: float = 0.0) -> np.ndarray:
        """Return whether the arms of each pair can come closer than the minimum separation plus ``slack`` (mm)."""
        distance = np.hypot(*(self.xy[pairs[:, 0]] - self.xy[pairs[:, 1]]).T)
        return distance < self.arm_reach[pairs].sum(axis=1) + self.separation + slack

    @cached_property
    def n_sharing(self) -> np.ndarray:
        reach = self.largest_radius * (1 + 1e-6)
        pairs = pairs_within(self.xy, 2 * reach.max())
        distance = np.hypot(*(self.xy[pairs[:, 0]] - self.xy[pairs[:, 1]]).T)
        near = [column[distance <= reach[column] + reach.max()] for column in pairs.T]
        return locked(sum(np.bincount(rows, minlength=len(reach)) for rows in near))

    @cached_property
    def runs(self) -> np.ndarray:
        """Neighbors as sorted entries (i, j, n), each of which stands for n pairs: (i, j), (i + 1, j + 1), ...

        If positioners are numbered along the rows of a lattice, a few entries (i, j, n) represent thousands of pairs.
        """
        pairs = self.neighbors
        if len(pairs) == 0:
            return np.empty((0, 3), dtype=np.int64)
        pairs = pairs[np.lexsort((pairs[:, 0], pairs[:, 1] - pairs[:, 0]))]
        first = np.append(True, (np.diff(pairs, axis=0) != 1).any(axis=1))
        rows = np.flatnonzero(first)
        runs = np.column_stack([pairs[rows], np.diff(np.append(rows, len(pairs)))])
        return runs[np.lexsort((runs[:, 1], runs[:, 0]))]

    @cached_property
    def both_ways(self) -> tuple[np.ndarray, np.ndarray]:
        """All neighbors of each positioner in compressed rows (CSR): the start of each row, and the neighbors.

        The array of neighbors is never empty, because arrays on a GPU must not be empty.
        """
        pairs = np.vstack([self.neighbors, self.neighbors[:, ::-1]])
        pairs = pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]
        return np.searchsorted(pairs[:, 0], np.arange(len(self.plane) + 1)), np.append(pairs[:, 1], 0)
