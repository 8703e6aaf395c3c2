"""Focal planes: the positioners of an instrument, their neighbors, and the targets that they reach."""

from dataclasses import dataclass, fields
from functools import cached_property

import astropy.units as u
import numpy as np
import scipy  # its subpackages are imported on first use
from astropy.table import QTable, Table

from rfpsurvey._common.units import to_points_mm
from rfpsurvey._instruments import focal_plane_tables as _tables
from rfpsurvey._instruments import joints as _kinematics
from rfpsurvey._instruments.arrays import FocalPlaneArrays
from rfpsurvey._instruments.focal_plane_tables import check_columns
from rfpsurvey._instruments.margins import Margins
from rfpsurvey._instruments.modules import Modular, hexagonal_cells
from rfpsurvey._instruments.positioner import Positioner
from rfpsurvey._instruments.reach import find_coverage, footprint_of, nearest_within
from rfpsurvey.errors import check_keywords


@check_keywords
@dataclass(frozen=True, eq=False)
class FocalPlane(Modular):
    """The positioners of an instrument, one per row, and the fixed obstacles between them.

    Parameters
    ----------
    xy : Quantity, shape (n, 2)
        Centers of the positioners.
    positioner : Positioner
        Geometry common to all positioners.
    id : array_like of int or str, shape (n,), optional
        Unique identifiers: integers, or text without blanks. By default, the row numbers.
    spectrograph : array_like of int, shape (n,) or (n, n_types), optional
        Spectrograph that each positioner feeds; 0 by default. If fibers of different types feed different
        spectrographs, the array has one column for each fiber type.
    fiber_type : array_like of str, shape (n,), optional
        Fiber types of each positioner, joined by ``+``, such as ``"BOSS+APOGEE"``.
    central_arm, eccentric_arm : Quantity, shape (n,), optional
        Arm lengths of each positioner; by default, the arm lengths of ``positioner``.
    disabled : array_like of bool, shape (n,), optional
        Whether each positioner is disabled: a disabled positioner takes no target and is parked.
    stuck : Quantity, shape (n, 2), optional
        theta and phi of positioners that cannot move; NaN for all other positioners.
    obstacles : Quantity, shape (m, 3), optional
        Circles (x, y, radius) that no arm may touch, such as fiducials.
    fiber_xy : Quantity, shape (n, 2), or dict of str to Quantity, optional
        Position of each fiber on the eccentric arm, instead of ``eccentric_arm``; a dict has one entry for each fiber
        type. The origin is the elbow, +x points along the mechanical axis of the arm, and +y to its left. NaN stands
        for a fiber that a positioner lacks. Names that no positioner lists in ``fiber_type``, such as the names of
        metrology fibers, are allowed: these fibers take no targets, and `forward` computes their positions.
    zero_points : Quantity, shape (n, 2), optional
        Zero points of theta and phi, 0 by default. The zero point of theta is the direction of the central arm at
        theta = 0, counter-clockwise from +x. The zero point of phi is the angle from the central arm to the mechanical
        axis of the eccentric arm at phi = 0.
    theta_range, phi_range : Quantity, shape (n, 2), optional
        Lower and upper joint limits of each positioner; NaN where the limits of ``positioner`` apply.
    hidden : Quantity, shape (k, 3), optional
        Circles (x, y, radius) where fibers receive no light, such as the areas behind the black dots of PFS. Targets
        inside a circle are out of reach, but arms may enter it. Collision probabilities do not depend on the circles.
    obstacle_polygons : sequence of Quantity, shape (k, 2), optional
        Vertices of convex polygons that no arm may touch, such as guide cameras. `~rfpsurvey.positioner.divide_polygon`
        divides a polygon that is not convex into convex polygons.
    margins : Margins, optional
        Distances that plans keep from the edges of patrol areas and from broken positioners; by default, none.
    groups : dict of str to array_like of int, optional
        Further integers, one per positioner and name, such as the petal or the block on the slit. Requirements such as
        ``sky=5/petal`` count the fibers of each petal.

    Raises
    ------
    InputError
        If the length of a column differs from the length of ``xy``, if an identifier occurs twice or contains blanks,
        if two positioners have the same center, or if ``fiber_xy`` lacks the position of a fiber of a positioner.

    Notes
    -----
    If ``fiber_xy`` is given, phi is the angle of the mechanical axis of the eccentric arm, and ``arm_angle`` of the
    positioner is the angle between this axis and the colliding segment. Without ``fiber_xy``, the mechanical axis
    points to the fiber. A target that does not require a fiber type is observed with the first fiber type of a
    positioner.

    An idle positioner whose two arms have equal lengths is parked and is an obstacle. If the arms of ``positioner``
    have equal lengths, this also applies to a positioner whose own arm lengths differ by at most 5 % of their sum.

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
    fiber_xy: u.Quantity | dict[str, u.Quantity] | None = None
    zero_points: u.Quantity | None = None
    theta_range: u.Quantity | None = None
    phi_range: u.Quantity | None = None
    hidden: u.Quantity | None = None
    obstacle_polygons: tuple[u.Quantity, ...] | None = None
    margins: Margins | None = None
    groups: dict[str, np.ndarray] | None = None

    def __post_init__(self):
        check_columns(self)

    def __len__(self):
        return len(self.id)

    _repr_html_ = _tables.html_of

    def __repr__(self):
        n_obstacles = len(self.arrays.obstacles) + len(self.arrays.obstacle_polygons)
        return f"<FocalPlane of {len(self)} positioners, {n_obstacles} obstacles>"

    def __getstate__(self):
        # the attribute ``arrays`` is not copied to other processes; each process computes it again
        return {f.name: getattr(self, f.name) for f in fields(self)}

    @cached_property
    def fiber_types(self) -> tuple[str, ...]:
        """Names of the fiber types, in the order in which they first occur."""
        return tuple(dict.fromkeys(t for row in dict.fromkeys(self.fiber_type) for t in row.split("+")))

    @cached_property
    def arrays(self) -> FocalPlaneArrays:
        """The columns as read-only arrays without units, in mm and radians (``FocalPlaneArrays``)."""
        return FocalPlaneArrays(self)

    @cached_property
    def collision_type(self) -> int:
        """Collision type: 1 if no arms can touch, 2 if only arms of adjacent positioners can touch, 3 otherwise."""
        pairs = self.neighbor_pairs()
        if len(pairs) == 0:
            return 1
        distance = np.hypot(*(self.arrays.xy[pairs[:, 0]] - self.arrays.xy[pairs[:, 1]]).T)
        # Distances to the nearest center above 4/3 of ``distance.max()`` become infinite; the result is the same.
        nearest = nearest_within(self.arrays.xy, 4 / 3 * distance.max())
        return 3 if distance.max() > 1.5 * np.median(nearest) else 2

    def neighbor_pairs(self) -> np.ndarray:
        """Return the pairs of positioners whose arms can come closer than the minimum separation.

        Returns
        -------
        ndarray of int, shape (k, 2)
            Row numbers (i, j) of the positioners of each pair, with i < j; the pairs are sorted.
        """
        return self.arrays.neighbors[self.arrays.can_touch(self.arrays.neighbors)]

    def reachable(self, xy: u.Quantity, fiber_type: np.ndarray | None = None) -> "scipy.sparse.csr_array":
        """Return the pairs of positioners and targets within reach as a sparse matrix.

        A target on the edge of a patrol area is within reach. Exact arithmetic decides cases in which rounding errors
        could change the result.

        Parameters
        ----------
        xy : Quantity, shape (n_targets, 2)
            Positions of the targets on the focal plane; a target with a NaN is out of reach.
        fiber_type : array_like of str, shape (n_targets,), optional
            Fiber type that each target requires; ``""`` means any.

        Returns
        -------
        scipy.sparse.csr_array of bool, shape (n_positioners, n_targets)
            Sparse matrix; ``indptr`` and ``indices`` list the targets of each positioner in ascending order.

        Raises
        ------
        InputError
            If ``xy`` has no unit of length, if a shape is wrong, or if a required fiber type is unknown.
        """
        return self.arrays.reach(to_points_mm(xy, "xy"), fiber_type).matrix

    def forward(self, theta: u.Quantity, phi: u.Quantity, fiber_type: str | np.ndarray | None = None) -> u.Quantity:
        """Return the position of a fiber of each positioner for given joint angles.

        Parameters
        ----------
        theta, phi : Quantity, shape (n,)
            Joint angles; a NaN results in a NaN position.
        fiber_type : str or array_like of str, shape (n,), optional
            Fiber type, or another name in ``fiber_xy``; by default, the first fiber type of each positioner.

        Returns
        -------
        Quantity, shape (n, 2)
            Positions on the focal plane in mm; NaN where an angle is NaN or the positioner lacks the fiber.

        Raises
        ------
        InputError
            If the angles do not have the shape ``(n,)``, or if a name in ``fiber_type`` is unknown.

        Examples
        --------
        >>> import astropy.units as u
        >>> import rfpsurvey as rs
        >>> robot = rs.Positioner(7.4 * u.mm, 15 * u.mm, 2 * u.mm)
        >>> plane = rs.FocalPlane([[0, 0]] * u.mm, robot, fiber_xy=[[14.965, 0.376]] * u.mm)
        >>> xy = plane.forward([0] * u.deg, [90] * u.deg)
        >>> xy
        <Quantity [[ 7.024, 14.965]] mm>
        >>> plane.inverse(xy)[1]
        <Quantity [90.] deg>
        """
        return _kinematics.forward(self, theta, phi, fiber_type)

    def inverse(
        self, xy: u.Quantity, fiber_type: str | np.ndarray | None = None, handedness: str | np.ndarray | None = None
    ) -> tuple[u.Quantity, u.Quantity]:
        """Return the joint angles that place a fiber of each positioner at a point.

        Parameters
        ----------
        xy : Quantity, shape (n, 2)
            Points on the focal plane, one for each positioner.
        fiber_type : str or array_like of str, shape (n,), optional
            Fiber type, or another name in ``fiber_xy``; by default, the first fiber type of each positioner.
        handedness : {"right", "left"} or array_like of str, shape (n,), optional
            Handedness of each arm; by default, the handedness of the positioner.

        Returns
        -------
        theta : Quantity, shape (n,)
            Angles of the central arms in deg, from the lower joint limit (-180 deg if there is no limit) to 360 deg
            above it. An angle is NaN if the point is NaN, out of reach or beyond the joint limits, or if the positioner
            lacks the fiber.
        phi : Quantity, shape (n,)
            Angles of the eccentric arms in deg, in the corresponding range for phi; NaN where ``theta`` is NaN.

        Raises
        ------
        InputError
            If the points do not have the shape ``(n, 2)``, or if a name in ``fiber_type`` is unknown.
        """
        return _kinematics.inverse(self, xy, fiber_type, handedness)

    def multiplicity(self, xy: u.Quantity) -> np.ndarray:
        """Return the number of positioners that reach each point; broken positioners do not reach any point.

        Parameters
        ----------
        xy : Quantity, shape (n, 2)
            Points on the focal plane; no positioner reaches a point with a NaN.

        Returns
        -------
        ndarray of int, shape (n,)
            Number of positioners that reach each point.

        Raises
        ------
        InputError
            If ``xy`` does not have a unit of length or the shape ``(n, 2)``.
        """
        return np.diff(self.arrays.reach(to_points_mm(xy, "xy")).indptr)

    @property
    def footprint(self) -> u.Quantity:
        """Area of the convex hull of the centers of the positioners."""
        return footprint_of(self).volume * u.mm**2

    def coverage(self, *, n_points: int = 2**20, rng: int | np.random.Generator | None = 0) -> np.ndarray:
        """Return the fractions of the footprint that exactly 0, 1, 2, ... positioners reach.

        Parameters
        ----------
        n_points : int, optional
            Number of points in the rectangle around the footprint; one random point lies in each cell of a square grid.
            With 2**20 points, the standard error of each fraction is below 0.0005.
        rng : int or Generator, optional
            Seed or random number generator for the positions of the points.

        Returns
        -------
        ndarray of float, shape (k,)
            Fractions of the footprint that exactly 0, 1, ..., k - 1 positioners reach; the sum is 1.

        Raises
        ------
        InputError
            If there are fewer than three centers, or if all centers lie on a line.

        Examples
        --------
        >>> import rfpsurvey as rs
        >>> plane = rs.Instrument.preset("lamost").focal_plane
        >>> plane.coverage().round(2)
        array([0.  , 0.55, 0.4 , 0.05])
        """
        return find_coverage(self, n_points, rng)

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
        """Make a focal plane of positioners on a hexagonal lattice around the origin.

        The center of the cell (q, k) is x = pitch (q + k / 2), y = pitch sqrt(3) k / 2; ``rows_along="y"`` exchanges
        x and y. The positioners are sorted by k; positioners with the same k are sorted by q.

        Parameters
        ----------
        positioner : Positioner
            Geometry common to all positioners.
        pitch : Quantity
            Distance between neighboring centers.
        rings : int, optional
            Number of rings around the central cell. The lattice has 3 rings (rings + 1) + 1 cells.
        count : int, optional
            Number of cells; the cells nearest the origin are used. Cells at the same distance are used in the order of
            their angle from +x, counter-clockwise.
        radius : Quantity, optional
            Largest distance of a center from the origin; centers farther away are omitted.
        inner_radius : Quantity, optional
            Smallest distance of a center from the origin; nearer centers are omitted.
        vacant : list of tuple of int, optional
            Cells (q, k) without a positioner.
        rows_along : {"x", "y"}, optional
            Direction of the closest-packed rows.
        **columns
            Further arguments of `FocalPlane`, such as ``fiber_type``.

        Returns
        -------
        FocalPlane
            The focal plane.

        Raises
        ------
        InputError
            If both ``rings`` and ``count`` are given, if none of ``rings``, ``count`` and ``radius`` is given, or if a
            value is out of range.
        """
        size = {"rings": rings, "count": count, "radius": radius, "inner_radius": inner_radius}
        xy, _ = hexagonal_cells(pitch, **size, vacant=vacant, rows_along=rows_along)
        return cls(xy * u.mm, positioner, **columns)

    @classmethod
    def from_table(cls, table: Table, positioner: Positioner | None = None) -> "FocalPlane":
        """Make a focal plane from a table of positioners.

        Parameters
        ----------
        table : Table or QTable
            Table with a row for each positioner, columns ``x`` and ``y`` (with units) and, optionally, ``id``,
            ``spectrograph``, ``fiber_type``, ``central_arm``, ``eccentric_arm``, ``disabled``, ``stuck_theta`` and
            ``stuck_phi`` (pose of a stuck positioner; NaN for other positioners). Rows with a finite
            ``obstacle_radius`` are circular obstacles, not positioners. Other columns that contain an integer for each
            positioner become ``groups``.
        positioner : Positioner, optional
            Geometry common to all positioners. Without it, ``table.meta["positioner"]`` must contain the arguments of
            a `Positioner`, with quantities as text, such as ``{"central_arm": "8.25 mm", ...}``.

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
        """Return the columns as a table that `from_table` can read.

        Returns
        -------
        QTable
            Table with a row for each positioner, followed by a row for each circle in ``obstacles`` and ``hidden``.
        """
        return _tables.to_table(self)
