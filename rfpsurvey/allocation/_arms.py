"""Compute the poses of the arms of positioners that have targets."""

import numpy as np

from rfpsurvey.allocation._problem import AllocationProblem


def place_segments(
    problem: AllocationProblem, own: np.ndarray, target: np.ndarray, side: np.ndarray, idle: np.ndarray | None = None
) -> np.ndarray:
    """Return the segments, shape (4, n), that represent the arms of positioners in tests for collisions.

    Each fiber is at its target. ``own``, ``target`` and ``side`` contain the row of the positioner, the row of the
    target, and the elbow (+1: right, -1: left) for each segment. ``idle`` contains the indices of the segments of idle
    arms, one for each positioner of the focal plane; the targets of these segments are ignored.
    """
    columns = problem.focal_plane.arrays
    # the row -1 of idle arms is clipped to 0
    points = problem.xy.take(target, axis=0, mode="clip") if len(problem.xy) else np.full((len(own), 2), np.nan)
    segments = columns.segments_of(own, problem.fiber_of(own, target), points, side)
    if idle is not None:
        segments[:, idle] = columns.idle_segments(problem.parked_obstacles)
    return segments
