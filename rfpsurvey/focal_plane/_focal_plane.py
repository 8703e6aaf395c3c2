"""All positioners of an instrument as columns: where they are, who is near whom, who reaches what."""

from dataclasses import dataclass
from functools import cached_property

import astropy.units as u
import numpy as np
from astropy.table import QTable, Table
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from rfpsurvey._kernels import arms
from rfpsurvey._units import to_mm, to_points_mm, to_radian
from rfpsurvey.focal_plane import _tables
from rfpsurvey.focal_plane._checks import check_columns
from rfpsurvey.focal_plane._columns import Columns
from rfpsurvey.focal_plane._coverage import find_coverage, footprint_of
from rfpsurvey.focal_plane._lattice import hexagonal_cells
from rfpsurvey.focal_plane._reach import Reach, accepted_types, find_reach, make_grid, sides
from rfpsurvey.positioner import Positioner

__all__ = ["FocalPlane"]


@dataclass(frozen=True, eq=False)
class FocalPlane:
    """The positioners of an instrument, a row each, and the fixed obstacles between them.

    Parameters
    ----------
    xy : Quantity, shape (n, 2)
        Centers of the positioners.
    positioner : Positioner
        Geometry common to all.
    id : array_like of int or str, shape (n,), optional
        Names, text without blanks; the row number by default.
    spectrograph : array_like of int, shape (n,) or (n, n_types), optional
        Spectrograph of each fiber, one column for each fiber type where they differ; 0 by default.
    fiber_type : array_like of str, shape (n,), optional
        Types of fiber that a positioner carries, joined by ``+``, such as ``"BOSS+APOGEE"``.
    central_arm, eccentric_arm : Quantity, shape (n,), optional
        Arm lengths of each unit, where they differ from the common ones.
    disabled : array_like of bool, shape (n,), optional
        Units that take no target and stand at home.
    stuck : Quantity, shape (n, 2), optional
        theta and phi of units that cannot move; NaN for those that can.
    obstacles : Quantity, shape (m, 3), optional
        Circles (x, y, radius) that no arm may touch, such as fiducials.

    Raises
    ------
    InputError
        If a column has another length than ``xy``, a name occurs twice or has blanks, or two positioners share a
        center.

    Examples
    --------
    >>> import astropy.units as u
    >>> import rfpsurvey as rs
    >>> robot = rs.Positioner(8.25 * u.mm, 8.25 * u.mm, 2.25 * u.mm)
    >>> plane = rs.FocalPlane.hexagonal(robot, rings=2, pitch=25.6 * u.mm)
    >>> len(plane), len(plane.neighbor_pairs()), plane.collision_type
    (19, 42, 2)
    """

    xy: u.Quantity
    positioner: Positioner
    id: np.ndarray | None = None
    spectrograph: np.ndarray | None = None
    fiber_type: np.ndarray | None = None
    central_arm: u.Quantity | None = None
    eccentric_arm: u.Quantity | None = None
    disabled: np.ndarray | None = None
    stuck: u.Quantity | None = None
    obstacles: u.Quantity | None = None

    def __post_init__(self):
        check_columns(self)

    def __len__(self):
        return len(self.id)

    def __repr__(self):
        return f"<FocalPlane of {len(self)} positioners, {len(self._obstacles_mm)} obstacles>"

    @cached_property
    def fiber_types(self) -> tuple[str, ...]:
        """Names of the fiber types, in the order in which they first occur."""
        return tuple(dict.fromkeys(t for row in dict.fromkeys(self.fiber_type) for t in row.split("+")))

    @cached_property
    def _first_type(self):
        """The fiber that each positioner uses where nothing says which."""
        return np.array([row.split("+")[0] for row in self.fiber_type])

    @cached_property
    def _first_index(self):
        """The same as an index of ``fiber_types``."""
        return np.array([self.fiber_types.index(name) for name in self._first_type.tolist()])

    @property
    def collision_type(self) -> int:
        """1: no two arms can touch; 2: only those of first neighbors; 3: further ones too."""
        pairs = self.neighbor_pairs()
        if len(pairs) == 0:
            return 1
        distance = np.hypot(*(self._xy_mm[pairs[:, 0]] - self._xy_mm[pairs[:, 1]]).T)
        nearest = cKDTree(self._xy_mm).query(self._xy_mm, k=2)[0][:, 1]
        return 3 if distance.max() > 1.5 * np.median(nearest) else 2

    @cached_property
    def _xy_mm(self):
        return to_points_mm(self.xy, "xy")

    @cached_property
    def _l1_mm(self):
        full = np.full(len(self), self.positioner._l1)
        return full if self.central_arm is None else to_mm(self.central_arm, "central_arm")

    @cached_property
    def _l2_mm(self):
        full = np.full(len(self), self.positioner._l2)
        return full if self.eccentric_arm is None else to_mm(self.eccentric_arm, "eccentric_arm")

    @cached_property
    def _equal_arms(self):
        return np.abs(self._l1_mm - self._l2_mm) < arms.EQUAL_ARMS

    @cached_property
    def _inner_mm(self):
        return np.where(self._equal_arms, 0.0, np.abs(self._l1_mm - self._l2_mm))

    @cached_property
    def _outer_mm(self):
        return self._l1_mm + self._l2_mm

    @cached_property
    def _arm_reach_mm(self):
        """Distance from the center that the colliding segment can reach."""
        length = self.positioner._arm_length_mm
        return self._l1_mm + (self._l2_mm if length is None else length)

    @cached_property
    def _stuck_rad(self):
        return np.full((len(self), 2), np.nan) if self.stuck is None else to_radian(self.stuck, "stuck")

    @cached_property
    def _is_stuck(self):
        return np.isfinite(self._stuck_rad).all(axis=1)

    @cached_property
    def _usable(self):
        """Positioners that may take a target."""
        return ~self.disabled & ~self._is_stuck

    @cached_property
    def _obstacles_mm(self):
        return np.empty((0, 3)) if self.obstacles is None else to_mm(self.obstacles, "obstacles")

    @cached_property
    def _offers(self):
        """Bit mask of the fiber types of each positioner; none for those that take no target."""
        masks = dict.fromkeys(np.unique(self.fiber_type).tolist(), 0)
        for row in masks:
            for name in row.split("+"):
                masks[row] |= 1 << self.fiber_types.index(name)
        return np.where(self._usable, [masks[row] for row in self.fiber_type], 0)

    @cached_property
    def _grid(self):
        return make_grid(self._xy_mm, self._outer_mm)

    @cached_property
    def _neighbors(self):
        """Pairs to test; those that only rounding could let collide are among them."""
        slack = self._columns.touch_slack
        limit = 2 * self._arm_reach_mm.max() + self.positioner._separation_mm + slack
        pairs = cKDTree(self._xy_mm).query_pairs(limit, output_type="ndarray")
        pairs = np.sort(pairs[self._can_touch(pairs, slack)], axis=1).astype(np.int64)
        return np.ascontiguousarray(pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))])

    def _can_touch(self, pairs, slack=0.0):
        """Mark pairs whose arms, stretched toward each other, come closer than the safe distance (plus ``slack``)."""
        distance = np.hypot(*(self._xy_mm[pairs[:, 0]] - self._xy_mm[pairs[:, 1]]).T)
        return distance < self._arm_reach_mm[pairs].sum(axis=1) + self.positioner._separation_mm + slack

    @cached_property
    def _n_sharing(self):
        """How many others can share a target with each positioner, at most."""
        reach = self._outer_mm * (1 + 1e-6)
        near = cKDTree(self._xy_mm).query_ball_point(self._xy_mm, reach + reach.max(), return_length=True)
        return np.asarray(near, dtype=np.int64) - 1

    @cached_property
    def _obstacle_pairs(self):
        """Pairs (positioner, obstacle) that can touch."""
        circles = self._obstacles_mm
        if len(circles) == 0:
            return np.empty((0, 2), dtype=np.int64)
        apart = np.hypot(*(self._xy_mm[:, None, :] - circles[None, :, :2]).transpose(2, 0, 1))
        limit = self._arm_reach_mm[:, None] + circles[None, :, 2] + self.positioner._clearance_mm
        return np.argwhere(apart < limit + self._columns.touch_slack)

    @cached_property
    def _columns(self):
        """What the collision kernels read."""
        return Columns(self)

    def neighbor_pairs(self) -> np.ndarray:
        """Return the pairs of positioners whose arms can come closer than the safe distance.

        Returns
        -------
        ndarray of int, shape (k, 2)
            Row numbers i < j, sorted.
        """
        return self._neighbors[self._can_touch(self._neighbors)]

    def reachable(self, xy: u.Quantity, fiber_type: np.ndarray | None = None) -> csr_array:
        """Return which positioner reaches which target.

        A target on the edge of a patrol area is in reach: patrol areas are closed, and ties are settled in
        exact arithmetic.

        Parameters
        ----------
        xy : Quantity, shape (n_targets, 2)
            Targets on the focal plane; NaN is out of reach.
        fiber_type : array_like of str, shape (n_targets,), optional
            Fiber type that each target needs; ``""`` means any.

        Returns
        -------
        scipy.sparse.csr_array of bool, shape (n_positioners, n_targets)
            Its ``indptr`` and ``indices`` list the targets of each positioner, ascending.

        Raises
        ------
        InputError
            If the targets are not lengths of this shape, or there are fiber types and these are others.
        """
        return self._reach(to_points_mm(xy, "xy"), fiber_type).matrix

    def multiplicity(self, xy: u.Quantity) -> np.ndarray:
        """Return how many positioners reach each point.

        Units that are disabled or stuck reach nothing.

        Parameters
        ----------
        xy : Quantity, shape (n, 2)
            Points on the focal plane; NaN is out of reach.

        Returns
        -------
        ndarray of int, shape (n,)
            Number of positioners.

        Raises
        ------
        InputError
            If the points are not lengths of this shape.
        """
        return np.diff(self._reach(to_points_mm(xy, "xy")).indptr)

    @property
    def footprint(self) -> u.Quantity:
        """Area of the convex hull of the centers."""
        return footprint_of(self).volume * u.mm**2

    def coverage(self, *, n_points: int = 2**20, rng: int | np.random.Generator | None = 0) -> np.ndarray:
        """Return the parts of the footprint that no positioner, one, two and more reach.

        Parameters
        ----------
        n_points : int, optional
            Points to look at in the rectangle around the footprint: a random one in each cell of a square grid.
            With 2**20 of them the standard error is below 0.0005.
        rng : int or Generator, optional
            Seed of the points.

        Returns
        -------
        ndarray of float, shape (k,)
            Part within reach of exactly 0, 1, ..., k - 1 positioners; the sum is 1.

        Raises
        ------
        InputError
            If there are fewer than three centers, or all lie on a line.

        Examples
        --------
        >>> import rfpsurvey as rs
        >>> plane = rs.Instrument.preset("lamost").focal_plane
        >>> plane.coverage().round(2)
        array([0.  , 0.55, 0.4 , 0.05])
        """
        return find_coverage(self, n_points, rng)

    def _reach(self, points: np.ndarray, fiber_type=None) -> Reach:
        """Reachable pairs of targets in mm."""
        return find_reach(self, points, accepted_types(self, fiber_type, len(points)))

    def _sides(self, points: np.ndarray, own: np.ndarray | None = None) -> np.ndarray:
        """Elbow of each positioner (or those in the rows ``own``) toward its own point in mm: +1 right, -1 left."""
        return sides(self, points, own)

    @classmethod
    def hexagonal(
        cls,
        positioner: Positioner,
        *,
        pitch: u.Quantity,
        rings: int | None = None,
        count: int | None = None,
        radius: u.Quantity | None = None,
        inner_radius: u.Quantity = 0 * u.mm,
        vacant: list[tuple[int, int]] = (),
        rows_along: str = "x",
        **columns,
    ) -> "FocalPlane":
        """Lay positioners out on a hexagonal lattice about the origin.

        Cell (q, k) has its center at pitch (q + k / 2, sqrt(3) k / 2), with x and y exchanged for
        ``rows_along="y"``. Cells are ordered by k, then q.

        Parameters
        ----------
        positioner : Positioner
            Geometry common to all.
        pitch : Quantity
            Distance of neighboring centers.
        rings : int, optional
            Rings around the central cell: 3 rings (rings + 1) + 1 cells.
        count : int, optional
            Number of cells, those nearest the origin (ties by angle from +x, counter-clockwise).
        radius : Quantity, optional
            Keep centers at most this far from the origin.
        inner_radius : Quantity, optional
            Keep centers at least this far from the origin.
        vacant : list of tuple of int, optional
            Cells (q, k) without a positioner.
        rows_along : {"x", "y"}, optional
            Direction of the closest-packed rows.
        **columns
            Further columns of the `FocalPlane`.

        Returns
        -------
        FocalPlane
            The focal plane.

        Raises
        ------
        InputError
            If none or several of ``rings``, ``count`` and ``radius`` alone leave the size open or impossible.
        """
        xy, _ = hexagonal_cells(
            pitch,
            rings=rings,
            count=count,
            radius=radius,
            inner_radius=inner_radius,
            vacant=vacant,
            rows_along=rows_along,
        )
        return cls(xy * u.mm, positioner, **columns)

    @classmethod
    def from_table(cls, table: Table, positioner: Positioner | None = None) -> "FocalPlane":
        """Make a focal plane from an instrument team's own table.

        Parameters
        ----------
        table : Table or QTable
            A row for each positioner, columns ``x`` and ``y`` (with units) and, where wanted, ``id``,
            ``spectrograph``, ``fiber_type``, ``central_arm``, ``eccentric_arm``, ``disabled``, ``stuck_theta`` and
            ``stuck_phi`` (pose of a stuck unit, NaN for others). Rows with a finite ``obstacle_radius`` are fixed
            circles, not positioners.
        positioner : Positioner, optional
            Geometry common to all. Without it ``table.meta["positioner"]`` must hold the arguments of a `Positioner`,
            quantities as text such as ``{"central_arm": "8.25 mm", ...}``.

        Returns
        -------
        FocalPlane
            The focal plane.

        Raises
        ------
        InputError
            If a column is missing or has no unit.
        """
        return cls(**_tables.read_columns(table, positioner))

    def to_table(self) -> QTable:
        """Return the columns as a table that `from_table` reads back.

        Returns
        -------
        QTable
            A row for each positioner, then one for each obstacle.
        """
        return _tables.to_table(self)
