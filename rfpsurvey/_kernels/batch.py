"""Count the collisions of many configurations or realizations of one focal plane, and slow tests of pairs of arms.

The memory is that of one configuration. The slow or approximate tests are compared with the default method. Random
numbers that depend on a seed and the identifiers of targets are reproducible.

All realizations share the reachable pairs of targets and positioners, and the segment of the arm of each pair. A
realization is a row of ``chosen``, which contains the index of the pair that each positioner uses, or -1. Bit r of a
mask stands for realization r of at most 32 realizations.
"""

from typing import NamedTuple

import numpy as np

from rfpsurvey._kernels.arms import check, fill_idle, place, shape
from rfpsurvey._kernels.collisions import (
    Limits,
    colliding_obstacles,
    endpoints_squared,
    find_colliding,
    halve,
    pair_squared,
    segments_squared,
    squared_limit,
)
from rfpsurvey._kernels.jit import kernel

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


@kernel
def sampled_squared(segments, i, j, n):
    """Return the smallest squared distance between n points on one arm and n points on another, including the ends."""
    ax, ay, cx, cy = segments[0, i], segments[1, i], segments[0, j], segments[1, j]
    ux, uy = (segments[2, i] - ax) / (n - 1), (segments[3, i] - ay) / (n - 1)
    vx, vy = (segments[2, j] - cx) / (n - 1), (segments[3, j] - cy) / (n - 1)
    best = np.inf
    for a in range(n):
        px, py = ax + a * ux - cx, ay + a * uy - cy
        for b in range(n):
            dx, dy = px - b * vx, py - b * vy
            best = min(best, dx * dx + dy * dy)
    return best


@kernel
def sampled(segments, first, second, n, squared):
    """Compute the squared distances of all pairs with `sampled_squared`."""
    for k in range(first.size):
        squared[k] = sampled_squared(segments, first[k], second[k], n)


@kernel
def endpoints(segments, first, second, squared):
    """Compute the squared distances of all pairs from the four ends of the segments, without a test for crossings."""
    for k in range(first.size):
        a, b = segments[:, first[k]], segments[:, second[k]]
        squared[k] = endpoints_squared(a[0], a[1], a[2], a[3], b[0], b[1], b[2], b[3])


@kernel
def all_pairs(segments, first, second, squared):
    """Compute the squared distances of all pairs, without a preselection of pairs."""
    for k in range(first.size):
        squared[k] = pair_squared(segments, first[k], second[k])


@kernel
def swept(poses, moving, first, second, squared):
    """Compute the smallest squared distance between any two poses on the paths of two arms.

    The poses of the two arms need not occur at the same time. The shape of ``poses`` is (steps, 4, n), and the last
    pose is at the target. An arm that does not move has only one pose, which is its last pose.
    """
    last = poses.shape[0] - 1
    for k in range(first.size):
        i, j = first[k], second[k]
        best = np.inf
        for a in range(0 if moving[i] else last, last + 1):
            for b in range(0 if moving[j] else last, last + 1):
                p, q = poses[a, :, i], poses[b, :, j]
                best = min(best, segments_squared(p[0], p[1], p[2], p[3], q[0], q[1], q[2], q[3]))
            if best == 0.0:
                break
        squared[k] = best


# Offset and prime of the hash FNV-1a with 64 bits.
FNV_OFFSET, FNV_PRIME = np.uint64(0xCBF29CE484222325), np.uint64(0x100000001B3)
# Increment and factors of the random number generator SplitMix64 (Steele, Lea & Flood 2014).
GOLDEN, FIRST, SECOND = np.uint64(0x9E3779B97F4A7C15), np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
# Code point of the digit 0, and the numbers 9 and 10. An unsigned integer of 64 bits is at most 10 * LARGEST + LAST;
# a signed integer is at least -MOST_NEGATIVE.
ZERO, NINE, TEN = np.uint64(48), np.uint64(9), np.uint64(10)
LARGEST, LAST, MOST_NEGATIVE = np.uint64((2**64 - 1) // 10), np.uint64((2**64 - 1) % 10), np.uint64(2**63)
# Scale that converts 53 bits to a number in [0, 1).
UNIT = 2.0**-53


def split_mix(number):
    """Return the output of SplitMix64 for a number or for an array; each bit depends on all bits of the number."""
    z = number + GOLDEN
    z = (z ^ (z >> np.uint64(30))) * FIRST
    z = (z ^ (z >> np.uint64(27))) * SECOND
    return z ^ (z >> np.uint64(31))


mix = kernel(split_mix)


@kernel
def numbers_of_texts(codes, out):
    """Compute one 64-bit integer for each text.

    Each row of ``codes`` contains the Unicode code points of one text, followed by zeros. A text that is an integer of
    at most 64 bits in decimal form is converted to this integer. For any other text, the result is the hash FNV-1a,
    computed from code points in place of bytes.
    """
    for t in range(codes.shape[0]):
        n = 0
        while n < codes.shape[1] and codes[t, n] != 0:
            n += 1
        begin = 1 if n > 1 and codes[t, 0] == 45 else 0
        # Integers have no leading zeros, and there is no negative zero.
        is_integer = begin < n <= begin + 20 and (codes[t, begin] != 48 or n == 1)
        value = np.uint64(0)
        total = FNV_OFFSET
        for k in range(n):
            code = np.uint64(codes[t, k])
            total = (total ^ code) * FNV_PRIME
            if k >= begin and is_integer:
                digit = code - ZERO
                is_integer = digit <= NINE and (value < LARGEST or (value == LARGEST and digit <= LAST))
                value = value * TEN + digit
        is_integer = is_integer and (begin == 0 or value <= MOST_NEGATIVE)
        out[t] = (np.uint64(0) - value if begin else value) if is_integer else total


# Largest number of realizations in one call.
MOST = 32


@kernel
def mark_visits(chosen, lost, target, mask, counts):
    """Set bit r of ``mask`` for each target that is visited in realization r, and count assigned and lost targets.

    ``target`` contains the target of each pair. The columns of ``counts`` are the number of positioners with a target,
    and the number of targets lost to collisions.
    """
    mask[:] = 0
    counts[:] = 0
    for r in range(chosen.shape[0]):
        bit = np.uint32(1) << np.uint32(r)
        for i in range(chosen.shape[1]):
            k = chosen[r, i]
            if k >= 0:
                counts[r, 0] += 1
                if lost[r, i]:
                    counts[r, 1] += 1
                else:
                    mask[target[k]] |= bit


@kernel
def record_visits(mask, slot, spends, left, is_open, observed):
    """Subtract the visits of a tile from the remaining visits, and count the visits of each realization.

    ``mask`` contains the visits of the tile; row ``slot[f]`` of ``left`` belongs to target f of the tile. ``spends``
    states whether a visit to a target reduces its remaining visits; visits to all other targets are ignored.
    ``is_open`` marks targets with remaining visits in at least one realization.
    """
    n = left.shape[1]
    for f in range(slot.size):
        s = slot[f]
        if mask[f] != 0 and spends[s]:
            any_left = False
            for r in range(n):
                done = (mask[f] >> np.uint32(r)) & np.uint32(1)
                left[s, r] -= np.uint8(done)
                observed[r] += np.int64(done)
                any_left |= left[s, r] > 0
            is_open[s] = any_left


@kernel
def find_pairs(indptr, owner, target_of_positioner, chosen):
    """Write the index of the pair of each positioner and its target to ``chosen``; -1 for positioners without one."""
    for i in range(chosen.size):
        t = target_of_positioner[i]
        k = indptr[t] if t >= 0 else -1
        while t >= 0 and owner[k] != i:
            k += 1
        chosen[i] = k
