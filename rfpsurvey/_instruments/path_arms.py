"""The arms of a plan in the form that the kernels of paths require: sizes, poses, joint limits and folded poses."""

from typing import NamedTuple

import numpy as np

from rfpsurvey._common.units import to_radian
from rfpsurvey._instruments import moves as _moves
from rfpsurvey._kernels import joint_motion, path_steps
from rfpsurvey._kernels.motion import TOLERANCE
from rfpsurvey.errors import InputError

WIDE = 3.0
"""Gap (mm) beyond which the poses of idle arms are not distinguished."""
SMALL = np.deg2rad(2.0)
"""Angle by which an initial pose may exceed the range of a joint; the range is then extended."""
BENDS = np.deg2rad([0.0, 30.0, 60.0, 90.0, 120.0, 150.0])
"""Angles by which an idle arm is less folded, if its folded arm collides in all directions."""


class CollidingPosesError(InputError):
    """Arms collide in the poses from which paths begin; ``rows`` are the rows of their positioners."""

    def __init__(self, text: str, rows: np.ndarray):
        super().__init__(text)
        self.rows = rows


class PathArms(NamedTuple):
    """The arms of a plan, with the joint angles that belong to the angles of the kernels."""

    bodies: joint_motion.Bodies
    around: joint_motion.Surroundings
    theta: np.ndarray  # initial poses in the convention of the kernels; NaN for arms that are absent
    psi: np.ndarray
    theta_zero: np.ndarray  # theta in the convention of the kernels minus the joint angle
    phi_zero: np.ndarray  # psi - theta minus the joint angle phi
    turns_freely: np.ndarray  # whether theta of each arm has no limits, except those that are assumed for its cables
    enclosed: np.ndarray  # idle arms that collide in all poses, and the arms with which they collide
    beyond: np.ndarray  # arms whose poses are beyond the ranges of their joints
    crowded: bool  # whether folded arms touch each other unless they point in one direction, which replaces home


def arms_of(columns, posed, motion, margin: float) -> PathArms:
    """Return the arms of a plan; ``columns`` are the arrays of the focal plane for the fibers in use.

    ``motion`` contains joint ranges, which apply where the focal plane has no limits. ``margin`` (mm) is added to the
    minimum separation where the initial poses permit it.
    """
    n, owner, fiber = len(columns.plane), np.arange(len(columns.plane)), columns.fiber_index
    bodies, offset = bodies_of(columns, owner, fiber)
    idle = ~posed.assigned & (True if posed.recorded is None else ~posed.recorded)
    joints = np.where(idle, np.where(columns.is_stuck, columns.stuck.T, columns.home), (posed.theta, posed.phi))
    theta_zero, phi_zero = columns.from_joints(np.zeros(n), np.zeros(n), owner, fiber)
    home_theta, home_phi = columns.home
    # From here, phi is the angle from the central arm to the axis of the eccentric arm, which is psi - theta.
    phi = _moves.split_phi(columns, joints[1] + phi_zero) + offset
    limits = _moves.limits_of(columns, owner, 1, "phi_range")
    low, high = _ends(motion.phi_range, *(v + phi_zero + offset for v in limits))
    # without limits, an arm does not pass its extended pose
    unlimited = ~np.isfinite(low)
    low = np.where(unlimited, np.where(np.signbit(phi - offset), -np.pi, 0.0) + np.minimum(offset, 0.0), low)
    high = np.where(unlimited, low + np.pi + np.abs(offset), high)
    phi = _within(phi, low, high)
    # folded to pi or -pi, or as far as the limits permit; of equal ones, the pose that is nearer
    folds = np.clip(np.pi * np.array([[1.0], [-1.0], [3.0]]), low, high)
    rank = 100.0 * (np.cos(folds) > np.cos(folds).min(axis=0) + _moves.MUCH) + np.abs(folds - phi)
    fold = np.take_along_axis(folds, rank.argmin(axis=0)[None], axis=0)[0]
    # the home pose replaces the folded pose if arms can turn there, too
    at_home = _within(home_phi + phi_zero + (offset if columns.joints is not None else 0.0), low, high)
    at_home = np.where(np.abs(at_home - fold) < 1.0, np.clip(at_home, low, high), fold)
    central = np.zeros(n) if columns.plane.positioner.outline is None else np.full(n, bodies.central)
    if len(_moves.touching(columns, _moves.extent(columns, at_home, bodies.length), central)) == 0:
        fold = at_home
    stays = _moves.stays_folded(columns, True) & idle
    phi = np.where(stays, fold, phi)
    theta_low, theta_high = _ends(motion.theta_range, *_moves.limits_of(columns, owner, 0, "theta_range"))
    # without limits, an arm turns by at most 180 deg from its home pose
    unlimited = ~(np.isfinite(theta_low) & np.isfinite(theta_high))
    theta_low = np.where(unlimited, home_theta - np.pi, theta_low) + theta_zero
    theta_high = np.where(unlimited, home_theta + np.pi + theta_zero, theta_high + theta_zero)
    theta = _within(joints[0] + theta_zero, theta_low, theta_high)
    home = np.clip(_within(home_theta + theta_zero, theta_low, theta_high), theta_low, theta_high)
    absent = ~np.isfinite(theta) | ~np.isfinite(phi)
    beyond = columns.usable & ((theta > theta_high + SMALL) | (phi > high + SMALL))
    theta_low, theta_high = np.minimum(theta_low, theta), np.maximum(theta_high, theta)
    low, high = np.minimum(low, phi), np.maximum(high, phi)
    bodies.x[absent] = np.nan
    theta, psi, fold = (np.where(absent, 0.0, v) for v in (theta, theta + phi, fold))
    idle, ends = np.flatnonzero(stays & ~absent), (theta_low, theta_high)
    pairs = _moves.touching(columns, _moves.extent(columns, fold, bodies.length), central)
    common = _common_direction(columns.limits, bodies, pairs, home, fold, ends)
    if common is not None:
        home = common
        theta[idle], psi[idle] = home[idle], (home + fold)[idle]
    joints = {"theta_low": theta_low, "theta_high": theta_high, "phi_low": low, "phi_high": high}
    joints |= {"home": home, "fold": fold}
    around, enclosed = _surroundings(columns, bodies, theta, psi, idle, joints, margin)
    around = around._replace(free=around.free & ~beyond)
    return PathArms(
        bodies, around, theta, psi, theta_zero, phi_zero + offset, unlimited, enclosed, beyond, common is not None
    )


def _ends(given, low, high):
    """Return joint limits; a given range (Quantity or None) applies to positioners without limits."""
    if given is None:
        return low, high
    first, last = to_radian(given, "range")
    return np.where(np.isfinite(low), low, first), np.where(np.isfinite(low), high, last)


def _within(angle, low, high):
    """Return angles in the 360 deg from ``low``, or from slightly below ``low`` if the range is smaller."""
    slack = np.where(high - low > 2 * np.pi - SMALL, 1e-9, SMALL)
    return low + np.mod(angle - low + slack, 2 * np.pi) - slack


def bodies_of(columns, owner, fiber):
    """Return the sizes of all arms, and the angles from the fibers to the axes of the arms."""
    g, outline = columns.geometry_of(owner, fiber), columns.plane.positioner.outline
    offset, *sizes = _moves.sizes_of(columns, owner, fiber, g)
    central = 0.0 if outline is None else float(outline.reach[1])
    return joint_motion.Bodies(g.cx.copy(), g.cy.copy(), g.l1.copy(), *sizes, central), offset


def _common_direction(limits, bodies, pairs, home, fold, ends):
    """Return theta of folded arms that all point in one direction in which no ``pairs`` touch, or None."""
    n, common, widest = len(home), None, limits.separation + TOLERANCE
    if len(pairs) == 0:
        return None
    rows, near = np.arange(0, 2 * n, 2), np.empty(len(pairs))
    for angle in np.deg2rad(np.arange(0.0, 180.0, 7.5)):
        for direction in (angle, -angle):
            theta = np.clip(_within(home[0] + direction, *ends), *ends)
            poses = np.repeat(theta, 2), np.repeat(theta + fold, 2)
            knots = joint_motion.Knots(rows, rows + 2, np.tile([0.0, 1.0], n), *poses)
            joint_motion.find_near(knots, bodies, limits, pairs, limits.separation + WIDE, near)
            least = min(near.min(), limits.separation + WIDE)
            if least > widest + TOLERANCE:  # of equal gaps, the one that is nearest to the home pose
                common, widest = theta, least
    return common


def _surroundings(columns, bodies, theta, psi, idle, joints, margin):
    """Choose the poses of idle arms, and return what each arm must avoid, and which arms are enclosed.

    ``joints`` contains the joint limits, the home poses and the folds as in `Surroundings`.
    """
    n, limits, pairs = len(theta), columns.limits, columns.obstacle_pairs
    start, near = _grouped(np.vstack([columns.neighbors, columns.neighbors[:, ::-1]]), n)
    o_start, o_near = _grouped(pairs, n)
    separation, clearance = np.empty(len(near)), np.full(len(o_near), columns.clearance + margin)
    around = joint_motion.Surroundings(
        *(start, near, separation, o_start, o_near, clearance, columns.obstacles, columns.clearance),
        free=columns.usable & np.isfinite(bodies.x),
        **joints,
    )
    segments, gap = np.empty((4, n + 1)), np.full(n, np.inf)
    path_steps.locate_all(bodies, theta, psi, segments)
    _check_start(columns, segments, idle)
    segments[:, idle] = np.nan
    path_steps.place_idle(bodies, limits, around, idle, BENDS, WIDE, theta, psi, segments, gap)
    enclosed = gap <= TOLERANCE
    for i in np.flatnonzero(enclosed):  # they and their neighbors have no proven path
        row = near[start[i] : start[i + 1]]
        distance = [path_steps.distance_at_rest(segments, limits, i, i, j, j, limits.separation + WIDE) for j in row]
        enclosed[row[np.array(distance) <= limits.separation + TOLERANCE]] = True
        bodies.x[i] = np.nan
        segments[:, i] = np.nan
    path_steps.keep_separations(segments, limits, start, near, margin, separation)
    owner, is_near = np.repeat(np.arange(n), np.diff(o_start)), np.zeros(len(o_near), dtype=bool)
    for k, (i, j) in enumerate(zip(owner, o_near, strict=True)):
        pose = bodies, limits, i, theta[i], 0.0, psi[i], 0.0, columns.obstacles, j
        distance = joint_motion.comes_near_obstacle(*pose, clearance[k])
        is_near[k] = around.free[i] and distance <= columns.clearance + TOLERANCE
        clearance[k] = max(min(clearance[k], distance - 2 * TOLERANCE), columns.clearance)
    touching = np.unique(owner[is_near])
    if len(touching):
        raise CollidingPosesError(
            "the arms must not touch obstacles in the poses of the plan, but the arm of the positioner "
            f"{columns.plane.id[touching[0]]} is not farther from an obstacle than the clearance plus 1e-6 mm; "
            "find_collisions lists all collisions",
            touching,
        )
    return around._replace(free=around.free & ~enclosed), enclosed


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
    apart = [path_steps.distance_at_rest(segments, limits, i, i, j, j, limits.separation + WIDE) for i, j in pairs]
    pairs = pairs[np.array(apart) <= limits.separation + TOLERANCE]
    if len(pairs):
        i, j = pairs[0]
        raise CollidingPosesError(
            "the arms must not collide in the poses of the plan, but the arms of the positioners "
            f"{ids[i]} and {ids[j]} collide, or are closer than the minimum separation plus 1e-6 mm; "
            "find_collisions lists all collisions",
            np.unique(pairs),
        )
