"""Kinematics of positioners with two arms: positions of elbows, and segments of arms that can collide.

Segments are columns of an array of shape (4, n), with the rows x0, y0, x1 and y1. Compiled code processes several
positioners at a time, because segments are stored as columns and the loops have no branches.
"""

import math
from typing import NamedTuple

import numpy as np

from rfpsurvey._jit import kernel

# If the lengths of two arms differ by less than this (mm), they are treated as equal, and the fiber reaches the center.
EQUAL_ARMS = 1e-9

# Values of ``model``, which states the part of an arm that can collide.
ELBOW_TO_TIP, CAPSULE, FIBER_TIP = 0, 1, 2


class Geometry(NamedTuple):
    """Positions and arm lengths of all positioners, and the directions of the central arms in the parked pose."""

    cx: np.ndarray
    cy: np.ndarray
    l1: np.ndarray
    l2: np.ndarray
    home_x: float
    home_y: float


class Bounds(NamedTuple):
    """Squared inner and outer radius of the patrol area of each positioner, and whether the positioner is usable."""

    low: np.ndarray
    high: np.ndarray
    usable: np.ndarray


@kernel
def inner_difference(l1, l2):
    """Return the signed difference of the arm lengths, or 0 if they differ by less than ``EQUAL_ARMS``."""
    difference = l1 - l2
    return 0.0 if abs(difference) < EQUAL_ARMS else difference


@kernel
def elbow(dx, dy, l1, l2, side, home_x, home_y):
    """Return the elbow of the arm whose tip is at (dx, dy), and two numbers proportional to sin(phi) and cos(phi).

    The positions of elbow and tip are relative to the center of the positioner. The factor of proportionality is
    positive, and the same for the sine and the cosine.

    ``side`` is +1 for phi in [0, pi] ("right") and -1 for the mirror image. For a tip out of reach, the result
    is the pose at the nearest reachable point in the same direction. A tip at the center of the positioner has no
    direction; the direction (home_x, home_y) of the parked central arm is used instead. If the tip is NaN, the result
    is NaN.
    """
    total = l1 + l2
    difference = inner_difference(l1, l2)
    inner = abs(difference)
    r2 = dx * dx + dy * dy
    at_center = r2 < 1e-300  # the square of a shorter distance is imprecise because of underflow
    r = math.sqrt(r2)
    inverse = 0.0 if at_center else 1.0 / r
    ux = home_x if at_center else dx * inverse
    uy = home_y if at_center else dy * inverse
    s = r if r > inner else inner
    s = s if s < total else total
    folded = s < 1e-150
    half = 0.0 if folded else 0.5 / s
    # Sine and cosine of phi, multiplied by 2 l1 l2. This form of the sine is accurate at both edges of the annulus.
    sine = math.sqrt(((total - s) * (total + s)) * ((s - inner) * (s + inner)))
    cosine = s * s - l1 * l1 - l2 * l2
    along = l1 if folded else (s * s + difference * total) * half
    across = side * sine * half
    return along * ux + across * uy, along * uy - across * ux, sine, cosine


@kernel
def solve(tips, geometry, side, theta, phi):
    """Compute the joint angles of each positioner from the position of its tip; the angles are NaN if the tip is NaN.

    The shape of ``tips`` is (n, 2).
    """
    g = geometry
    for i in range(g.cx.size):
        dx, dy = tips[i, 0] - g.cx[i], tips[i, 1] - g.cy[i]
        ex, ey, sine, cosine = elbow(dx, dy, g.l1[i], g.l2[i], side[i], g.home_x, g.home_y)
        theta[i] = math.atan2(ey, ex)
        phi[i] = side[i] * math.atan2(sine, cosine) if ex == ex else np.nan


@kernel
def pose(theta, phi, geometry, segments):
    """Compute the positions of the elbow and tip of each positioner from its joint angles."""
    g = geometry
    for i in range(g.cx.size):
        segments[0, i] = g.cx[i] + g.l1[i] * math.cos(theta[i])
        segments[1, i] = g.cy[i] + g.l1[i] * math.sin(theta[i])
        segments[2, i] = segments[0, i] + g.l2[i] * math.cos(theta[i] + phi[i])
        segments[3, i] = segments[1, i] + g.l2[i] * math.sin(theta[i] + phi[i])


@kernel
def place(tips, geometry, side, segments):
    """Compute the elbow of each arm from its tip, and write both to ``segments``; the elbow is NaN if the tip is NaN.

    The shape of ``tips`` is (n, 2).
    """
    cx, cy, l1, l2 = geometry.cx, geometry.cy, geometry.l1, geometry.l2
    home_x, home_y = geometry.home_x, geometry.home_y
    ex, ey, x, y = segments[0], segments[1], segments[2], segments[3]
    for i in range(cx.size):
        x[i], y[i] = tips[i, 0], tips[i, 1]
    for i in range(cx.size):
        dx, dy, _, _ = elbow(x[i] - cx[i], y[i] - cy[i], l1[i], l2[i], side[i], home_x, home_y)
        ex[i], ey[i] = cx[i] + dx, cy[i] + dy


@kernel
def capsule_end(ex, ey, x, y, length, cosine, sine):
    """Return the end of a segment of the given length that starts at the elbow (ex, ey).

    The direction of the segment is the direction from the elbow to the tip (x, y), rotated counter-clockwise by the
    angle with the given cosine and sine.
    """
    ux, uy = x - ex, y - ey
    scale = length / math.sqrt(ux * ux + uy * uy)
    return ex + scale * (cosine * ux - sine * uy), ey + scale * (cosine * uy + sine * ux)


@kernel
def shape(segments, model, length, cosine, sine):
    """Replace elbows and tips, in place, by the ends of the segments that can collide."""
    if model == CAPSULE:
        ex, ey, x, y = segments[0], segments[1], segments[2], segments[3]
        for i in range(cosine.size):
            x[i], y[i] = capsule_end(ex[i], ey[i], x[i], y[i], length, cosine[i], sine[i])
    elif model == FIBER_TIP:
        for i in range(cosine.size):
            segments[0, i], segments[1, i] = segments[2, i], segments[3, i]


@kernel
def check(tips, geometry, bounds, assigned, far):
    """Mark the positioners with a target, and the tips that are out of reach; return the number of these tips."""
    n = 0
    cx, cy, low, high, usable = geometry.cx, geometry.cy, bounds.low, bounds.high, bounds.usable
    for i in range(cx.size):
        dx, dy = tips[i, 0] - cx[i], tips[i, 1] - cy[i]
        r2 = dx * dx + dy * dy
        assigned[i] = r2 < np.inf
        far[i] = (r2 < low[i]) | (r2 > high[i])
    # a single loop would take twice the time, because numbers and flags have different sizes in memory
    for i in range(cx.size):
        assigned[i] &= usable[i]
    for i in range(cx.size):
        far[i] &= usable[i]
    for i in range(cx.size):
        n += far[i]
    return n


@kernel
def fill_idle(assigned, idle, segments):
    """Replace the segment of each positioner without a target by the segment of its idle arm, in place.

    The segment of an idle arm that is not an obstacle is NaN.
    """
    for row in range(4):
        placed, parked = segments[row], idle[row]
        for i in range(assigned.size):
            a, b = placed[i], parked[i]
            placed[i] = a if assigned[i] else b
