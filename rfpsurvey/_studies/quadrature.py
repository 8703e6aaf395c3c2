"""Quadrature for independent targets, which each positioner draws from a density over its patrol area.

The result is computed once for each environment: a group of positioners with the same positions and kinds of neighbors.
"""

from dataclasses import dataclass
from functools import cache, cached_property

import astropy.units as u
import numpy as np
from scipy.spatial import cKDTree

from rfpsurvey._common.executors import Progress, map_in_order
from rfpsurvey._common.units import locked, to_plain
from rfpsurvey._instruments.count_collisions import make_setup
from rfpsurvey._instruments.focal_plane import FocalPlane
from rfpsurvey._kernels import queues
from rfpsurvey._kernels.batch import split_mix
from rfpsurvey._studies.intervals import effective_number, quantile, wilson
from rfpsurvey._studies.question import ProbabilityQuestion
from rfpsurvey._studies.simulate import make_entries, make_expected, make_positioners
from rfpsurvey.errors import INCONVERTIBLE, InputError

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
        center = np.repeat(np.arange(n), [len(r) for r in rows])
        k = np.concatenate([np.array(r, dtype=int) for r in rows])
        i, away = np.append(i, center), np.vstack([away, circles[k, :2] - xy[center]])
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
    value = split_mix(what.astype(np.uint64))
    for cell in cells:
        value = split_mix(value ^ cell.astype(np.int64).astype(np.uint64))
    out = np.zeros(n, dtype=np.uint64)
    np.add.at(out, i, value)
    return out


DENSITIES = ("uniform", "shared", "voronoi")
SCRAMBLES = 8
FIRST_POINTS = 128
"""Number of points per positioner in the first estimate, if all positioners have the same environment.

An environment is an arrangement of neighbors. The errors of several environments average out. Therefore, fewer points
are sufficient if there are several environments.
"""
LEAST_POINTS, LEAST_WEIGHTED = 16, 256
"""Minimum numbers of points per positioner: for points with equal weights (first), and with different weights (second).

The weights are equal if the density is uniform and joint limits do not restrict the patrol areas. Different weights
require more points, because the bias of a weighted mean does not average out.
"""
FORESIGHT = 1.5
"""Factor by which the predicted error is increased, because the error is estimated from few scramblings."""
BITS = 30
NARROW = 2**12
"""Minimum number of points from which the code concludes that the density is 0 in a patrol area.

If the density is 0 at all points of a smaller set, the computation is repeated with more points.
"""


@dataclass(frozen=True, eq=False)
class Quadrature:
    """Function that estimates the collision probability of one positioner with scrambled Sobol points."""

    plane: FocalPlane
    density: object

    @cached_property
    def environments(self) -> tuple[np.ndarray, np.ndarray]:
        """The result of ``environments``: a representative positioner of each group of positioners, and all groups.

        The positioners of a group have the same arrangement of neighbors. The first array contains the row of one
        positioner for each group, and the second array contains the index of the group of each positioner.
        """
        plane = self.plane
        if not isinstance(self.density, str):
            return np.arange(len(plane)), np.arange(len(plane))
        touching = 2 * float(plane.arrays.arm_reach.max()) + plane.arrays.separation
        radius = touching + plane.arrays.touch_slack
        if len(plane.arrays.broken_pairs):  # include broken positioners near the neighbors
            radius += touching + plane.margins.numbers["broken"]
        if self.density != "uniform":  # include positioners whose patrol areas overlap the neighbors' areas
            radius += 2 * float(plane.arrays.outer_radius.max())
        return environments(plane, radius)

    def __call__(self, i: int, n_points: int, rng: np.random.Generator) -> tuple[float, float]:
        """Return the collision probability of positioner i, and its share of the expected number of colliding pairs.

        The integral uses ``n_points`` points for the positioner and for each of its neighbors.
        """
        plane, (starts, neighbor) = self.plane, self.plane.arrays.both_ways
        group = np.concatenate([[i], neighbor[starts[i] : starts[i + 1]]])
        moving = plane.arrays.usable[group]
        rows = np.repeat(group[moving], n_points)
        tips = self._tips(rows, _scramble(n_points, int(moving.sum()), rng))
        entries = make_entries(len(group), len(rows))
        entries.weight[: len(rows)] = self._weight(rows, tips)
        entries.segments[:, : len(rows)] = plane.arrays.segments_of(rows, None, tips)
        queues.prepare_entries(np.append(0, np.cumsum(n_points * moving)), self._idle[:, group].copy(), entries)
        if not (entries.total[moving] > 0).all() and n_points < NARROW:
            return self(i, 4 * n_points, rng)
        if not (entries.total[moving] > 0).all():
            where = plane.arrays.xy[group[moving][entries.total[moving] <= 0][0]]
            raise InputError(
                f"density must be positive somewhere in every patrol area; it is 0 at all {n_points} samples in the "
                f"patrol area around ({where[0]:.4g}, {where[1]:.4g}) mm"
            )
        pairs = np.column_stack([np.zeros(len(group) - 1, dtype=np.int64), np.arange(1, len(group))])
        obstacles = self._setup.obstacle_pairs
        obstacles = obstacles[obstacles[:, 0] == i] * [0, 1]
        setup = self._setup._replace(limits=_limits_of(self._setup.limits, group), obstacle_pairs=obstacles)
        expected = make_expected(len(group), len(pairs))
        queues.expect(pairs, plane.arrays.geometry_of(group), setup, entries, expected)
        # a pair of positioners that can both move is counted twice, once for each positioner, with the weight 0.5
        return float(expected.probability[0]), float(expected.pair_probability @ np.where(moving[1:], 0.5, 1.0))

    def _tips(self, rows, points):
        """Return points (mm) in the patrol areas, computed from points in the unit square by an equal-area map."""
        inner, outer = (radius[rows] for radius in self.plane.arrays.edges)
        r = np.sqrt(inner**2 + points[:, 0] * (outer**2 - inner**2))
        alpha = 2 * np.pi * points[:, 1]
        return self.plane.arrays.xy[rows] + r[:, None] * np.column_stack([np.cos(alpha), np.sin(alpha)])

    def _weight(self, rows, tips):
        """Return the density at each point, up to a constant factor."""
        weight = np.ones(len(rows))
        if self.density == "voronoi":
            weight = (cKDTree(self.plane.arrays.xy).query(tips)[1] == rows).astype(float)
        elif not isinstance(self.density, str):
            weight = self.density(tips << u.mm)
            try:
                weight = to_plain(weight).astype(float)
            except INCONVERTIBLE:
                raise InputError(f"density must return numbers, got {type(weight).__name__}") from None
            if weight.shape != (len(rows),) or not ((weight >= 0) & (weight < np.inf)).all():
                raise InputError(
                    f"density must return a finite number of at least 0 for each point, shape ({len(rows)},), got the "
                    f"shape {weight.shape} with values from {weight.min(initial=0):g} to {weight.max(initial=0):g}"
                )
        if self.density == "shared" or not self.plane.arrays.poses_free:
            reach = self.plane.arrays.reach(tips)
            many = np.diff(reach.indptr)
            mine = np.bincount(reach.target, reach.owner == np.repeat(rows, many), minlength=len(rows))
            weight = weight * mine / (np.maximum(many, 1) if self.density == "shared" else 1)
        # a constant factor does not change the result, but squares of large densities may overflow
        return weight / max(weight.max(initial=0.0), 1e-300)

    @cached_property
    def _setup(self):
        return make_setup(self.plane.arrays, parked_obstacles=False)

    @cached_property
    def _idle(self):
        """Segments of the arms of positioners that cannot move; NaN for all other positioners."""
        return make_positioners(self.plane, self._setup).idle


def _limits_of(limits, group):
    """Return collision limits that contain only the outlines of the positioners in ``group``, in this order."""
    outline = limits.outline
    if outline.start.size == 1:
        return limits
    centers = locked(np.ascontiguousarray(outline.centers[group]))
    return limits._replace(outline=outline._replace(centers=centers))


@cache
def _net(n_points: int) -> np.ndarray:
    """Return Sobol points of the unit square; their coordinates are whole numbers, in units of ``2**-BITS``."""
    from scipy.stats import qmc  # this import takes longer than importing rfpsurvey

    points = qmc.Sobol(2, scramble=False, bits=BITS).random(n_points)
    return (points * 2**BITS).astype(np.int64)


def _scramble(n_points: int, n_sets: int, rng: np.random.Generator) -> np.ndarray:
    """Return several sets of Sobol points in one array; each set has its own random digital shift."""
    shifts = rng.integers(0, 2**BITS, (n_sets, 1, 2))
    return ((_net(n_points) ^ shifts).reshape(-1, 2) + rng.random(2)) / 2**BITS


def integrate(task: Quadrature, question: ProbabilityQuestion) -> dict:
    """Return the collision probability and its confidence interval, with as many points as the precision requires."""
    precision, plane, (first, number) = question.precision, task.plane, task.environments
    used = np.flatnonzero(plane.arrays.usable[first])
    share = np.bincount(number, minlength=len(first))[used] / np.count_nonzero(plane.arrays.usable)
    plain = isinstance(task.density, str) and task.density == "uniform" and plane.arrays.poses_free
    least = min(LEAST_POINTS if plain else LEAST_WEIGHTED, precision.max_iterations)
    n_points = min(max(FIRST_POINTS >> int(np.log2(len(used)) / 2), least), precision.max_iterations)
    # fewer points are used for environments of few positioners, which contribute little to the error of the mean
    rare = (np.log2(share.max() / share) / 2).astype(int)
    last = False
    with Progress(question.progress) as bar:
        while True:
            jobs = np.repeat(first[used], SCRAMBLES)
            sizes, sources = np.repeat(np.maximum(n_points >> rare, least), SCRAMBLES), question.rng.spawn(len(jobs))
            results = np.empty((len(jobs), 2))
            for k, result in enumerate(map_in_order(question.executor, task, jobs.tolist(), sizes.tolist(), sources)):
                results[k] = result
                bar(n_points / precision.max_iterations * (k + 1) / len(jobs))
            probabilities, pairs = results.reshape(len(used), SCRAMBLES, 2).transpose(2, 1, 0)
            values = probabilities @ share
            p, error = float(values.mean()), float(values.std(ddof=1) / np.sqrt(SCRAMBLES))
            trials = effective_number(p, error, SCRAMBLES * n_points)
            low, high = wilson(p, trials, quantile(precision.confidence, SCRAMBLES - 1))
            half = (high - low) / 2
            met = precision.standard_error is not None and (last or half <= precision.half_width)
            if last or 2 * n_points > precision.max_iterations:
                break
            # Earlier points determine the last number of points; if the last points did, the estimate would be biased.
            # The error is approximately proportional to 1 / n_points.
            more = 4.0 if precision.half_width == 0 else FORESIGHT * half / precision.half_width
            last = precision.half_width > 0 and more <= 2
            factor = int(np.clip(np.ceil(np.log2(max(more, 1.0))) - (not last), not last, 3))
            n_points = min(n_points * 2**factor, precision.max_iterations)
        bar(1)
    per_positioner = np.full(len(first), np.nan)
    per_positioner[used] = probabilities.mean(axis=0)
    density = task.density if isinstance(task.density, str) else "given"
    return {
        "value": p,
        "value_assigned": p,
        "low": low,
        "high": high,
        "standard_error": error,
        "n": n_points,
        "n_effective": trials,
        "pairs_per_positioner": float(pairs.mean(axis=0) @ share),
        "per_positioner": per_positioner[number],
        "met": met,
        "meta": {"density": density, "environments": len(used)},
    }
