"""Arms that unfold at the same time: whether two arms, or an arm and an obstacle, collide at any time of the motion.

While arms unfold, elbows are fixed, and each eccentric arm rotates around its elbow from its folded direction to its
direction at the target. The functions begin at the target and follow the motion backward (folding is the exact time
reversal of unfolding). From the gap at one time, they compute a step during which the gap certainly remains larger than
the minimum separation (conservative advancement), until the arms are folded, or the gap exceeds the minimum separation
by less than ``TOLERANCE``. Arms that never collide according to this test are therefore never closer than the minimum
separation, and arms that collide are closer than the minimum separation plus ``TOLERANCE`` at some time.
"""

import math
from typing import NamedTuple

import numpy as np

from rfpsurvey._kernels.collisions import Limits, obstacle_distance, orientation, outlined_squared, pair_squared
from rfpsurvey._kernels.jit import kernel
from rfpsurvey._kernels.outlines import outlines_squared

# Gaps that exceed the minimum separation by less than this length (mm) count as collisions.
TOLERANCE = 1e-6
# Length (mm) by which a step underestimates the gap; it exceeds all rounding errors of positions and gaps.
ROUNDING = 1e-9
# Largest gap of outlines that is computed, as a fraction of the path of the fastest points of both arms.
LOOK_AHEAD = 0.1


class Moves(NamedTuple):
    """The motion of each arm, from its target to its folded direction; NaN for arms that are absent.

    The segment that can collide, or the core of an outline, begins at the distance ``inner`` from the elbow and ends at
    the distance ``length``.
    """

    x: np.ndarray  # position of the elbow, mm
    y: np.ndarray
    angle: np.ndarray  # direction of the segment at the target, in radians
    turn: np.ndarray  # angle from there to the direction of the folded arm, in radians; 0 for arms that do not move
    inner: np.ndarray
    length: np.ndarray
    reach: np.ndarray  # largest distance of a part of the eccentric arm from the elbow, mm
    circle: np.ndarray  # center and radius of a circle that contains the arm during the motion, shape (3, n)
    sector: np.ndarray  # direction of the axis of the swept sector, cosine and sine of half its angle, shape (4, n)


@kernel
def enclose(x, y, angle, turn, reach, circle, sector):
    """Compute the sectors of all points within ``reach`` of the elbow in the directions of the motion, and circles."""
    for k in range(x.size):
        half = 0.5 * abs(turn[k])
        # a sector is contained in a circle through its tip and the ends of its arc, or in a circle around its chord
        along, radius = 0.0, reach[k]
        if half <= 0.25 * math.pi:
            along = radius = 0.5 * reach[k] / math.cos(half)
        elif half < 0.5 * math.pi:
            along, radius = reach[k] * math.cos(half), reach[k] * math.sin(half)
        middle = angle[k] + 0.5 * turn[k]
        circle[0, k], circle[1, k] = x[k] + along * math.cos(middle), y[k] + along * math.sin(middle)
        circle[2, k] = radius
        half = min(half, math.pi)
        sector[0, k], sector[1, k] = math.cos(middle), math.sin(middle)
        sector[2, k], sector[3, k] = math.cos(half), math.sin(half)


@kernel
def extent(ux, uy, mx, my, c, s, reach):
    """Return how far a sector extends in the direction u; its axis is m, and c and s belong to half its angle."""
    along, across = ux * mx + uy * my, abs(ux * my - uy * mx)
    return reach if along >= c else max(reach * (along * c + across * s), 0.0)


@kernel
def sectors_apart(moves, a, b, x, y, limit):
    """Return whether the sectors that two arms sweep are farther apart than ``limit`` along the direction (x, y)."""
    inverse = 1.0 / math.sqrt(x * x + y * y)
    ux, uy, v = x * inverse, y * inverse, moves.sector
    extent_a = extent(ux, uy, v[0, a], v[1, a], v[2, a], v[3, a], moves.reach[a])
    extent_b = extent(-ux, -uy, v[0, b], v[1, b], v[2, b], v[3, b], moves.reach[b])
    return (moves.x[b] - moves.x[a]) * ux + (moves.y[b] - moves.y[a]) * uy - extent_a - extent_b > limit


@kernel
def to_segment(px, py, ax, ay, bx, by):
    """Return the vector from the point p to the nearest point of the segment a-b."""
    ux, uy, vx, vy = bx - ax, by - ay, ax - px, ay - py
    length2 = ux * ux + uy * uy
    t = 0.0
    if length2 > 0.0:
        t = min(max(-(vx * ux + vy * uy) / length2, 0.0), 1.0)
    return vx + t * ux, vy + t * uy


@kernel
def between(ax, ay, bx, by, cx, cy, dx, dy):
    """Return the shortest vector from the segment a-b to the segment c-d; (0, 0) if the segments cross."""
    x, y = to_segment(ax, ay, cx, cy, dx, dy)
    least = x * x + y * y
    u, v = to_segment(bx, by, cx, cy, dx, dy)
    if u * u + v * v < least:
        x, y, least = u, v, u * u + v * v
    u, v = to_segment(cx, cy, ax, ay, bx, by)
    if u * u + v * v < least:
        x, y, least = -u, -v, u * u + v * v
    u, v = to_segment(dx, dy, ax, ay, bx, by)
    if u * u + v * v < least:
        x, y, least = -u, -v, u * u + v * v
    if (
        orientation(ax, ay, bx, by, cx, cy) * orientation(ax, ay, bx, by, dx, dy) < 0
        and orientation(cx, cy, dx, dy, ax, ay) * orientation(cx, cy, dx, dy, bx, by) < 0
    ):
        return 0.0, 0.0
    return x, y


@kernel
def leaves(gap, rate, bend):
    """Return the time for which gap + rate t - bend t^2 / 2 certainly remains positive; the bend must be positive."""
    if not gap > 0.0:  # along an uncertain direction, the gap of long arms can be negative
        return 0.0
    root = math.sqrt(rate * rate + 2.0 * bend * gap)
    return (rate + root) / bend if rate > 0.0 else 2.0 * gap / (root - rate)


@kernel
def segments_meet(ax, ay, a, a_turn, a_inner, a_length, bx, by, b, b_turn, b_inner, b_length, separation):
    """Return whether two segments are closer than ``separation + TOLERANCE`` at any time of their rotation.

    The first segment rotates around (ax, ay), from the direction ``a`` by the angle ``a_turn``; its ends are at the
    distances ``a_inner`` and ``a_length`` from this point. Both segments rotate at constant rates in the same time.
    """
    fast, bend = abs(a_turn) * a_length + abs(b_turn) * b_length, a_turn**2 * a_length + b_turn**2 * b_length
    t = 0.0
    while True:
        c, s = math.cos(a + t * a_turn), math.sin(a + t * a_turn)
        px, py, qx, qy = a_inner * c, a_inner * s, a_length * c, a_length * s
        c, s = math.cos(b + t * b_turn), math.sin(b + t * b_turn)
        ux, uy, vx, vy = b_inner * c, b_inner * s, b_length * c, b_length * s
        x, y = between(ax + px, ay + py, ax + qx, ay + qy, bx + ux, by + uy, bx + vx, by + vy)
        distance = math.sqrt(x * x + y * y)
        if not distance > separation + TOLERANCE:
            return distance == distance
        gap = distance - separation - ROUNDING
        if gap >= (1.0 - t) * fast:
            return False
        # Along the direction (x, y), the gap is that of two ends; its second derivative is at least -bend.
        x, y = x / distance, y / distance
        ex, ey, separated = bx - ax, by - ay, separation + ROUNDING
        p, q, u, v = x * px + y * py, x * qx + y * qy, x * ux + y * uy, x * vx + y * vy
        away = x * ex + y * ey - separated
        rate_p, rate_q = a_turn * (y * px - x * py), a_turn * (y * qx - x * qy)
        rate_u, rate_v = b_turn * (y * ux - x * uy), b_turn * (y * vx - x * vy)
        step = min(
            min(leaves(away + u - p, rate_u - rate_p, bend), leaves(away + u - q, rate_u - rate_q, bend)),
            min(leaves(away + v - p, rate_v - rate_p, bend), leaves(away + v - q, rate_v - rate_q, bend)),
        )
        t += max(step, gap / fast)
        if t >= 1.0:
            return False


@kernel
def outlines_meet(ax, ay, a, a_turn, bx, by, b, b_turn, reach, limits, i, j):
    """Return whether the outlines of positioners i and j are closer than the minimum separation at any time.

    The parameters are those of `segments_meet`; ``reach`` is the largest distance of a part of an eccentric arm from
    its elbow.
    """
    fast = (abs(a_turn) + abs(b_turn)) * reach
    outline = limits.outline
    length = 1.0 / outline.inverse_length
    ahead = max(LOOK_AHEAD * fast, 10.0 * TOLERANCE)
    t = 0.0
    while True:
        ac, as_ = length * math.cos(a + t * a_turn), length * math.sin(a + t * a_turn)
        bc, bs = length * math.cos(b + t * b_turn), length * math.sin(b + t * b_turn)
        enough = limits.separation + ahead
        squared = outlines_squared(outline, enough, i, j, ax, ay, ax + ac, ay + as_, bx, by, bx + bc, by + bs)
        gap = min(math.sqrt(squared) - limits.separation, ahead)
        if not gap > TOLERANCE:
            return gap == gap
        if fast == 0.0:
            return False
        t += (gap - ROUNDING) / fast
        if t >= 1.0:
            return False


@kernel
def arms_meet(ax, ay, a, a_turn, a_inner, a_length, bx, by, b, b_turn, b_inner, b_length, reach, limits, i, j):
    """Return whether two arms collide at any time of a rotation at constant rates, for arms with or without outlines.

    All outlines have the same ``reach``, which is not required for other arms.
    """
    if limits.outline.start.size > 1:
        return outlines_meet(ax, ay, a, a_turn, bx, by, b, b_turn, reach, limits, i, j)
    return segments_meet(ax, ay, a, a_turn, a_inner, a_length, bx, by, b, b_turn, b_inner, b_length, limits.separation)


@kernel
def pair_meets(moves, a, b, same_speed, limits, i, j):
    """Return whether the arms a and b, of the positioners i and j, collide while they unfold.

    Both arms take the same time or, if ``same_speed`` is true, begin to unfold at the same time with the same speed.
    """
    at_a, reach = (moves.x[a], moves.y[a]), moves.reach[a]
    at_b = (moves.x[b], moves.y[b])
    a_angle, a_turn, a_inner, a_length = moves.angle[a], moves.turn[a], moves.inner[a], moves.length[a]
    b_angle, b_turn, b_inner, b_length = moves.angle[b], moves.turn[b], moves.inner[b], moves.length[b]
    if same_speed and a_turn != 0.0 and b_turn != 0.0:
        # the arm with the longer way moves alone at first
        a_first = math.copysign(max(abs(a_turn) - abs(b_turn), 0.0), a_turn)
        b_first = math.copysign(max(abs(b_turn) - abs(a_turn), 0.0), b_turn)
        if arms_meet(
            *at_a, a_angle, a_first, a_inner, a_length, *at_b, b_angle, b_first, b_inner, b_length, reach, limits, i, j
        ):
            return True
        a_angle, a_turn, b_angle, b_turn = a_angle + a_first, a_turn - a_first, b_angle + b_first, b_turn - b_first
    return arms_meet(
        *at_a, a_angle, a_turn, a_inner, a_length, *at_b, b_angle, b_turn, b_inner, b_length, reach, limits, i, j
    )


@kernel
def list_meeting(pairs, p, start, moves, same_speed, limits, first, second):
    """List the candidates of each pair of neighbors that collide while they unfold, beginning with the pair p.

    Returns the number of listed pairs of candidates, and the index of the first pair of neighbors for which there was
    no space in the lists. Candidate k of positioner i has an index from ``start[i]`` to ``start[i + 1] - 1``.
    """
    outlined = limits.outline.start.size > 1
    n, limit = 0, limits.separation - limits.outline.offset + TOLERANCE
    x, y, radius = moves.circle[0], moves.circle[1], moves.circle[2]
    size = 0
    for i in range(start.size - 1):
        size = max(size, start[i + 1] - start[i])
    near = np.empty(size, np.bool_)
    while p < pairs.shape[0]:
        i, j = pairs[p, 0], pairs[p, 1]
        a0, a1, b0, b1 = start[i], start[i + 1], start[j], start[j + 1]
        if n + (a1 - a0) * (b1 - b0) > first.size:
            break
        p += 1
        for a in range(a0, a1):
            for b in range(b0, b1):
                dx, dy, far = x[b] - x[a], y[b] - y[a], radius[a] + radius[b] + limit
                near[b - b0] = dx * dx + dy * dy <= far * far
            for b in range(b0, b1):
                if not near[b - b0]:
                    continue
                if not outlined:
                    if sectors_apart(moves, a, b, x[b] - x[a], y[b] - y[a], limit):
                        continue
                    if sectors_apart(moves, a, b, moves.x[b] - moves.x[a], moves.y[b] - moves.y[a], limit):
                        continue
                if pair_meets(moves, a, b, same_speed, limits, i, j):
                    first[n], second[n] = a, b
                    n += 1
    return n, p


@kernel
def count_meeting(pairs, start, moves, same_speed, limits, counts):
    """Count the candidates that collide with the folded arm of each positioner, for several directions of this arm.

    The folded arm of positioner i with direction k follows all candidates in ``moves``. The shape of ``counts`` is
    (number of positioners, number of directions).
    """
    outlined = limits.outline.start.size > 1
    limit = limits.separation - limits.outline.offset + TOLERANCE
    x, y, radius = moves.circle[0], moves.circle[1], moves.circle[2]
    counts[:] = 0
    for p in range(pairs.shape[0]):
        for swap in range(2):
            i, j = pairs[p, swap], pairs[p, 1 - swap]
            for k in range(counts.shape[1]):
                a = start[-1] + i * counts.shape[1] + k
                for b in range(start[j], start[j + 1]):
                    dx, dy, far = x[b] - x[a], y[b] - y[a], radius[a] + radius[b] + limit
                    near = dx * dx + dy * dy <= far * far
                    if near and (outlined or not sectors_apart(moves, a, b, dx, dy, limit)):
                        counts[i, k] += pair_meets(moves, a, b, same_speed, limits, i, j)


@kernel
def obstacle_meets(moves, k, limits, obstacles, clearance, i, j):
    """Return whether arm k, of positioner i, collides with obstacle j while it unfolds."""
    x, y, turn, inner, length = moves.x[k], moves.y[k], moves.turn[k], moves.inner[k], moves.length[k]
    fast = abs(turn) * moves.reach[k]
    limit = clearance + (obstacles[j, 2] if j < obstacles.shape[0] else 0.0)
    t = 0.0
    while True:
        c, s = math.cos(moves.angle[k] + t * turn), math.sin(moves.angle[k] + t * turn)
        distance = obstacle_distance(
            limits, obstacles, i, x + inner * c, y + inner * s, x + length * c, y + length * s, j
        )
        if not distance - limit > TOLERANCE:
            return distance == distance
        if fast == 0.0:
            return False
        t += (distance - limit - ROUNDING) / fast
        if t >= 1.0:
            return False


@kernel
def obstacles_meeting(moves, owner, limits, pairs, obstacles, clearance, out):
    """Mark the pairs (arm, obstacle) that collide while the arm unfolds, in ``out``."""
    for k in range(pairs.shape[0]):
        a, j = pairs[k, 0], pairs[k, 1]
        out[k] = obstacle_meets(moves, a, limits, obstacles, clearance, owner[a], j)


@kernel
def gaps_to_one(segments, k, i, j, ahead, limits, out):
    """Compute the distance from the arms ``segments[:, :k]``, of positioner i, to the arm k, of positioner j.

    The distance of outlines is infinity if it exceeds the minimum separation by more than ``ahead``.
    """
    wide = Limits(limits.separation + ahead, limits.slack, limits.near, limits.band, limits.outline, limits.polygons)
    for a in range(k):
        if limits.outline.start.size > 1:
            out[a] = math.sqrt(outlined_squared(segments, a, k, wide, i, j)) - limits.outline.offset
        else:
            out[a] = math.sqrt(pair_squared(segments, a, k))


@kernel
def gaps_to_obstacle(segments, i, j, limits, obstacles, out):
    """Compute the distance from arms of positioner i to the edge of obstacle j."""
    for a in range(out.size):
        ends = segments[0, a], segments[1, a], segments[2, a], segments[3, a]
        out[a] = obstacle_distance(limits, obstacles, i, *ends, j)
        if j < obstacles.shape[0]:
            out[a] -= obstacles[j, 2]
