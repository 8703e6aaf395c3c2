"""Use an index, in which directions are sorted by declination zone, to find directions near a given direction.

The directions are sorted by ``zone + right ascension / 2 pi``. In each zone that a circle touches, the directions that
can be inside the circle form one run of the index, or two runs if the circle contains right ascension 0. If the circle
contains a pole, each run contains all directions of a zone.
"""

import math

import numpy as np

from rfpsurvey._jit import kernel

# Largest rounding error of the ends of a run, as a fraction of 360 deg of right ascension.
SLACK = 1e-12


@kernel
def make_keys(vectors, n_zones, key):
    """Compute the value ``zone + right ascension / 2 pi`` by which the directions are sorted."""
    for i in range(vectors.shape[0]):
        phase = math.atan2(vectors[i, 1], vectors[i, 0]) / (2.0 * math.pi)
        phase += phase < 0.0
        dec = math.atan2(vectors[i, 2], math.hypot(vectors[i, 0], vectors[i, 1]))
        zone = min(max(int((dec / math.pi + 0.5) * n_zones), 0), n_zones - 1)
        # a phase that rounds to 1 would belong to the next zone
        key[i] = zone + min(phase, 1.0 - SLACK)


@kernel
def list_runs(key, n_zones, center, radius, runs):
    """List the ranges of positions in the index that cover a circle, as rows (first, last + 1); return their number."""
    dec = math.atan2(center[2], math.hypot(center[0], center[1]))
    phase = math.atan2(center[1], center[0]) / (2.0 * math.pi)
    low, high = dec - radius - 1e-9, dec + radius + 1e-9
    half = 0.5
    if low > -0.5 * math.pi and high < 0.5 * math.pi:
        # the largest difference in right ascension of a point of the circle, which does not contain a pole
        half = math.asin(min(math.sin(radius) / math.cos(dec), 1.0)) * (1.0 + 1e-9) / (2.0 * math.pi) + SLACK
    first = min(max(int((low / math.pi + 0.5) * n_zones), 0), n_zones - 1)
    last = min(max(int((high / math.pi + 0.5) * n_zones), 0), n_zones - 1)
    n = 0
    for zone in range(first, last + 1):
        if half >= 0.5:
            runs[n, 0], runs[n, 1] = np.searchsorted(key, zone), np.searchsorted(key, zone + 1)
            n += 1
            continue
        begin = phase - half - math.floor(phase - half)
        end = begin + 2.0 * half
        runs[n, 0] = np.searchsorted(key, zone + begin)
        runs[n, 1] = np.searchsorted(key, zone + min(end, 1.0), side="right")
        if end < 1.0:
            n += 1
            continue
        runs[n, 1] = np.searchsorted(key, zone + 1)
        runs[n + 1, 0] = np.searchsorted(key, zone)
        runs[n + 1, 1] = np.searchsorted(key, zone + end - 1.0, side="right")
        n += 2
    return n


@kernel
def find_near(vectors, key, n_zones, center, radius, limit, left, out):
    """List the directions near a center for which ``left`` is larger than 0.

    A direction is near if the square of half the chord to the center is at most ``limit``. The positions of these
    directions in the index are written to ``out``. Returns the number of near directions, even if ``out`` is too short
    for all of these directions.
    """
    runs = np.empty((2 * n_zones, 2), dtype=np.int64)
    n = 0
    for k in range(list_runs(key, n_zones, center, radius, runs)):
        for i in range(runs[k, 0], runs[k, 1]):
            if left[i] > 0:
                a, b, c = vectors[i, 0] - center[0], vectors[i, 1] - center[1], vectors[i, 2] - center[2]
                if 0.25 * (a * a + b * b + c * c) <= limit:
                    if n < out.size:
                        out[n] = i
                    n += 1
    return n


@kernel
def sum_near(vectors, key, n_zones, centers, radius, limit, weight, out):
    """Sum the weights of the directions near each center.

    A direction is near if the square of half the chord to the center is at most ``limit``.
    """
    runs = np.empty((2 * n_zones, 2), dtype=np.int64)
    for m in range(centers.shape[0]):
        center = centers[m]
        total = 0.0
        for k in range(list_runs(key, n_zones, center, radius, runs)):
            for i in range(runs[k, 0], runs[k, 1]):
                a, b, c = vectors[i, 0] - center[0], vectors[i, 1] - center[1], vectors[i, 2] - center[2]
                if 0.25 * (a * a + b * b + c * c) <= limit:
                    total += weight[i]
        out[m] = total


@kernel
def number_circles(vectors, key, n_zones, order, radius, limit, group, smallest, number):
    """Assign numbers to directions, in the order of their rows; directions near each other have distinct numbers.

    Directions are near if the square of half the chord between them is at most ``limit``. The number of a direction
    depends only on the near directions in earlier rows. By default, the number is one more than the largest number of a
    near direction in an earlier row, or 0 if there is none. If ``smallest`` is true, only near directions of the same
    group are considered, and the number is the smallest number that none of these directions has. ``order`` contains
    the row of each position in the index.
    """
    n = order.size
    runs = np.empty((2 * n_zones, 2), dtype=np.int64)
    # the last row that is near to each number; the array is therefore not reset for each row
    place, taken = np.empty(n, dtype=np.int64), np.full(n + 1, -1)
    for i in range(n):
        place[order[i]] = i
    for row in range(n):
        center = vectors[place[row]]
        largest = -1
        for k in range(list_runs(key, n_zones, center, radius, runs)):
            for i in range(runs[k, 0], runs[k, 1]):
                neighbor = order[i]
                if neighbor >= row or (smallest and group[neighbor] != group[row]):
                    continue
                a, b, c = vectors[i, 0] - center[0], vectors[i, 1] - center[1], vectors[i, 2] - center[2]
                if 0.25 * (a * a + b * b + c * c) <= limit:
                    taken[number[neighbor]] = row
                    largest = max(largest, number[neighbor])
        number[row] = largest + 1
        if smallest:
            number[row] = 0
            while taken[number[row]] == row:
                number[row] += 1
