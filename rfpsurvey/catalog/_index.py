"""An index of directions on the sky, which finds the directions inside a circle without testing all directions."""

from functools import cached_property

import numpy as np

from rfpsurvey._kernels import zones

# Largest number of zones, and mean number of directions in a square whose side is the height of a zone.
MOST_ZONES = 1800
PER_SQUARE = 25.0
# Number of directions that are copied together.
BLOCK = 1 << 18


class SkyIndex:
    """Unit vectors sorted by zones of declination.

    The index of a direction in the sorted list is called the *position* of the direction. ``order[k]`` is the row,
    in the parameter ``vectors``, of the direction that has the position k.

    Parameters
    ----------
    vectors : ndarray, shape (n, 3)
        Unit vectors of the directions to sort.
    """

    def __init__(self, vectors: np.ndarray):
        n = len(vectors)
        self.n_zones = int(np.clip(np.sqrt(max(n, 1) / PER_SQUARE), 1, MOST_ZONES))
        self.key = np.empty(n)
        zones.make_keys(vectors, self.n_zones, self.key)
        # The type is int32 if possible, because this array uses much of the memory of a large catalog.
        self.order = np.argsort(self.key, kind="stable").astype(np.int32 if n < 2**31 else np.int64)
        self.key = self.key[self.order]
        self.vectors = np.empty((n, 3))
        for first in range(0, n, BLOCK):  # `take` is fast, but it makes a copy of the indices with 64 bits
            rows = slice(first, first + BLOCK)
            vectors.take(self.order[rows], axis=0, out=self.vectors[rows], mode="clip")

    def __len__(self):
        return len(self.order)

    @cached_property
    def _everything(self):
        return np.ones(len(self), dtype=np.uint8)

    def near(self, center: np.ndarray, radius_rad: float, left: np.ndarray | None = None) -> np.ndarray:
        """Return the positions (in the sorted list) of the directions inside a circle, in the order of their rows.

        Parameters
        ----------
        center : ndarray, shape (3,)
            Unit vector of the center of the circle.
        radius_rad : float
            Angular radius of the circle, in radians.
        left : ndarray, shape (n,), optional
            Value for the direction at each position, such as a number of remaining visits. Directions with the value 0
            are omitted.

        Returns
        -------
        ndarray of int
            Positions of these directions in the sorted list.
        """
        limit = half_chord_squared(radius_rad)
        left = self._everything if left is None else left
        size = 4096
        while True:
            out = np.empty(size, dtype=np.int64)
            n = zones.find_near(self.vectors, self.key, self.n_zones, center, radius_rad, limit, left, out)
            if n <= size:
                return out[:n][np.argsort(self.order[out[:n]])]
            size = n

    def sum_near(self, centers: np.ndarray, radius_rad: float, weight: np.ndarray) -> np.ndarray:
        """Return the sum of the weights of the directions in a circle about each center, shape (m,)."""
        out = np.empty(len(centers))
        limit = half_chord_squared(radius_rad)
        centers = np.ascontiguousarray(centers)
        zones.sum_near(self.vectors, self.key, self.n_zones, centers, radius_rad, limit, weight, out)
        return out


def half_chord_squared(radius_rad: float) -> float:
    """Return the square of half the chord of an angle, slightly increased to allow for rounding errors."""
    return np.sin(0.5 * min(radius_rad, np.pi)) ** 2 * (1 + 1e-15)
