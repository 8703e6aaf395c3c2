"""Collisions of many configurations of one focal plane, counted; memory for one of them at a time."""

from typing import NamedTuple

import numpy as np

from rfpsurvey._jit import kernel
from rfpsurvey._kernels.arms import check, fill_idle, place, shape
from rfpsurvey._kernels.collisions import Limits, colliding_obstacles, colliding_pairs, halve

# Columns of ``counts``.
PAIRS, OBSTACLE_PAIRS, COLLIDING, COLLIDING_ASSIGNED, ASSIGNED, COUNTED, BORDERLINE = range(7)
N_COUNTS = 7


class Stage(NamedTuple):
    """What all configurations share: neighbors, limits, the shape of arms, those without a target, obstacles."""

    runs: np.ndarray
    limits: Limits
    model: int
    length: float
    cosine: np.ndarray
    sine: np.ndarray
    idle: np.ndarray
    """Elbow and tip of each positioner without a target, NaN if it gives way, shape (4, n)."""
    parked: np.ndarray
    """Does it count then?"""
    obstacle_pairs: np.ndarray
    obstacles: np.ndarray
    clearance: float


class Desk(NamedTuple):
    """Scratch of one thread."""

    segments: np.ndarray
    halves: np.ndarray
    assigned: np.ndarray
    far: np.ndarray
    colliding: np.ndarray
    mask: np.ndarray
    first: np.ndarray
    second: np.ndarray
    squared: np.ndarray
    hits: np.ndarray
    gaps: np.ndarray


@kernel
def count(stage, desk, counts, times):
    """Count the collisions of the arms on the desk; ``times`` gains one where a positioner collides."""
    n = borderline = 0
    if stage.runs.shape[0] > 0:
        halve(desk.segments, desk.halves)
        n, borderline = colliding_pairs(
            desk.segments, desk.halves, stage.runs, stage.limits, desk.mask, desk.first, desk.second, desk.squared
        )
    desk.colliding[:] = False
    limit = stage.limits.separation**2
    counts[:] = 0
    counts[BORDERLINE] = borderline
    for k in range(n):
        if desk.squared[k] < limit:
            counts[PAIRS] += 1
            desk.colliding[desk.first[k]] = desk.colliding[desk.second[k]] = True
    if stage.obstacle_pairs.shape[0] > 0:
        m = colliding_obstacles(
            desk.segments, stage.obstacle_pairs, stage.obstacles, stage.clearance, 0.0, desk.hits, desk.gaps
        )
        counts[OBSTACLE_PAIRS] = m
        for k in range(m):
            desk.colliding[desk.hits[k, 0]] = True
    assigned = colliding = both = counted = 0
    for i in range(desk.assigned.size):
        counts_too = desk.assigned[i] | stage.parked[i]
        assigned += desk.assigned[i]
        counted += counts_too
        colliding += desk.colliding[i] & counts_too
        both += desk.colliding[i] & desk.assigned[i]
        times[i] += desk.colliding[i]
    counts[ASSIGNED], counts[COUNTED], counts[COLLIDING], counts[COLLIDING_ASSIGNED] = (
        assigned,
        counted,
        colliding,
        both,
    )


@kernel
def count_tips(tips, geometry, bounds, side, stage, desk, counts, times):
    """Count for configurations given by their tips, (m, n, 2); returns the number of tips that are out of reach.

    ``side`` has one row for all configurations, or one for each.
    """
    far = 0
    for c in range(tips.shape[0]):
        far += check(tips[c], geometry, bounds, desk.assigned, desk.far)
        if stage.runs.shape[0] > 0 or stage.obstacle_pairs.shape[0] > 0:  # else nothing can collide
            place(tips[c], geometry, side[min(c, side.shape[0] - 1)], desk.segments)
            fill_idle(desk.assigned, stage.idle, desk.segments)
            shape(desk.segments, stage.model, stage.length, stage.cosine, stage.sine)
        count(stage, desk, counts[c], times)
    return far


@kernel
def count_draws(uniform, indptr, entries, idle, stage, desk, counts, times):
    """Count for configurations that take one entry from each queue, by uniform numbers in [0, 1), shape (m, n).

    ``entries`` are the segments of all queues, one after the other; ``idle`` those of the positioners without one.
    """
    n = indptr.size - 1
    for i in range(n):
        desk.assigned[i] = indptr[i + 1] > indptr[i]
        if not desk.assigned[i]:
            for row in range(4):
                desk.segments[row, i] = idle[row, i]
    for c in range(uniform.shape[0]):
        for i in range(n):
            length = indptr[i + 1] - indptr[i]
            if length > 0:
                k = indptr[i] + min(int(uniform[c, i] * length), length - 1)
                for row in range(4):
                    desk.segments[row, i] = entries[row, k]
        count(stage, desk, counts[c], times)
