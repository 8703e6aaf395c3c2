"""A theta-phi positioner: its two arms, their joints, and the parts that can collide."""

from dataclasses import dataclass
from functools import cached_property, partial

import astropy.units as u
import numpy as np

from rfpsurvey._common.descriptions import to_html
from rfpsurvey._common.settings import Checked, option
from rfpsurvey._common.small_figures import ring
from rfpsurvey._common.units import ByValue, to_points_mm, to_radian
from rfpsurvey._instruments.joints import PositionerNumbers
from rfpsurvey._instruments.outline import ArmOutline
from rfpsurvey._kernels import arms
from rfpsurvey.errors import InputError, check_choice, check_keywords

HANDEDNESS = ("right", "left", "both")
ARM_MODELS = ("elbow_to_tip", "capsule", "fiber_tip", "outline")


def two_angles(value: u.Quantity, name: str) -> u.Quantity:
    """Return two angles after their check."""
    if not (to_radian(value, name).shape == (2,) and np.isfinite(value).all()):
        raise InputError(f"{name} must be two finite angles, got {value}")
    return value


def check_ranges(settings: Checked) -> None:
    """Raise an error if the lower end of ``theta_range`` or ``phi_range`` is not below the upper end."""
    for name in ("theta_range", "phi_range"):
        value = getattr(settings, name)
        if value is not None and not value[0] < value[1]:
            raise InputError(f"{name} must be (low, high) with low < high, got {value}")


@check_keywords
@dataclass(frozen=True, eq=False)
class Positioner(Checked, ByValue):
    """A theta-phi fiber positioner with two arms.

    The central arm rotates by theta around the center, counter-clockwise from +x. The eccentric arm rotates by phi
    around the elbow, relative to the central arm. The arms are extended at phi = 0 and folded at phi = 180 deg. The
    fiber reaches all points of the closed annulus between ``inner_radius`` and ``outer_radius``.

    Parameters
    ----------
    central_arm : Quantity
        Length l1 of the central arm, from the center to the elbow.
    eccentric_arm : Quantity
        Length l2 of the eccentric arm, from the elbow to the fiber.
    clearance : Quantity
        Width d of the margin around the eccentric arm. The minimum separation of two arms is 2 d plus the largest
        displacement of the arm within one step.
    step : Quantity, optional
        Angle of one motor step. Within a step, the arm is displaced by at most (l1 + l2) sin(2 step).
    handedness : {"right", "left", "both"}, optional
        ``right``: phi in [0, 180] deg; ``left``: the mirror image of ``right``; ``both``: ``right``, except for targets
        that the fiber can reach only with ``left`` because of the joint limits.
    theta_range, phi_range : Quantity, shape (2,), optional
        Lower and upper joint limits of theta and phi, modulo 360 deg; by default, there are no limits.
    home : Quantity, shape (2,), optional
        theta and phi of a parked positioner, within the joint limits. By default, theta = 0 and phi = 180 deg (folded),
        or the nearest angles that the joint limits allow.
    displacement : Quantity, optional
        Largest displacement of the arm within one step, in place of (l1 + l2) sin(2 step). If ``displacement`` is
        given, ``step`` is ignored.
    arm_model : {"elbow_to_tip", "capsule", "fiber_tip", "outline"}, optional
        Part of the positioner that can collide. ``elbow_to_tip``: the segment from the elbow to the fiber. ``capsule``:
        a segment that starts at the elbow, with its own length and angle. ``fiber_tip``: only the fiber, so two
        positioners collide only if their targets are closer than the minimum separation. ``outline``: the shape of both
        arms that the parameter ``outline`` contains.
    arm_length : Quantity, optional
        Length of the segment of the arm model ``capsule``, from the elbow.
    arm_angle : Quantity or dict of str to Quantity, optional
        Angle of the axis of the eccentric arm, counter-clockwise from the line from the elbow to the fiber, for the arm
        models ``capsule`` and ``outline``. A dict contains an angle for each fiber type.
    outline : ArmOutline, optional
        Shape of both arms, for the arm model ``outline``.

    Raises
    ------
    InputError
        If a length or an angle is out of range, if the handedness or the arm model is unknown, or if the arguments
        do not fit the arm model.

    References
    ----------
    Chen and coauthors (2024), arXiv:2409.07288, "General Methods for Evaluating Collision Probability of Different
    Types of Theta-phi Positioners", equations 1 and 2 (minimum separation).

    Examples
    --------
    >>> import astropy.units as u
    >>> import rfpsurvey as rs
    >>> robot = rs.Positioner(7.4 * u.mm, 15 * u.mm, 2.5 * u.mm, step=0.1 * u.deg)
    >>> robot.min_separation
    <Quantity 5.0781907 mm>
    >>> theta, phi = robot.inverse([[15, 10]] * u.mm)
    >>> robot.forward(theta, phi)
    <Quantity [[15., 10.]] mm>
    """

    central_arm: u.Quantity[u.mm] = option(above=0, below=1e6)
    eccentric_arm: u.Quantity[u.mm] = option(above=0, below=1e6)
    clearance: u.Quantity[u.mm] = option(low=0, below=1e6)
    step: u.Quantity[u.rad] = option(0 * u.deg, low=0, below=np.pi / 4)
    handedness: str = option("right", choices=HANDEDNESS)
    theta_range: u.Quantity | None = option(None, convert=partial(two_angles, name="theta_range"))
    phi_range: u.Quantity | None = option(None, convert=partial(two_angles, name="phi_range"))
    home: u.Quantity | None = option(None, convert=partial(two_angles, name="home"))
    displacement: u.Quantity[u.mm] | None = option(None, low=0, below=1e6)
    arm_model: str = option("elbow_to_tip", choices=ARM_MODELS, what="arm model")
    arm_length: u.Quantity[u.mm] | None = option(None, low=0, below=1e6)
    arm_angle: u.Quantity[u.rad] | dict[str, u.Quantity[u.rad]] | None = None
    outline: ArmOutline | None = option(None, words="an ArmOutline")

    def _check(self) -> None:
        if (self.arm_model == "capsule") != (self.arm_length is not None):
            raise InputError("arm_length must be given for the arm model 'capsule', and only for this model")
        if (self.arm_model == "outline") != (self.outline is not None):
            raise InputError("outline must be given for the arm model 'outline', and only for this model")
        if self.arm_model not in ("capsule", "outline") and self.arm_angle is not None:
            raise InputError("arm_angle must be given only for the arm models 'capsule' and 'outline'")
        check_ranges(self)
        if self.home is not None and not self.numbers.joints_allowed(*self.numbers.home[:, None])[0]:
            raise InputError(f"home must lie within the joint limits, got {self.home}")

    def _repr_html_(self) -> str:
        inner, outer = self.inner_radius, self.outer_radius
        return to_html(self, {"patrol area": f"{inner:.5g} to {outer:.5g}"}, figure=ring(inner.value, outer.value))

    def __repr__(self):
        numbers = self.numbers
        parts = [f"arms {numbers.central_arm:.6g} + {numbers.eccentric_arm:.6g} mm"]
        parts += [f"clearance {numbers.clearance:.6g} mm", f"minimum separation {numbers.separation:.6g} mm"]
        parts += [self.handedness] if self.handedness != "right" else []
        parts += [self.arm_model] if self.arm_model != "elbow_to_tip" else []
        return f"<Positioner: {', '.join(parts)}>"

    @cached_property
    def numbers(self) -> PositionerNumbers:
        """The geometry as numbers without units, in mm and radians (``PositionerNumbers``)."""
        return PositionerNumbers(self)

    def _geometry(self, n: int) -> arms.Geometry:
        """Return the geometry of n positioners with centers at the origin, as arrays for the compiled functions."""
        zero, l1, l2 = np.zeros(n), np.full(n, self.numbers.central_arm), np.full(n, self.numbers.eccentric_arm)
        home = self.numbers.home[0]
        return arms.Geometry(zero, zero, l1, l2, float(np.cos(home)), float(np.sin(home)))

    @property
    def equal_arms(self) -> bool:
        """Whether both arms have the same length (within 1e-9 mm); the fiber then reaches the center."""
        return abs(self.numbers.central_arm - self.numbers.eccentric_arm) < arms.EQUAL_ARMS

    @property
    def inner_radius(self) -> u.Quantity:
        """Inner radius of the patrol area: the absolute difference of the arm lengths."""
        return (0.0 if self.equal_arms else abs(self.numbers.central_arm - self.numbers.eccentric_arm)) * u.mm

    @property
    def outer_radius(self) -> u.Quantity:
        """Outer radius of the patrol area: the sum of the arm lengths."""
        return (self.numbers.central_arm + self.numbers.eccentric_arm) * u.mm

    @property
    def min_separation(self) -> u.Quantity:
        """Minimum separation D of two arms: the displacement within a step plus twice the clearance."""
        return self.numbers.separation * u.mm

    def inverse(self, xy: u.Quantity, handedness: str | None = None) -> tuple[u.Quantity, u.Quantity]:
        """Return the joint angles that place the fiber at given points.

        Parameters
        ----------
        xy : Quantity, shape (n, 2)
            Points relative to the positioner's center.
        handedness : {"right", "left", "both"}, optional
            Handedness to use in place of the positioner's handedness. With ``both``, the left solution is returned if
            the joint limits forbid the right solution.

        Returns
        -------
        theta : Quantity, shape (n,)
            Angle in deg, in [-180, 180]. For a point at the center, theta is that of the parked pose. For a point
            out of reach, theta is NaN.
        phi : Quantity, shape (n,)
            Angle in deg, in [0, 180] ("right") or [-180, 0] ("left"). For a point out of reach, phi is NaN.

        Raises
        ------
        InputError
            If ``xy`` is not an array of lengths with the shape (n, 2), or if the handedness is unknown.
        """
        points = to_points_mm(xy, "xy")
        choice = check_choice(handedness or self.handedness, HANDEDNESS, "handedness")
        theta, phi, ok = self._solve(points, -1.0 if choice == "left" else 1.0)
        if choice == "both" and not ok.all():
            theta_left, phi_left, ok_left = self._solve(points, -1.0)
            use = ~ok & ok_left
            theta[use], phi[use] = theta_left[use], phi_left[use]
            ok |= ok_left
        theta[~ok] = phi[~ok] = np.nan
        return np.rad2deg(theta) * u.deg, np.rad2deg(phi) * u.deg

    def forward(self, theta: u.Quantity, phi: u.Quantity) -> u.Quantity:
        """Return the position of the fiber for given joint angles.

        Parameters
        ----------
        theta, phi : Quantity, shape (n,) or scalar
            Joint angles.

        Returns
        -------
        Quantity, shape (n, 2)
            Positions relative to the center, in mm.

        Raises
        ------
        InputError
            If ``theta`` or ``phi`` is not an array of angles with the shape (n,), or if their lengths differ.
        """
        theta, phi = np.atleast_1d(to_radian(theta, "theta")), np.atleast_1d(to_radian(phi, "phi"))
        if theta.ndim != 1 or phi.ndim != 1 or len({theta.size, phi.size} - {1}) > 1:
            raise InputError(f"theta and phi must have the shape (n,), got {theta.shape} and {phi.shape}")
        theta, phi = np.broadcast_arrays(theta, phi)
        n = theta.size
        segments = np.empty((4, n))
        arms.pose(theta.copy(), phi.copy(), self._geometry(n), segments)
        return segments[2:].T.copy() * u.mm

    def _solve(self, points, side):
        """Return joint angles in radians, and whether the fiber can reach the points within the joint limits."""
        n = len(points)
        theta, phi = np.empty(n), np.empty(n)
        arms.solve(points, self._geometry(n), np.full(n, side), theta, phi)
        r = np.hypot(*points.T)
        # Because of this allowance for rounding, a point computed from the joint angles of an extended arm is in reach.
        slack = 1e-12 * (self.numbers.central_arm + self.numbers.eccentric_arm)
        inner, outer = self.inner_radius.value, self.outer_radius.value
        ok = (r >= inner - slack) & (r <= outer + slack)
        return theta, phi, ok & self.numbers.joints_allowed(theta, phi)
