"""Count the collisions of many configurations of one focal plane, with memory for one configuration at a time."""

from typing import NamedTuple

import numpy as np

from rfpsurvey._jit import kernel
from rfpsurvey._kernels.arms import check, fill_idle, place, shape
from rfpsurvey._kernels.collisions import Limits, colliding_obstacles, find_colliding, halve, squared_limit

# Columns of ``counts``, in the order of the fields of `CollisionCounts`.
PAIRS, OBSTACLE_PAIRS, COLLIDING, COLLIDING_ASSIGNED, COUNTED, ASSIGNED, BORDERLINE = range(7)
N_COUNTS = 7


class CollisionSetup(NamedTuple):
    """Data that are the same for all configurations: neighbors, limits, the shape of arms, idle arms, and obstacles."""

    runs: np.ndarray
    limits: Limits
    model: int
    length: float
    cosine: np.ndarray
    sine: np.ndarray
    idle: np.ndarray  # elbow and tip of each arm in the idle state, shape (4, n); NaN if it is no obstacle
    parked: np.ndarray  # whether each positioner is counted even if it has no target
    obstacle_pairs: np.ndarray
    obstacles: np.ndarray
    clearance: float


class Workspace(NamedTuple):
    """Arrays in which one thread stores intermediate results."""

    segments: np.ndarray
    halves: np.ndarray
    assigned: np.ndarray
    far: np.ndarray
    colliding: np.ndarray
    first: np.ndarray
    second: np.ndarray
    squared: np.ndarray


@kernel
def mark_colliding(setup, workspace, slack):
    """Mark the arms of the workspace that collide with other arms or with obstacles.

    Returns the number of colliding pairs of arms, the number of pairs of an arm and an obstacle, and the number of
    borderline pairs. Arms that are farther away from obstacles than the clearance, by less than ``slack``, are also
    marked; they and the arms that are closer than the clearance by at most ``slack`` form borderline pairs.
    """
    w, circles, pairs = workspace, setup.obstacles, setup.obstacle_pairs
    w.colliding[:] = False
    n_pairs = n_hits = borderline = 0
    if setup.runs.shape[0] > 0:
        halve(w.segments, w.halves)
        n, borderline = find_colliding(w.segments, w.halves, setup.runs, setup.limits, w.first, w.second, w.squared)
        limit = squared_limit(setup.limits)
        for k in range(n):
            if w.squared[k] < limit:
                n_pairs += 1
                w.colliding[w.first[k]] = w.colliding[w.second[k]] = True
    if pairs.shape[0] > 0:
        rows, hits, gaps = np.arange(w.assigned.size), np.empty_like(pairs), np.empty(pairs.shape[0])
        n_hits = colliding_obstacles(w.segments, rows, setup.limits, pairs, circles, setup.clearance, slack, hits, gaps)
        for k in range(n_hits):
            i, j = hits[k, 0], hits[k, 1]
            radius = circles[j, 2] if j < circles.shape[0] else 0.0
            borderline += gaps[k] >= radius + setup.clearance - slack
            w.colliding[i] = True
    return n_pairs, n_hits, borderline


@kernel
def count(setup, workspace, slack, counts, times):
    """Count the collisions of the arms in the workspace, and add 1 to ``times[i]`` for each colliding positioner i."""
    counts[PAIRS], counts[OBSTACLE_PAIRS], counts[BORDERLINE] = mark_colliding(setup, workspace, slack)
    assigned = n_both = counted = n = 0
    for i in range(workspace.assigned.size):
        counts_too = workspace.assigned[i] | setup.parked[i]
        assigned += workspace.assigned[i]
        counted += counts_too
        n += workspace.colliding[i] & counts_too
        n_both += workspace.colliding[i] & workspace.assigned[i]
        times[i] += workspace.colliding[i]
    counts[ASSIGNED], counts[COUNTED], counts[COLLIDING], counts[COLLIDING_ASSIGNED] = assigned, counted, n, n_both


@kernel
def count_tips(tips, geometry, bounds, side, setup, workspace, counts, times):
    """Count the collisions of m configurations, and return the number of tips out of reach.

    The shape of ``tips`` is (m, n, 2). ``side`` (the sign of phi) has a single row for all configurations, or one row
    for each configuration.
    """
    far = 0
    for c in range(tips.shape[0]):
        far += check(tips[c], geometry, bounds, workspace.assigned, workspace.far)
        if setup.runs.shape[0] > 0 or setup.obstacle_pairs.shape[0] > 0:  # otherwise nothing can collide
            place(tips[c], geometry, side[min(c, side.shape[0] - 1)], workspace.segments)
            fill_idle(workspace.assigned, setup.idle, workspace.segments)
            shape(workspace.segments, setup.model, setup.length, setup.cosine, setup.sine)
        count(setup, workspace, 0.0, counts[c], times)
    return far


@kernel
def count_poses(chosen, segments, idle, setup, slack, workspace, counts, times):
    """Count the collisions of m configurations, in which each positioner has one of several known poses.

    ``segments`` contains the arms in all poses, ``chosen`` the index of the pose of each positioner in each
    configuration, or -1 if the arm is idle, and ``idle`` the idle arms. See `mark_colliding` for ``slack``. ``times``
    has a single row, for the sums over all configurations, or one row for each configuration.
    """
    can_collide = setup.runs.shape[0] > 0 or setup.obstacle_pairs.shape[0] > 0
    for c in range(chosen.shape[0]):
        for i in range(chosen.shape[1]):
            workspace.assigned[i] = chosen[c, i] >= 0
        for row in range(4 if can_collide else 0):
            for i in range(chosen.shape[1]):
                k = chosen[c, i]
                workspace.segments[row, i] = segments[row, k] if k >= 0 else idle[row, i]
        count(setup, workspace, slack, counts[c], times[min(c, times.shape[0] - 1)])
