"""The geometry of a positioner as numbers without units."""

from functools import cached_property
from typing import TYPE_CHECKING

import astropy.units as u
import numpy as np

from rfpsurvey._common.units import locked, to_mm, to_radian
from rfpsurvey.errors import InputError, listed

if TYPE_CHECKING:
    from rfpsurvey._instruments.positioner import Positioner


class PositionerNumbers:
    """The geometry of a positioner as numbers without units, in mm and radians.

    Parameters
    ----------
    positioner : Positioner
        The positioner.

    Attributes
    ----------
    central_arm, eccentric_arm : float
        Lengths of the arms in mm.
    clearance : float
        Width in mm of the margin around each arm.
    separation : float
        Distance in mm below which two arms collide.
    arm_length : float or None
        Length in mm of the segment (arm model ``capsule``) or of the `~rfpsurvey.positioner.ArmOutline` (arm model
        ``outline``); None for the other arm models.
    home : ndarray of float, shape (2,)
        theta and phi of a parked positioner, in radians.
    joints_free : bool
        Whether the fiber can reach the whole patrol area within the joint limits, with the handedness of the positioner
        (``right`` if the handedness is ``both``).

    Examples
    --------
    >>> import astropy.units as u
    >>> import rfpsurvey as rs
    >>> numbers = rs.Positioner(0.825 * u.cm, 8.25 * u.mm, 2.25 * u.mm).numbers
    >>> numbers.central_arm, numbers.separation, numbers.home
    (8.25, 4.5, array([0.        , 3.14159265]))
    """

    def __init__(self, positioner: "Positioner"):
        self.positioner = positioner
        self._arm_angles: dict[tuple[str, ...], np.ndarray] = {}
        self.central_arm = float(to_mm(positioner.central_arm, "central_arm"))
        self.eccentric_arm = float(to_mm(positioner.eccentric_arm, "eccentric_arm"))
        self.clearance = float(to_mm(positioner.clearance, "clearance"))
        length = positioner.arm_length if positioner.outline is None else positioner.outline.length
        self.arm_length = None if length is None else float(to_mm(length, "arm_length"))
        if positioner.displacement is None:
            moved = (self.central_arm + self.eccentric_arm) * np.sin(2 * float(to_radian(positioner.step, "step")))
        else:
            moved = float(to_mm(positioner.displacement, "displacement"))
        self.separation = float(moved + 2 * self.clearance)

    @cached_property
    def limits(self) -> np.ndarray:
        """Lower and upper joint limits of theta and of phi in radians, shape (2, 2); infinite without a limit."""
        ranges = self.positioner.theta_range, self.positioner.phi_range
        return np.array([(-np.inf, np.inf) if pair is None else to_radian(pair, "joint limits") for pair in ranges])

    @cached_property
    def home(self) -> np.ndarray:
        if self.positioner.home is not None:
            return locked(to_radian(self.positioner.home, "home"))
        home = np.array([0.0, np.pi])
        for k, ends in enumerate(self.limits):
            if not within_limits(home[k], *ends):
                home[k] = ends[np.argmin(np.abs(np.mod(ends - home[k] + np.pi, 2 * np.pi) - np.pi))]
        return locked(home)

    def joints_allowed(self, theta: np.ndarray, phi: np.ndarray) -> np.ndarray:
        """Return whether joint angles are within the joint limits."""
        return within_limits(theta, *self.limits[0]) & within_limits(phi, *self.limits[1])

    @cached_property
    def joints_free(self) -> bool:
        return self.joints_free_for(-1.0 if self.positioner.handedness == "left" else 1.0)

    def joints_free_for(self, side: float) -> bool:
        """Return whether the fiber can reach the whole patrol area with a handedness (+1: right, -1: left)."""
        return self._free[int(side < 0)]

    @cached_property
    def _free(self) -> tuple[bool, bool]:
        """Whether the fiber can reach the whole patrol area with right and with left handedness."""
        theta, phi = self.positioner.theta_range, self.positioner.phi_range
        if theta is not None and not theta[1] - theta[0] >= 360 * u.deg:
            return False, False
        ends = (0 * u.deg, 180 * u.deg), (-180 * u.deg, 0 * u.deg)
        return tuple(phi is None or bool(phi[0] <= low and phi[1] >= high) for low, high in ends)

    def arm_angles(self, fiber_types: tuple[str, ...]) -> np.ndarray:
        """Return, for each fiber type, the angle (radians) from the direction of the fiber to the eccentric arm's axis.

        The direction of the fiber is the direction from the elbow to the fiber. Positive angles are counter-clockwise.
        """
        if fiber_types not in self._arm_angles:
            given = self.positioner.arm_angle
            if not isinstance(given, dict):
                given = dict.fromkeys(fiber_types, 0 * u.deg if given is None else given)
            known, unknown = [name for name in fiber_types if name], [name for name in given if name not in fiber_types]
            if unknown and not known:
                raise InputError(
                    f"arm_angle must be one angle, because the positioners of the focal plane have no fiber types, got "
                    f"angles for {listed(given)}; give the column fiber_type of the focal plane, or one angle"
                )
            if unknown:
                raise InputError(
                    f"arm_angle must have the fiber types of the focal plane, {listed(known)}, got {listed(unknown)}; "
                    "correct the names in arm_angle or in the column fiber_type"
                )
            angles = [float(to_radian(given.get(name, 0 * u.deg), "arm_angle")) for name in fiber_types]
            self._arm_angles[fiber_types] = locked(np.array(angles))
        return self._arm_angles[fiber_types]


def within_limits(angle: np.ndarray, low: np.ndarray | float, high: np.ndarray | float) -> np.ndarray:
    """Return whether angles are in the interval [low, high], modulo 360 deg."""
    free = np.isinf(low) | (high - low >= 2 * np.pi)
    if np.all(free):
        return ~np.isnan(angle)
    with np.errstate(invalid="ignore"):
        return np.where(free, ~np.isnan(angle), np.mod(angle - low + 1e-12, 2 * np.pi) <= high - low + 2e-12)
