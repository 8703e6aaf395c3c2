"""Methods that find colliding pairs: a fast exact method, and other methods for comparison."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from rfpsurvey._kernels import arms, collisions, reference
from rfpsurvey._methods import Method, table_of
from rfpsurvey.collision._arms import Arms
from rfpsurvey.collision._exact_arithmetic import arms_closer_exactly
from rfpsurvey.focal_plane import FocalPlane


@dataclass(frozen=True, eq=False)
class Configuration:
    """One configuration of all arms, in which a method finds the colliding pairs."""

    plane: FocalPlane
    segments: np.ndarray  # segments that can collide, as columns, shape (4, n)
    n_points: int
    poses: Callable[[], Arms]  # function that returns the poses of all arms; only a few methods call it


class Found(NamedTuple):
    """Colliding pairs with first < second, their distances (mm), and the number of borderline pairs."""

    first: np.ndarray
    second: np.ndarray
    distances: np.ndarray
    n_borderline: int | None = None


@dataclass(frozen=True)
class CollisionMethod(Method):
    """A method that finds colliding pairs; the function takes a `Configuration` and returns a `Found`."""

    supports_outlines: bool = False  # whether arms may have outlines
    device: str = "CPU"  # device that computes the distances
    # number of configurations per task of `count_collisions`; 0 if the method cannot count many of them; random draws
    # depend on it, but not on the number of workers; for 4000 positioners, 2048 configurations on a GPU use 256 MB
    chunk: int = 0
    numbers_of_points: tuple[int, ...] = ()  # values of ``n_points`` that a benchmark measures; empty without points


def exact(case: Configuration) -> Found:
    """Compute distances with a proven error limit; rational arithmetic decides pairs for which the error matters."""
    columns = case.plane.arrays
    halves, first, second = _scratch(case)
    squared = np.empty(len(first))
    outlined = case.plane.positioner.outline is not None
    search = collisions.colliding_outlines if outlined else collisions.colliding_pairs
    n, _ = search(case.segments, halves, columns.runs, columns.limits, first, second, squared)
    return _settle(case, first[:n], second[:n], squared[:n])


def sampled(case: Configuration) -> Found:
    """Compute the smallest distance between ``n_points`` points on one arm and ``n_points`` points on the other arm.

    The method misses some pairs that are only slightly closer than D, and also some crossings if n_points <= 1 + length
    of the arm / (sqrt(2) D).
    """
    first, second = near_pairs(case)
    squared = np.empty(len(first))
    reference.sampled(case.segments, first, second, case.n_points, squared)
    return keep_closer(case, first, second, np.sqrt(squared))


def sweep(case: Configuration) -> Found:
    """Compute the distance between the areas that two arms sweep on the way from their parked poses to the given poses.

    Each area is sampled by ``n_points`` poses. Both joints rotate at the same time, in the shorter direction
    (regardless of hard stops). There are no false negatives, but many false positives.
    """
    plane, posed = case.plane, case.poses()
    pairs = plane.arrays.neighbors[posed.present[plane.arrays.neighbors].all(axis=1)]
    first, second = pairs.T.copy()
    poses = np.empty((case.n_points, *case.segments.shape))
    # Idle arms remain parked.
    columns = plane.arrays.using(posed.fiber)
    start = np.array(columns.from_joints(*columns.home))
    end = np.array(columns.from_joints(posed.theta, posed.phi))
    move = end - start
    move -= 2 * np.pi * np.round(move / (2 * np.pi))
    angles = _capsule_angles(posed)
    for pose, part in zip(poses[:-1], np.linspace(0, 1, case.n_points), strict=False):
        arms.pose(*(start + part * move), columns.geometry, pose)
        arms.shape(pose, plane.arrays.model, plane.arrays.length, *angles)
    poses[-1] = case.segments
    squared = np.empty(len(first))
    reference.swept(poses, posed.assigned, first, second, squared)
    limits = plane.arrays.limits
    near = squared < collisions.squared_limit(limits) + limits.band  # because of this allowance, no pair is missed
    return Found(first[near], second[near], np.sqrt(squared[near]))


def scipy(case: Configuration) -> Found:
    """Minimize the distance by SciPy, with bounded least squares over two points along the two arms; slow."""
    from scipy.optimize import lsq_linear

    first, second = near_pairs(case)
    distances = np.empty(len(first))
    for k in range(len(first)):
        p, q = case.segments[:, first[k]].reshape(2, 2), case.segments[:, second[k]].reshape(2, 2)
        matrix, offset = np.column_stack([p[1] - p[0], q[0] - q[1]]), q[0] - p[0]
        solution = lsq_linear(matrix, offset, bounds=(0, 1), method="bvls", tol=1e-14)
        distances[k] = np.hypot(*(matrix @ solution.x - offset))
    return keep_closer(case, first, second, distances)


def cuda(case: Configuration) -> Found:
    """Use the method ``exact``, with distances computed on a GPU (requires ``rfpsurvey[cuda]``)."""
    from rfpsurvey.collision import _gpu

    return _settle(case, *_gpu.find_pairs(case.segments, case.plane.arrays.neighbors, case.plane.arrays.limits))


METHODS = table_of(
    CollisionMethod("exact", exact, supports_outlines=True, chunk=64),
    CollisionMethod("sampled", sampled, numbers_of_points=(3, 5, 9, 17, 33, 65, 129)),
    CollisionMethod("sweep", sweep, numbers_of_points=(9, 65)),
    CollisionMethod("scipy", scipy),
    CollisionMethod("cuda", cuda, device="GPU", chunk=2048),
)
"""Methods by name."""
DEFAULT_METHOD = "exact"
"""The method that finds collisions unless the user chooses another one; benchmarks compare all methods with it."""


def near_pairs(case: Configuration) -> tuple[np.ndarray, np.ndarray]:
    """Return the pairs of neighbors that may be closer than the minimum separation."""
    halves, first, second = _scratch(case)
    n = collisions.near_pairs(halves, case.plane.arrays.runs, case.plane.arrays.limits, first, second)
    return first[:n], second[:n]


def keep_closer(case: Configuration, first: np.ndarray, second: np.ndarray, distances: np.ndarray) -> Found:
    """Return the pairs closer than the minimum separation."""
    near = distances < case.plane.arrays.separation
    return Found(first[near], second[near], distances[near])


def _scratch(case):
    """Return the midpoints and half vectors (from midpoint to end) of segments, and work arrays for all pairs."""
    size = len(case.plane.arrays.neighbors)
    halves = np.empty_like(case.segments)
    collisions.halve(case.segments, halves)
    return halves, np.empty(size, dtype=np.int64), np.empty(size, dtype=np.int64)


def _settle(case, first, second, squared):
    """Return the pairs that collide; exact arithmetic decides pairs for which rounding could change the result."""
    limits = case.plane.arrays.limits
    edge = np.flatnonzero(squared >= collisions.squared_limit(limits) - limits.band)
    if len(edge):
        keep = np.ones(len(squared), dtype=bool)
        for k in edge:
            keep[k] = arms_closer_exactly(case.plane.arrays, case.segments, first[k], second[k], first[k], second[k])
        first, second, squared = first[keep], second[keep], squared[keep]
    # the distances of outlines are computed with an offset; overlapping outlines have the distance 0
    return Found(first, second, np.maximum(np.sqrt(squared) - limits.outline.offset, 0.0), len(edge))


def _capsule_angles(posed):
    """Return the cosine and sine of the angle, at each elbow, from the fiber to the segment that can collide."""
    (ux, uy), (vx, vy) = (posed.tip - posed.elbow).T, (posed.segments[:, 2:] - posed.elbow).T
    scale = np.hypot(ux, uy) * np.hypot(vx, vy)
    scale[scale == 0] = 1  # capsules whose length is 0
    return (ux * vx + uy * vy) / scale, (ux * vy - uy * vx) / scale
