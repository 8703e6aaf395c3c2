"""The targets and poses that plans may use: joint limits, margins, and circles in which fibers receive no light."""

from functools import cached_property

import numpy as np

from rfpsurvey._kernels import arms, collisions, conflicts, reach
from rfpsurvey._units import locked
from rfpsurvey.focal_plane._fibers import edges_exactly
from rfpsurvey.focal_plane._neighbors import pairs_within
from rfpsurvey.focal_plane._reach import make_grid

ROOM = 1 << 16


class Circles:
    """Circles in mm (columns x, y and radius), with a grid of cells that makes the search for circles fast."""

    def __init__(self, rows: np.ndarray):
        self.x, self.y, self.radius = rows.T.copy()
        self._grid = make_grid(rows[:, :2], self.radius) if len(rows) else None

    def contain(self, points: np.ndarray) -> np.ndarray:
        """Return whether each point (mm) is in one of the circles or on its edge; a NaN point is in no circle."""
        if self._grid is None:
            return np.zeros(len(points), dtype=bool)
        n, (x, y) = len(self.x), points.T.copy()
        any_type = np.broadcast_to(np.int64(-1), len(points)), np.broadcast_to(np.int64(-1), n)
        start, empty = np.empty(len(points) + 1, dtype=np.int64), np.empty(0)
        circles = reach.annuli(self.x, self.y, np.zeros(n), self.radius), any_type[1].copy()
        # without room for pairs, the kernel only counts them
        pairs = np.empty(0, dtype=np.int64), empty, np.empty(0, dtype=np.int8)
        reach.reachable_pairs(x, y, any_type[0].copy(), *circles, *self._grid, start, *pairs)
        return np.diff(start) > 0


class AllowedPoses:
    """Properties that `FocalPlaneArrays` inherits, which state the targets and poses that plans may use."""

    @cached_property
    def edges(self) -> tuple[np.ndarray, np.ndarray]:
        """Radii between which targets of each positioner may lie, mm: the patrol area, reduced by the margins."""
        margins = self.plane.margins
        if not (margins.outer > 0 or margins.inner > 0):
            return self.inner_radius, self.outer_radius
        # rational arithmetic takes long, but many positioners have the same lengths and radii
        kinds = np.column_stack([self.central_arm, self.eccentric_arm, self.inner_radius, self.outer_radius])
        _, rows, inverse = np.unique(kinds, axis=0, return_index=True, return_inverse=True)
        radii = np.array([[float(v) for v in edges_exactly(self, k)] for k in rows])[inverse.reshape(-1)]
        return tuple(locked(column.copy()) for column in radii.T)

    def is_hidden(self, points: np.ndarray) -> np.ndarray:
        """Return whether each point (mm) is in a circle without targets: ``hidden``, or around a broken positioner."""
        return self._circles.contain(points)

    @cached_property
    def _circles(self) -> Circles:
        margins, broken = self.plane.margins, np.flatnonzero(~self.usable)
        circles = self.hidden * (1.0, 1.0, margins.hidden_factor)
        if margins.broken_factor > 0 and len(broken):
            radius = margins.broken_factor * self.plane.arrays.outer_radius[broken]
            circles = np.vstack([circles, np.column_stack([self.xy[broken], radius])])
        return Circles(circles)

    @property
    def any_hidden(self) -> bool:
        """Whether there is at least one circle without targets."""
        return len(self._circles.x) > 0

    def joints_free_for(self, side: float) -> bool:
        """Return whether joint limits let all positioners reach their whole patrol areas with handedness ``side``."""
        numbers = self.plane.positioner.numbers
        return numbers.joints_free_for(side) if self.joints is None else bool(self.joints.free[side].all())

    @cached_property
    def joints_free(self) -> bool:
        """Whether joint limits let all positioners reach their whole patrol areas with the default handedness."""
        return self.joints_free_for(-1.0 if self.plane.positioner.handedness == "left" else 1.0)

    def joints_allow(
        self, own: np.ndarray, points: np.ndarray, side: np.ndarray | float, fiber: np.ndarray | None = None
    ) -> np.ndarray:
        """Return whether joint limits let each positioner in ``own`` reach its point (mm) with handedness ``side``."""
        side = np.broadcast_to(side, len(own)).astype(float)
        if self.joints is not None:
            allowed = np.isfinite(points).all(axis=1)
            free = np.where(side < 0, self.joints.free[-1.0][own], self.joints.free[1.0][own])
            rows = np.flatnonzero(allowed & ~free)
            own, points, side = own[rows], points[rows], side[rows]
            fiber = self.fiber_index[own] if fiber is None else fiber[rows]
        theta, phi = np.empty((2, len(own)))
        arms.solve(points, self.geometry_of(own, fiber), side, theta, phi)
        if self.joints is None:
            return self.plane.positioner.numbers.joints_allowed(theta, phi)
        allowed[rows] = self.joints.allowed(*self.to_joints(theta, phi, own, fiber), own)
        return allowed

    def sides(self, points: np.ndarray, own: np.ndarray | None = None, fiber: np.ndarray | None = None) -> np.ndarray:
        """Return the handedness with which each positioner in ``own`` reaches its point: +1 is right, -1 is left.

        If arms can bend to both sides, the result is right, unless joint limits and margins allow only left.
        """
        handedness = self.plane.positioner.handedness
        side = np.full(len(points), -1.0 if handedness == "left" else 1.0)
        if handedness == "both" and not self.poses_free:
            rows = np.flatnonzero(np.isfinite(points).all(axis=1))
            own = np.arange(len(self.plane)) if own is None else own
            fiber = None if fiber is None else fiber[rows]
            right, left = (self.poses_allowed(own[rows], points[rows], s, fiber) for s in (1.0, -1.0))
            side[rows[~right & left]] = -1.0
        return side

    @cached_property
    def poses_free(self) -> bool:
        """Whether plans may use all poses in the patrol area: no joint limit and no broken positioner forbids a pose.

        This refers to the default handedness.
        """
        return self.joints_free and len(self.plane.arrays.broken_pairs) == 0

    def poses_allowed(
        self, own: np.ndarray, points: np.ndarray, side: np.ndarray | float, fiber: np.ndarray | None = None
    ) -> np.ndarray:
        """Return whether a plan may use the pose of each positioner in ``own`` at its point (mm): see `joints_allow`.

        The arm must also keep the margin ``broken`` from the arms of broken positioners.
        """
        allowed = self.joints_allow(own, points, side, fiber)
        if len(self.plane.arrays.broken_pairs):
            allowed &= _clear_of_broken(self, own, points, side, fiber)
        return allowed

    @cached_property
    def broken_pairs(self) -> np.ndarray:
        """Pairs (usable, broken) of positioners whose arms can come closer than the margin ``broken`` allows."""
        extra = self.plane.margins.numbers["broken"]
        if extra == 0 or self.usable.all():
            return locked(np.empty((0, 2), dtype=np.int64))
        pairs = pairs_within(self.xy, 2 * self.arm_reach.max() + self.separation + extra + self.touch_slack)
        pairs = pairs[self.usable[pairs].sum(axis=1) == 1]
        return locked(np.where(self.usable[pairs[:, :1]], pairs, pairs[:, ::-1]))


def _clear_of_broken(columns, owner, points, side, fiber):
    """Return whether arms keep the margin from the arms of broken positioners; they do not if rounding is uncertain."""
    plane, pairs = columns.plane, columns.plane.arrays.broken_pairs
    clear = np.ones(len(owner), dtype=bool)
    near = np.zeros(len(plane), dtype=bool)
    near[pairs[:, 0]] = True
    rows = np.flatnonzero(near[owner] & np.isfinite(points).all(axis=1))
    broken = np.unique(pairs[:, 1])
    if len(rows) == 0:
        return clear
    mine, side = owner[rows], np.broadcast_to(side, len(owner)).astype(float)[rows]
    fiber = columns.fiber_index[mine] if fiber is None else fiber[rows]
    moved = columns.segments_of(mine, fiber, np.ascontiguousarray(points[rows]), side)
    fixed = columns.idle_segments(False)[:, broken]
    of_segment = np.concatenate([mine, broken])
    order = np.argsort(of_segment, kind="stable")
    segments, of_segment = np.ascontiguousarray(np.hstack([moved, fixed])[:, order]), of_segment[order]
    size = np.bincount(of_segment, minlength=len(plane))
    start = np.concatenate([[0], np.cumsum(size)])
    halves, limits = np.empty_like(segments), plane.arrays.limits_with(plane.margins.numbers["broken"])
    collisions.halve(segments, halves)
    room = max(ROOM, int(size.max()))
    first, second = np.empty(room, dtype=np.int64), np.empty(room, dtype=np.int64)
    borderline = np.empty(room, dtype=bool)
    p = 0
    while p < len(pairs):
        n, p = conflicts.list_conflicts(
            pairs, p, plane.arrays.geometry, start, segments, halves, limits, first, second, borderline
        )
        if limits.outline.start.size > 1:
            n = conflicts.keep_outlined(n, of_segment, segments, limits, first, second, borderline)
        # the moved arms precede the broken arms
        close = order[first[:n]]
        clear[rows[close[close < len(rows)]]] = False
    return clear
