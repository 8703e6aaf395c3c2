"""The decision of the kernel for a single pair of segments."""

import numpy as np

from rfpsurvey._kernels import collisions

RUN = np.array([[0, 1, 1]])


def decide(first, second, limit):
    """Return True, False, or None for a borderline pair."""
    pair = np.array([first, second]).T.copy()
    halves, squared = np.empty((4, 2)), np.empty(2)
    collisions.halve(pair, halves)
    longest = float(np.hypot(pair[2] - pair[0], pair[3] - pair[1]).max())
    limits = collisions.limits(limit, longest * (1 + 1e-15), float(np.hypot(*np.abs(pair).reshape(2, -1).max(axis=1))))
    rows = np.empty(2, np.int64), np.empty(2, np.int64)
    n, borderline = collisions.colliding_pairs(pair, halves, RUN, limits, *rows, squared)
    return None if borderline else bool(n)
