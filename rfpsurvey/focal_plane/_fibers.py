"""Positions of fibers relative to the elbow, and zero points and limits of joints, if positioners differ in these."""

from functools import cached_property

import numpy as np

from rfpsurvey._units import to_points_mm, to_radian

__all__ = ["Fibers", "Joints"]


class Fibers:
    """Lengths and directions from the elbow to each fiber.

    Attributes
    ----------
    names : tuple of str
        The fiber types of the focal plane, followed by the types of fibers that take no target.
    length : ndarray of float, shape (k, n)
        Distance from the elbow to the fiber of each type, mm. If a positioner lacks the fiber, the value is that of its
        first fiber type.
    angle : ndarray of float, shape (k, n)
        Angle from the mechanical axis of the eccentric arm to the direction of the fiber, in radians.
    missing : ndarray of bool, shape (k, n)
        Whether a positioner lacks the fiber.
    """

    def __init__(self, plane, first_index: np.ndarray):
        given = plane.fiber_xy
        self.names = plane.fiber_types + tuple(name for name in given if name not in plane.fiber_types)
        x, y = np.array([to_points_mm(given[name], "fiber_xy") for name in self.names]).transpose(2, 0, 1)
        rows = np.arange(len(plane))
        self.missing = ~(np.isfinite(x) & np.isfinite(y))
        x, y = (np.where(self.missing, values[first_index, rows], values) for values in (x, y))
        self.length, self.angle = np.hypot(x, y), np.arctan2(y, x)


class Joints:
    """Conversion between the angles of the kernels and the angles of the joints.

    The kernels measure theta from +x, and phi from the direction of the central arm to the direction of the fiber.

    Parameters
    ----------
    plane : FocalPlane
        The focal plane, which has ``zero_points``, ``fiber_xy``, or joint limits of single positioners.
    fibers : Fibers or None
        The positions of the fibers.
    """

    def __init__(self, plane, fibers: Fibers | None):
        n = len(plane)
        zeros = np.zeros((n, 2)) if plane.zero_points is None else to_radian(plane.zero_points, "zero_points")
        self.theta_zero, self.phi_zero = zeros.T.copy()
        self.angle = None if fibers is None else fibers.angle
        limits = []
        for name in ("theta_range", "phi_range"):
            common, own = getattr(plane.positioner, name), getattr(plane, name)
            pair = np.array([-np.inf, np.inf]) if common is None else to_radian(common, name)
            pair = np.repeat(pair[:, None], n, axis=1)
            if own is not None:
                given = to_radian(own, name).T
                pair = np.where(np.isfinite(given), given, pair)
            limits += list(pair)
        self.limits = np.array(limits)

    def zeros(self, own, fiber):
        """Return the offsets of theta and phi of the kernels from those of the joints, for positioners (by row)."""
        phi = self.phi_zero[own]
        return self.theta_zero[own], phi if self.angle is None else phi + self.angle[fiber, own]

    def home(self, home, fiber, *, folded: bool):
        """Return the angles of parked positioners, within the joint limits, or of folded arms if ``folded``."""
        own = np.arange(self.limits.shape[1])
        angles = np.repeat(np.asarray(home)[:, None], len(own), axis=1)
        if folded:
            angles[1] = np.pi - self.zeros(own, fiber)[1]
        for k, value in enumerate(angles):
            ends = self.limits[2 * k : 2 * k + 2]
            beyond = ~_within(value, *ends)
            away = np.abs(np.mod(ends[:, beyond] - value[beyond] + np.pi, 2 * np.pi) - np.pi)
            value[beyond] = np.where(away[0] <= away[1], *ends[:, beyond])
        return angles

    def from_kernel(self, theta, phi, own, fiber):
        """Return the joint angles of positioners (by row), each within 360 deg above its low limit or -180 deg."""
        found = []
        for value, zero, low in zip((theta, phi), self.zeros(own, fiber), self.limits[::2, own], strict=True):
            start = np.where(np.isfinite(low), low, -np.pi) - 1e-12
            found.append(start + np.mod(value - zero - start, 2 * np.pi))
        return found

    def allowed(self, theta, phi, own):
        """Return whether joint angles are within the limits of positioners (by row)."""
        low, high, phi_low, phi_high = self.limits[:, own]
        return _within(theta, low, high) & _within(phi, phi_low, phi_high)

    @cached_property
    def free(self) -> dict[float, np.ndarray]:
        """Whether the limits allow the whole patrol areas of each positioner, for the elbow 1 (right) and -1 (left)."""
        low, high, phi_low, phi_high = self.limits
        offset = self.phi_zero if self.angle is None else self.phi_zero + self.angle
        offset = offset.reshape(-1, len(low))
        turns = high - low >= 2 * np.pi
        return {
            side: turns & ((phi_low <= first - offset) & (phi_high >= last - offset)).all(axis=0)
            for side, first, last in ((1.0, 0.0, np.pi), (-1.0, -np.pi, 0.0))
        }


def _within(angle, low, high):
    """Return whether angles are in the interval [low, high], modulo 360 deg."""
    free = np.isinf(low) | (high - low >= 2 * np.pi)
    with np.errstate(invalid="ignore"):
        return np.where(free, ~np.isnan(angle), np.mod(angle - low + 1e-12, 2 * np.pi) <= high - low + 2e-12)
