"""Where the arms stand, and which of them are closer than the safe distance."""

from dataclasses import dataclass
from functools import cached_property

import astropy.units as u
import numpy as np

from rfpsurvey._kernels import arms, collisions
from rfpsurvey._units import to_points_mm, to_radian
from rfpsurvey.errors import InputError, check_choice
from rfpsurvey.focal_plane import FocalPlane

__all__ = ["METHODS", "Arms", "CollisionReport", "find_collisions", "place_arms"]


@dataclass(frozen=True, eq=False)
class Arms:
    """Poses of all positioners, in mm and radians; NaN for arms that are not there."""

    theta: np.ndarray
    phi: np.ndarray
    elbow: np.ndarray
    tip: np.ndarray
    segments: np.ndarray
    """What can collide, rows (x0, y0, x1, y1)."""
    assigned: np.ndarray
    """Positioners that look at a target."""
    parked: np.ndarray
    """Usable positioners without a target that stand at home and count."""
    clipped: np.ndarray
    """Positioners whose target is out of reach: stretched toward it, or bent as the joint limits forbid."""

    @property
    def present(self) -> np.ndarray:
        """Positioners whose arm is there."""
        return np.isfinite(self.segments[:, 0])


@dataclass(frozen=True, eq=False)
class CollisionReport:
    """Static collisions of one configuration.

    Parameters
    ----------
    pairs : ndarray of int, shape (k, 2)
        Positioners i < j whose arms are closer than the safe distance, sorted.
    distances : Quantity, shape (k,)
        Their distances.
    obstacle_pairs : ndarray of int, shape (m, 2)
        Pairs (positioner, obstacle) closer than the clearance.
    obstacle_distances : Quantity, shape (m,)
        Distances from the arm to the edge of the circle.
    in_collision : ndarray of bool, shape (n,)
        Positioners that occur in either list.
    assigned : ndarray of bool, shape (n,)
        Positioners that look at a target.
    counted : ndarray of bool, shape (n,)
        Positioners that the rate refers to: assigned ones and parked equal-arm ones.
    """

    pairs: np.ndarray
    distances: u.Quantity
    obstacle_pairs: np.ndarray
    obstacle_distances: u.Quantity
    in_collision: np.ndarray
    assigned: np.ndarray
    counted: np.ndarray

    @property
    def rate(self) -> float:
        """Part of the counted positioners (assigned and parked) that is in collision; NaN if none counts."""
        return _ratio(self.in_collision, self.counted)

    @property
    def rate_assigned(self) -> float:
        """Part of the assigned positioners that is in collision; NaN if none is assigned."""
        return _ratio(self.in_collision, self.assigned)

    @cached_property
    def colliding_with(self) -> list[list[int]]:
        """For each positioner the others that it collides with, ascending."""
        partners: list[list[int]] = [[] for _ in self.in_collision]
        for i, j in self.pairs.tolist():
            partners[i].append(j)
            partners[j].append(i)
        return partners  # ascending, because the pairs are sorted

    def __repr__(self):
        return (
            f"<CollisionReport: {len(self.pairs)} pairs, {len(self.obstacle_pairs)} with obstacles, "
            f"{int(self.in_collision.sum())} of {int(self.counted.sum())} positioners>"
        )


def _exact(segments, pairs, separation):
    out = np.empty_like(pairs)
    squared = np.empty(len(pairs))
    half = np.empty(len(segments))
    collisions.half_lengths(segments, half)
    n = collisions.colliding_pairs(segments, half, pairs, separation, out, squared)
    return out[:n], np.sqrt(squared[:n])


METHODS = {"exact": _exact}
"""Name to function (segments, neighbor pairs, separation) -> (pairs, distances)."""


def find_collisions(
    focal_plane: FocalPlane,
    tips: object = None,
    *,
    theta: u.Quantity | None = None,
    phi: u.Quantity | None = None,
    handedness: str | np.ndarray | None = None,
    fiber_type: np.ndarray | None = None,
    parked_obstacles: bool = True,
    method: str = "exact",
) -> CollisionReport:
    """Find the arms that are closer to each other than the safe distance D.

    Two positioners collide if and only if the distance of the segments that can collide is below D (strictly);
    crossing segments have the distance 0. An arm collides with an obstacle if it comes
    nearer to the edge of the circle than its clearance d.

    Parameters
    ----------
    focal_plane : FocalPlane
        The positioners.
    tips : Quantity, shape (n, 2), or Allocation, or Arms, optional
        Where the fiber of each positioner is, NaN for those without a target; or an allocation, whose elbows and
        options are then used; or poses that are already there.
    theta, phi : Quantity, shape (n,), optional
        Joint angles instead of ``tips``; NaN for positioners without a target.
    handedness : {"right", "left"} or array_like of str, shape (n,), optional
        Elbow of each arm, where it is not the positioner's own.
    fiber_type : array_like of str, shape (n,), optional
        Fiber in use, for arm models that depend on it.
    parked_obstacles : bool, optional
        Do equal-arm positioners without a target stand at home, as obstacles that count? Those with unequal arms
        are followers that give way, and are ignored. An allocation has an option of its own, which is then used.
    method : {"exact"}, optional
        How distances are found.

    Returns
    -------
    CollisionReport
        Pairs, distances, flags and rates.

    Raises
    ------
    InputError
        If a tip lies outside its patrol area or beyond the joint limits, or a shape does not fit.

    References
    ----------
    Chen et al., "General Methods for Evaluating Collision Probability of Different Types of Theta-phi
    Positioners", Eq. 1.

    Examples
    --------
    >>> import astropy.units as u
    >>> import rfpsurvey as rs
    >>> robot = rs.Positioner(8.25 * u.mm, 8.25 * u.mm, 2.25 * u.mm)
    >>> plane = rs.FocalPlane([[0, 0], [25.6, 0]] * u.mm, robot)
    >>> rs.find_collisions(plane, [[12, 0], [14, 0]] * u.mm)
    <CollisionReport: 1 pairs, 0 with obstacles, 2 of 2 positioners>
    """
    function = METHODS[check_choice(method, METHODS, "collision method")]
    ready = isinstance(tips, Arms) or hasattr(tips, "target_of_positioner")
    if ready and not (theta is phi is handedness is fiber_type is None):
        raise InputError("an Allocation or Arms bring their own poses; give no theta, phi, handedness or fiber_type")
    if isinstance(tips, Arms):
        posed = tips
        if len(posed.segments) != len(focal_plane):
            raise InputError(f"the arms are those of {len(posed.segments)} positioners, not of {len(focal_plane)}")
    elif hasattr(tips, "target_of_positioner"):
        posed = tips.place_arms(focal_plane)
    else:
        posed = place_arms(
            focal_plane, tips, theta=theta, phi=phi, handedness=handedness, fiber_type=fiber_type,
            parked_obstacles=parked_obstacles,
        )  # fmt: skip
    pairs, distances = function(posed.segments, focal_plane._neighbors, focal_plane.positioner._separation_mm)
    touching = focal_plane._obstacle_pairs
    hits, gaps = np.empty_like(touching), np.empty(len(touching))
    clearance = float(focal_plane.positioner.clearance.to_value(u.mm))
    n = collisions.colliding_obstacles(posed.segments, touching, focal_plane._obstacles_mm, clearance, hits, gaps)
    flags = np.zeros(len(focal_plane), dtype=bool)
    flags[pairs.ravel()] = True
    flags[hits[:n, 0]] = True
    counted = posed.assigned | posed.parked
    return CollisionReport(pairs, distances * u.mm, hits[:n], gaps[:n] * u.mm, flags, posed.assigned, counted)


def place_arms(
    focal_plane: FocalPlane,
    tips: u.Quantity | None = None,
    *,
    theta: u.Quantity | None = None,
    phi: u.Quantity | None = None,
    handedness: str | np.ndarray | None = None,
    fiber_type: np.ndarray | None = None,
    parked_obstacles: bool = True,
    clip: bool = False,
) -> Arms:
    """Return the poses of all positioners; parameters as in `find_collisions`.

    With ``clip``, arms whose tip is out of reach stretch toward it as far as they can.
    """
    n = len(focal_plane)
    if (theta is None) != (phi is None) or (tips is None) == (theta is None):
        raise InputError("give tips, or theta and phi, not both")
    center = focal_plane._xy_mm
    geometry = (*center.T.copy(), focal_plane._l1_mm, focal_plane._l2_mm)
    angles = np.full((2, n), np.nan)
    elbow, tip = np.full((2, n), np.nan), np.full((2, n), np.nan)
    if tips is None:
        for row, (value, name) in enumerate(((theta, "theta"), (phi, "phi"))):
            angles[row] = _columns(to_radian(value, name), name, n)
        arms.pose(*angles, *geometry, *elbow, *tip)
        far = np.zeros(n, dtype=bool)
    else:
        points = to_points_mm(tips, "tips")
        if len(points) != n:
            raise InputError(f"tips must have a row for each of the {n} positioners, got {len(points)}")
        side = focal_plane._sides(points) if handedness is None else _sides(handedness, n)
        arms.solve(*points.T.copy(), *geometry, side, focal_plane.positioner._home_rad[0], *angles, *elbow)
        tip = points.T.copy()
        far = _out_of_reach(focal_plane, points) & focal_plane._usable
        there = np.isfinite(points).all(axis=1) & focal_plane._usable
        barred = there & ~far & ~focal_plane.positioner._joints_allowed(*angles)
        if far.any() and not clip:
            k = int(np.flatnonzero(far)[0])
            raise InputError(
                f"{int(far.sum())} tips are out of reach, the first that of positioner {focal_plane.id[k]}: "
                f"{np.hypot(*(points[k] - center[k])):.4f} mm from its center, "
                f"must be {focal_plane._inner_mm[k]:.4f} to {focal_plane._outer_mm[k]:.4f} mm"
            )
        if barred.any() and not clip:
            raise InputError(
                f"{int(barred.sum())} tips are beyond the joint limits, the first that of positioner "
                f"{focal_plane.id[np.flatnonzero(barred)[0]]}"
            )
        if far.any():
            posed = [np.empty(n) for _ in range(4)]
            arms.pose(*angles, *geometry, *posed)
            tip[:, far] = np.array(posed[2:])[:, far]
        far |= barred
    assigned = np.isfinite(tip).all(axis=0) & focal_plane._usable
    # arms at home: those that cannot move always; idle equal arms if wanted; idle unequal arms give way
    parked = focal_plane._usable & ~assigned & focal_plane._equal_arms & bool(parked_obstacles)
    standing = parked | ~focal_plane._usable
    stuck = focal_plane._is_stuck
    home = np.repeat(focal_plane.positioner._home_rad[:, None], n, axis=1)
    home[:, stuck] = focal_plane._stuck_rad[stuck].T
    home_elbow, home_tip = np.empty((2, n)), np.empty((2, n))
    arms.pose(*home, *geometry, *home_elbow, *home_tip)
    folded = standing & ~stuck & focal_plane._equal_arms & (focal_plane.positioner._home_rad[1] == np.pi)
    home_tip[:, folded] = center[folded].T
    for values, at_home in ((angles, home), (elbow, home_elbow), (tip, home_tip)):
        values[:, ~assigned] = np.where(standing, at_home, np.nan)[:, ~assigned]
    segments = np.empty((n, 4))
    angle = _arm_angles(focal_plane, fiber_type)
    arms.arm_segments(*elbow, *tip, focal_plane._arm_length_mm, angle, segments)
    return Arms(*angles, elbow.T.copy(), tip.T.copy(), segments, assigned, parked, far & assigned)


def nearest_distance(posed: Arms) -> np.ndarray:
    """Distance (mm) of each arm to the nearest other one; NaN: absent, infinity: alone."""
    half, out = np.empty(len(posed.segments)), np.empty(len(posed.segments))
    collisions.half_lengths(posed.segments, half)
    mid = 0.5 * (posed.segments[:, :2] + posed.segments[:, 2:])
    there = np.flatnonzero(posed.present)
    order = there[np.argsort(mid[there, 0], kind="stable")]
    collisions.nearest_arm(posed.segments, half, order, mid, out)
    return out


def _out_of_reach(focal_plane, points):
    """Mark tips outside their patrol area by more than rounding."""
    r = np.hypot(*(points - focal_plane._xy_mm).T)
    slack = 1e-12 * (focal_plane._outer_mm + np.abs(focal_plane._xy_mm).max())
    return (r < focal_plane._inner_mm - slack) | (r > focal_plane._outer_mm + slack)


def _arm_angles(focal_plane, fiber_type):
    names = focal_plane.fiber_types
    types = np.full(len(focal_plane), "") if fiber_type is None else np.asarray(fiber_type, dtype=str)
    if types.shape != (len(focal_plane),):
        raise InputError(f"fiber_type must have the shape ({len(focal_plane)},), got {types.shape}")
    types = np.where(types == "", focal_plane._first_type, types)
    for name in np.unique(types):
        check_choice(str(name), names, "fiber type")
    by_type = dict(zip(names, focal_plane.positioner._arm_angle_rad(names), strict=True))
    return np.array([by_type[t] for t in types.tolist()])


def _sides(handedness, n):
    """Turn elbow names into +1 (right) and -1 (left)."""
    names = np.full(n, handedness) if isinstance(handedness, str) else np.asarray(handedness, dtype=str)
    if names.shape != (n,):
        raise InputError(f"handedness must be one name or have the shape ({n},), got {names.shape}")
    for name in np.unique(names):
        check_choice(str(name), ("right", "left"), "handedness of an arm")
    return np.where(names == "left", -1.0, 1.0)


def _columns(values, name, n):
    if values.shape != (n,):
        raise InputError(f"{name} must have the shape ({n},), got {values.shape}")
    return values


def _ratio(flags, among):
    n = int(among.sum())
    return float((flags & among).sum() / n) if n else float("nan")
