"""Distances of moving arms, sampled at many times with plain numpy."""

import numpy as np


def ends(x, y, angle, inner, length):
    """Return the ends of segments at the directions ``angle`` around (x, y), shape (..., 2, 2)."""
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([np.stack([x + r * c, y + r * s], axis=-1) for r in (inner, length)], axis=-2)


def _point_to_segment(p, a, b):
    u, v = b - a, p - a
    length2 = (u * u).sum(axis=-1)
    t = np.clip((u * v).sum(axis=-1) / np.where(length2 > 0, length2, 1), 0, 1)
    return np.linalg.norm(v - t[..., None] * u, axis=-1)


def segment_distance(one, two):
    """Return the distances between segments of shape (..., 2, 2)."""
    (a, b), (c, d) = (np.moveaxis(s, -2, 0) for s in (one, two))
    found = np.min([_point_to_segment(*p) for p in ((a, c, d), (b, c, d), (c, a, b), (d, a, b))], axis=0)

    def cross(o, p, q):
        return (p[..., 0] - o[..., 0]) * (q[..., 1] - o[..., 1]) - (p[..., 1] - o[..., 1]) * (q[..., 0] - o[..., 0])

    crossing = (cross(a, b, c) * cross(a, b, d) < 0) & (cross(c, d, a) * cross(c, d, b) < 0)
    return np.where(crossing, 0.0, found)


def angle_at(angle, turn, t, same_speed, longest):
    """Return the direction of an arm that is at its target at the time t = 0 and folded at t = 1."""
    if not same_speed:
        return angle + t * turn
    # all arms begin to unfold at t = 1, with the speed of the arm with the longest way
    return angle + np.sign(turn) * np.maximum(np.abs(turn) - (1 - t) * longest, 0.0)


def least_distance(one, two, *, same_speed=False, n=10_000, rounds=0, gap=None):
    """Return the least distance of two arms (x, y, angle, turn, inner, length) at n times, refined ``rounds`` times.

    ``gap`` is the function that returns distances; by default, that of segments.
    """
    longest = max(abs(one[3]), abs(two[3]))

    def at(t):
        angles = (angle_at(arm[2], arm[3], t, same_speed, longest) for arm in (one, two))
        if gap is not None:
            return gap(*angles)
        return segment_distance(
            *(ends(arm[0], arm[1], a, arm[4], arm[5]) for arm, a in zip((one, two), angles, strict=True))
        )

    t = np.linspace(0, 1, n)
    if same_speed and longest:  # the rate of an arm changes when it reaches its target
        t = np.sort(np.append(t, np.clip([1 - abs(arm[3]) / longest for arm in (one, two)], 0, 1)))
    found = at(t)
    best = found.min()
    speed = (abs(one[3]) * one[5] + abs(two[3]) * two[5]) * (2 if same_speed else 1)
    for _ in range(rounds):
        width = np.diff(t).max()
        low = np.flatnonzero(found <= best + speed * width)
        if len(low) > n:
            break
        t = np.unique((t[low][:, None] + np.linspace(-width, width, max(3, n // len(low)) | 1)).clip(0, 1))
        found = at(t)
        best = min(best, found.min())
    return best
