"""The problem of placing tiles, the state of the tiles placed so far, and the order in which tiles are observed.

This module also makes the summary of a tiling, and issues warnings about goals that the tiling does not reach.
"""

import heapq
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from rfpsurvey._sky.arrays import SkyIndex
from rfpsurvey._survey.tiling.centers import Centers, Declinations
from rfpsurvey._survey.tiling.tiling import place_of, to_ra_dec
from rfpsurvey.errors import warn

ROW = np.dtype(
    [("center", float, 3), ("pass", np.int64), ("n_targets", np.int64), ("n_new", np.int64), ("completeness", float)]
)
"""Columns of a placed tile: ``n_targets`` targets in its field require a visit, and it observes ``n_new`` of them."""


@dataclass(frozen=True)
class TilingProblem:
    """The problem of placing tiles; angles are in radians.

    The *position* of a target is its place in the spatial index ``index``.
    """

    radius: float
    index: SkyIndex
    wanted: np.ndarray
    """Number of requested visits of each target."""
    fibers: int
    serve: Callable
    """Function serve(center, positions, state) that returns the positions of the targets that a tile observes."""
    reach: float
    """Largest distance from the center of a tile at which the tile observes targets."""
    where: Centers = field(default_factory=Centers)
    """Constraints on the centers of tiles."""
    passes: int = 1
    n_tiles: int | None = None
    completeness: float | None = None
    n_beyond: int = 0
    """Number of requested visits that no tile within the limits can make; ``wanted`` does not include these visits."""
    level: np.ndarray | None = None
    """Priority class of each target, 0 for the highest priority; None if all targets have the same priority."""
    tell: Callable | None = None
    """Function that is called after each tile with the number of tiles and the completeness."""

    @property
    def open_ended(self) -> bool:
        """Whether neither a number of tiles nor a completeness is given as the goal."""
        return self.n_tiles is None and self.completeness is None

    def visits_near(self, centers: np.ndarray, margin: float = 0.0) -> np.ndarray:
        """Return the number of visits requested in the field around each center, which is enlarged by a margin."""
        return self.index.sum_near(centers, min(self.radius + margin, np.pi), self.wanted.astype(np.float64))

    def circle(self) -> tuple[np.ndarray, float]:
        """Return the center and the radius of a circle around the targets with requested visits."""
        vectors = self.index.vectors[self.wanted > 0]
        center = vectors.sum(axis=0)
        length = np.linalg.norm(center)
        # targets all over the sky may have no mean direction
        center = center / length if length > 1e-6 * len(vectors) else np.array([0.0, 0.0, 1.0])
        chord = np.linalg.norm(vectors - center, axis=1).max()
        return center, float(2 * np.arcsin(min(chord / 2, 1.0)))


@dataclass
class TilingState:
    """The remaining visits, and the tiles placed so far."""

    problem: TilingProblem
    left: np.ndarray = field(init=False)
    """Number of remaining visits of each target."""
    hopeless: np.ndarray = field(init=False)
    """For each target, whether no more tiles are placed for it, because a tile near it observed no target."""
    chances: np.ndarray | None = None
    """Number of later tiles that cover each target; None if these numbers are unknown."""
    rows: list = field(default_factory=list)
    """The tiles that were placed, as tuples of the values of `ROW`."""

    def __post_init__(self):
        self.left = self.problem.wanted.astype(np.float64)
        self.hopeless = np.zeros(len(self.left), dtype=bool)
        self._n_left = float(self.left.sum())
        self._n_requested = max(self._n_left + self.problem.n_beyond, 1.0)
        self._at = {}

    @property
    def table(self) -> np.ndarray:
        """The tiles that were placed, as records."""
        return np.array(self.rows, ROW)

    @property
    def weight(self) -> np.ndarray:
        """Number of remaining visits of each target, weighted by its priority; 0 where ``hopeless`` is true.

        Each visit of the highest remaining priority has the weight 1. The weights of all other visits sum to less than
        1.
        """
        weight = np.where(self.hopeless, 0.0, self.left) if self.hopeless.any() else self.left
        if self.problem.level is None:
            return weight
        return np.where(self.problem.level == self.leading(weight), weight, weight * self.unit)

    def leading(self, weight: np.ndarray | None = None) -> int:
        """Return the class of the highest priority among the targets for which tiles are still placed."""
        if self.problem.level is None:
            return 0
        weight = self.left * ~self.hopeless if weight is None else weight
        return int(self.problem.level[weight > 0].min(initial=self.problem.level.max()))

    @property
    def unit(self) -> float:
        """Weight of a visit to a target whose priority is below the highest remaining priority."""
        # all visits of lower priority together weigh less than one visit of the highest remaining priority
        return 1.0 if self.problem.level is None else 1.0 / (1.0 + self._n_requested)

    @property
    def completeness(self) -> float:
        """Fraction of the requested visits that the tiles placed so far provide."""
        return 1.0 - (self._n_left + self.problem.n_beyond) / self._n_requested

    @property
    def done(self) -> bool:
        """Whether the required completeness is reached, no visits remain, or no more tiles are allowed."""
        problem = self.problem
        enough = problem.completeness is not None and self.completeness >= problem.completeness - 1e-12
        return enough or self._n_left == 0 or (problem.n_tiles is not None and len(self.rows) >= problem.n_tiles)

    def observe(self, center: np.ndarray, number: int | None = None, *, every: bool = False) -> np.ndarray:
        """Place a tile, and return the positions of the targets that it observes.

        A tile that observes no target is placed only if ``every`` is true. By default, the number of the pass is 1 plus
        the number of earlier tiles with the same center.
        """
        problem = self.problem
        near = problem.index.near(center, problem.reach, self.left)
        served = problem.serve(center, near, self) if len(near) else near
        if len(served) == 0 and not every:
            return served
        self.left[served] -= 1
        self._n_left -= len(served)
        if number is None:
            key = tuple(place_of(*to_ra_dec(center[None]))[0].tolist())
            number = self._at[key] = self._at.get(key, 0) + 1
        self.rows.append((center, number, len(near), len(served), self.completeness))
        if problem.tell is not None:
            problem.tell(len(self.rows), self.completeness)
        return served

    def give_up(self, center: np.ndarray) -> None:
        """Stop placing tiles for the targets around a center where a tile observed no target."""
        problem, weight = self.problem, self.weight
        near = problem.index.near(center, problem.radius, weight)
        near = near if len(near) else np.flatnonzero(weight > 0)
        vectors = problem.index.vectors[near]
        closest = vectors[np.argmin(np.linalg.norm(vectors - center, axis=1))]
        self.hopeless[near[np.linalg.norm(vectors - closest, axis=1) <= 0.1 * problem.radius]] = True


def visit_all(state: TilingState, centers: np.ndarray, number: int | None, *, every: bool = False) -> int:
    """Observe the tiles of one pass until no more tiles are needed; return the number of placed tiles.

    By default, a tile is omitted if none of its targets still requires a visit. If ``every`` is true, a tile is omitted
    only if no visits to its targets were requested. The tile with the most targets that still require a visit is
    observed next. Because this number can only decrease, these targets are counted again only for the tile with the
    largest earlier count. If this count has not changed, no other tile has more of these targets.
    """
    index, radius = state.problem.index, state.problem.radius
    state.chances = np.zeros(len(index))
    for center in centers:
        state.chances[index.near(center, radius)] += 1
    counts = index.sum_near(centers, radius, (state.left > 0).astype(np.float64))
    wanted = index.sum_near(centers, radius, (state.problem.wanted > 0).astype(np.float64))
    use = wanted if every else counts
    heap = [(-count, k) for k, count in enumerate(counts.tolist()) if use[k] > 0]
    heapq.heapify(heap)
    before = len(state.rows)
    while heap and (every or not state.done):
        old, k = heapq.heappop(heap)
        count = len(index.near(centers[k], radius, state.left))
        if count < -old and (count > 0 or every):
            heapq.heappush(heap, (-count, k))
            continue
        state.chances[index.near(centers[k], radius)] -= 1
        if count or every:
            state.observe(centers[k], number, every=every)
    state.chances = None
    return len(state.rows) - before


def visit_given(problem: TilingProblem) -> TilingState:
    """Observe the tiles in ``centers`` in their order until the goal is reached; without a goal, observe all tiles."""
    state = TilingState(problem)
    for center, number in zip(problem.where.tiling.vectors, problem.where.tiling.table["pass"].tolist(), strict=True):
        if state.done and not problem.open_ended:
            break
        state.observe(center, number, every=True)
    return state


def warn_of_rest(state: TilingState, n_away: int, limits: Declinations) -> None:
    """Issue a warning for goals that are not reached, and for targets that no tile reaches."""
    problem, n = state.problem, len(state.rows)
    goal = problem.completeness
    if goal is not None and state.completeness < goal - 1e-12:
        limit = "" if problem.n_tiles is None or n < problem.n_tiles else f"; n_tiles={n} allows no more tiles"
        warn(f"{n} tiles reach a completeness of {state.completeness:.4f}, not {goal:g}{limit}")
    if n_away:
        warn(f"{n_away} targets are out of reach{limits.words}; they count as not observed")
    if not n:
        warn("no tile observes any target")


def account_of(state: TilingState, neighbors, n_away: int) -> dict:
    """Return the summary of a tiling; ``n_away`` targets cannot be reached within the declination limits."""
    problem = state.problem
    wanted, made = problem.wanted, problem.wanted - state.left
    n = len(state.rows)
    depth = SkyIndex(state.table["center"]).sum_near(problem.index.vectors[wanted > 0], problem.radius, np.ones(n))
    account = {
        "n_targets": int(np.count_nonzero(wanted)) + n_away,
        **({} if problem.where.limits.anywhere else {"n_beyond_declination": n_away}),
        "n_on_tiles": int(np.count_nonzero(depth)),
        "n_requested": int(wanted.sum()) + problem.n_beyond,
        "n_observed": int(made.sum()),
        "completeness": float(state.completeness),
        "fiber_use": float(made.sum() / max(n * problem.fibers, 1)),
    }
    if neighbors is not None:
        indptr, neighbor = neighbors
        # only neighbors with requested visits can be too close
        near = np.bincount(np.repeat(np.arange(len(wanted)), np.diff(indptr)), wanted[neighbor] > 0, len(wanted))
        alone = np.flatnonzero((wanted > 0) & (near == 0))
        account["n_isolated"] = len(alone)
        account["completeness_isolated"] = float(made[alone].sum() / max(wanted[alone].sum(), 1))
    return account
