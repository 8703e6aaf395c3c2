"""Positioners as numbers without units: joint limits, and conversions of joint angles to positions of fibers."""

from collections.abc import Callable
from fractions import Fraction
from functools import cached_property, partial
from typing import TYPE_CHECKING

import astropy.units as u
import numpy as np

from rfpsurvey._common.units import locked, to_mm, to_plain, to_points_mm, to_radian
from rfpsurvey._kernels import arms
from rfpsurvey._kernels.arms import EQUAL_ARMS
from rfpsurvey.errors import InputError, check_choice, check_fiber_type, listed

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


MODELS = {
    "elbow_to_tip": arms.ELBOW_TO_TIP,
    "capsule": arms.CAPSULE,
    "fiber_tip": arms.FIBER_TIP,
    "outline": arms.CAPSULE,  # the core of an outline is a segment along the eccentric arm
}
"""Number by which the kernels identify each arm model."""


def forward(plane, theta, phi, fiber_type) -> u.Quantity:
    """Return the position of a fiber of each positioner; see `FocalPlane.forward`."""
    n, columns = len(plane), plane.arrays
    angles = [to_radian(value, name) for value, name in ((theta, "theta"), (phi, "phi"))]
    if any(value.shape != (n,) for value in angles):
        raise InputError(f"theta and phi must have the shape ({n},), got {' and '.join(str(v.shape) for v in angles)}")
    fiber, missing = _fibers(plane, fiber_type)
    owner, segments = np.arange(n), np.empty((4, n))
    angles = (np.ascontiguousarray(v, dtype=float) for v in columns.from_joints(*angles, owner, fiber))
    arms.pose(*angles, columns.geometry_of(owner, fiber), segments)
    segments[:, missing] = np.nan
    return segments[2:].T.copy() << u.mm


def inverse(plane, xy, fiber_type, handedness) -> tuple[u.Quantity, u.Quantity]:
    """Return the joint angles that place a fiber of each positioner at a point; see `FocalPlane.inverse`."""
    n, columns = len(plane), plane.arrays
    points = to_points_mm(xy, "xy")
    if len(points) != n:
        raise InputError(f"xy must have a row for each of the {n} positioners, got {len(points)}")
    fiber, missing = _fibers(plane, fiber_type)
    owner = np.arange(n)
    side = to_sides(columns, points, handedness, fiber)
    g, angles = columns.geometry_of(owner, fiber), np.empty((2, n))
    arms.solve(points, g, side, *angles)
    bounds = columns.bounds_of(owner, fiber, side)
    r2 = ((points - columns.xy) ** 2).sum(axis=1)
    reached = (r2 >= bounds.low) & (r2 <= bounds.high) & ~missing & columns.joints_allow(owner, points, side, fiber)
    return tuple(np.rad2deg(np.where(reached, v, np.nan)) << u.deg for v in columns.to_joints(*angles, owner, fiber))


def to_sides(columns, points: np.ndarray, handedness: object, fiber: np.ndarray | None = None) -> np.ndarray:
    """Return +1 for right-handed and -1 for left-handed arms; by default, the focal plane determines the handedness."""
    if handedness is None:
        return columns.sides(points, None, fiber)
    check = partial(check_choice, choices=("right", "left"), what="handedness of an arm")
    return np.where(_names(handedness, len(columns.plane), "handedness", check) == "left", -1.0, 1.0)


def _fibers(plane, fiber_type):
    """Return the index of the requested fiber of each positioner, and whether the positioner lacks this fiber."""
    n, columns = len(plane), plane.arrays
    fibers = columns.fibers
    names = plane.fiber_types if fibers is None else fibers.names
    if fiber_type is None:
        return columns.first_index, np.zeros(n, dtype=bool)
    types = _names(fiber_type, n, "fiber_type", partial(check_fiber_type, fiber_types=names))
    index = np.array([names.index(name) for name in types.tolist()])
    lists = [row.split("+") for row in plane.fiber_type.tolist()]
    missing = np.array([t not in row for t, row in zip(types.tolist(), lists, strict=True)])
    return index, missing if fibers is None else fibers.missing[index, np.arange(n)]


def _names(given, n: int, what: str, check: Callable) -> np.ndarray:
    """Return one name for each of n positioners, after a check of each different name."""
    names = to_plain(given, what).astype(str)
    if names.shape not in ((), (n,)):
        raise InputError(f"{what} must be one name or have the shape ({n},), got {names.shape}")
    for name in np.unique(names):
        check(str(name))
    return np.broadcast_to(names, n)


class FiberOffsets:
    """Distances and directions from the elbow to each fiber.

    Attributes
    ----------
    names : tuple of str
        The fiber types of the focal plane, followed by the types of fibers that take no target.
    length : ndarray of float, shape (k, n)
        Distance from the elbow to the fiber of each type, mm. If a positioner lacks the fiber, the value for its first
        fiber type is used.
    angle : ndarray of float, shape (k, n)
        Angle from the mechanical axis of the eccentric arm to the direction of the fiber, in radians.
    missing : ndarray of bool, shape (k, n)
        Whether a positioner lacks the fiber of each type.
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
    """Converts angles of the kernels to angles of the joints, and vice versa.

    The kernels measure theta from +x, and phi from the direction of the central arm to the direction of the fiber.

    Parameters
    ----------
    plane : FocalPlane
        Focal plane with at least one of the columns ``zero_points``, ``fiber_xy``, ``theta_range`` and ``phi_range``.
    fibers : FiberOffsets or None
        Positions of the fibers relative to the elbows; None if the focal plane has no ``fiber_xy``.
    l1, l2 : ndarray of float, shape (n,) and (k, n)
        Lengths of the central arms, and distances from the elbow to the fiber of each type, mm.

    Attributes
    ----------
    inner, outer : ndarray of float, shape (k, n)
        Smallest and largest distance from fiber to center of the positioner that the limits of phi allow, mm. The
        values are 0 and infinity where the limits of phi do not restrict this distance, or cannot be replaced by limits
        of this distance.
    free : dict of float to ndarray of bool, shape (n,)
        Whether joint limits allow all points from ``inner`` to ``outer``, for the handedness 1 (right) and -1 (left).
    """

    def __init__(self, plane, fibers: FiberOffsets | None, l1: np.ndarray, l2: np.ndarray):
        n = len(plane)
        zeros = np.zeros((n, 2)) if plane.zero_points is None else to_radian(plane.zero_points, "zero_points")
        self.theta_zero, self.phi_zero = zeros.T.copy()
        self.angle = None if fibers is None else fibers.angle
        limits = []
        for ranges, common in zip((plane.theta_range, plane.phi_range), plane.positioner.numbers.limits, strict=True):
            pair = np.repeat(common[:, None], n, axis=1)
            if ranges is not None:
                given = to_radian(ranges, "joint limits").T
                pair = np.where(np.isfinite(given), given, pair)
            limits += list(pair)
        self.limits = np.array(limits)
        self.inner, self.outer = np.zeros_like(l2), np.full_like(l2, np.inf)
        self.free = {side: self._allow_all(side) for side in (1.0, -1.0)}
        if plane.positioner.handedness != "both":
            side = -1.0 if plane.positioner.handedness == "left" else 1.0
            self.free[side] |= self._cut(l1, l2, side)

    def zeros(self, owner, fiber):
        """Return, for theta and phi, the angle that the kernels use minus the joint angle."""
        phi = self.phi_zero[owner]
        return self.theta_zero[owner], phi if self.angle is None else phi + self.angle[fiber, owner]

    def home(self, home, fiber, *, folded: bool):
        """Return the joint angles of parked positioners: the angles ``home``, or folded arms if ``folded`` is true.

        An angle beyond the joint limits is replaced by the nearest limit.
        """
        owner = np.arange(self.limits.shape[1])
        angles = np.repeat(np.asarray(home)[:, None], len(owner), axis=1)
        if folded:
            angles[1] = np.pi - self.zeros(owner, fiber)[1]
        for k, value in enumerate(angles):
            ends = self.limits[2 * k : 2 * k + 2]
            beyond = ~within_limits(value, *ends)
            away = np.abs(np.mod(ends[:, beyond] - value[beyond] + np.pi, 2 * np.pi) - np.pi)
            value[beyond] = np.where(away[0] <= away[1], *ends[:, beyond])
        return angles

    def from_kernel(self, theta, phi, owner, fiber):
        """Convert kernel angles to joint angles.

        The joint angles are in the range of 360 deg that starts at the lower joint limit (at -180 deg without a limit).
        """
        angles = []
        for value, zero, low in zip((theta, phi), self.zeros(owner, fiber), self.limits[::2, owner], strict=True):
            start = np.where(np.isfinite(low), low, -np.pi) - 1e-12
            angles.append(start + np.mod(value - zero - start, 2 * np.pi))
        return angles

    def allowed(self, theta, phi, owner):
        """Return whether joint angles are within the joint limits of the positioners in the rows ``owner``."""
        low, high, phi_low, phi_high = self.limits[:, owner]
        return within_limits(theta, low, high) & within_limits(phi, phi_low, phi_high)

    def _allow_all(self, side):
        """Return whether each positioner reaches its whole patrol area with a handedness (1: right, -1: left)."""
        low, high, phi_low, phi_high = self.limits
        offset = self.phi_zero if self.angle is None else self.phi_zero + self.angle
        first, last = (-np.pi, 0.0) if side < 0 else (0.0, np.pi)
        allowed = (phi_low <= first - offset) & (phi_high >= last - offset)
        return (high - low >= 2 * np.pi) & allowed.reshape(-1, len(low)).all(axis=0)

    def _cut(self, l1, l2, side):
        """Replace limits of phi by limits of the distance from fiber to center; return which positioners allow it.

        The replacement is possible if theta has no limits and if the allowed values of phi form one interval. The
        points in reach then form a ring, because the distance between fiber and center depends only on phi.
        """
        low, high, phi_low, phi_high = self.limits
        offset = np.broadcast_to(self.phi_zero if self.angle is None else self.phi_zero + self.angle, l2.shape)
        start = -np.pi if side < 0 else 0.0
        with np.errstate(invalid="ignore"):
            # phi is measured from ``start``, so that its range for this handedness is [0, pi]; ``last`` may exceed 2 pi
            first = np.mod(phi_low + offset - start, 2 * np.pi)
            last = first + (phi_high - phi_low)
        before, after = first <= np.pi, last >= 2 * np.pi
        begin, end = np.where(before, first, 0.0), np.where(before, np.minimum(last, np.pi), last - 2 * np.pi)
        is_single, end = np.isfinite(first) & (before ^ after), np.minimum(end, np.pi)
        phi = start + np.array([begin - 1e-12, end + 1e-12]).clip(0.0, np.pi)
        squared = np.sort(l1**2 + l2**2 + 2 * l1 * l2 * np.cos(phi), axis=0)
        possible = is_single.all(axis=0) & (high - low >= 2 * np.pi)
        inner, outer = np.sqrt(np.maximum(squared, 0.0))
        # an interval that ends at phi = 0 or 180 deg limits the distance no more than the arm lengths do
        near, far = (begin, end) if side < 0 else (np.pi - end, np.pi - begin)
        self.inner = np.where(possible & (near > 1e-9), inner, self.inner)
        self.outer = np.where(possible & (far < np.pi - 1e-9), outer, self.outer)
        return possible


def patrol_radii(columns, owner=None, fiber=None, side=None) -> tuple[np.ndarray, np.ndarray]:
    """Return the inner and outer radii of patrol areas (mm) for the positioners ``owner`` and fiber types ``fiber``."""
    owner, fiber = columns.rows_of(owner, fiber)
    l1 = columns.central_arm[owner]
    l2 = columns.eccentric_arm[owner] if columns.fibers is None else columns.fibers.length[fiber, owner]
    inner = np.abs(l1 - l2)
    inner, outer = np.where(inner < EQUAL_ARMS, 0.0, inner), l1 + l2
    if columns.joints is None:
        return inner, outer
    kind = 0 if columns.fibers is None else fiber
    low, high = columns.joints.inner[kind, owner], columns.joints.outer[kind, owner]
    if side is not None:  # these limits are for the default handedness
        usual = np.asarray(side) == (-1.0 if columns.plane.positioner.handedness == "left" else 1.0)
        low, high = np.where(usual, low, 0.0), np.where(usual, high, np.inf)
    return np.maximum(inner, low), np.minimum(outer, high)


def edges_exactly(columns, i: int) -> tuple[Fraction, Fraction]:
    """Return the two radii between which targets of positioner i may lie, in mm.

    A radius that is reduced by a margin is rounded to double precision; the other radii are not rounded.
    """
    l1, l2 = Fraction(columns.central_arm[i]), Fraction(columns.eccentric_arm[i])
    inner, outer = Fraction(0) if columns.equal_arms[i] else abs(l1 - l2), l1 + l2
    if columns.joints is not None:
        inner = max(inner, Fraction(columns.inner_radius[i]))
        outer = min(outer, Fraction(columns.outer_radius[i]))
    margins = columns.plane.margins.numbers
    inner = Fraction(float(inner + Fraction(margins["inner"]))) if margins["inner"] else inner
    return inner, Fraction(float(outer - Fraction(margins["outer"]))) if margins["outer"] else outer
