"""Arms whose two joints rotate at constant rates: distances that are certain at all times between two poses.

The pose of an arm is the direction ``theta`` of its central arm and the direction ``psi`` of its eccentric arm, both in
the focal plane; psi is theta + phi plus the constant angle from the fiber to the axis of the arm. During a step, from
the time 0 to the time 1, all angles change at constant rates. From the distance at one time, the functions compute a
time until which the distance certainly remains larger than a given separation (conservative advancement). Along a fixed
direction, the second derivative of the position of a point at the distance r from the elbow is at most
l1 theta'^2 + r psi'^2, where l1 is the length of the central arm.

A path is a sequence of steps between knots. The first and the last times of all paths are the same.
"""

import math
from typing import NamedTuple

import numpy as np

from rfpsurvey._kernels.collisions import obstacle_distance
from rfpsurvey._kernels.jit import kernel
from rfpsurvey._kernels.motion import LOOK_AHEAD, ROUNDING, TOLERANCE, between, leaves
from rfpsurvey._kernels.outlines import outlines_squared


class Bodies(NamedTuple):
    """The sizes of all arms in mm; the segment, or the core of an outline, begins ``inner`` from the elbow."""

    x: np.ndarray  # center of the positioner; NaN for arms that are absent
    y: np.ndarray
    l1: np.ndarray
    inner: np.ndarray
    length: np.ndarray
    reach: np.ndarray  # largest distance of a part of the eccentric arm from the elbow
    central: float  # largest distance of a part of an outline on the central arm from the center


class Knots(NamedTuple):
    """The poses of all arms at the knots of their paths, between which all angles change at constant rates."""

    start: np.ndarray  # the knots of positioner i are start[i] to stop[i] - 1; at least two
    stop: np.ndarray
    time: np.ndarray
    theta: np.ndarray
    psi: np.ndarray


class Surroundings(NamedTuple):
    """What each arm must not come near to, and the limits of its joints in the convention of the kernels."""

    start: np.ndarray  # the neighbors of positioner i are near[start[i]:start[i + 1]]
    near: np.ndarray
    separation: np.ndarray  # separation of each pair, as in `Limits`
    o_start: np.ndarray
    o_near: np.ndarray
    clearance: np.ndarray  # clearance of each pair (arm, obstacle)
    obstacles: np.ndarray
    required: float  # clearance of all arms
    theta_low: np.ndarray
    theta_high: np.ndarray
    phi_low: np.ndarray  # limits of psi - theta
    phi_high: np.ndarray
    home: np.ndarray  # theta of the home pose, within the joint limits
    fold: np.ndarray  # psi - theta of the folded arm
    free: np.ndarray  # whether each arm can move


@kernel
def elbow_at(bodies, i, theta):
    """Return the position of the elbow of arm i."""
    return bodies.x[i] + bodies.l1[i] * math.cos(theta), bodies.y[i] + bodies.l1[i] * math.sin(theta)


@kernel
def speed_of(bodies, i, theta_rate, psi_rate):
    """Return the largest speed of a point of an arm, in mm per step."""
    eccentric = bodies.l1[i] * abs(theta_rate) + bodies.reach[i] * abs(psi_rate)
    return max(eccentric, bodies.central * abs(theta_rate))


@kernel
def segments_come_near(bodies, i, a, a_rate, p, p_rate, j, b, b_rate, q, q_rate, separation):
    """Return a distance of two segments that is at most ``separation + TOLERANCE``, or infinity if there is none.

    The arm of positioner i begins at theta = a and psi = p, and the arm of positioner j at theta = b and psi = q.
    """
    l1, k1, length, end = bodies.l1[i], bodies.l1[j], bodies.length[i], bodies.length[j]
    bend = a_rate * a_rate * l1 + p_rate * p_rate * length + b_rate * b_rate * k1 + q_rate * q_rate * end
    fast = abs(a_rate) * l1 + abs(p_rate) * length + abs(b_rate) * k1 + abs(q_rate) * end
    dx, dy = bodies.x[j] - bodies.x[i], bodies.y[j] - bodies.y[i]
    t = 0.0
    while True:
        # positions relative to the center of the first positioner
        c, s = math.cos(a + t * a_rate), math.sin(a + t * a_rate)
        ex, ey = l1 * c, l1 * s
        c, s = math.cos(b + t * b_rate), math.sin(b + t * b_rate)
        fx, fy = k1 * c, k1 * s
        c, s = math.cos(p + t * p_rate), math.sin(p + t * p_rate)
        px, py, qx, qy = bodies.inner[i] * c, bodies.inner[i] * s, length * c, length * s
        c, s = math.cos(q + t * q_rate), math.sin(q + t * q_rate)
        ux, uy, vx, vy = bodies.inner[j] * c, bodies.inner[j] * s, end * c, end * s
        gx, gy = dx + fx, dy + fy
        x, y = between(ex + px, ey + py, ex + qx, ey + qy, gx + ux, gy + uy, gx + vx, gy + vy)
        distance = math.sqrt(x * x + y * y)
        if not distance > separation + TOLERANCE:
            return distance if distance == distance else math.inf
        gap = distance - separation - ROUNDING
        if gap >= (1.0 - t) * fast:
            return math.inf
        # Along the direction (x, y), the gap is the smallest of the gaps of four pairs of ends; the second derivative
        # of each is at least -bend.
        x, y = x / distance, y / distance
        away = x * (gx - ex) + y * (gy - ey) - separation - ROUNDING
        rate = b_rate * (y * fx - x * fy) - a_rate * (y * ex - x * ey)
        p_along, q_along, u_along, v_along = x * px + y * py, x * qx + y * qy, x * ux + y * uy, x * vx + y * vy
        p_moves, q_moves = p_rate * (y * px - x * py), p_rate * (y * qx - x * qy)
        u_moves, v_moves = q_rate * (y * ux - x * uy), q_rate * (y * vx - x * vy)
        step = min(
            min(
                leaves(away + u_along - p_along, rate + u_moves - p_moves, bend),
                leaves(away + u_along - q_along, rate + u_moves - q_moves, bend),
            ),
            min(
                leaves(away + v_along - p_along, rate + v_moves - p_moves, bend),
                leaves(away + v_along - q_along, rate + v_moves - q_moves, bend),
            ),
        )
        t += max(step, gap / fast)
        if t >= 1.0:
            return math.inf


@kernel
def outlines_come_near(bodies, outline, i, a, a_rate, p, p_rate, j, b, b_rate, q, q_rate, separation):
    """Return a distance of two outlines that is at most ``separation + TOLERANCE``, or infinity if there is none.

    ``separation`` and the distance are those of the cores, as in `Limits`; the other parameters are those of
    `segments_come_near`.
    """
    fast = speed_of(bodies, i, a_rate, p_rate) + speed_of(bodies, j, b_rate, q_rate)
    ahead = max(LOOK_AHEAD * fast, 10.0 * TOLERANCE)
    length = 1.0 / outline.inverse_length
    t = 0.0
    while True:
        ax, ay = elbow_at(bodies, i, a + t * a_rate)
        bx, by = elbow_at(bodies, j, b + t * b_rate)
        px, py = length * math.cos(p + t * p_rate), length * math.sin(p + t * p_rate)
        qx, qy = length * math.cos(q + t * q_rate), length * math.sin(q + t * q_rate)
        squared = outlines_squared(
            outline, separation + ahead, i, j, ax, ay, ax + px, ay + py, bx, by, bx + qx, by + qy
        )
        distance = math.sqrt(squared)
        gap = min(distance - separation, ahead)
        if not gap > TOLERANCE:
            return distance if gap == gap else math.inf
        if not fast > 0.0:  # true for NaN, that is, for arms that are absent
            return math.inf
        t += (gap - ROUNDING) / fast
        if t >= 1.0:
            return math.inf


@kernel
def come_near(bodies, limits, i, a, a_rate, p, p_rate, j, b, b_rate, q, q_rate, separation):
    """Call the function for outlines or segments; ``separation`` is that of ``limits``, or larger."""
    if limits.outline.start.size > 1:
        return outlines_come_near(bodies, limits.outline, i, a, a_rate, p, p_rate, j, b, b_rate, q, q_rate, separation)
    return segments_come_near(bodies, i, a, a_rate, p, p_rate, j, b, b_rate, q, q_rate, separation)


@kernel
def comes_near_obstacle(bodies, limits, i, a, a_rate, p, p_rate, obstacles, j, clearance):
    """Return a distance of an arm from obstacle j that is at most ``clearance + TOLERANCE``, or infinity."""
    fast = speed_of(bodies, i, a_rate, p_rate)
    radius = obstacles[j, 2] if j < obstacles.shape[0] else 0.0
    inner, length = bodies.inner[i], bodies.length[i]
    t = 0.0
    while True:
        x, y = elbow_at(bodies, i, a + t * a_rate)
        c, s = math.cos(p + t * p_rate), math.sin(p + t * p_rate)
        ends = x + inner * c, y + inner * s, x + length * c, y + length * s
        distance = obstacle_distance(limits, obstacles, i, *ends, j) - radius
        if not distance - clearance > TOLERANCE:
            return distance if distance == distance else math.inf
        if fast == 0.0:
            return math.inf
        t += (distance - clearance - ROUNDING) / fast
        if t >= 1.0:
            return math.inf


@kernel
def pose_at(knots, k, t):
    """Return theta and psi at the time t, between the knots k and k + 1."""
    f = (t - knots.time[k]) / (knots.time[k + 1] - knots.time[k])
    theta, psi = knots.theta[k], knots.psi[k]
    return theta + f * (knots.theta[k + 1] - theta), psi + f * (knots.psi[k + 1] - psi)


@kernel
def paths_come_near(knots, bodies, limits, i, j, separation):
    """Return a distance of two arms on their paths that is at most ``separation + TOLERANCE``, or infinity."""
    k, m = knots.start[i], knots.start[j]
    a, p, b, q = knots.theta[k], knots.psi[k], knots.theta[m], knots.psi[m]
    while k < knots.stop[i] - 1 and m < knots.stop[j] - 1:
        t = min(knots.time[k + 1], knots.time[m + 1])
        next_a, next_p = pose_at(knots, k, t)
        next_b, next_q = pose_at(knots, m, t)
        distance = come_near(
            bodies, limits, i, a, next_a - a, p, next_p - p, j, b, next_b - b, q, next_q - q, separation
        )
        if distance < math.inf:
            return distance
        a, p, b, q = next_a, next_p, next_b, next_q
        k += knots.time[k + 1] <= t
        m += knots.time[m + 1] <= t
    return math.inf


@kernel
def find_near(knots, bodies, limits, pairs, separation, out):
    """Write a distance that is at most ``separation + TOLERANCE``, or infinity, for each pair of paths."""
    for k in range(pairs.shape[0]):
        out[k] = paths_come_near(knots, bodies, limits, pairs[k, 0], pairs[k, 1], separation)


@kernel
def obstacle_comes_near(knots, bodies, limits, i, obstacles, j, clearance):
    """Return a distance of an arm from obstacle j that is at most ``clearance + TOLERANCE``, or infinity."""
    for k in range(knots.start[i], knots.stop[i] - 1):
        a, p = knots.theta[k], knots.psi[k]
        a_rate, p_rate = knots.theta[k + 1] - a, knots.psi[k + 1] - p
        distance = comes_near_obstacle(bodies, limits, i, a, a_rate, p, p_rate, obstacles, j, clearance)
        if distance < math.inf:
            return distance
    return math.inf


@kernel
def find_near_obstacles(knots, bodies, limits, pairs, obstacles, clearance, out):
    """Write a distance that is at most ``clearance + TOLERANCE``, or infinity, for each pair (arm, obstacle)."""
    for n in range(pairs.shape[0]):
        out[n] = obstacle_comes_near(knots, bodies, limits, pairs[n, 0], obstacles, pairs[n, 1], clearance)


@kernel
def keeps_apart(knots, bodies, limits, around, i):
    """Return whether arm i comes near to no neighbor and no obstacle on its path."""
    for n in range(around.start[i], around.start[i + 1]):
        if paths_come_near(knots, bodies, limits, i, around.near[n], limits.separation) < math.inf:
            return False
    for n in range(around.o_start[i], around.o_start[i + 1]):
        j = around.o_near[n]
        if obstacle_comes_near(knots, bodies, limits, i, around.obstacles, j, around.required) < math.inf:
            return False
    return True


@kernel
def thin(knots, i, tolerance, keep, stack):
    """Mark the knots of arm i that remain if angles change by at most ``tolerance`` (Douglas and Peucker 1973)."""
    first, last = knots.start[i], knots.stop[i] - 1
    keep[: last - first + 1] = False
    keep[0] = keep[last - first] = True
    stack[0, 0], stack[0, 1] = first, last
    n = 1
    while n > 0:
        n -= 1
        low, high = stack[n, 0], stack[n, 1]
        worst, at = tolerance, -1
        for k in range(low + 1, high):
            f = (knots.time[k] - knots.time[low]) / (knots.time[high] - knots.time[low])
            theta = knots.theta[low] + f * (knots.theta[high] - knots.theta[low])
            psi = knots.psi[low] + f * (knots.psi[high] - knots.psi[low])
            away = max(abs(knots.theta[k] - theta), abs(knots.psi[k] - psi))
            if away > worst:
                worst, at = away, k
        if at >= 0:
            keep[at - first] = True
            stack[n, 0], stack[n, 1], stack[n + 1, 0], stack[n + 1, 1] = low, at, at, high
            n += 2


@kernel
def simplify(knots, bodies, limits, around, tolerances):
    """Remove knots of each path in place, with the first tolerance with which the arm comes near to nothing."""
    size = np.max(knots.stop - knots.start)
    keep, stack = np.empty(size, np.bool_), np.empty((size + 1, 2), np.int64)
    saved = np.empty((3, size))
    for i in range(knots.start.size):
        first, count = knots.start[i], knots.stop[i] - knots.start[i]
        rows = slice(first, first + count)
        saved[0, :count], saved[1, :count], saved[2, :count] = knots.time[rows], knots.theta[rows], knots.psi[rows]
        for tolerance in tolerances:
            if count <= 2:
                break
            thin(knots, i, tolerance, keep, stack)
            kept = first
            for k in range(count):
                if keep[k]:
                    knots.time[kept], knots.theta[kept], knots.psi[kept] = saved[0, k], saved[1, k], saved[2, k]
                    kept += 1
            knots.stop[i] = kept
            if keeps_apart(knots, bodies, limits, around, i):
                break
            knots.time[rows], knots.theta[rows], knots.psi[rows] = saved[0, :count], saved[1, :count], saved[2, :count]
            knots.stop[i] = first + count
