"""Distances of moving arms, sampled at many times with plain numpy."""

from typing import NamedTuple

import astropy.units as u
import numpy as np
import shapely


def ends(x, y, angle, inner, length):
    """Return the ends of segments at the directions ``angle`` around (x, y), shape (..., 2, 2)."""
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([np.stack([x + r * c, y + r * s], axis=-1) for r in (inner, length)], axis=-2)


def _point_to_segment(p, a, b):
    u, v = b - a, p - a
    length2 = (u * u).sum(axis=-1)
    t = np.clip((u * v).sum(axis=-1) / np.where(length2 > 0, length2, 1), 0, 1)
    return np.linalg.norm(v - t[..., None] * u, axis=-1)


def segment_distance(one, two):
    """Return the distances between segments of shape (..., 2, 2)."""
    (a, b), (c, d) = (np.moveaxis(s, -2, 0) for s in (one, two))
    found = np.min([_point_to_segment(*p) for p in ((a, c, d), (b, c, d), (c, a, b), (d, a, b))], axis=0)

    def cross(o, p, q):
        return (p[..., 0] - o[..., 0]) * (q[..., 1] - o[..., 1]) - (p[..., 1] - o[..., 1]) * (q[..., 0] - o[..., 0])

    crossing = (cross(a, b, c) * cross(a, b, d) < 0) & (cross(c, d, a) * cross(c, d, b) < 0)
    return np.where(crossing, 0.0, found)


def angle_at(angle, turn, t, same_speed, longest):
    """Return the direction of an arm that is at its target at the time t = 0 and folded at t = 1."""
    if not same_speed:
        return angle + t * turn
    # all arms begin to unfold at t = 1, with the speed of the arm with the longest way
    return angle + np.sign(turn) * np.maximum(np.abs(turn) - (1 - t) * longest, 0.0)


def least_distance(one, two, *, same_speed=False, n=10_000, rounds=0, gap=None):
    """Return the least distance of two arms (x, y, angle, turn, inner, length) at n times, refined ``rounds`` times.

    ``gap`` is the function that returns distances; by default, that of segments.
    """
    longest = max(abs(one[3]), abs(two[3]))

    def at(t):
        angles = (angle_at(arm[2], arm[3], t, same_speed, longest) for arm in (one, two))
        if gap is not None:
            return gap(*angles)
        return segment_distance(
            *(ends(arm[0], arm[1], a, arm[4], arm[5]) for arm, a in zip((one, two), angles, strict=True))
        )

    t = np.linspace(0, 1, n)
    if same_speed and longest:  # the rate of an arm changes when it reaches its target
        t = np.sort(np.append(t, np.clip([1 - abs(arm[3]) / longest for arm in (one, two)], 0, 1)))
    speed = (abs(one[3]) * one[5] + abs(two[3]) * two[5]) * (2 if same_speed else 1)
    return refined(at, t, speed, rounds)


def refined(at, t, speed, rounds):
    """Return the smallest value of a function at the times t from 0 to 1, refined ``rounds`` times around its minima.

    Finally, the surroundings of the smallest value are sampled more and more densely. The function ``at`` of an array
    of times changes by at most ``speed`` per time.
    """
    n, found = len(t), at(t)
    best, width = found.min(), np.diff(t).max()
    for _ in range(rounds):
        low = np.flatnonzero(found <= best + speed * width)
        if len(low) > n:
            break
        m = max(3, n // len(low)) | 1
        t = np.unique((t[low][:, None] + np.linspace(-width, width, m)).clip(0, 1))
        width *= 2 / (m - 1)
        found = at(t)
        best = min(best, found.min())
    middle = t[found.argmin()]
    for _ in range(6 if rounds else 0):  # the distance is smooth near most minima
        t = np.unique((middle + np.linspace(-width, width, 41)).clip(0, 1))
        found = at(t)
        middle, width = t[found.argmin()], 0.1 * width
        best = min(best, found.min())
    return best


class TwoJoints(NamedTuple):
    """An arm whose central and eccentric arms turn at constant rates from the time 0 to the time 1, in radians."""

    x: float
    y: float
    l1: float
    theta: float
    theta_rate: float
    psi: float  # direction of the eccentric arm
    psi_rate: float
    inner: float
    length: float

    @property
    def speed(self):
        """Return the largest speed of a point of the segment."""
        return self.l1 * abs(self.theta_rate) + self.length * abs(self.psi_rate)

    def elbow(self, t):
        """Return the positions of the elbow."""
        theta = self.theta + t * self.theta_rate
        return self.x + self.l1 * np.cos(theta), self.y + self.l1 * np.sin(theta)

    def segment(self, t):
        """Return the segments at the times t, shape (..., 2, 2)."""
        return ends(*self.elbow(t), self.psi + t * self.psi_rate, self.inner, self.length)


def two_joint_distance(one, two, *, n=10_000, rounds=0):
    """Return the least distance of two `TwoJoints` at n times, refined ``rounds`` times."""

    def at(t):
        return segment_distance(one.segment(t), two.segment(t))

    return refined(at, np.linspace(0, 1, n), one.speed + two.speed, rounds)


class MovingArm(NamedTuple):
    """An arm of a small scene: its elbow, its direction and angle to the fold, and the segment that can collide."""

    x: float
    y: float
    angle: float
    turn: float
    inner: float
    length: float
    own: int


def moving_arm(plane, i, theta, phi, *, fiber="", moves=True):
    """Return an arm that folds from the angles theta and phi in radians, by plain geometry.

    ``plane`` has neither zero points nor limits of each positioner.
    """
    unit = plane.positioner
    x, y = plane.xy[i].to_value(u.mm)
    l1, l2 = unit.central_arm.to_value(u.mm), unit.eccentric_arm.to_value(u.mm)
    offset, length, inner = 0.0, l2, 0.0
    if unit.arm_model in ("capsule", "outline"):
        given = unit.arm_angle
        given = given.get(fiber, 0 * u.deg) if isinstance(given, dict) else given
        offset = 0.0 if given is None else given.to_value(u.rad)
        length = (unit.arm_length if unit.outline is None else unit.outline.length).to_value(u.mm)
    elif unit.arm_model == "fiber_tip":
        inner = l2
    side = -1 if phi < 0 or (phi == 0 and unit.handedness == "left") else 1
    fold = side * np.pi - offset
    if unit.phi_range is not None:
        fold = np.clip(fold, *unit.phi_range.to_value(u.rad))
    turn = fold - phi if moves else 0.0
    return MovingArm(x + l1 * np.cos(theta), y + l1 * np.sin(theta), theta + phi + offset, turn, inner, length, i)


def outline_parts(plane, arm, angles):
    """Return shapes of the parts of an outline at each direction of the eccentric arm, and their radii.

    The position of the elbow can be one number or one number per direction.
    """
    outline, center = plane.positioner.outline, plane.xy[arm.own].to_value(u.mm)
    body = np.arctan2(arm.y - center[1], arm.x - center[0]) + np.zeros_like(angles)
    found = []
    for k, (vertices, radius) in enumerate(outline.parts):
        eccentric = k < outline.n_eccentric
        origin, turn = ((arm.x, arm.y), angles) if eccentric else (center, body)
        c, s = np.cos(turn)[:, None], np.sin(turn)[:, None]
        x, y = vertices.T
        x0, y0 = (np.reshape(value, (-1, 1)) for value in origin)
        points = np.stack([x0 + c * x - s * y, y0 + s * x + c * y], axis=-1)
        make = {1: lambda p: shapely.points(p[:, 0]), 2: shapely.linestrings}.get(len(vertices), shapely.polygons)
        found.append((make(points), radius, eccentric))
    return found


def outline_distance(plane, one, two, first, second):
    """Return the distances of two outlines whose eccentric arms have the directions ``first`` and ``second``."""
    return np.min(
        [
            np.maximum(shapely.distance(a, b) - r - q, 0.0)
            for a, r, moves in outline_parts(plane, one, first)
            for b, q, other_moves in outline_parts(plane, two, second)
            if moves or other_moves
        ],
        axis=0,
    )


def arms_distance(plane, one, two, **options):
    """Return the least distance of two `MovingArm`, refined; arms with outlines are shapes of shapely."""
    if plane.positioner.outline is None:
        return least_distance(one[:6], two[:6], rounds=3, **options)

    def gap(first, second):
        first, second = np.broadcast_arrays(np.atleast_1d(first), np.atleast_1d(second))
        return outline_distance(plane, one, two, first, second)

    reach = plane.positioner.outline.reach[0]
    moved = (arm[:5] + (reach,) for arm in (one, two))
    return least_distance(*moved, rounds=3, gap=gap, **options)


def circle_distance(arm, circle, n=2001):
    """Return the least distance of an arm without an outline from a circle (x, y, radius), sampled and refined."""
    point = (circle[0], circle[1], 0.0, 0.0, 0.0, 0.0)
    return least_distance(arm[:6], point, n=n, rounds=3) - circle[2]
