"""What the collision kernels read of a focal plane: columns and limits, made once."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from rfpsurvey._kernels import arms, collisions

__all__ = ["Columns"]


@dataclass(frozen=True, eq=False)
class Idle:
    """Arms without a target: NaN where there is none, because it gives way."""

    theta: np.ndarray
    phi: np.ndarray
    segments: np.ndarray
    """Elbow and tip, shape (4, n)."""
    parked: np.ndarray
    """Usable positioners that then stand at home, in the way."""


class Columns:
    """Columns of a focal plane for the kernels; ``plane`` is a `FocalPlane`."""

    def __init__(self, plane):
        self.plane = plane
        self.separation = plane.positioner._separation_mm
        self.clearance = plane.positioner._clearance_mm
        length = plane.positioner._arm_length_mm
        self.model = {"elbow_to_tip": arms.ELBOW_TO_TIP, "capsule": arms.CAPSULE, "fiber_tip": arms.FIBER_TIP}[
            plane.positioner.arm_model
        ]
        self.length = 0.0 if length is None else length

    @cached_property
    def geometry(self) -> arms.Geometry:
        """What poses depend on."""
        plane = self.plane
        cx, cy = plane._xy_mm.T.copy()
        home = plane.positioner._home_rad[0]
        return arms.Geometry(cx, cy, plane._l1_mm, plane._l2_mm, float(np.cos(home)), float(np.sin(home)))

    def geometry_of(self, own: np.ndarray) -> arms.Geometry:
        """Return the same for any list of positioners."""
        return arms.Geometry(*(c[own] if isinstance(c, np.ndarray) else c for c in self.geometry))

    @cached_property
    def bounds(self) -> arms.Bounds:
        """Which tips are taken."""
        low = np.maximum(self.plane._inner_mm - self.reach_slack, 0.0) ** 2
        return arms.Bounds(low, (self.plane._outer_mm + self.reach_slack) ** 2, self.plane._usable)

    def bounds_of(self, own: np.ndarray) -> arms.Bounds:
        """Return the same for any list of positioners."""
        return arms.Bounds(*(c[own] for c in self.bounds))

    @cached_property
    def reach_slack(self) -> float:
        """What rounding may do to the distance of a tip from its center."""
        return 1e-12 * float(self.plane._outer_mm.max() + np.abs(self.plane._xy_mm).max())

    @cached_property
    def touch_slack(self) -> float:
        """What rounding, and arms that count as equal, may do to the gap of two arms stretched toward each other."""
        return 4 * (self.reach_slack + arms.EQUAL_ARMS)

    @cached_property
    def limits(self) -> collisions.Limits:
        """Safe distance and the slack for rounding."""
        extent = np.hypot(*self.plane._xy_mm.T) + self.plane._arm_reach_mm
        return collisions.limits(
            self.separation, self.longest, float(extent.max()) + self.reach_slack + arms.EQUAL_ARMS
        )

    @cached_property
    def longest(self) -> float:
        """No segment is longer."""
        length = {arms.ELBOW_TO_TIP: self.plane._l2_mm.max(), arms.CAPSULE: self.length, arms.FIBER_TIP: 0.0}[
            self.model
        ]
        # almost equal arms count as equal, which moves their elbow
        return (1.0 + 1e-12) * (float(length) + 2 * self.reach_slack + arms.EQUAL_ARMS)

    @cached_property
    def obstacle_slack(self) -> float:
        """What rounding may do to the distance of an arm from an obstacle that it just touches."""
        size = self.plane._obstacles_mm[:, 2].max(initial=0.0) + self.clearance + self.longest
        return 1.2 * collisions.DISTANCE_ERROR * float(size)

    @cached_property
    def runs(self) -> np.ndarray:
        """Neighbors as rows (i, j, n): i with j, i + 1 with j + 1, and so on, in the order of the first.

        On a lattice whose rows are numbered through, a few rows stand for thousands of pairs.
        """
        pairs = self.plane._neighbors
        if len(pairs) == 0:
            return np.empty((0, 3), dtype=np.int64)
        pairs = pairs[np.lexsort((pairs[:, 0], pairs[:, 1] - pairs[:, 0]))]
        first = np.append(True, (np.diff(pairs, axis=0) != 1).any(axis=1))
        rows = np.flatnonzero(first)
        runs = np.column_stack([pairs[rows], np.diff(np.append(rows, len(pairs)))])
        return runs[np.lexsort((runs[:, 1], runs[:, 0]))]

    @cached_property
    def both_ways(self) -> tuple[np.ndarray, np.ndarray]:
        """All neighbors of each positioner: where its row begins, and the neighbors, never empty."""
        pairs = self.plane._neighbors
        both = np.vstack([pairs, pairs[:, ::-1]])
        both = both[np.lexsort((both[:, 1], both[:, 0]))]
        return np.searchsorted(both[:, 0], np.arange(len(self.plane) + 1)), np.append(both[:, 1], 0)

    @cached_property
    def longest_run(self) -> int:
        """Length of the mask that the broad phase needs."""
        return int(self.runs[:, 2].max(initial=0))

    @cached_property
    def angles(self) -> tuple[np.ndarray, np.ndarray]:
        """Cosine and sine of the capsule's angle where every positioner uses its first fiber."""
        return self.angles_of(self.plane._first_type)

    def angles_of(self, fiber_type: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Cosine and sine of the capsule's angle for given fibers."""
        names = self.plane.fiber_types
        values = self.plane.positioner._arm_angle_rad(names)
        angle = np.empty(len(fiber_type))
        for name, value in zip(names, values, strict=True):
            angle[fiber_type == name] = value
        return np.cos(angle), np.sin(angle)

    @cached_property
    def _idle(self) -> dict[bool, Idle]:
        plane, n = self.plane, len(self.plane)
        stuck = plane._is_stuck
        home = np.repeat(plane.positioner._home_rad[:, None], n, axis=1)
        home[:, stuck] = plane._stuck_rad[stuck].T
        segments = np.empty((4, n))
        arms.pose(*home, self.geometry, segments)
        folded = ~stuck & plane._equal_arms & (plane.positioner._home_rad[1] == np.pi)
        segments[2:, folded] = plane._xy_mm[folded].T  # sin(pi) is not 0
        states = {}
        for parked_obstacles in (False, True):
            parked = plane._usable & plane._equal_arms & parked_obstacles
            gone = plane._usable & ~parked
            values = [np.where(gone, np.nan, v) for v in (*home, segments)]
            states[parked_obstacles] = Idle(*values, parked)
        return states

    def idle(self, parked_obstacles: bool) -> Idle:
        """Arms without a target: those that cannot move, and idle equal arms if they are obstacles."""
        return self._idle[bool(parked_obstacles)]
