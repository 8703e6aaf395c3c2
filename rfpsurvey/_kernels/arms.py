"""Kinematics of a two-arm positioner: target to elbow, elbow to the segment that can collide."""

import math

import numpy as np

from rfpsurvey._jit import kernel

# Arms whose lengths differ by less than this (mm) count as equal: they reach their own center.
EQUAL_ARMS = 1e-9


@kernel
def elbow(dx, dy, l1, l2, side, home_theta):
    """Elbow (relative to the center) and joint angles for a tip at (dx, dy).

    ``side`` is +1 for phi in [0, pi] ("right") and -1 for its mirror image. A tip outside the annulus gets
    the pose that points to it from the nearest reachable radius. At r = 0 (equal arms) theta is free: home.
    """
    r = math.hypot(dx, dy)
    total = l1 + l2
    difference = l1 - l2
    if abs(difference) < EQUAL_ARMS:
        if r == 0.0:
            return l1 * math.cos(home_theta), l1 * math.sin(home_theta), home_theta, side * math.pi
        difference = 0.0
    r_in = abs(difference)
    s = min(max(r, r_in), total)
    if r > 0.0:
        ux, uy = dx / r, dy / r
    else:
        ux, uy = math.cos(home_theta), math.sin(home_theta)
    # 2 l1 l2 times the sine and cosine of phi, the sine without cancellation at either edge
    sine = math.sqrt(max(0.0, (total - s) * (total + s))) * math.sqrt(max(0.0, s - r_in)) * math.sqrt(s + r_in)
    cosine = s * s - l1 * l1 - l2 * l2
    phi = math.atan2(sine, cosine)
    along = (s * s + difference * total) / (2.0 * s)
    across = sine / (2.0 * s)
    ex = along * ux + side * across * uy
    ey = along * uy - side * across * ux
    return ex, ey, math.atan2(ey, ex), side * phi


@kernel
def solve(x, y, cx, cy, l1, l2, side, home_theta, theta, phi, elbow_x, elbow_y):
    """Pose of each positioner for its own tip (x, y), absolute coordinates; NaN tips give NaN."""
    for i in range(x.size):
        if math.isnan(x[i]) or math.isnan(y[i]):
            theta[i] = phi[i] = elbow_x[i] = elbow_y[i] = np.nan
        else:
            ex, ey, theta[i], phi[i] = elbow(x[i] - cx[i], y[i] - cy[i], l1[i], l2[i], side[i], home_theta)
            elbow_x[i] = cx[i] + ex
            elbow_y[i] = cy[i] + ey


@kernel
def pose(theta, phi, cx, cy, l1, l2, elbow_x, elbow_y, tip_x, tip_y):
    """Elbow and tip of each positioner for given joint angles."""
    for i in range(theta.size):
        elbow_x[i] = cx[i] + l1[i] * math.cos(theta[i])
        elbow_y[i] = cy[i] + l1[i] * math.sin(theta[i])
        tip_x[i] = elbow_x[i] + l2[i] * math.cos(theta[i] + phi[i])
        tip_y[i] = elbow_y[i] + l2[i] * math.sin(theta[i] + phi[i])


@kernel
def arm_segments(elbow_x, elbow_y, tip_x, tip_y, length, angle, out):
    """Segment of each arm that can collide.

    From the elbow to the tip where ``length`` is NaN; otherwise ``length`` long from the elbow, turned by
    ``angle`` counter-clockwise from the direction of the tip.
    """
    for i in range(elbow_x.size):
        out[i, 0] = elbow_x[i]
        out[i, 1] = elbow_y[i]
        if math.isnan(length[i]):
            out[i, 2] = tip_x[i]
            out[i, 3] = tip_y[i]
        else:
            direction = math.atan2(tip_y[i] - elbow_y[i], tip_x[i] - elbow_x[i]) + angle[i]
            out[i, 2] = elbow_x[i] + length[i] * math.cos(direction)
            out[i, 3] = elbow_y[i] + length[i] * math.sin(direction)
