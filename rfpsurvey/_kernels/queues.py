"""Collision probabilities of positioners that draw their poses from queues, and areas of patrol annuli.

The poses in a queue are called its entries. One entry of each queue is in use, with a probability proportional to its
weight, independent of all other queues. For a given entry of a positioner, collisions with different neighbors are
therefore independent, and the probability of no collision is a product over the neighbors.
"""

import math
from typing import NamedTuple

import numpy as np

from rfpsurvey._kernels.arms import CAPSULE, FIBER_TIP, capsule_end, elbow
from rfpsurvey._kernels.collisions import (
    halve,
    keep_near,
    obstacle_distance,
    outlined_squared,
    pair_squared,
    project,
    squared_limit,
)
from rfpsurvey._kernels.jit import kernel

# Number of pairs of entries that are tested together.
BATCH = 2048


class Entries(NamedTuple):
    """Entries of all queues, and arrays for results; the entries of positioner i are ``start[i]:stop[i]``."""

    start: np.ndarray
    stop: np.ndarray
    segments: np.ndarray
    halves: np.ndarray
    weight: np.ndarray
    total: np.ndarray  # sum of the weights of the entries of each queue
    free: np.ndarray  # probability that the pose of an entry does not collide if the entry is in use
    hit: np.ndarray  # sum of the weights of the entries of one neighbor that collide with each entry; work array
    ahead: np.ndarray  # coordinate of the extreme point of each entry along the line between two centers


class Expected(NamedTuple):
    """Arrays to which kernels write probabilities, and to which they add the values of all realizations."""

    probability: np.ndarray  # collision probability of each positioner in the last realization
    pair_probability: np.ndarray  # collision probability of each pair of neighbors in the last realization
    times: np.ndarray  # for each positioner, the sum of its collision probabilities while it is counted
    counted: np.ndarray  # for each positioner, the number of realizations in which it is counted


@kernel
def place_queues(realization, positioners, setup, segments):
    """Compute the segments of the entries of all queues, one queue after the other."""
    g, indptr, queue = positioners.geometry, realization.queues, realization.queue
    x, y, model, length = realization.x, realization.y, setup.model, setup.length
    ex, ey, tx, ty = segments[0], segments[1], segments[2], segments[3]
    for k in range(indptr[-1]):
        tx[k], ty[k] = x[queue[k]], y[queue[k]]
    for i in range(indptr.size - 1):
        cx, cy, l1, l2, elbow_side = g.cx[i], g.cy[i], g.l1[i], g.l2[i], positioners.side[i]
        for k in range(indptr[i], indptr[i + 1]):
            dx, dy, _, _ = elbow(tx[k] - cx, ty[k] - cy, l1, l2, elbow_side, g.home_x, g.home_y)
            ex[k], ey[k] = cx + dx, cy + dy
        if model == CAPSULE:
            for k in range(indptr[i], indptr[i + 1]):
                tx[k], ty[k] = capsule_end(ex[k], ey[k], tx[k], ty[k], length, setup.cosine[i], setup.sine[i])
        elif model == FIBER_TIP:
            for k in range(indptr[i], indptr[i + 1]):
                ex[k], ey[k] = tx[k], ty[k]


@kernel
def prepare_entries(indptr, idle, entries):
    """Set the start and end of each queue, and compute the fields that depend on the segments and weights.

    ``entries.segments`` must already contain the segments of the queues; this function appends the segments of idle
    arms. If the queue of a positioner contains no targets and its idle arm is an obstacle, the idle arm is the only
    entry of the queue.
    """
    n, m = indptr.size - 1, indptr[-1]
    for i in range(n):
        empty = indptr[i] == indptr[i + 1]
        obstacle = idle[0, i] == idle[0, i]  # false for NaN
        entries.start[i] = m + i if empty else indptr[i]
        entries.stop[i] = m + i + (1 if obstacle else 0) if empty else indptr[i + 1]
        for row in range(4):
            entries.segments[row, m + i] = idle[row, i]
        entries.weight[m + i] = 1.0
        entries.total[i] = 0.0
        for k in range(entries.start[i], entries.stop[i]):
            entries.total[i] += entries.weight[k]
    used = m + n
    halve(entries.segments[:, :used], entries.halves[:, :used])
    for k in range(used):
        entries.free[k] = 1.0


@kernel
def expect(pairs, geometry, setup, entries, expected):
    """Compute the collision probability of each positioner and of each pair of positioners.

    The probability of a positioner without entries is NaN. Entries are first compared in the projection on the line
    between the centers of the two positioners: their separation along this line is a lower limit of their distance. An
    entry is skipped if its separation along this line from every entry of the other positioner is too large for a
    collision. This function is not divided, because passing the arrays to a second function takes longer than testing
    short queues.
    """
    limits, obstacle_pairs, obstacles = setup.limits, setup.obstacle_pairs, setup.obstacles
    probability, pair_probability = expected.probability, expected.pair_probability
    segments, halves, weight, total = entries.segments, entries.halves, entries.weight, entries.total
    free, hit, ahead = entries.free, entries.hit, entries.ahead
    longest = (entries.stop - entries.start).max()
    near, marks = np.empty(longest, np.int64), np.empty(longest, np.bool_)
    mid_x, mid_y, back = np.empty(longest), np.empty(longest), np.empty(longest)
    first, second = np.empty(BATCH + longest, np.int64), np.empty(BATCH + longest, np.int64)
    x0, y0, x1, y1 = segments[0], segments[1], segments[2], segments[3]
    touching, limit = limits.separation + limits.slack, squared_limit(limits)
    near2 = limits.near**2
    outlined = limits.outline.start.size > 1
    for p in range(pairs.shape[0]):
        i, j = pairs[p, 0], pairs[p, 1]
        pair_probability[p] = 0.0
        a0, a1, b0, b1 = entries.start[i], entries.stop[i], entries.start[j], entries.stop[j]
        if a0 == a1 or b0 == b1:
            continue
        foremost, hindmost = project(segments, a0, a1, b0, b1, geometry, i, j, ahead)
        if hindmost - foremost > touching:
            continue
        n = 0
        for b in range(b0, b1):
            near[n], mid_x[n], mid_y[n], back[n] = b, halves[0, b], halves[1, b], ahead[b]
            n += (ahead[b] - foremost <= touching) & (weight[b] > 0.0)
        a, any_collides = a0, False
        while a < a1:
            m = np.int64(0)  # for a literal 0, numba would compile `keep_near` again
            while a < a1 and m < BATCH:
                line = ahead[a] + touching
                if hindmost <= line and weight[a] > 0.0:
                    x, y = halves[0, a], halves[1, a]
                    for k in range(n):
                        dx, dy = mid_x[k] - x, mid_y[k] - y
                        marks[k] = (dx * dx + dy * dy <= near2) & (back[k] <= line)
                    for k in range(n):
                        first[m], second[m] = a, near[k]
                        m += marks[k]
                a += 1
            for k in range(keep_near(halves, m, touching**2, first, second)):
                a_row, b_row = first[k], second[k]
                if outlined:
                    collides = outlined_squared(segments, a_row, b_row, limits, i, j) < limit
                else:
                    collides = pair_squared(segments, a_row, b_row) < limit
                hit[a_row] += weight[b_row] * collides
                hit[b_row] += weight[a_row] * collides
                any_collides |= collides
        if not any_collides:
            continue
        # queues are drawn independently, so that the probabilities of no collision with each neighbor are multiplied
        chance = 0.0
        for a in range(a0, a1):
            chance += weight[a] * hit[a]
            free[a] *= 1.0 - hit[a] / total[j]
            hit[a] = 0.0
        for b in range(b0, b1):
            free[b] *= 1.0 - hit[b] / total[i]
            hit[b] = 0.0
        pair_probability[p] = chance / total[i] / total[j]
    for k in range(obstacle_pairs.shape[0]):
        i, j = obstacle_pairs[k, 0], obstacle_pairs[k, 1]
        touch = setup.clearance + (obstacles[j, 2] if j < obstacles.shape[0] else 0.0)
        for a in range(entries.start[i], entries.stop[i]):
            if obstacle_distance(limits, obstacles, i, x0[a], y0[a], x1[a], y1[a], j) < touch:
                free[a] = 0.0
    for i in range(probability.size):
        without = 0.0
        for a in range(entries.start[i], entries.stop[i]):
            without += weight[a] * free[a]
        probability[i] = max(1.0 - without / total[i], 0.0) if total[i] > 0.0 else np.nan


@kernel
def half_angle(r, d, radius):
    """Return half the central angle of the arc of one circle that lies inside another circle.

    The circle of the arc has the radius ``r``, and the other circle has the radius ``radius``. The distance between
    their centers is ``d``.
    """
    if r + d <= radius:
        return math.pi
    if abs(r - d) >= radius:
        return 0.0
    return math.acos(min(max((r * r + d * d - radius * radius) / (2.0 * r * d), -1.0), 1.0))


@kernel
def covered(i, indptr, neighbor, cx, cy, inner, outer, n_steps, begin, end):
    """Return the fraction of the patrol area of positioner i that the patrol area of at least one neighbor covers.

    The patrol area is divided into rings of equal area. One circle in each ring represents the ring. The arcs of the
    circle that lie in the patrol areas of neighbors are computed exactly.
    """
    total = 0.0
    low2, high2 = inner[i] ** 2, outer[i] ** 2
    for step in range(n_steps):
        r = math.sqrt(low2 + (high2 - low2) * (step + 0.5) / n_steps)
        n = 0
        for k in range(indptr[i], indptr[i + 1]):
            j = neighbor[k]
            dx, dy = cx[j] - cx[i], cy[j] - cy[i]
            d = math.sqrt(dx * dx + dy * dy)
            wide, narrow = half_angle(r, d, outer[j]), half_angle(r, d, inner[j])
            if wide <= narrow:
                continue
            direction = math.atan2(dy, dx)
            for sign in (-1.0, 1.0):  # the two arcs are symmetric about the direction of the neighbor
                a = direction + sign * (wide if sign < 0.0 else narrow)
                a -= 2.0 * math.pi * math.floor(a / (2.0 * math.pi))
                b = a + wide - narrow
                begin[n], end[n] = a, min(b, 2.0 * math.pi)
                n += 1
                if b > 2.0 * math.pi:
                    begin[n], end[n] = 0.0, b - 2.0 * math.pi
                    n += 1
        order = np.argsort(begin[:n])
        reached = 0.0
        for k in range(n):
            a, b = begin[order[k]], end[order[k]]
            if b > reached:
                total += b - max(a, reached)
                reached = b
    return total / (2.0 * math.pi * n_steps)


@kernel
def covered_parts(indptr, neighbor, cx, cy, inner, outer, n_steps, out):
    """Compute the fraction of the patrol area of each positioner that its neighbors cover, with `covered`."""
    size = 1
    for i in range(out.size):
        size = max(size, 4 * (indptr[i + 1] - indptr[i]))
    begin, end = np.empty(size), np.empty(size)
    for i in range(out.size):
        out[i] = covered(i, indptr, neighbor, cx, cy, inner, outer, n_steps, begin, end)
