"""A focal plane as plain numbers: read-only columns in mm and radians, and the input of the collision kernels."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from rfpsurvey._kernels import arms, collisions
from rfpsurvey._units import locked, to_mm, to_points_mm, to_radian
from rfpsurvey.focal_plane._reach import Reach, accepted_types, find_reach, make_grid, sides

__all__ = ["FocalPlaneArrays"]


@dataclass(frozen=True, eq=False)
class Idle:
    """Poses of arms without a target; NaN for arms that are no obstacles because they avoid all other arms."""

    theta: np.ndarray
    phi: np.ndarray
    segments: np.ndarray
    """Elbows and tips, shape (4, n)."""
    parked: np.ndarray
    """Whether each positioner is usable and parked as an obstacle."""


class FocalPlaneArrays:
    """The columns of a focal plane as read-only plain numbers in mm and radians.

    The columns are computed on first use and kept. Row i belongs to positioner i.

    Parameters
    ----------
    plane : FocalPlane
        The focal plane.

    Attributes
    ----------
    xy : ndarray of float, shape (n, 2)
        Centers of the positioners, mm.
    central_arm, eccentric_arm : ndarray of float, shape (n,)
        Arm lengths, mm.
    inner_radius, outer_radius : ndarray of float, shape (n,)
        Radii of the patrol areas, mm.
    equal_arms : ndarray of bool, shape (n,)
        Whether both arms have the same length.
    arm_reach : ndarray of float, shape (n,)
        Largest distance of the colliding segment from the center, mm.
    usable : ndarray of bool, shape (n,)
        Whether each positioner may have a target: it is neither disabled nor stuck.
    stuck : ndarray of float, shape (n, 2)
        theta and phi of stuck positioners, NaN for other positioners.
    is_stuck : ndarray of bool, shape (n,)
        Whether each positioner cannot move.
    obstacles : ndarray of float, shape (m, 3)
        Circles (x, y, radius) that no arm may touch, mm.
    first_type : ndarray of str, shape (n,)
        Fiber type that each positioner uses by default.
    first_index : ndarray of int, shape (n,)
        Index of ``first_type`` in ``fiber_types``.
    neighbors : ndarray of int, shape (k, 2)
        Pairs of positioners to test for collisions, including those that can collide only because of rounding.
    obstacle_pairs : ndarray of int, shape (k, 2)
        Pairs of rows (positioner, obstacle) that can touch.
    n_sharing : ndarray of int, shape (n,)
        Largest number of other positioners that can share a target with each positioner.
    separation, clearance, length : float
        Minimum separation of two arms, clearance of an arm, and length of the colliding segment (0 means the segment
        from the elbow to the fiber), mm.

    Examples
    --------
    >>> import rfpsurvey as rs
    >>> arrays = rs.Instrument.preset("lamost").focal_plane.arrays
    >>> arrays.xy.shape, float(arrays.outer_radius[0]), len(arrays.neighbors)
    ((4000, 2), 16.5, 11769)
    """

    def __init__(self, plane):
        self.plane = plane
        numbers = plane.positioner.numbers
        self.separation, self.clearance = numbers.separation, numbers.clearance
        self.model = {"elbow_to_tip": arms.ELBOW_TO_TIP, "capsule": arms.CAPSULE, "fiber_tip": arms.FIBER_TIP}[
            plane.positioner.arm_model
        ]
        self.length = 0.0 if numbers.arm_length is None else numbers.arm_length

    @cached_property
    def xy(self) -> np.ndarray:
        return locked(to_points_mm(self.plane.xy, "xy"))

    @cached_property
    def central_arm(self) -> np.ndarray:
        plane = self.plane
        full = np.full(len(plane), plane.positioner.numbers.central_arm)
        return locked(full if plane.central_arm is None else to_mm(plane.central_arm, "central_arm"))

    @cached_property
    def eccentric_arm(self) -> np.ndarray:
        plane = self.plane
        full = np.full(len(plane), plane.positioner.numbers.eccentric_arm)
        return locked(full if plane.eccentric_arm is None else to_mm(plane.eccentric_arm, "eccentric_arm"))

    @cached_property
    def equal_arms(self) -> np.ndarray:
        return locked(np.abs(self.central_arm - self.eccentric_arm) < arms.EQUAL_ARMS)

    @cached_property
    def inner_radius(self) -> np.ndarray:
        return locked(np.where(self.equal_arms, 0.0, np.abs(self.central_arm - self.eccentric_arm)))

    @cached_property
    def outer_radius(self) -> np.ndarray:
        return locked(self.central_arm + self.eccentric_arm)

    @cached_property
    def arm_reach(self) -> np.ndarray:
        length = self.plane.positioner.numbers.arm_length
        return locked(self.central_arm + (self.eccentric_arm if length is None else length))

    @cached_property
    def stuck(self) -> np.ndarray:
        plane = self.plane
        return locked(np.full((len(plane), 2), np.nan) if plane.stuck is None else to_radian(plane.stuck, "stuck"))

    @cached_property
    def is_stuck(self) -> np.ndarray:
        return locked(np.isfinite(self.stuck).all(axis=1))

    @cached_property
    def usable(self) -> np.ndarray:
        return locked(~self.plane.disabled & ~self.is_stuck)

    @cached_property
    def obstacles(self) -> np.ndarray:
        plane = self.plane
        return locked(np.empty((0, 3)) if plane.obstacles is None else to_mm(plane.obstacles, "obstacles"))

    @cached_property
    def first_type(self) -> np.ndarray:
        return locked(np.array([row.split("+")[0] for row in self.plane.fiber_type]))

    @cached_property
    def first_index(self) -> np.ndarray:
        return locked(np.array([self.plane.fiber_types.index(name) for name in self.first_type.tolist()]))

    @cached_property
    def offers(self) -> np.ndarray:
        """Bit mask of the fiber types of each positioner; 0 for positioners that take no target."""
        plane = self.plane
        masks = dict.fromkeys(np.unique(plane.fiber_type).tolist(), 0)
        for row in masks:
            for name in row.split("+"):
                masks[row] |= 1 << plane.fiber_types.index(name)
        return np.where(self.usable, [masks[row] for row in plane.fiber_type], 0)

    @cached_property
    def grid(self) -> tuple:
        """Square cells, with the positioners that reach into each cell."""
        return make_grid(self.xy, self.outer_radius)

    @cached_property
    def neighbors(self) -> np.ndarray:
        limit = 2 * self.arm_reach.max() + self.separation + self.touch_slack
        pairs = cKDTree(self.xy).query_pairs(limit, output_type="ndarray")
        pairs = np.sort(pairs[self.can_touch(pairs, self.touch_slack)], axis=1).astype(np.int64)
        return locked(np.ascontiguousarray(pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]))

    def can_touch(self, pairs: np.ndarray, slack: float = 0.0) -> np.ndarray:
        """Mark pairs whose arms, stretched toward each other, are closer than the minimum separation plus ``slack``."""
        distance = np.hypot(*(self.xy[pairs[:, 0]] - self.xy[pairs[:, 1]]).T)
        return distance < self.arm_reach[pairs].sum(axis=1) + self.separation + slack

    @cached_property
    def n_sharing(self) -> np.ndarray:
        reach = self.outer_radius * (1 + 1e-6)
        near = cKDTree(self.xy).query_ball_point(self.xy, reach + reach.max(), return_length=True)
        return locked(np.asarray(near, dtype=np.int64) - 1)

    @cached_property
    def obstacle_pairs(self) -> np.ndarray:
        circles = self.obstacles
        if len(circles) == 0:
            return locked(np.empty((0, 2), dtype=np.int64))
        apart = np.hypot(*(self.xy[:, None, :] - circles[None, :, :2]).transpose(2, 0, 1))
        limit = self.arm_reach[:, None] + circles[None, :, 2] + self.clearance
        return locked(np.ascontiguousarray(np.argwhere(apart < limit + self.touch_slack)))

    def reach(self, points: np.ndarray, fiber_type: np.ndarray | None = None) -> Reach:
        """Return the pairs of positioners and targets (mm) within reach."""
        return find_reach(self.plane, points, accepted_types(self.plane, fiber_type, len(points)))

    def sides(self, points: np.ndarray, own: np.ndarray | None = None) -> np.ndarray:
        """Return the elbow of each positioner (or of the rows ``own``) toward its point: +1 is right, -1 is left."""
        return sides(self.plane, points, own)

    @cached_property
    def geometry(self) -> arms.Geometry:
        """Geometry of the positioners, as the kernels that compute poses expect it."""
        plane = self.plane
        cx, cy = self.xy.T.copy()
        home = plane.positioner.numbers.home[0]
        lengths = self.central_arm.copy(), self.eccentric_arm.copy()
        return arms.Geometry(cx, cy, *lengths, float(np.cos(home)), float(np.sin(home)))

    def geometry_of(self, own: np.ndarray) -> arms.Geometry:
        """Return the same data for a list of positioners."""
        return arms.Geometry(*(c[own] if isinstance(c, np.ndarray) else c for c in self.geometry))

    @cached_property
    def bounds(self) -> arms.Bounds:
        """Limits of the tips that each positioner can reach."""
        low = np.maximum(self.inner_radius - self.reach_slack, 0.0) ** 2
        return arms.Bounds(low, (self.outer_radius + self.reach_slack) ** 2, self.usable.copy())

    def bounds_of(self, own: np.ndarray) -> arms.Bounds:
        """Return the same data for a list of positioners."""
        return arms.Bounds(*(c[own] for c in self.bounds))

    @cached_property
    def reach_slack(self) -> float:
        """Upper limit of the rounding error of the distance of a tip from its center."""
        return 1e-12 * float(self.outer_radius.max() + np.abs(self.xy).max())

    @cached_property
    def touch_slack(self) -> float:
        """Upper limit of the error of the gap between two arms stretched toward each other, even if almost equal."""
        return 4 * (self.reach_slack + arms.EQUAL_ARMS)

    @cached_property
    def limits(self) -> collisions.Limits:
        """Minimum separation and the allowance for rounding."""
        extent = np.hypot(*self.xy.T) + self.arm_reach
        return collisions.limits(
            self.separation, self.longest, float(extent.max()) + self.reach_slack + arms.EQUAL_ARMS
        )

    @cached_property
    def longest(self) -> float:
        """Upper limit of the length of a colliding segment."""
        length = {arms.ELBOW_TO_TIP: self.eccentric_arm.max(), arms.CAPSULE: self.length, arms.FIBER_TIP: 0.0}[
            self.model
        ]
        # almost equal arms are treated as equal, which displaces their elbow
        return (1.0 + 1e-12) * (float(length) + 2 * self.reach_slack + arms.EQUAL_ARMS)

    @cached_property
    def obstacle_slack(self) -> float:
        """Upper limit of the rounding error of the distance between an arm and an obstacle that it barely touches."""
        size = self.obstacles[:, 2].max(initial=0.0) + self.clearance + self.longest
        return 1.2 * collisions.DISTANCE_ERROR * float(size)

    @cached_property
    def runs(self) -> np.ndarray:
        """Neighbors as sorted rows (i, j, n), each of which stands for n pairs: i and j, i + 1 and j + 1, and so on.

        On a lattice that is numbered row by row, a few runs contain thousands of pairs.
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
        """All neighbors of each positioner: the start of each row, and the neighbors (an array that is never empty)."""
        pairs = self.neighbors
        both = np.vstack([pairs, pairs[:, ::-1]])
        both = both[np.lexsort((both[:, 1], both[:, 0]))]
        return np.searchsorted(both[:, 0], np.arange(len(self.plane) + 1)), np.append(both[:, 1], 0)

    @cached_property
    def angles(self) -> tuple[np.ndarray, np.ndarray]:
        """Cosine and sine of the capsule's angle if every positioner uses its first fiber type."""
        return self.angles_of(self.first_type)

    def angles_of(self, fiber_type: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return cosine and sine of the capsule's angle for given fiber types."""
        names = self.plane.fiber_types
        values = self.plane.positioner.numbers.arm_angles(names)
        angle = np.empty(len(fiber_type))
        for name, value in zip(names, values, strict=True):
            angle[fiber_type == name] = value
        return np.cos(angle), np.sin(angle)

    @cached_property
    def _idle(self) -> dict[bool, Idle]:
        plane, n = self.plane, len(self.plane)
        stuck = self.is_stuck
        home = np.repeat(plane.positioner.numbers.home[:, None], n, axis=1)
        home[:, stuck] = self.stuck[stuck].T
        segments = np.empty((4, n))
        arms.pose(*home, self.geometry, segments)
        folded = ~stuck & self.equal_arms & (plane.positioner.numbers.home[1] == np.pi)
        segments[2:, folded] = self.xy[folded].T  # sin(pi) is not 0
        states = {}
        for parked_obstacles in (False, True):
            parked = self.usable & self.equal_arms & parked_obstacles
            gone = self.usable & ~parked
            values = [np.where(gone, np.nan, v) for v in (*home, segments)]
            states[parked_obstacles] = Idle(*values, parked)
        return states

    def idle(self, parked_obstacles: bool) -> Idle:
        """Return the arms without a target: those that cannot move, and idle equal arms if these are obstacles."""
        return self._idle[bool(parked_obstacles)]
