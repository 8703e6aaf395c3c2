"""The targets and poses that plans may use, and the poses of arms without a target.

Joint limits, margins, and circles in which fibers receive no light limit the targets and poses.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from rfpsurvey._common.units import locked
from rfpsurvey._instruments.joints import edges_exactly
from rfpsurvey._instruments.reach import make_grid, pairs_within
from rfpsurvey._kernels import arms, collisions, conflicts
from rfpsurvey._kernels import arms as reach


@dataclass(frozen=True, eq=False)
class Idle:
    """Poses of arms without a target; NaN for arms that avoid all other arms and thus are not obstacles."""

    theta: np.ndarray
    phi: np.ndarray
    segments: np.ndarray  # x and y of the elbow, x and y of the fiber tip in mm, shape (4, n)
    parked: np.ndarray  # whether each positioner is usable and parked, and is thus an obstacle

    def at_angles(self, columns, angles: np.ndarray, *, obstacles: bool) -> "Idle":
        """Return these poses, replaced by joint angles in radians, shape (2, n), where these are not NaN.

        If ``obstacles`` is False, the angles of usable positioners are ignored, because their arms are not obstacles.
        """
        known = np.isfinite(angles).all(axis=0) & (~columns.usable | obstacles)
        posed = np.empty_like(self.segments)
        arms.pose(*(np.ascontiguousarray(v) for v in columns.from_joints(*angles)), columns.geometry, posed)
        parked = self.theta, self.phi, self.segments
        values = [np.where(known, *pair) for pair in zip((*angles, posed), parked, strict=True)]
        return Idle(*values, np.where(known, columns.usable, self.parked))


NEARLY_EQUAL = 0.05
"""If the nominal arm lengths are equal, idle positioners whose measured arm lengths differ by at most this fraction of
their sum are parked."""


class ArmSegments:
    """Methods that `FocalPlaneArrays` inherits, which compute the poses of idle arms and the segments of arms."""

    @cached_property
    def _idle(self) -> dict[bool, Idle]:
        """Poses of idle arms, in a dict with the keys True (parked arms are obstacles) and False."""
        n, stuck = len(self.plane), self.is_stuck
        home = self.home.copy()
        home[:, stuck] = self.stuck[stuck].T
        theta, phi = (np.ascontiguousarray(v) for v in self.from_joints(*home))
        segments = np.empty((4, n))
        arms.pose(theta, phi, self.geometry, segments)
        l1, l2 = self.central_arm, self.eccentric_arm
        nearly = self.plane.positioner.equal_arms & (np.abs(l1 - l2) <= NEARLY_EQUAL * (l1 + l2))
        folded = ~stuck & self.equal_arms & (np.abs(phi - np.pi) < 1e-12)
        segments[2:, folded] = self.xy[folded].T  # in floating-point numbers, sin(pi) is not 0
        states = {}
        for parked_obstacles in (False, True):
            parked = self.usable & (self.equal_arms | nearly) & parked_obstacles
            gone = self.usable & ~parked
            values = [np.where(gone, np.nan, v) for v in (*home, segments)]
            states[parked_obstacles] = Idle(*values, parked)
        return states

    def idle(self, parked_obstacles: bool) -> Idle:
        """Return the poses of arms that cannot move and, if ``parked_obstacles`` is true, of parked arms."""
        return self.plane.arrays._idle[bool(parked_obstacles)]

    def idle_segments(self, parked_obstacles: bool) -> np.ndarray:
        """Return the segments of the arms of `idle` that represent them in tests for collisions, shape (4, n)."""
        return self.plane.arrays._idle_segments[bool(parked_obstacles)]

    @cached_property
    def _idle_segments(self) -> dict[bool, np.ndarray]:
        copies = {key: idle.segments.copy() for key, idle in self._idle.items()}
        for segments in copies.values():
            arms.shape(segments, self.model, self.length, *self.angles)
        return {key: locked(segments) for key, segments in copies.items()}

    def segments_of(
        self, own: np.ndarray, fiber: np.ndarray | None, points: np.ndarray, side: np.ndarray | None = None
    ) -> np.ndarray:
        """Return the segments that represent arms in tests for collisions, shape (4, k).

        For each of k arms, ``own`` is the row of the positioner, ``fiber`` is the index of the fiber type in use (None:
        the fiber type that each positioner uses by default), ``points`` is the position of this fiber, and ``side`` is
        the handedness (+1 is right, -1 is left), by default that of `sides`.
        """
        side = self.sides(points, own, fiber) if side is None else side
        angles = (angle[own] for angle in self.angles) if fiber is None else self.angles_of(own, fiber)
        segments = np.empty((4, len(own)))
        arms.place(points, self.geometry_of(own, fiber), side, segments)
        arms.shape(segments, self.model, self.length, *angles)
        return segments


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
