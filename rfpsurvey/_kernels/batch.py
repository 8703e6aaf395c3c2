"""Count the collisions of many configurations of one focal plane, with memory for one configuration at a time."""

from typing import NamedTuple

import numpy as np

from rfpsurvey._jit import kernel
from rfpsurvey._kernels.arms import check, fill_idle, place, shape
from rfpsurvey._kernels.collisions import Limits, colliding_obstacles, find_colliding, halve

# Columns of ``counts``.
PAIRS, OBSTACLE_PAIRS, COLLIDING, COLLIDING_ASSIGNED, ASSIGNED, COUNTED, BORDERLINE = range(7)
N_COUNTS = 7


class CollisionSetup(NamedTuple):
    """Data that are the same for all configurations: neighbors, limits, the shape of arms, idle arms, and obstacles."""

    runs: np.ndarray
    limits: Limits
    model: int
    length: float
    cosine: np.ndarray
    sine: np.ndarray
    idle: np.ndarray
    """Elbow and tip of each arm in the idle state, shape (4, n); NaN if the idle arm is not an obstacle."""
    parked: np.ndarray
    """Whether each positioner is counted even if it has no target."""
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
def find_pairs(setup, workspace):
    """List the colliding and the borderline pairs of the arms in the workspace, as `find_colliding` does."""
    w = workspace
    if setup.runs.shape[0] == 0:
        return np.int64(0), np.int64(0)
    halve(w.segments, w.halves)
    return find_colliding(w.segments, w.halves, setup.runs, setup.limits, w.first, w.second, w.squared)


@kernel
def find_hits(setup, workspace, slack, hits, gaps):
    """List the arms of the workspace that touch obstacles, as `colliding_obstacles` does, and return their number."""
    if setup.obstacle_pairs.shape[0] == 0:
        return 0
    own, circles = np.arange(workspace.assigned.size), setup.obstacles
    pairs, limits, clearance = setup.obstacle_pairs, setup.limits, setup.clearance
    return colliding_obstacles(workspace.segments, own, limits, pairs, circles, clearance, slack, hits, gaps)


@kernel
def count(setup, workspace, counts, times):
    """Count the collisions of the arms in the workspace, and add 1 to ``times[i]`` for each colliding positioner i."""
    n, borderline = find_pairs(setup, workspace)
    workspace.colliding[:] = False
    limit = setup.limits.separation**2
    counts[:] = 0
    counts[BORDERLINE] = borderline
    for k in range(n):
        if workspace.squared[k] < limit:
            counts[PAIRS] += 1
            workspace.colliding[workspace.first[k]] = workspace.colliding[workspace.second[k]] = True
    hits, gaps = np.empty_like(setup.obstacle_pairs), np.empty(setup.obstacle_pairs.shape[0])
    counts[OBSTACLE_PAIRS] = find_hits(setup, workspace, 0.0, hits, gaps)
    for k in range(counts[OBSTACLE_PAIRS]):
        workspace.colliding[hits[k, 0]] = True
    assigned = colliding = both = counted = 0
    for i in range(workspace.assigned.size):
        counts_too = workspace.assigned[i] | setup.parked[i]
        assigned += workspace.assigned[i]
        counted += counts_too
        colliding += workspace.colliding[i] & counts_too
        both += workspace.colliding[i] & workspace.assigned[i]
        times[i] += workspace.colliding[i]
    counts[ASSIGNED], counts[COUNTED], counts[COLLIDING], counts[COLLIDING_ASSIGNED] = (
        assigned,
        counted,
        colliding,
        both,
    )


@kernel
def count_tips(tips, geometry, bounds, side, setup, workspace, counts, times):
    """Count the collisions of m configurations and return the number of tips out of reach.

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
        count(setup, workspace, counts[c], times)
    return far


@kernel
def count_draws(uniform, indptr, entries, idle, setup, workspace, counts, times):
    """Count the collisions of m random configurations; each configuration has one random pose from each queue.

    The queue of a positioner contains its possible poses. ``uniform`` contains the random numbers of the draws, in
    [0, 1), with the shape (m, n). ``entries`` contains the segments of all poses, one queue after the other. ``idle``
    contains the segments of the positioners whose queue is empty.
    """
    n = indptr.size - 1
    for i in range(n):
        workspace.assigned[i] = indptr[i + 1] > indptr[i]
        if not workspace.assigned[i]:
            for row in range(4):
                workspace.segments[row, i] = idle[row, i]
    for c in range(uniform.shape[0]):
        for i in range(n):
            length = indptr[i + 1] - indptr[i]
            if length > 0:
                k = indptr[i] + min(int(uniform[c, i] * length), length - 1)
                for row in range(4):
                    workspace.segments[row, i] = entries[row, k]
        count(setup, workspace, counts[c], times)
