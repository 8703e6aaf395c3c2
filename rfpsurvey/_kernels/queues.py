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
def look(hall, m, limits):
    """Add the weights of the candidate pairs that collide."""
    limit = limits.separation**2
    for k in range(keep_near(hall.halves, m, (limits.separation + limits.slack) ** 2, hall.first, hall.second)):
        a, b = hall.first[k], hall.second[k]
        collides = pair_squared(hall.segments, a, b) < limit
        hall.hit[a] += hall.weight[b] * collides
        hall.hit[b] += hall.weight[a] * collides


@kernel
def meet(i, j, ux, uy, hall, limits):
    """Account for the collisions of the queues i and j, j in the direction (ux, uy); returns the chance of one.

    Along that direction no entry of i can come nearer to j than its foremost point, and the other way around: entries
    that reach for nobody are not looked at.
    """
    s, first, last, begin, end = hall.segments, hall.start[i], hall.stop[i], hall.start[j], hall.stop[j]
    room = limits.separation + limits.slack
    foremost, hindmost = -np.inf, np.inf
    for a in range(first, last):
        hall.ahead[a] = max(s[0, a] * ux + s[1, a] * uy, s[2, a] * ux + s[3, a] * uy)
        foremost = max(foremost, hall.ahead[a])
    for b in range(begin, end):
        hall.ahead[b] = min(s[0, b] * ux + s[1, b] * uy, s[2, b] * ux + s[3, b] * uy)
        hindmost = min(hindmost, hall.ahead[b])
    n = 0
    for b in range(begin, end):
        hall.near[n] = b
        hall.middle_x[n], hall.middle_y[n], hall.back[n] = hall.halves[0, b], hall.halves[1, b], hall.ahead[b]
        n += (hall.ahead[b] - foremost <= room) & (hall.weight[b] > 0.0)
    middle_x, middle_y, back = hall.middle_x[:n], hall.middle_y[:n], hall.back[:n]
    marks = hall.marks[:n]
    m = 0
    near2 = limits.near**2
    for a in range(first, last):
        line = hall.ahead[a] + room
        if hindmost > line or hall.weight[a] == 0.0:
            continue
        x, y = hall.halves[0, a], hall.halves[1, a]
        for k in range(n):
            dx, dy = middle_x[k] - x, middle_y[k] - y
            marks[k] = (dx * dx + dy * dy <= near2) & (back[k] <= line)
        for k in range(n):
            hall.first[m], hall.second[m] = a, hall.near[k]
            m += marks[k]
        if m >= BATCH:
            look(hall, m, limits)
            m = 0
    look(hall, m, limits)
    chance = 0.0
    for a in range(first, last):
        chance += hall.weight[a] * hall.hit[a]
        hall.free[a] *= 1.0 - hall.hit[a] / hall.total[j]
        hall.hit[a] = 0.0
    for b in range(begin, end):
        hall.free[b] *= 1.0 - hall.hit[b] / hall.total[i]
        hall.hit[b] = 0.0
    return chance / (hall.total[i] * hall.total[j])


@kernel
def expect(pairs, geometry, limits, obstacle_pairs, obstacles, clearance, hall, risk):
    """Chance of a collision of each positioner, NaN without a queue; returns the expected number of colliding pairs."""
    expected = 0.0
    for k in range(pairs.shape[0]):
        i, j = pairs[k, 0], pairs[k, 1]
        if hall.start[i] == hall.stop[i] or hall.start[j] == hall.stop[j]:
            continue
        dx, dy = geometry.cx[j] - geometry.cx[i], geometry.cy[j] - geometry.cy[i]
        inverse = 1.0 / math.sqrt(dx * dx + dy * dy)
        expected += meet(i, j, dx * inverse, dy * inverse, hall, limits)
    s = hall.segments
    for k in range(obstacle_pairs.shape[0]):
        i, j = obstacle_pairs[k, 0], obstacle_pairs[k, 1]
        x, y, limit = obstacles[j, 0], obstacles[j, 1], obstacles[j, 2] + clearance
        for a in range(hall.start[i], hall.stop[i]):
            if math.sqrt(point_segment_squared(x, y, s[0, a], s[1, a], s[2, a], s[3, a])) < limit:
                hall.free[a] = 0.0
    for i in range(risk.size):
        unharmed = 0.0
        for a in range(hall.start[i], hall.stop[i]):
            unharmed += hall.weight[a] * hall.free[a]
        risk[i] = 1.0 - unharmed / hall.total[i] if hall.total[i] > 0.0 else np.nan
    return expected
