"""The segments that represent arms in tests for collisions."""

from functools import cached_property

import numpy as np

from rfpsurvey._kernels import arms
from rfpsurvey._units import locked


class ArmSegments:
    """Methods that `FocalPlaneArrays` inherits, which compute the segments of arms."""

    def idle_segments(self, parked_obstacles: bool) -> np.ndarray:
        """Return the segments of the arms of `idle` that represent them in tests for collisions, shape (4, n)."""
        return self.plane.arrays._idle_segments[bool(parked_obstacles)]

    @cached_property
    def _idle_segments(self) -> dict[bool, np.ndarray]:
        found = {key: one.segments.copy() for key, one in self._idle.items()}
        for segments in found.values():
            arms.shape(segments, self.model, self.length, *self.angles)
        return {key: locked(segments) for key, segments in found.items()}

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
