"""Slow or approximate tests of pairs of arms, for comparison with the default method."""

import numpy as np

from rfpsurvey._jit import kernel
from rfpsurvey._kernels.collisions import endpoints_squared, pair_squared, segments_squared


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
