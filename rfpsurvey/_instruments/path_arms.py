"""The arms of a plan in the form that the kernels of paths require: sizes, poses, joint limits and folded poses."""

from typing import NamedTuple

import numpy as np

from rfpsurvey._common.units import to_radian
from rfpsurvey._instruments import moves as _moves
from rfpsurvey._kernels import arms, joint_motion, path_steps
from rfpsurvey._kernels.motion import TOLERANCE
from rfpsurvey.errors import InputError

WIDE = 3.0
"""Gap (mm) beyond which the poses of idle arms are not distinguished."""
BENDS = np.deg2rad([0.0, 30.0, 60.0, 90.0, 120.0, 150.0])
"""Angles by which an idle arm is less folded, if its folded arm collides in all directions."""


class PathArms(NamedTuple):
    """The arms of a plan, with the joint angles that belong to the angles of the kernels."""

    bodies: joint_motion.Bodies
    around: joint_motion.Surroundings
    theta: np.ndarray  # initial poses in the convention of the kernels; NaN for arms that are absent
    psi: np.ndarray
    home: np.ndarray  # theta of the arms in the home pose, within the joint limits
    theta_zero: np.ndarray  # theta in the convention of the kernels minus the joint angle
    phi_zero: np.ndarray  # psi - theta minus the joint angle phi
    enclosed: np.ndarray  # idle arms that collide in all poses, and the arms with which they collide


def arms_of(columns, posed, theta_range, phi_range, margin: float) -> PathArms:
    """Return the arms of a plan; ``columns`` are the arrays of the focal plane for the fibers in use.

    ``theta_range`` and ``phi_range`` (rad, or None) are joint limits that are known in addition to those of the focal
    plane. ``margin`` (mm) is added to the minimum separation where the initial poses permit it.
    """
    n, owner, fiber = len(columns.plane), np.arange(len(columns.plane)), columns.fiber_index
    bodies, offset = bodies_of(columns, owner, fiber)
    idle = ~posed.assigned & (True if posed.recorded is None else ~posed.recorded)
    joints = np.where(idle, np.where(columns.is_stuck, columns.stuck.T, columns.home), (posed.theta, posed.phi))
    theta, phi = (np.array(v, dtype=float) for v in columns.from_joints(*joints, owner, fiber))
    phi = _moves.split_phi(columns, phi)
    theta_zero, (*_, phi_zero) = theta - joints[0], _moves.phi_limits(columns, owner, fiber)
    joint = _moves.joint_phi(columns, owner, fiber, phi)
    low, high = _phi_ends(columns, owner, fiber, phi, phi_range)
    fold = np.clip(joint + _moves.to_fold(columns, owner, fiber, phi, offset), low, high)
    home_theta, home_phi = columns.home
    # the home pose replaces the folded pose if arms can turn there, too
    at_home = np.where((home_phi >= low) & (home_phi <= high), home_phi, fold)
    central = np.zeros(n) if columns.plane.positioner.outline is None else np.full(n, bodies.central)
    if len(_moves.touching(columns, _moves.extent(columns, at_home + phi_zero + offset, bodies.length), central)) == 0:
        fold = at_home
    stays = _moves.stays_folded(columns, True) & idle
    joint = np.where(stays, fold, joint)
    low, high = np.minimum(low, np.minimum(joint, fold)), np.maximum(high, np.maximum(joint, fold))
    theta_low, theta_high = _theta_ends(columns, owner, home_theta, theta_range)
    # the joint angle of the initial pose, in the range of the joint
    start = theta_low + np.mod(theta - theta_zero - theta_low + 1e-9, 2 * np.pi) - 1e-9
    home = np.clip(theta_low + np.mod(home_theta - theta_low + 1e-9, 2 * np.pi) - 1e-9, theta_low, theta_high)
    theta_low, theta_high = np.minimum(theta_low, start), np.maximum(theta_high, start)
    zero = phi_zero + offset
    theta, psi, fold = start + theta_zero, start + theta_zero + joint + zero, fold + zero
    absent = ~np.isfinite(theta) | ~np.isfinite(psi)
    bodies.x[absent] = np.nan
    theta, psi, fold = (np.where(absent, 0.0, v) for v in (theta, psi, fold))
    around, enclosed = _surroundings(columns, bodies, theta, psi, fold, np.flatnonzero(stays & ~absent), margin)
    around = around._replace(
        theta_low=theta_low + theta_zero,
        theta_high=theta_high + theta_zero,
        phi_low=low + zero,
        phi_high=high + zero,
        free=columns.usable & ~absent & ~enclosed,
    )
    return PathArms(bodies, around, theta, psi, home + theta_zero, theta_zero, zero, enclosed)


def bodies_of(columns, owner, fiber):
    """Return the sizes of all arms, and the angles from the fibers to the axes of the arms."""
    g, outline = columns.geometry_of(owner, fiber), columns.plane.positioner.outline
    has_axis = columns.model == arms.CAPSULE
    offset = np.arctan2(*columns.angles_of(owner, fiber)[::-1]) if has_axis else np.zeros(len(owner))
    length = np.full(len(owner), columns.length) if has_axis else g.l2.copy()
    inner = length.copy() if columns.model == arms.FIBER_TIP else np.zeros(len(owner))
    reach, central = (length.copy(), 0.0) if outline is None else (np.full(len(owner), outline.reach[0]), outline.reach[1])
    return joint_motion.Bodies(g.cx.copy(), g.cy.copy(), g.l1.copy(), inner, length, reach, float(central)), offset


def _phi_ends(columns, owner, fiber, phi, given):
    """Return the joint limits of phi; an arm without limits does not pass its extended pose."""
    low, high, zero = _moves.phi_limits(columns, owner, fiber)
    if given is not None:
        low, high = np.maximum(low, given[0]), np.minimum(high, given[1])
    unlimited = ~np.isfinite(low)
    low = np.where(unlimited, np.where(np.signbit(phi), -np.pi, 0.0) - zero, low)
    return low, np.where(unlimited | ~np.isfinite(high), low + np.pi, high)


def _theta_ends(columns, owner, home, given):
    """Return the joint limits of theta; an arm without limits turns by at most 180 deg from its home pose."""
    low, high = _moves.limits_of(columns, owner, 0, "theta_range")
    if given is not None:
        low, high = np.maximum(low, given[0]), np.minimum(high, given[1])
    unlimited = ~np.isfinite(low) | ~np.isfinite(high)
    return np.where(unlimited, home - np.pi, low), np.where(unlimited, home + np.pi, high)


def _surroundings(columns, bodies, theta, psi, fold, idle, margin):
    """Choose the poses of idle arms, and return what each arm must avoid, and which arms are enclosed."""
    n, limits = len(theta), columns.limits
    start, near = _grouped(np.vstack([columns.neighbors, columns.neighbors[:, ::-1]]), n)
    segments, gap = np.empty((4, n + 1)), np.full(n, np.inf)
    path_steps.locate_all(bodies, theta, psi, segments)
    _check_start(columns, segments, idle)
    segments[:, idle] = np.nan
    path_steps.place_idle(bodies, limits, start, near, idle, fold, BENDS, WIDE, theta, psi, segments, gap)
    enclosed = gap <= TOLERANCE
    for i in np.flatnonzero(enclosed):  # they and their neighbors have no proven path
        row = near[start[i] : start[i + 1]]
        distance = [path_steps.distance_at_rest(segments, limits, i, i, j, j, limits.separation + WIDE) for j in row]
        enclosed[row[np.array(distance) <= limits.separation + TOLERANCE]] = True
        bodies.x[i] = np.nan
        segments[:, i] = np.nan
    separation = np.empty(len(near))
    path_steps.keep_separations(segments, limits, start, near, margin, separation)
    pairs = columns.obstacle_pairs
    o_start, o_near = _grouped(pairs, n)
    owner, clearance = np.repeat(np.arange(n), np.diff(o_start)), np.full(len(o_near), columns.clearance + margin)
    for k, (i, j) in enumerate(zip(owner, o_near, strict=True)):
        pose = bodies, limits, i, theta[i], 0.0, psi[i], 0.0, columns.obstacles, j
        distance = joint_motion.comes_near_obstacle(*pose, clearance[k])
        clearance[k] = max(min(clearance[k], distance - 2 * TOLERANCE), columns.clearance)
    nothing = np.zeros(0)
    around = joint_motion.Surroundings(
        start, near, separation, o_start, o_near, clearance, columns.obstacles, columns.clearance, *[nothing] * 4, fold,
        enclosed,
    )
    return around, enclosed


def _grouped(pairs, n):
    """Return the second elements of pairs, sorted by the first, and where those of each first element begin."""
    pairs = pairs[np.argsort(pairs[:, 0], kind="stable")]
    return np.searchsorted(pairs[:, 0], np.arange(n + 1)), pairs[:, 1].copy()


def _check_start(columns, segments, idle):
    """Raise an error if arms with targets, or with fixed poses, collide in the initial poses."""
    present = np.ones(len(columns.plane), dtype=bool)
    present[idle] = False
    pairs, limits, ids = columns.neighbors, columns.limits, columns.plane.id
    pairs = pairs[present[pairs].all(axis=1) & columns.usable[pairs].any(axis=1)]
    for i, j in pairs:
        distance = path_steps.distance_at_rest(segments, limits, i, i, j, j, limits.separation + WIDE)
        if distance <= limits.separation + TOLERANCE:
            raise InputError(
                f"the arms must not collide at the beginning of the paths, but the arms of the positioners {ids[i]} and "
                f"{ids[j]} collide; find_collisions lists all collisions"
            )


def joint_range(value, name: str) -> np.ndarray | None:
    """Return joint limits in radians, or None."""
    return None if value is None else to_radian(value, name)
