"""Constraints on the centers of tiles: a list of centers, and limits of declination."""

from dataclasses import dataclass
from functools import cached_property

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord
from astropy.table import Table

from rfpsurvey._units import ByValue, from_lonlat, to_direction, to_lonlat, to_scalar, to_unit, to_vectors
from rfpsurvey.catalog import is_table
from rfpsurvey.errors import INCONVERTIBLE, InputError, InputTypeError, refusal, short
from rfpsurvey.tiling._tiling import Tiling, as_tiling, place_of

# Tolerance (radians) for rounding errors at the limits of declination.
ROUNDING = 1e-12


@dataclass(frozen=True, eq=False)
class Centers(ByValue):
    """Constraints on the centers of tiles, and the position angle of the tiles.

    Parameters
    ----------
    coord : SkyCoord, Tiling or Table, optional
        List of the allowed centers, such as bright stars or the tiles of an earlier survey. Tiles at these centers may
        leave gaps in the field. The method ``given`` uses all of these centers in their order. If the list is a tiling
        or a table, this method also keeps its identifiers, position angles, passes and further columns.
    declination : tuple of Quantity or Quantity, shape (2,), optional
        Lowest and highest declination of a center. For a site at the latitude b and a maximum zenith distance z on
        the meridian, the limits are b - z and b + z.
    position_angle : Quantity, optional
        Position angle of the +y axis of the focal plane, from north toward east, for all tiles. The default is 0 or,
        for the method ``given``, the position angle of each tile in the list.

    Raises
    ------
    InputError
        If a direction, an angle or a unit is not valid, if the lower limit exceeds the upper limit, or if no center is
        inside the limits.

    Examples
    --------
    >>> import astropy.units as u
    >>> import rfpsurvey as rs
    >>> north = rs.tiling.Centers(declination=(-10 * u.deg, 60 * u.deg))
    >>> tiling = rs.place_tiles(rs.Region.parse("box 0 20 40 60"), "desi", centers=north)
    >>> tiling.table["dec"].max() <= 60 * u.deg
    np.True_
    """

    coord: SkyCoord | Tiling | Table | None = None
    declination: tuple[u.Quantity, u.Quantity] | u.Quantity | None = None
    position_angle: u.Quantity | None = None

    def __post_init__(self):
        if self.position_angle is not None:
            to_scalar(self.position_angle, u.deg, "position_angle", low=-3600, high=3600)
        limits, vectors = self.limits, self.vectors
        if vectors is not None and len(vectors) == 0:
            inside = "" if limits.anywhere else " inside the limits of declination"
            raise InputError(f"centers must contain at least one finite direction{inside}, got none")

    @cached_property
    def limits(self) -> "Declinations":
        """The limits of declination in radians."""
        return Declinations() if self.declination is None else Declinations(*_two(self.declination))

    @cached_property
    def tiling(self) -> Tiling | None:
        """The finite centers of the list that are inside the limits; None if there is no list."""
        if self.coord is None:
            return None
        given = self.coord
        if not (isinstance(given, SkyCoord | Tiling) or is_table(given)):
            raise InputTypeError(f"centers must be a SkyCoord, a Tiling or a Table, got {short(given)}")
        if isinstance(given, SkyCoord):
            finite = np.isfinite(to_vectors(given, "centers")).all(axis=1)
            given = to_direction(given).reshape(-1).icrs[finite]
            given = given[_distinct(given.ra.deg, given.dec.deg)]
        tiling = as_tiling(given)
        inside = self.limits.distance(tiling.vectors) <= ROUNDING
        return tiling if inside.all() else Tiling(tiling.table[inside])

    @property
    def angle_deg(self) -> float:
        """Position angle, in degrees, of tiles for which no position angle is listed."""
        return 0.0 if self.position_angle is None else float(self.position_angle.to_value(u.deg))

    @cached_property
    def vectors(self) -> np.ndarray | None:
        """The distinct centers of the list as unit vectors, or None if no list was given."""
        if self.tiling is None:
            return None
        return self.tiling.vectors[_distinct(self.tiling.table["ra"].value, self.tiling.table["dec"].value)]


@dataclass(frozen=True)
class Declinations:
    """Limits of declination in radians."""

    low: float = -np.pi / 2
    high: float = np.pi / 2

    @property
    def anywhere(self) -> bool:
        """Whether every declination is allowed."""
        return self.low <= -np.pi / 2 and self.high >= np.pi / 2

    @property
    def words(self) -> str:
        """The limits as text for use within a sentence."""
        low, high = np.rad2deg([self.low, self.high])
        return "" if self.anywhere else f" of centers from {low:g} to {high:g} deg declination"

    def distance(self, vectors: np.ndarray) -> np.ndarray:
        """Return the distances (radians) of directions from the limits; 0 for directions inside the limits."""
        lat = to_lonlat(vectors)[1]
        return np.maximum(np.maximum(self.low - lat, lat - self.high), 0.0)

    def move_inside(self, vectors: np.ndarray) -> np.ndarray:
        """Move directions outside the limits along their meridian to the nearest limit; shape (..., 3)."""
        if self.anywhere:
            return vectors
        lon, lat = to_lonlat(vectors)
        inside = np.clip(lat, self.low, self.high)
        return np.where((inside != lat)[..., None], from_lonlat(lon, inside), vectors)

    def fit(self, vectors: np.ndarray, radius: float) -> np.ndarray:
        """Return the directions that are inside the limits, or outside by less than a radius.

        Directions outside the limits are moved onto the limits.
        """
        return vectors if self.anywhere else self.move_inside(vectors[self.distance(vectors) < radius])


def given_tiles(where: Centers) -> Tiling:
    """Return the tiles of the list, with the position angle of ``where`` if there is one."""
    if where.position_angle is None:
        return where.tiling
    table = where.tiling.table.copy()
    table["position_angle"] = where.angle_deg * u.deg
    return Tiling(table)


def _distinct(ra_deg, dec_deg):
    """Return the first row of each distinct direction."""
    return np.sort(np.unique(place_of(ra_deg, dec_deg), axis=0, return_index=True)[1])


def _two(limits):
    """Return the lower and the upper limit in radians."""
    try:
        low, high = limits
    except INCONVERTIBLE:
        text = "declination must be two angles, the lower and the upper limit"
        raise refusal(text, limits, list, tuple, u.Quantity) from None
    low, high = (float(to_unit(angle, u.deg, "declination")) for angle in (low, high))
    if not -90 <= low <= high <= 90:
        raise InputError(
            f"declination must be a lower and an upper limit from -90 to 90 deg, got {low:g} and {high:g} deg"
        )
    return np.deg2rad(low), np.deg2rad(high)
