"""Groups of positioners with the same environment (positions and kinds of neighbors); lattices have few groups."""

import numpy as np
from scipy.spatial import cKDTree

from rfpsurvey.focal_plane import FocalPlane

RESOLUTION = 1e-6
"""Positions that differ by less than this distance (mm) are treated as equal."""


def environments(plane: FocalPlane, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the row of one positioner for each environment, and the index of the environment of each positioner.

    Two environments are the same if, within the radius (mm), they have the same kinds of neighbors and obstacles at the
    same relative positions. If no joint limit depends on the direction, environments that differ only by a rotation by
    a multiple of 60 deg are also the same.

    Environments are compared by their keys. For each rotation of an environment, the hashes of its neighbors are added;
    the sum does not depend on the order of the neighbors. The smallest of these sums is the key.
    """
    n, xy = len(plane), plane.arrays.xy
    pairs = cKDTree(xy).query_pairs(radius, output_type="ndarray").astype(np.int64)
    i, j = np.concatenate([pairs, pairs[:, ::-1], np.repeat(np.arange(n)[:, None], 2, axis=1)]).T
    columns = plane.arrays
    kinds = [columns.central_arm, columns.eccentric_arm, columns.first_type, *columns.angles]
    if columns.joints is not None:
        kinds += [columns.inner_radius, columns.outer_radius]
        if not columns.joints_free:
            kinds += [*columns.joints.limits, columns.joints.theta_zero, columns.joints.phi_zero]
    kinds = np.column_stack([np.unique(values, return_inverse=True)[1].reshape(-1) for values in kinds])
    kinds = np.unique(kinds, axis=0, return_inverse=True)[1].reshape(-1)
    # each positioner that does not move is a separate kind; since its pose does not rotate with its surroundings, the
    # hash below uses a different kind for each rotation
    kinds = np.where(plane.arrays.usable, kinds, n + np.arange(n))
    # polygonal obstacles are not compared; instead, each of the few positioners near a polygon is a separate kind
    touched = np.zeros(n, dtype=bool)
    pairs = plane.arrays.obstacle_pairs
    touched[pairs[pairs[:, 1] >= len(plane.arrays.obstacles), 0]] = True
    kinds = np.where(touched, n + np.arange(n), kinds)
    away, what = xy[j] - xy[i], kinds[j]
    circles = plane.arrays.obstacles
    if len(circles):
        rows = cKDTree(circles[:, :2]).query_ball_point(xy, radius + circles[:, 2].max())
        own = np.repeat(np.arange(n), [len(r) for r in rows])
        k = np.concatenate([np.array(r, dtype=int) for r in rows])
        i, away = np.append(i, own), np.vstack([away, circles[k, :2] - xy[own]])
        what = np.append(what, 2 * n + k)  # each of the few obstacles is a separate kind
    rotations = range(6) if plane.arrays.poses_free else range(1)
    still = (what >= n) & (what < 2 * n)
    keys = np.array([_hash(n, i, away, what + still * (k * 1_000_000_007), k * np.pi / 3) for k in rotations])
    _, first, number = np.unique(keys.min(axis=0), return_index=True, return_inverse=True)
    return first, number.reshape(-1)


def _hash(n, i, away, what, angle):
    """Return, for each positioner, the sum of the hashes of its neighbors.

    The hash of a neighbor depends on its offset and its kind.
    """
    c, s = np.cos(angle), np.sin(angle)
    x, y = c * away[:, 0] - s * away[:, 1], s * away[:, 0] + c * away[:, 1]
    # because of the offset 0.37, multiples of the resolution are far from the edges of cells
    cells = (np.floor(v / RESOLUTION + 0.37) for v in (x, y))
    value = _mix(what.astype(np.uint64))
    for cell in cells:
        value = _mix(value ^ cell.astype(np.int64).astype(np.uint64))
    out = np.zeros(n, dtype=np.uint64)
    np.add.at(out, i, value)
    return out


def _mix(value):
    """Return a 64-bit hash of each integer, computed by the finalizer of the generator splitmix64."""
    value = (value + np.uint64(0x9E3779B97F4A7C15)).astype(np.uint64)
    value = (value ^ (value >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    value = (value ^ (value >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return value ^ (value >> np.uint64(31))
