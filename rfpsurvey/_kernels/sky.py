"""Convert unit vectors on the sky to points on the focal plane, and find the directions near a given direction.

The directions are sorted by ``zone + right ascension / 2 pi``. In each zone that a circle touches, the directions that
can be inside the circle form one run of the index, or two runs if the circle contains right ascension 0. If the circle
contains a pole, each run contains all directions of a zone.
"""

import math

import numpy as np

from rfpsurvey._kernels.jit import kernel

# Forms of a radial map r(theta); the formulas are in `radius_and_slope`.
THETA, TAN_THETA, SINE = 0, 1, 2
# Directions are not projected if the cosine of their angle from the field center is at most this value.
HORIZON = 1e-15


@kernel
def project(vectors, basis, focal_length, out):
    """Project unit vectors gnomonically; the rows of ``basis`` are the directions of +x, +y and the field center.

    The result is NaN for directions 90 deg or more from the center, because they cannot be projected.
    """
    for i in range(vectors.shape[0]):
        a, b, c = vectors[i, 0], vectors[i, 1], vectors[i, 2]
        along = a * basis[2, 0] + b * basis[2, 1] + c * basis[2, 2]
        scale = focal_length / along if along > HORIZON else np.nan
        out[i, 0] = scale * (a * basis[0, 0] + b * basis[0, 1] + c * basis[0, 2])
        out[i, 1] = scale * (a * basis[1, 0] + b * basis[1, 1] + c * basis[1, 2])


@kernel
def unproject(xy, basis, focal_length, out):
    """Compute the unit vectors of points on the focal plane; this is the inverse of `project`."""
    for i in range(xy.shape[0]):
        x, y = xy[i, 0] / focal_length, xy[i, 1] / focal_length
        norm = 1.0 / math.sqrt(1.0 + x * x + y * y)
        for k in range(3):
            out[i, k] = norm * (basis[2, k] + x * basis[0, k] + y * basis[1, k])


@kernel
def radius_and_slope(theta, form, coefficients, argument, inner, output):
    """Return the radius r(theta) of a radial map and its derivative.

    The radius is ``output * p(t)`` with ``t = argument * theta`` for the form THETA, or with
    ``t = argument * tan(theta)`` for the form TAN_THETA. For the form SINE, the radius is
    ``output * sin(inner * p(t))`` with ``t = argument * theta``. The polynomial p(t) has the terms
    ``coefficients[k] * t**(2 * k + 1)``.
    """
    if form == TAN_THETA:
        tangent = math.tan(theta)
        t = argument * tangent
        t_slope = argument * (1.0 + tangent * tangent)
    else:
        t = argument * theta
        t_slope = argument
    t2 = t * t
    value = slope = 0.0
    for k in range(coefficients.size - 1, -1, -1):
        value = value * t2 + coefficients[k]
        slope = slope * t2 + (2 * k + 1) * coefficients[k]
    value *= t
    slope *= t_slope
    if form == SINE:
        return output * math.sin(inner * value), output * inner * slope * math.cos(inner * value)
    return output * value, output * slope


@kernel
def radii(theta, form, coefficients, argument, inner, output, limit, out):
    """Compute the radius of each field angle; it is NaN for angles larger than ``limit``."""
    for i in range(theta.size):
        r = radius_and_slope(theta[i], form, coefficients, argument, inner, output)[0]
        out[i] = r if 0.0 <= theta[i] <= limit else np.nan


@kernel
def invert_radius(r, form, coefficients, argument, inner, output, limit):
    """Return the field angle at radius ``r``, by Newton's method with bisection; return NaN if there is none."""
    low, high = 0.0, limit
    edge = radius_and_slope(limit, form, coefficients, argument, inner, output)[0]
    if not 0.0 <= r <= edge:
        return np.nan
    theta = r / radius_and_slope(0.0, form, coefficients, argument, inner, output)[1]
    for _ in range(100):
        if not low <= theta <= high:
            theta = 0.5 * (low + high)
        value, slope = radius_and_slope(theta, form, coefficients, argument, inner, output)
        if value > r:
            high = theta
        else:
            low = theta
        step = (r - value) / slope
        theta += step
        if abs(step) <= 1e-16 * (1.0 + 4.0 * theta):
            break
    return min(max(theta, 0.0), limit)


@kernel
def angles(r, form, coefficients, argument, inner, output, limit, out):
    """Compute the field angle of each radius; it is NaN if no field angle up to ``limit`` has this radius."""
    for i in range(r.size):
        out[i] = invert_radius(r[i], form, coefficients, argument, inner, output, limit)


@kernel
def project_radial(vectors, basis, form, coefficients, argument, inner, output, limit, out):
    """Project unit vectors by a radial map; the result is NaN for field angles larger than ``limit``."""
    cosine_limit = math.cos(limit) - 1e-12  # a fast first test; the angles themselves are compared below
    for i in range(vectors.shape[0]):
        a, b, c = vectors[i, 0], vectors[i, 1], vectors[i, 2]
        along = a * basis[2, 0] + b * basis[2, 1] + c * basis[2, 2]
        out[i, 0] = out[i, 1] = np.nan
        if along >= cosine_limit:
            x = a * basis[0, 0] + b * basis[0, 1] + c * basis[0, 2]
            y = a * basis[1, 0] + b * basis[1, 1] + c * basis[1, 2]
            sine = math.hypot(x, y)
            theta = math.atan2(sine, along)
            if theta <= limit:
                r = radius_and_slope(theta, form, coefficients, argument, inner, output)[0]
                ratio = r / sine if sine > 0.0 else 0.0
                out[i, 0] = ratio * x
                out[i, 1] = ratio * y


@kernel
def unproject_radial(xy, basis, form, coefficients, argument, inner, output, limit, out):
    """Compute the unit vectors of points on the focal plane; this is the inverse of `project_radial`."""
    for i in range(xy.shape[0]):
        r = math.hypot(xy[i, 0], xy[i, 1])
        theta = invert_radius(r, form, coefficients, argument, inner, output, limit)
        ratio = math.sin(theta) / r if r > 0.0 else 0.0
        for k in range(3):
            out[i, k] = math.cos(theta) * basis[2, k] + ratio * (xy[i, 0] * basis[0, k] + xy[i, 1] * basis[1, k])


@kernel
def within(vectors, center, half_chord_squared, out):
    """Mark the directions for which the square of half the chord to ``center`` is at most the given value."""
    for i in range(vectors.shape[0]):
        a, b, c = vectors[i, 0] - center[0], vectors[i, 1] - center[1], vectors[i, 2] - center[2]
        out[i] = 0.25 * (a * a + b * b + c * c) <= half_chord_squared


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
