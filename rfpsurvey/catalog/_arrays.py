"""The columns of a catalog as arrays without units, and an index that finds the directions inside a circle."""

from functools import cached_property

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord

from rfpsurvey._kernels import sky, zones
from rfpsurvey._units import locked, to_vectors
from rfpsurvey.catalog._extra import result_name
from rfpsurvey.catalog._time import to_time

# Largest number of zones, and mean number of directions in a square whose side is the height of a zone.
MOST_ZONES = 1800
PER_SQUARE = 25.0
# Number of directions that are copied or converted together; astropy makes many temporary arrays of this length.
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


class CatalogArrays:
    """The columns of a catalog as read-only arrays without units, which are computed on first use and then stored.

    Parameters
    ----------
    catalog : Catalog
        The catalog.

    Attributes
    ----------
    vectors : ndarray of float, shape (n, 3)
        Unit vectors in the directions of the targets, in the frame ICRS.
    repeated_ids : bool
        Whether any two targets have the same identifier.
    extra : dict
        Values of the extra columns of the catalog, without units. The keys are the names that the columns have in
        results; for example, the key of a column ``ra`` is ``target_ra``.
    extra_units : dict
        Units of the extra columns as text, with the same keys as ``extra``. The text is empty for a column without a
        unit.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astropy.coordinates import SkyCoord
    >>> import rfpsurvey as rs
    >>> catalog = rs.Catalog(SkyCoord([0, 90] * u.deg, [0, 0] * u.deg))
    >>> catalog.arrays.vectors
    array([[1., 0., 0.],
           [0., 1., 0.]])
    """

    def __init__(self, catalog):
        # The catalog itself is not stored, because a circular reference would delay the release of its memory.
        self._coord, self._id, self._epoch = catalog.coord, catalog.id, catalog.epoch
        names = [] if catalog.extra is None else catalog.extra.colnames
        columns = {result_name(name): catalog.extra[name] for name in names}
        self.extra = {name: np.asarray(getattr(column, "value", column)) for name, column in columns.items()}
        self.extra_units = {name: str(getattr(column, "unit", None) or "") for name, column in columns.items()}

    @cached_property
    def vectors(self) -> np.ndarray:
        vectors = np.empty((len(self._coord), 3))
        for first in range(0, len(vectors), BLOCK):
            block = slice(first, first + BLOCK)
            vectors[block] = to_vectors(self._coord[block])
        return locked(vectors)

    @cached_property
    def repeated_ids(self) -> bool:
        ids = self._id
        if ids.dtype.kind == "i" and (ids[1:] > ids[:-1]).all():
            return False
        return len(np.unique(ids)) < len(ids)

    def rows_within(self, center: SkyCoord, radius_rad: float) -> np.ndarray:
        """Return the row numbers of the targets inside a circle on the sky."""
        mask = np.empty(len(self._id), dtype=bool)
        center = to_vectors(center, "center", scalar=True)[0]
        sky.within(self.vectors, center, half_chord_squared(radius_rad), mask)
        return np.flatnonzero(mask)

    def rows_near(self, center: SkyCoord, radius_rad: float, time: object) -> np.ndarray:
        """Return the row numbers of all targets that could be inside a circle on the sky at another epoch.

        The radius of the circle is increased by the largest angle by which any target moves until this epoch.
        """
        # A small additional margin allows for rounding errors.
        return self.rows_within(center, radius_rad + self.farthest_rad(time) * (1 + 1e-9) + 1e-12)

    def farthest_rad(self, time: object) -> float:
        """Return an upper limit of the angle (rad) by which any target moves until another epoch."""
        if "s" not in self._coord.data.differentials or self._epoch is None:
            return 0.0
        icrs = self._coord.icrs
        speed = np.nan_to_num(np.hypot(icrs.pm_ra_cosdec, icrs.pm_dec).to_value(u.rad / u.yr))
        years = np.abs((to_time(time, "epoch").tdb - self._epoch.tdb).to_value(u.yr))
        return float(np.max(speed * years, initial=0.0))
