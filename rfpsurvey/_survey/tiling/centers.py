"""Constraints on the centers of tiles, and the targets that a tile observes.

The constraints are a list of centers, and limits of declination. A tile has ideal fibers or the positioners of a focal
plane.
"""

from dataclasses import dataclass
from functools import cached_property

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord
from astropy.table import Table
from astropy.time import Time

from rfpsurvey._common.settings import Settings, option
from rfpsurvey._common.units import ByValue, from_lonlat, to_direction, to_lonlat, to_scalar, to_unit, to_vectors
from rfpsurvey._field.plan import plan_field
from rfpsurvey._field.targets import FieldBuilder
from rfpsurvey._instruments.instrument import Instrument
from rfpsurvey._sky.arrays import has_role
from rfpsurvey._sky.frames import is_table
from rfpsurvey._survey.tiling.columns import FieldsOfTiles
from rfpsurvey._survey.tiling.tiling import Tiling, as_tiling, place_of, to_ra_dec
from rfpsurvey.errors import INCONVERTIBLE, InputError, InputTypeError, check_keywords, refusal, short

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


@check_keywords
@dataclass(frozen=True, eq=False, repr=False)
class Fibers(Settings):
    """The largest number of targets that a tile observes, their minimum separation, and the effect of collisions.

    Parameters
    ----------
    number : int, optional
        Largest number of targets that a tile observes; by default the number of positioners that are neither disabled
        nor stuck.
    min_separation : Quantity, optional
        Minimum angular separation of the targets that a tile observes. This parameter applies only to ideal fibers,
        which reach any target of the field, and is not allowed with an allocator.
    lost_in_collision : bool, optional
        Whether a target counts as not observed if the arm at this target collides, as in `~rfpsurvey.plan_survey`. This
        parameter applies only if an allocator plans the tiles.

    Raises
    ------
    InputError
        If ``number`` is not a positive whole number, or if ``min_separation`` is not an angle.

    Examples
    --------
    >>> import astropy.units as u
    >>> import rfpsurvey as rs
    >>> rs.tiling.Fibers(640, min_separation=55 * u.arcsec).number
    640
    """

    number: int | None = option(None, low=1, what="fibers")
    min_separation: u.Quantity[u.rad] | None = option(None, above=0, below=np.pi)
    lost_in_collision: bool = option(True)

    @property
    def ideal(self) -> bool:
        """Whether each fiber reaches every target of the field; true if ``number`` or ``min_separation`` is given."""
        return self.number is not None or self.min_separation is not None


class FreeFibers:
    """Ideal fibers that reach any target of the field, with a minimum separation of their targets.

    Targets receive fibers in the order of priority. Targets of equal priority are sorted by the number of later tiles
    that cover them (fewest first), then by the number of other targets that are too close to them (fewest first), and
    then by their order in the catalog.

    Parameters
    ----------
    fibers : int
        Largest number of targets.
    priority : ndarray or None
        Priority of each target, in the order of the spatial index.
    neighbors : tuple of ndarray or None
        Pairs of targets that are too close to each other, as `neighbors_within` returns them.
    """

    def __init__(self, fibers: int, priority: np.ndarray | None, neighbors: tuple | None):
        self.fibers, self.priority, self.neighbors = fibers, priority, neighbors
        self.means = "an upper limit: each fiber reaches any target of its field, and no arms collide"

    def __call__(self, center, near, state):
        """Return the targets that a tile observes; ``near`` lists the targets in its field that require a visit."""
        if self.neighbors is None and len(near) <= self.fibers:
            return near
        keys = [np.arange(len(near))]
        if self.neighbors is not None:
            indptr, neighbor = self.neighbors
            first, size = indptr[near], indptr[near + 1] - indptr[near]
            # the neighbors of all targets, one target after the other, without a loop
            of_pair = np.repeat(np.arange(len(near)), size)
            too_close = neighbor[np.repeat(first - np.cumsum(size) + size, size) + np.arange(len(of_pair))]
            degree = np.bincount(of_pair[np.isin(too_close, near)], minlength=len(near))
            keys.append(degree)
        if state.chances is not None:
            keys.append(state.chances[near])
        if self.priority is not None:
            keys.append(-self.priority[near])
        order = np.lexsort(keys)  # the last key is the first criterion
        if self.neighbors is not None:
            taken, blocked = degree == 0, set()
            for k in order[degree[order] > 0].tolist():
                if near[k] not in blocked:
                    taken[k] = True
                    blocked.update(neighbor[first[k] : first[k] + size[k]].tolist())
            order = order[taken[order]]
        return near[np.sort(order[: self.fibers])]


@dataclass(eq=False)
class FocalPlaneFibers(FieldsOfTiles):
    """The positioners of an instrument with an allocator; tiles are planned as in a survey."""

    instrument: Instrument
    builder: FieldBuilder
    fibers: Fibers
    tiling: Tiling | float
    """The tiles, in their order; or the position angle (degrees) of tiles that are not yet placed."""
    seed: int
    reference: Time | None

    def __post_init__(self):
        self.source = self.builder.source
        if not isinstance(self.tiling, Tiling):
            self.places, self.conditions, self.reference = None, None, None
        lost = "is not observed" if self.fibers.lost_in_collision else "counts as observed"
        self.means = f"the allocator {self.builder.options.name} plans each tile; a target whose arm collides {lost}"

    def __call__(self, center, near, state):
        """Return the targets that a tile observes; ``near`` lists the targets in its field that require a visit."""
        number = len(state.rows)
        place = [*np.concatenate(to_ra_dec(center[None])), self.tiling] if self.places is None else self.places[number]
        conditions, builder = None if self.conditions is None else self.conditions[number], self.builder
        plane = self.instrument.field_projection(*np.deg2rad(place), conditions)
        years = 0.0 if self.years is None else float(self.years[number])
        left = state.left if builder.reusable is None else np.where(builder.reusable, 1.0, state.left)
        slot, _, targets = builder.field(center, self.radius_rad, left, years=years, margin_rad=self.margin_rad)
        rng = np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(number,)))
        plan = plan_field(self.instrument, plane, targets, builder.options, rng, builder.blank)
        counts = (plan.target >= 0) & has_role(plan.kind, "science")
        if self.fibers.lost_in_collision:
            counts &= ~plan.report.in_collision[plan.positioner]
        served = np.sort(plan.target[counts])
        if self.fibers.number is not None and len(served) > self.fibers.number:
            priority, is_required = targets.columns.priority, targets.columns.is_required
            keys = [np.zeros(len(slot)) if priority is None else -priority]
            keys += [] if is_required is None else [~is_required]
            order = served[np.lexsort([key[served] for key in keys])]
            served = np.sort(order[: self.fibers.number])
        return slot[served]


def neighbors_within(vectors: np.ndarray, separation_rad: float) -> tuple[np.ndarray, np.ndarray]:
    """Return, for each direction, the other directions that are closer than ``separation_rad``.

    The two arrays of the result are ``indptr`` and ``indices`` of a matrix in compressed rows.
    """
    from scipy.spatial import cKDTree

    chord = 2 * np.sin(min(separation_rad, np.pi) / 2)
    pairs = cKDTree(vectors).query_pairs(chord, output_type="ndarray")
    distance = np.linalg.norm(vectors[pairs[:, 0]] - vectors[pairs[:, 1]], axis=1)
    pairs = pairs[distance < chord]  # the tree also returns pairs exactly at this distance
    ordered = np.concatenate([pairs, pairs[:, ::-1]])
    ordered = ordered[np.lexsort((ordered[:, 1], ordered[:, 0]))]
    indptr = np.searchsorted(ordered[:, 0], np.arange(len(vectors) + 1))
    return indptr, ordered[:, 1]
