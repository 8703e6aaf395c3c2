"""The methods of LAMOST, which place tiles one after the other where targets are dense."""

from collections.abc import Callable
from functools import partial

import numpy as np

from rfpsurvey._sky import shapes as _healpix
from rfpsurvey._sky.arrays import SkyIndex
from rfpsurvey._survey.tiling.problem import TilingProblem, TilingState

# Lengths as fractions of the radius of a tile: spacing of the candidate centers, standard deviation of the smoothing,
# radius of the circle that determines where targets are densest, smallest step, and shifts of a tile that observes no
# target.
GRID = 0.1
SIGMA = 0.5
SEED = 0.5
STILL = 1e-3
BESIDE = (0.1, 0.35)
MOST_STEPS = 200
_TURN = np.array([np.cos(np.arange(8) * np.pi / 4), np.sin(np.arange(8) * np.pi / 4)])[:, :, None]


def max_density(problem: TilingProblem) -> TilingState:
    """Place each tile where its targets of the highest remaining priority require the largest number of visits.

    If this number is equal for several centers, the center with the most remaining visits to targets of other
    priorities is used. The candidate centers form a HEALPix grid finer than a tenth of the radius. For each candidate,
    the sum of the remaining visits in its field is updated after each new tile. The best candidate is then shifted as
    long as its sum increases.
    """
    state = TilingState(problem)
    places = _grid(problem) if problem.where.vectors is None else problem.where.vectors
    candidates = _Candidates(state, places, problem.radius)

    def seek():
        center = candidates.best()
        return center if center is None or problem.where.vectors is not None else _climb_sum(state, center)

    return _run(state, [candidates], seek)


def density_gradient(problem: TilingProblem) -> TilingState:
    """Place each tile at a maximum of the smoothed density of targets; the search starts where targets are densest."""
    return _follow(problem, _climb_density)


def mean_shift(problem: TilingProblem) -> TilingState:
    """Place each tile by repeatedly moving it to the mean of its targets, starting where targets are densest."""
    return _follow(problem, _shift_to_mean)


def _follow(problem: TilingProblem, move: Callable) -> TilingState:
    """Place tiles one after the other; each tile starts where targets are densest, and ``move`` returns its center."""
    state = TilingState(problem)
    seeds = _Candidates(state, _grid(problem), SEED * problem.radius)
    allowed = [] if problem.where.vectors is None else [_Candidates(state, problem.where.vectors, problem.radius)]

    def seek():
        seed = seeds.best()
        if seed is None:
            return None
        center = problem.where.limits.move_inside(move(state, seed))
        if allowed:
            return allowed[0].about(center)
        # if the maximum of the smoothed density lies between targets, a tile there may contain no target
        return center if len(problem.index.near(center, problem.radius, state.weight)) else seed

    return _run(state, [seeds, *allowed], seek)


def _run(state: TilingState, candidates: list["_Candidates"], seek: Callable) -> TilingState:
    """Place tiles until no more tiles are needed or no further target can be observed."""
    while not state.done:
        center = seek()
        if center is None:
            break
        tries = [center]
        # a small shift of the tile can bring targets within reach of a positioner
        if state.problem.where.vectors is None:
            beside = np.vstack([ring(center, step * state.problem.radius) for step in BESIDE])
            tries += list(state.problem.where.limits.move_inside(beside))
        if not any(len(state.observe(shifted)) for shifted in tries):
            state.give_up(center)
        changed = max(state.problem.reach, state.problem.radius) + max(BESIDE) * state.problem.radius
        for sums in candidates:
            sums.update(center, changed)
    return state


class _Candidates:
    """Candidate centers of a tile, and the weighted sum of the remaining visits around each candidate."""

    def __init__(self, state: TilingState, vectors: np.ndarray, reach: float):
        self.state, self.reach = state, reach
        self.index = SkyIndex(vectors)
        self.leading = state.leading()
        self.sum = state.problem.index.sum_near(self.index.vectors, reach, state.weight)

    def best(self) -> np.ndarray | None:
        """Return the candidate with the largest sum; None if all sums are 0."""
        most = self.sum.max(initial=0.0)
        if most <= 0.5 * self.state.unit:
            return None
        # if sums are equal, the candidate in the first row is used, independent of the order of the spatial index
        top = np.flatnonzero(self.sum >= most - min(1e-9, 1e-2 * self.state.unit))
        return self.index.vectors[top[np.argmin(self.index.order[top])]]

    def about(self, center: np.ndarray) -> np.ndarray | None:
        """Return the best candidate (with the largest sum) among those within half a tile radius of a direction.

        If none of these candidates has a sum above 0, the best of all candidates is returned.
        """
        near = self.index.near(center, 0.5 * self.state.problem.radius)
        if len(near) == 0 or self.sum[near].max() <= 0.5 * self.state.unit:
            return self.best()
        return self.index.vectors[near[np.argmax(self.sum[near])]]

    def update(self, center: np.ndarray, changed: float) -> None:
        """Update the sums after targets within ``changed`` of a center were observed."""
        near, leading = self.index.near(center, min(changed + self.reach, np.pi)), self.state.leading()
        if leading != self.leading:  # the weights of all targets have changed
            near, self.leading = np.arange(len(self.sum)), leading
        weight = self.state.weight
        self.sum[near] = self.state.problem.index.sum_near(self.index.vectors[near], self.reach, weight)


def _grid(problem: TilingProblem) -> np.ndarray:
    """Return candidate centers with targets in their field: a HEALPix grid finer than a tenth of the tile radius."""
    fine = _healpix.nside_for(GRID * problem.radius / 1.0233)  # the side of a pixel is 1.0233 / nside
    coarse = max(_healpix.nside_for(problem.radius) // 2, 1)
    coarse_centers = _healpix.centers(coarse, np.arange(12 * coarse**2))
    near = np.flatnonzero(problem.visits_near(coarse_centers, _healpix.pixel_radius(coarse)) > 0)
    children = (fine // coarse) ** 2
    centers = _healpix.centers(fine, (near[:, None] * children + np.arange(children)).ravel())
    centers = problem.where.limits.fit(centers, problem.radius)
    return centers[problem.visits_near(centers) > 0]


def ring(center: np.ndarray, step: float) -> np.ndarray:
    """Return eight directions at the distance ``step`` (radians) from a center."""
    helper = np.eye(3)[np.argmin(np.abs(center))]
    x = _cross(helper, center)
    x /= np.linalg.norm(x)
    return np.cos(step) * center + np.sin(step) * (_TURN[0] * x + _TURN[1] * _cross(center, x))


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the cross product of two vectors; `numpy.cross` takes five times as long for a single pair."""
    (a0, a1, a2), (b0, b1, b2) = a.tolist(), b.tolist()
    return np.array([a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0])


def climb(
    center: np.ndarray, value: Callable, step: float, last: float, *, move: Callable | None = None, gain: float = 0.0
) -> np.ndarray:
    """Shift a center by decreasing steps (radians) as long as its value increases, and return the center.

    Parameters
    ----------
    center : ndarray, shape (3,)
        Center from which the search starts.
    value : callable
        Function that returns the values of centers.
    step, last : float
        Length of the first step, and of the step after which the search ends.
    move : callable, optional
        Function that moves centers to allowed centers.
    gain : float, optional
        Smallest increase of the value.

    Returns
    -------
    ndarray, shape (3,)
        The center.
    """
    best = value(center[None])[0]
    while step > last:
        around = ring(center, step)
        around = around if move is None else move(around)
        values = value(around)
        k = int(np.argmax(values))
        if values[k] > best + gain:
            center, best = around[k], values[k]
        else:
            step /= 2
    return center / np.linalg.norm(center)


def _climb_sum(state: TilingState, center: np.ndarray) -> np.ndarray:
    """Shift a center as long as the number of remaining visits inside the tile increases."""
    index, radius, weight = state.problem.index, state.problem.radius, state.weight
    visits = partial(index.sum_near, radius_rad=radius, weight=weight)
    return climb(center, visits, 0.5 * GRID * radius, 5 * STILL * radius, move=state.problem.where.limits.move_inside)


def _climb_density(state: TilingState, center: np.ndarray) -> np.ndarray:
    """Move a center along the gradient of the smoothed density of targets until the step is small.

    The density is smoothed by a Gaussian whose standard deviation is half the radius of a tile.
    """
    problem, weight = state.problem, state.weight
    sigma = SIGMA * problem.radius

    def look(place):
        near = problem.index.near(place, min(3 * sigma, np.pi), weight)
        away = problem.index.vectors[near] - place
        part = weight[near] * np.exp(-0.5 * np.sum(away**2, axis=1) / sigma**2)
        slope = part @ away
        return part.sum(), slope - (slope @ place) * place

    value, slope = look(center)
    step = 0.5 * sigma
    for _ in range(MOST_STEPS):
        length = np.linalg.norm(slope)
        if step <= STILL * problem.radius or length <= 1e-12 * max(value, 1e-300):
            break
        place = np.cos(step) * center + np.sin(step) * slope / length
        place /= np.linalg.norm(place)
        new, new_slope = look(place)
        if new > value:
            center, value, slope = place, new, new_slope
            step = min(1.5 * step, sigma)
        else:
            step /= 2
    return center


def _shift_to_mean(state: TilingState, center: np.ndarray) -> np.ndarray:
    """Move a center to the mean of its targets until it no longer moves, and return the best center on the path."""
    problem, weight = state.problem, state.weight
    best, most = center, -1.0
    for _ in range(MOST_STEPS):
        near = problem.index.near(center, problem.radius, weight)
        total = weight[near].sum()
        if total > most:
            best, most = center, total
        mean = weight[near] @ problem.index.vectors[near]
        length = np.linalg.norm(mean)
        if length < 1e-9 * max(total, 1e-300) or total == 0:
            break
        mean = mean / length
        moved = np.linalg.norm(mean - center)
        center = mean
        if moved <= STILL * problem.radius:
            # the last center is also a candidate
            last = weight[problem.index.near(center, problem.radius, weight)].sum()
            best = center if last >= most else best
            break
    return best
