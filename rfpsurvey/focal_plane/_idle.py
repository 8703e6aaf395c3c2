"""Poses of arms without a target."""

from dataclasses import dataclass

import numpy as np

from rfpsurvey._kernels import arms


@dataclass(frozen=True, eq=False)
class Idle:
    """Poses of arms without a target; NaN for arms that avoid all other arms and thus are not obstacles."""

    theta: np.ndarray
    phi: np.ndarray
    segments: np.ndarray
    """Positions of elbows and fiber tips in mm, shape (4, n): x and y of the elbow, x and y of the tip."""
    parked: np.ndarray
    """Whether each positioner is usable and parked, and is thus an obstacle."""

    def at_angles(self, columns, angles: np.ndarray, *, obstacles: bool) -> "Idle":
        """Return these poses, replaced by joint angles in radians, shape (2, n), where these are not NaN.

        If ``obstacles`` is False, the angles of usable positioners are ignored, because their arms are not obstacles.
        """
        known = np.isfinite(angles).all(axis=0) & (~columns.usable | obstacles)
        posed = np.empty_like(self.segments)
        arms.pose(*(np.ascontiguousarray(v) for v in columns.from_joints(*angles)), columns.geometry, posed)
        own = self.theta, self.phi, self.segments
        values = [np.where(known, *pair) for pair in zip((*angles, posed), own, strict=True)]
        return Idle(*values, np.where(known, columns.usable, self.parked))


NEARLY_EQUAL = 0.05
"""If the nominal arm lengths are equal, idle positioners whose measured arm lengths differ by at most this fraction of
their sum are parked."""


def find_idle(columns) -> dict[bool, Idle]:
    """Return the poses of idle arms, in a dict with the keys True (parked arms are obstacles) and False."""
    n, stuck = len(columns.plane), columns.is_stuck
    home = columns.home.copy()
    home[:, stuck] = columns.stuck[stuck].T
    theta, phi = (np.ascontiguousarray(v) for v in columns.from_joints(*home))
    segments = np.empty((4, n))
    arms.pose(theta, phi, columns.geometry, segments)
    l1, l2 = columns.central_arm, columns.eccentric_arm
    nearly = columns.plane.positioner.equal_arms & (np.abs(l1 - l2) <= NEARLY_EQUAL * (l1 + l2))
    folded = ~stuck & columns.equal_arms & (np.abs(phi - np.pi) < 1e-12)
    segments[2:, folded] = columns.xy[folded].T  # in floating-point numbers, sin(pi) is not 0
    states = {}
    for parked_obstacles in (False, True):
        parked = columns.usable & (columns.equal_arms | nearly) & parked_obstacles
        gone = columns.usable & ~parked
        values = [np.where(gone, np.nan, v) for v in (*home, segments)]
        states[parked_obstacles] = Idle(*values, parked)
    return states
