"""Paths of all arms to their folded poses, in short steps in which each arm moves toward its fold, waits or gives way.

In each step, the arms decide in turn. A motion is possible if the arm comes near to no neighbor: neighbors that have
decided move during the step, and the others remain where they are. Therefore, each arm can always wait. An arm whose
motion toward its fold is not possible takes the best of nine motions (both joints forward, backward or at rest), by a
cost that increases with the remaining angle of phi and with the proximity of neighbors. Neighbors that are in its way
also choose by this cost for some steps, even if they are folded.
"""

import math

import numpy as np

from rfpsurvey._kernels.collisions import obstacle_distance, pair_squared
from rfpsurvey._kernels.jit import kernel
from rfpsurvey._kernels.joint_motion import come_near, comes_near_obstacle, speed_of
from rfpsurvey._kernels.motion import TOLERANCE
from rfpsurvey._kernels.outlines import outlines_squared

# Number of steps for which gaps are known in advance.
LOOK_AHEAD = 20.0


@kernel
def locate(bodies, theta, psi, k, segments, column):
    """Write the ends of the segment, or of the core of the outline, of arm k."""
    x = bodies.x[k] + bodies.l1[k] * math.cos(theta)
    y = bodies.y[k] + bodies.l1[k] * math.sin(theta)
    c, s = math.cos(psi), math.sin(psi)
    segments[0, column], segments[1, column] = x + bodies.inner[k] * c, y + bodies.inner[k] * s
    segments[2, column], segments[3, column] = x + bodies.length[k] * c, y + bodies.length[k] * s


@kernel
def locate_all(bodies, theta, psi, segments):
    """Write the ends of the segments of all arms."""
    for i in range(theta.size):
        locate(bodies, theta[i], psi[i], i, segments, i)


@kernel
def distance_at_rest(segments, limits, a, i, b, j, ahead):
    """Return the distance of the arms in columns a and b, of positioners i and j; infinity if it exceeds ``ahead``."""
    if limits.outline.start.size > 1:
        ax, ay, bx, by = segments[0, a], segments[1, a], segments[2, a], segments[3, a]
        cx, cy, dx, dy = segments[0, b], segments[1, b], segments[2, b], segments[3, b]
        return math.sqrt(outlines_squared(limits.outline, ahead, i, j, ax, ay, bx, by, cx, cy, dx, dy))
    return math.sqrt(pair_squared(segments, a, b))


@kernel
def swept_in(bodies, i, step):
    """Return the largest distance by which a point of arm i moves if both joints rotate by ``step``."""
    return step * max(bodies.l1[i] + 2.0 * bodies.reach[i], bodies.central)


@kernel
def blocked_by(bodies, limits, around, state, i, turn, psi_turn, gaps):
    """Return the neighbor that arm i would come near to, or -2 for an obstacle, or -1 if the motion is possible."""
    theta, psi, rate, psi_rate, decided = state
    speed = speed_of(bodies, i, turn, psi_turn)
    for n in range(around.start[i], around.start[i + 1]):
        j = around.near[n]
        other = speed_of(bodies, j, rate[j], psi_rate[j]) if decided[j] else 0.0
        if gaps[n - around.start[i]] - around.separation[n] > speed + other + TOLERANCE:
            continue
        moves_j = (rate[j], psi_rate[j]) if decided[j] else (0.0, 0.0)
        motion = theta[i], turn, psi[i], psi_turn, j, theta[j], moves_j[0], psi[j], moves_j[1]
        if come_near(bodies, limits, i, *motion, around.separation[n]) < math.inf:
            return j
    for n in range(around.o_start[i], around.o_start[i + 1]):
        motion_of_arm = theta[i], turn, psi[i], psi_turn, around.obstacles, around.o_near[n]
        if comes_near_obstacle(bodies, limits, i, *motion_of_arm, around.clearance[n]) < math.inf:
            return -2
    return -1


@kernel
def nearness(bodies, limits, around, state, i, turn, psi_turn, segments, gaps, wide):
    """Return the sum over the neighbors of arm i of (1 - gap / wide)^2, for gaps below ``wide`` (mm) after a motion.

    ``gaps`` contains lower limits of the distances before the motion.
    """
    theta, psi, _, _, _ = state
    last = segments.shape[1] - 1
    locate(bodies, theta[i] + turn, psi[i] + psi_turn, i, segments, last)
    total, speed = 0.0, speed_of(bodies, i, turn, psi_turn)
    for n in range(around.start[i], around.start[i + 1]):
        j = around.near[n]
        if gaps[n - around.start[i]] - around.separation[n] > wide + speed:
            continue
        gap = distance_at_rest(segments, limits, last, i, j, j, around.separation[n] + wide) - around.separation[n]
        if gap < wide:
            total += (1.0 - max(gap, 0.0) / wide) ** 2
    return total


@kernel
def walk(bodies, limits, around, theta, psi, order, step, n_steps, patience, n_pressed, wide, noise, weight, rng):
    """Move all arms toward their folded poses; return the knots of all paths and the number of steps.

    ``theta`` and ``psi`` are the initial poses, which are replaced by the final poses. The walk ends when all arms are
    folded, after ``n_steps`` steps, or if the sum of the remaining angles does not decrease in ``patience`` steps.
    Neighbors that block an arm give way during ``n_pressed`` steps. In the cost of a motion, neighbors with a gap below
    ``wide`` (mm) count, and a random number between 0 and ``noise`` is added. If ``weight`` is not 0, the arms also
    turn to their home poses, and the cost increases by ``weight`` per step of theta that remains.
    """
    n = theta.size
    rate, psi_rate = np.zeros(n), np.zeros(n)
    before, psi_before = np.full(n, np.nan), np.full(n, np.nan)
    decided = np.zeros(n, np.bool_)
    pressed = np.zeros(n, np.int64)  # steps in which an arm still gives way
    segments = np.empty((4, n + 1))
    widest = 0
    for i in range(n):
        locate(bodies, theta[i], psi[i], i, segments, i)
        widest = max(widest, around.start[i + 1] - around.start[i])
    gaps = np.empty(widest)
    known, known_at = np.full(around.near.size, -np.inf), np.zeros(around.near.size, np.int64)
    size = 4 * n + 1024
    owner, when = np.empty(size, np.int64), np.empty(size)
    where = np.empty((2, size))
    used = 0
    state = theta, psi, rate, psi_rate, decided
    best, since = math.inf, 0
    done = 0
    for t in range(n_steps + 1):
        left, remaining = 0, 0.0
        for i in range(n):
            decided[i] = not around.free[i]
            rate[i] = psi_rate[i] = 0.0
            off = abs(around.fold[i] - (psi[i] - theta[i]))
            if weight > 0.0:
                off += abs(around.home[i] - theta[i])
            if around.free[i] and off > 1e-9:
                left += 1
                remaining += off
        since = 0 if remaining < best - 1e-9 else since + 1
        best = min(best, remaining)
        done = t
        if left > 0 and since <= patience and t < n_steps:
            for i in order:
                if decided[i]:
                    continue
                phi = psi[i] - theta[i]
                off = around.fold[i] - phi
                away = around.home[i] - theta[i] if weight > 0.0 else 0.0
                if abs(off) <= 1e-9 and abs(away) <= 1e-9 and pressed[i] == 0:
                    decided[i] = True
                    continue
                toward, back = min(max(off, -step), step), min(max(away, -step), step)
                for k in range(around.start[i], around.start[i + 1]):
                    j = around.near[k]
                    # no gap shrinks by more than this in a step; a gap is computed again when it could be too small
                    most = swept_in(bodies, i, step) + swept_in(bodies, j, step)
                    gap = known[k] - (t - known_at[k]) * most
                    if not gap > around.separation[k] + most + TOLERANCE:
                        ahead = around.separation[k] + LOOK_AHEAD * most
                        distance = distance_at_rest(segments, limits, i, i, j, j, ahead)
                        gap = known[k] = distance if distance < math.inf else ahead  # also for NaN
                        known_at[k] = t
                    gaps[k - around.start[i]] = gap
                choose = pressed[i] > 0
                if not choose:
                    blocker = blocked_by(bodies, limits, around, state, i, back, back + toward, gaps)
                    if blocker == -1:
                        rate[i], psi_rate[i] = back, back + toward
                    else:
                        choose = True
                        if blocker >= 0:
                            pressed[blocker] = n_pressed
                if choose:
                    lowest = math.inf
                    for u in range(3):
                        # near its limit, an arm turns exactly to the limit
                        turn = min(max(theta[i] + step * (u - 1), around.theta_low[i]), around.theta_high[i]) - theta[i]
                        if abs(back) < step and turn * back > 0.0:
                            turn = back
                        for v in range(3):
                            bend = toward if v == 1 else (0.0 if v == 0 else -math.copysign(step, off))
                            if v == 1 and toward == 0.0:
                                continue
                            if not around.phi_low[i] - 1e-9 <= phi + bend <= around.phi_high[i] + 1e-9:
                                continue
                            cost = (abs(off - bend) + weight * abs(away - turn)) / step + noise * rng.random()
                            if cost < lowest:
                                motion = state, i, turn, turn + bend
                                cost += nearness(bodies, limits, around, *motion, segments, gaps, wide)
                                if cost < lowest and blocked_by(bodies, limits, around, *motion, gaps) == -1:
                                    lowest, rate[i], psi_rate[i] = cost, turn, turn + bend
                    pressed[i] = max(pressed[i] - 1, 0)
                decided[i] = True
        for i in range(n):
            last = left == 0 or since > patience or t == n_steps
            if rate[i] != before[i] or psi_rate[i] != psi_before[i] or last:
                if used == size:
                    size *= 2
                    more, more_when, more_where = np.empty(size, np.int64), np.empty(size), np.empty((2, size))
                    more[:used], more_when[:used], more_where[:, :used] = owner, when, where
                    owner, when, where = more, more_when, more_where
                owner[used], when[used], where[0, used], where[1, used] = i, t, theta[i], psi[i]
                used += 1
            before[i], psi_before[i] = rate[i], psi_rate[i]
            if rate[i] != 0.0 or psi_rate[i] != 0.0:
                theta[i] += rate[i]
                psi[i] += psi_rate[i]
                locate(bodies, theta[i], psi[i], i, segments, i)
        if left == 0 or since > patience:
            break
    return owner[:used], when[:used], where[:, :used], done


@kernel
def keep_separations(segments, limits, start, near, margin, out):
    """Compute the separation of each pair of neighbors with which paths are planned.

    It is the minimum separation plus ``margin``, or less if two arms are closer at the beginning.
    """
    for i in range(start.size - 1):
        for n in range(start[i], start[i + 1]):
            j = near[n]
            distance = distance_at_rest(segments, limits, i, i, j, j, limits.separation + 2.0 * margin)
            out[n] = limits.separation
            if distance == distance:
                out[n] = max(min(limits.separation + margin, distance - 2.0 * TOLERANCE), limits.separation)


@kernel
def place_idle(bodies, limits, around, rows, bends, wide, theta, psi, segments, gap):
    """Choose a pose of each of the idle arms ``rows``: folded if possible, and as far from other arms as possible.

    Poses are tried in 24 directions from that of ``theta``, within the joint limits, for each angle of ``bends`` by
    which the arm is less folded. The gap of a pose is the smallest of those to other arms and obstacles; gaps of
    ``wide`` or more are not distinguished. The poses, their segments and gaps are written to the last arrays; the
    segments of these arms must be NaN before.
    """
    last = segments.shape[1] - 1
    low, high, fold, obstacles = around.theta_low, around.theta_high, around.fold, around.obstacles
    for i in rows:
        home = theta[i]
        gap[i] = -math.inf
        for bend in bends:
            for way in range(24):
                if gap[i] >= wide:
                    break
                a = low[i] + (home + way * math.pi / 12.0 - low[i]) % (2.0 * math.pi)
                if a > high[i]:
                    continue
                p = a + fold[i] - math.copysign(bend, fold[i])
                locate(bodies, a, p, i, segments, last)
                least = wide
                for n in range(around.start[i], around.start[i + 1]):
                    j = around.near[n]
                    distance = distance_at_rest(segments, limits, last, i, j, j, limits.separation + wide)
                    if distance - limits.separation < least:  # false for NaN
                        least = distance - limits.separation
                ends = segments[0, last], segments[1, last], segments[2, last], segments[3, last]
                for n in range(around.o_start[i], around.o_start[i + 1]):
                    j = around.o_near[n]
                    radius = obstacles[j, 2] if j < obstacles.shape[0] else 0.0
                    away = obstacle_distance(limits, obstacles, i, *ends, j) - radius
                    least = min(least, away - around.required)
                if least > gap[i]:
                    gap[i], theta[i], psi[i] = least, a, p
            if gap[i] > 0.1 * wide:
                break
        locate(bodies, theta[i], psi[i], i, segments, i)
