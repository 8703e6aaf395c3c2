"""Every positioner has a queue of places where its arm may stand: which of them collide with which.

One entry of each queue is in use, with a chance proportional to its weight, whatever the others do. Given one's own
entry the neighbors are independent, and the chance of no collision is a product over them.
"""

import math
from typing import NamedTuple

import numpy as np

from rfpsurvey._jit import kernel
from rfpsurvey._kernels.arms import CAPSULE, FIBER_TIP, capsule_end, elbow
from rfpsurvey._kernels.collisions import halve, keep_near, pair_squared, point_segment_squared

# Candidate pairs that are looked at together.
BATCH = 2048


class Hall(NamedTuple):
    """Entries of all queues, those of positioner i from ``start[i]`` up to ``stop[i]``, and scratch."""

    start: np.ndarray
    stop: np.ndarray
    segments: np.ndarray
    halves: np.ndarray
    weight: np.ndarray
    total: np.ndarray
    """Sum of the weights of each queue."""
    free: np.ndarray
    """Chance of each entry to be without a collision."""
    hit: np.ndarray
    """Weight of the entries of one neighbor that collide with each entry; zero between calls."""
    ahead: np.ndarray
    near: np.ndarray
    marks: np.ndarray
    middle_x: np.ndarray
    middle_y: np.ndarray
    back: np.ndarray
    first: np.ndarray
    second: np.ndarray


@kernel
def place_queues(x, y, indptr, queue, geometry, side, model, length, cosine, sine, segments):
    """Segments of the entries of all queues, one queue after the other."""
    g = geometry
    ex, ey, tx, ty = segments[0], segments[1], segments[2], segments[3]
    for k in range(indptr[-1]):
        tx[k], ty[k] = x[queue[k]], y[queue[k]]
    for i in range(indptr.size - 1):
        cx, cy, l1, l2, hand = g.cx[i], g.cy[i], g.l1[i], g.l2[i], side[i]
        for k in range(indptr[i], indptr[i + 1]):
            dx, dy, _, _ = elbow(tx[k] - cx, ty[k] - cy, l1, l2, hand, g.home_x, g.home_y)
            ex[k], ey[k] = cx + dx, cy + dy
        if model == CAPSULE:
            for k in range(indptr[i], indptr[i + 1]):
                tx[k], ty[k] = capsule_end(ex[k], ey[k], tx[k], ty[k], length, cosine[i], sine[i])
        elif model == FIBER_TIP:
            for k in range(indptr[i], indptr[i + 1]):
                ex[k], ey[k] = tx[k], ty[k]


@kernel
def line_up(indptr, idle, hall):
    """Say where queues begin and end; who has none has one entry for the idle arm, if that stands in the way.

    The entries are in ``hall.segments`` already, the idle arms are put behind them.
    """
    n, m = indptr.size - 1, indptr[-1]
    for i in range(n):
        empty = indptr[i] == indptr[i + 1]
        there = idle[0, i] == idle[0, i]
        hall.start[i] = m + i if empty else indptr[i]
        hall.stop[i] = m + i + (1 if there else 0) if empty else indptr[i + 1]
        for row in range(4):
            hall.segments[row, m + i] = idle[row, i]
        hall.weight[m + i] = 1.0
        hall.total[i] = 0.0
        for k in range(hall.start[i], hall.stop[i]):
            hall.total[i] += hall.weight[k]
    used = m + n
    halve(hall.segments[:, :used], hall.halves[:, :used])
    for k in range(used):
        hall.free[k] = 1.0


@kernel
def expect(pairs, geometry, limits, obstacle_pairs, obstacles, clearance, hall, risk, chance_of):
    """Chance of a collision of each positioner, NaN without a queue, and of each pair.

    Along the line between the centers of i and j no entry of i comes nearer to j than its foremost point, and the other
    way around: entries that reach for nobody are not looked at. All is in one function, because handing over so many
    arrays takes longer than to look at short queues.
    """
    segments, halves, weight, total = hall.segments, hall.halves, hall.weight, hall.total
    free, hit = hall.free, hall.hit
    ahead, near, marks, first, second = hall.ahead, hall.near, hall.marks, hall.first, hall.second
    middle_x, middle_y, back = hall.middle_x, hall.middle_y, hall.back
    x0, y0, x1, y1 = segments[0], segments[1], segments[2], segments[3]
    room, limit = limits.separation + limits.slack, limits.separation**2
    near2 = limits.near**2
    for p in range(pairs.shape[0]):
        i, j = pairs[p, 0], pairs[p, 1]
        chance_of[p] = 0.0
        a0, a1, b0, b1 = hall.start[i], hall.stop[i], hall.start[j], hall.stop[j]
        if a0 == a1 or b0 == b1:
            continue
        ux, uy = geometry.cx[j] - geometry.cx[i], geometry.cy[j] - geometry.cy[i]
        inverse = 1.0 / math.sqrt(ux * ux + uy * uy)
        ux, uy = ux * inverse, uy * inverse
        foremost, hindmost = -np.inf, np.inf
        for a in range(a0, a1):
            ahead[a] = max(x0[a] * ux + y0[a] * uy, x1[a] * ux + y1[a] * uy)
            foremost = max(foremost, ahead[a])
        for b in range(b0, b1):
            ahead[b] = min(x0[b] * ux + y0[b] * uy, x1[b] * ux + y1[b] * uy)
            hindmost = min(hindmost, ahead[b])
        if hindmost - foremost > room:
            continue
        n = 0
        for b in range(b0, b1):
            near[n], middle_x[n], middle_y[n], back[n] = b, halves[0, b], halves[1, b], ahead[b]
            n += (ahead[b] - foremost <= room) & (weight[b] > 0.0)
        a, found = a0, False
        while a < a1:
            m = 0
            while a < a1 and m < BATCH:
                line = ahead[a] + room
                if hindmost <= line and weight[a] > 0.0:
                    x, y = halves[0, a], halves[1, a]
                    for k in range(n):
                        dx, dy = middle_x[k] - x, middle_y[k] - y
                        marks[k] = (dx * dx + dy * dy <= near2) & (back[k] <= line)
                    for k in range(n):
                        first[m], second[m] = a, near[k]
                        m += marks[k]
                a += 1
            for k in range(keep_near(halves, m, room**2, first, second)):
                own, other = first[k], second[k]
                collides = pair_squared(segments, own, other) < limit
                hit[own] += weight[other] * collides
                hit[other] += weight[own] * collides
                found |= collides
        if not found:
            continue
        chance = 0.0
        for a in range(a0, a1):
            chance += weight[a] * hit[a]
            free[a] *= 1.0 - hit[a] / total[j]
            hit[a] = 0.0
        for b in range(b0, b1):
            free[b] *= 1.0 - hit[b] / total[i]
            hit[b] = 0.0
        chance_of[p] = chance / total[i] / total[j]
    for k in range(obstacle_pairs.shape[0]):
        i, j = obstacle_pairs[k, 0], obstacle_pairs[k, 1]
        x, y, touch = obstacles[j, 0], obstacles[j, 1], obstacles[j, 2] + clearance
        for a in range(hall.start[i], hall.stop[i]):
            if math.sqrt(point_segment_squared(x, y, x0[a], y0[a], x1[a], y1[a])) < touch:
                free[a] = 0.0
    for i in range(risk.size):
        unharmed = 0.0
        for a in range(hall.start[i], hall.stop[i]):
            unharmed += weight[a] * free[a]
        risk[i] = max(1.0 - unharmed / total[i], 0.0) if total[i] > 0.0 else np.nan
