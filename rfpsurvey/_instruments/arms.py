"""Compute the poses of the arms of all positioners."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial

import astropy.units as u
import numpy as np

from rfpsurvey._common.units import to_plain, to_points_mm, to_radian
from rfpsurvey._instruments.focal_plane import FocalPlane
from rfpsurvey._instruments.joints import to_sides
from rfpsurvey._kernels import arms, collisions
from rfpsurvey.errors import InputError, InputTypeError, check_fiber_type, check_switch


@dataclass(frozen=True, eq=False)
class Arms:
    """The poses of the arms of all positioners, in mm and radians; NaN for arms that are absent.

    An arm is absent if its positioner can move, has no target, and is not a parked obstacle. `place_arms` returns
    objects of this class.

    Parameters
    ----------
    find_angles : callable or None
        Function that returns the joint angles theta and phi, shape (2, n); it is called when they are used first.
    elbow, tip : ndarray of float, shape (n, 2)
        Positions of the elbows and of the fibers.
    segments : ndarray of float, shape (n, 4)
        Segments of the arms that can collide, as rows (x0, y0, x1, y1).
    assigned : ndarray of bool, shape (n,)
        Whether each positioner has a target.
    parked : ndarray of bool, shape (n,)
        Whether each positioner is an obstacle: usable, without target, parked or in a known pose.
    clipped : ndarray of bool, shape (n,)
        Whether the target of each positioner is out of reach, by distance or joint limits.
    fiber : ndarray of int, shape (n,), optional
        Index of the fiber type in use; None if all fibers are at one place.
    recorded : ndarray of bool, shape (n,), optional
        Whether each positioner is idle in a known pose (``idle_angles``).

    Examples
    --------
    >>> import astropy.units as u
    >>> import rfpsurvey as rs
    >>> robot = rs.Positioner(8.25 * u.mm, 8.25 * u.mm, 2.25 * u.mm)
    >>> plane = rs.FocalPlane([[0, 0], [25.6, 0]] * u.mm, robot)
    >>> arms = rs.collision.place_arms(plane, [[12, 0], [14, 0]] * u.mm)
    >>> len(rs.find_collisions(plane, arms).pairs)
    1
    """

    find_angles: Callable[[], np.ndarray] | None
    elbow: np.ndarray
    tip: np.ndarray
    segments: np.ndarray
    assigned: np.ndarray
    parked: np.ndarray
    clipped: np.ndarray
    fiber: np.ndarray | None = None
    recorded: np.ndarray | None = None

    @cached_property
    def _angles(self) -> np.ndarray:
        return self.find_angles()

    @property
    def theta(self) -> np.ndarray:
        """Joint angles theta of all positioners, in radians."""
        return self._angles[0]

    @property
    def phi(self) -> np.ndarray:
        """Joint angles phi of all positioners, in radians."""
        return self._angles[1]

    def __getstate__(self):
        return {**self.__dict__, "_angles": self._angles, "find_angles": None}

    @property
    def present(self) -> np.ndarray:
        """Whether the arm of each positioner is present (not NaN)."""
        return np.isfinite(self.segments[:, 0])


def place_arms(
    focal_plane: FocalPlane,
    tips: u.Quantity | None = None,
    *,
    theta: u.Quantity | None = None,
    phi: u.Quantity | None = None,
    handedness: str | np.ndarray | None = None,
    fiber_type: np.ndarray | None = None,
    parked_obstacles: bool = True,
    clip: bool = False,
    idle_angles: np.ndarray | None = None,
) -> Arms:
    """Return the poses of all positioners, which `~rfpsurvey.find_collisions` accepts instead of positions of fibers.

    Parameters
    ----------
    focal_plane : FocalPlane
        The positioners.
    tips : Quantity, shape (n, 2), optional
        Position of the fiber of each positioner; NaN for positioners without a target.
    theta, phi : Quantity, shape (n,), optional
        Joint angles, instead of ``tips``; NaN for positioners without a target.
    handedness : {"right", "left"} or array_like of str, shape (n,), optional
        Handedness of each arm, only with ``tips``; by default, the focal plane determines it.
    fiber_type : array_like of str, shape (n,), optional
        Type of the fiber on each target; by default, the first fiber type of each positioner.
    parked_obstacles : bool, optional
        Whether positioners without a target are obstacles if their arms have equal lengths.
    clip : bool, optional
        Whether an arm whose tip is out of reach is stretched toward the tip as far as possible.
    idle_angles : ndarray of float, shape (2, n), optional
        Joint angles, in radians, of positioners without a target; NaN if the pose is not known.

    Returns
    -------
    Arms
        The poses.

    Raises
    ------
    InputError
        If neither ``tips`` nor both angles are given, if an array has a wrong shape, or if a tip is out of reach and
        ``clip`` is false.

    Examples
    --------
    >>> import astropy.units as u
    >>> import rfpsurvey as rs
    >>> robot = rs.Positioner(8.25 * u.mm, 8.25 * u.mm, 2.25 * u.mm)
    >>> plane = rs.FocalPlane([[0, 0], [25.6, 0]] * u.mm, robot)
    >>> arms = rs.collision.place_arms(plane, theta=[0, 90] * u.deg, phi=[0, 90] * u.deg)
    >>> arms.tip
    array([[16.5 ,  0.  ],
           [17.35,  8.25]])
    """
    check_plane(focal_plane)
    n, columns = len(focal_plane), to_columns(focal_plane, fiber_type)
    idle = columns.idle(check_switch(parked_obstacles, "parked_obstacles"))
    if idle_angles is not None:
        idle = idle.at_angles(focal_plane.arrays, idle_angles, obstacles=parked_obstacles)
    if (theta is None) != (phi is None) or (tips is None) == (theta is None):
        raise InputError("either tips, or both theta and phi, must be given")
    if tips is None:
        if handedness is not None:
            raise InputError("handedness can be given only with tips; theta and phi already determine the elbow")
        given = np.array([_column(to_radian(v, name), name, n) for v, name in ((theta, "theta"), (phi, "phi"))])
        angles, segments = given.copy, np.empty((4, n))
        arms.pose(*columns.from_joints(*given), columns.geometry, segments)
        assigned = np.isfinite(segments[2]) & focal_plane.arrays.usable
        arms.fill_idle(assigned, idle.segments, segments)
        clipped = np.zeros(n, dtype=bool)
    else:
        points = to_tips(tips, n)
        side = to_sides(columns, points, handedness)
        segments, assigned, clipped = pose_tips(columns, points, side, idle, clip=clip)
        angles = partial(_solve, columns, points.copy(), side)
    find_angles = partial(_with_idle, angles, assigned, idle)
    elbow, tip = segments[:2].T.copy(), segments[2:].T.copy()
    arms.shape(segments, columns.model, columns.length, *capsule_angles(columns, assigned))
    fiber = None if columns.fibers is None else np.where(assigned, columns.fiber_index, columns.first_index)
    recorded = None if idle_angles is None else ~assigned & (idle.theta == idle_angles[0])
    return Arms(find_angles, elbow, tip, segments.T, assigned, idle.parked & ~assigned, clipped, fiber, recorded)


def _solve(columns, points, side):
    """Return the joint angles theta and phi of arms with tips at ``points``, shape (2, n)."""
    angles = np.empty((2, len(points)))
    arms.solve(points, columns.geometry, side, *angles)
    return np.array(columns.to_joints(*angles))


def _with_idle(find_angles, assigned, idle):
    """Return the joint angles of all positioners; positioners without a target have the angles of idle arms."""
    angles = find_angles()
    for angle, idle_angle in zip(angles, (idle.theta, idle.phi), strict=True):
        np.copyto(angle, idle_angle, where=~assigned)
    return angles


def pose_tips(columns, points, side, idle, *, clip=False):
    """Return elbows and tips, shape (4, n), whether each arm has a target, and whether this target is out of reach."""
    assigned, clipped = check_tips(columns, points, side, clip=clip)
    segments = place_tips(columns, points, side, clipped)
    arms.fill_idle(assigned, idle.segments, segments)
    return segments, assigned, clipped


def check_plane(focal_plane):
    """Raise an error unless the argument is a FocalPlane."""
    if not isinstance(focal_plane, FocalPlane):
        hint = "; use the attribute focal_plane of the Instrument" if hasattr(focal_plane, "focal_plane") else ""
        raise InputTypeError(f"focal_plane must be a FocalPlane, got {type(focal_plane).__name__}{hint}")


def check_arms(plane, posed):
    """Raise an error unless the arms belong to the positioners of this focal plane."""
    if len(posed.segments) != len(plane):
        raise InputError(
            f"the arms must belong to the {len(plane)} positioners of the focal plane, got the arms of "
            f"{len(posed.segments)} positioners"
        )
    away = np.hypot(*(posed.elbow - plane.arrays.xy).T) > plane.arrays.central_arm * (1 + 1e-9) + arms.EQUAL_ARMS
    if away.any():
        raise InputError(
            f"the arms belong to another focal plane: {int(away.sum())} elbows are farther from the center of "
            "the positioner than the length of the central arm"
        )


def to_tips(tips, n):
    """Return the tips of an allocation, or tips with units, in mm, one row for each positioner."""
    points = tips.tips_mm if hasattr(tips, "tips_mm") else to_points_mm(tips, "tips")
    if len(points) != n:
        raise InputError(f"tips must have a row for each of the {n} positioners, got {len(points)}")
    return points


def check_tips(columns, points, side, *, clip=False):
    """Return whether each positioner has a target, and whether this target is out of reach.

    Unless ``clip`` is true, the function raises an error if a target is out of reach or requires a pose beyond the
    joint limits.
    """
    plane, n = columns.plane, len(columns.plane)
    assigned, far = np.empty(n, dtype=bool), np.empty(n, dtype=bool)
    bounds = columns.bounds if columns.joints is None else columns.bounds_of(None, None, side)
    if arms.check(points, columns.geometry, bounds, assigned, far) and not clip:
        k = int(np.flatnonzero(far)[0])
        raise InputError(
            f"{int(far.sum())} tips are out of reach; the first is the tip of positioner {plane.id[k]}: its "
            f"distance from the center of the positioner must be {columns.inner_radius[k]:.4f} to "
            f"{columns.outer_radius[k]:.4f} mm, got {np.hypot(*(points[k] - columns.xy[k])):.7g} mm"
        )
    if not joints_free(columns, side):
        barred = assigned & ~far & ~columns.joints_allow(np.arange(n), points, side)
        if barred.any() and not clip:
            first = plane.id[np.flatnonzero(barred)[0]]
            raise InputError(
                f"{int(barred.sum())} tips are beyond the joint limits; the first is the tip of positioner {first}"
            )
        far |= barred
    return assigned, far & assigned


def joints_free(columns, side):
    """Return whether the joint limits allow all positions in the patrol areas, for the given sides of the elbows."""
    if columns.joints_free_for(1.0) and columns.joints_free_for(-1.0):
        return True
    return all(columns.joints_free_for(s) for s in {side.min(), side.max()})


def place_tips(columns, points, side, clipped):
    """Return elbows and tips for given points, shape (4, n); arms are stretched toward points that are out of reach."""
    geometry = columns.geometry
    bounds = columns.bounds if columns.joints is None else columns.bounds_of(None, None, side)
    segments = np.empty((4, len(points)))
    arms.place(points, geometry, side, segments)
    if clipped.any():
        angles, posed = np.empty((2, len(points))), np.empty_like(segments)
        arms.solve(points, geometry, side, *angles)
        arms.pose(*angles, geometry, posed)
        # poses that violate only the joint limits still reach their points
        r2 = ((points - columns.xy) ** 2).sum(axis=1)
        far = clipped & ((r2 < bounds.low) | (r2 > bounds.high))
        segments[2:, far] = posed[2:, far]
    return segments


def to_columns(plane, fiber_type):
    """Return the arrays of a focal plane for the fiber types in use; by default, the first type of each positioner."""
    if fiber_type is None:
        return plane.arrays
    types = _column(to_plain(fiber_type, "fiber_type").astype(str), "fiber_type", len(plane))
    given = types[types != ""]
    if len(given) == 0:
        return plane.arrays
    for name in np.unique(given):
        check_fiber_type(str(name), plane.fiber_types)
    return plane.arrays.using(plane.arrays.index_of(types))


def capsule_angles(columns, assigned):
    """Return the cosine and sine of the angle at each elbow, from the direction of the fiber to that of the capsule.

    For positioners without a target, the fiber is the first fiber of the positioner.
    """
    first = columns.plane.arrays
    if columns is first:
        return first.angles
    return tuple(np.where(assigned, *pair) for pair in zip(columns.angles, first.angles, strict=True))


def nearest_distance(plane: FocalPlane, posed: Arms) -> np.ndarray:
    """Return the distance (mm) from each arm to the nearest other arm.

    The distance is NaN for absent arms, and infinite if there is no other arm. If arms have an outline, only neighbors
    whose arms can touch are considered.
    """
    segments = np.ascontiguousarray(posed.segments.T)
    if plane.positioner.outline is not None:
        return _nearest_outline(plane, segments, posed.present)
    halves, out = np.empty_like(segments), np.empty(len(posed.segments))
    collisions.halve(segments, halves)
    present = np.flatnonzero(posed.present)
    collisions.nearest_arm(segments, halves, *_cells(halves[:2, present], present), out)
    return out


def _cells(points, rows):
    """Sort points into a grid that has about as many cells as there are points.

    Return the corner (x0, y0) of the grid, the size of a cell, the numbers of cells nx and ny along the axes, the index
    of the first point of each cell in the sorted list, and the rows of the points, sorted by cell.
    """
    low = points.min(axis=1, initial=np.inf) if len(rows) else np.zeros(2)
    wide, high = np.ptp(points, axis=1) if len(rows) else np.ones(2)
    # the second length limits the number of cells of points on a line, and the third that of equal points
    size = max(np.sqrt(wide * high / max(len(rows), 1)), max(wide, high) / (len(rows) + 1), 1e-6)
    nx, ny = int(wide / size) + 1, int(high / size) + 1
    column, row = np.minimum(((points - low[:, None]) / size).astype(int), [[nx - 1], [ny - 1]])
    cell = row * nx + column
    start = np.concatenate([[0], np.cumsum(np.bincount(cell, minlength=nx * ny))])
    return float(low[0]), float(low[1]), float(size), nx, ny, start, rows[np.argsort(cell, kind="stable")]


def _nearest_outline(plane, segments, present):
    """Return the distance (mm) from each outline to the nearest outline of a neighbor that can touch it."""
    pairs, limits = plane.arrays.neighbors, plane.arrays.limits
    pairs = pairs[present[pairs].all(axis=1)]
    gaps = np.empty(len(pairs))
    collisions.outline_gaps(segments, pairs, limits, gaps)
    out = np.where(present, np.inf, np.nan)
    for column in pairs.T:
        np.minimum.at(out, column, gaps)
    return out


def _column(values, name, n):
    if values.shape != (n,):
        raise InputError(f"{name} must have the shape ({n},), got {values.shape}")
    return values
