"""Poses of arms without a target, and the segments that represent arms in tests for collisions."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from rfpsurvey._kernels import arms
from rfpsurvey._units import locked


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
