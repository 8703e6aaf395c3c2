"""Rules on the distribution of fibers: the science fibers that lack neighbors, in plans, programs and local moves."""

from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from rfpsurvey._kernels import repair as moves
from rfpsurvey.allocation._clock import left
from rfpsurvey.constraints import Distribution

# Factor by which the distance is increased when pairs are searched, because of rounding errors.
WIDER = 1 + 1e-9


class Spread(NamedTuple):
    """The candidates that a rule on the distribution of fibers concerns."""

    rule: Distribution
    science: np.ndarray
    """Whether each candidate is a science fiber of the rule."""
    near: np.ndarray
    """Whether each candidate can be a neighbor of a science fiber."""


def members(problem, rule: Distribution, what: str, own: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Return whether assignments are of a kind or category, and use the fiber type of a rule."""
    found = np.append((problem.kind == what) | (problem.category == what), False)[target]
    if rule.fiber_type:
        found &= problem.fiber_of(own, target) == problem.focal_plane.fiber_types.index(rule.fiber_type)
    return found


def is_possible(problem, rule: Distribution) -> bool:
    """Return whether at least one science target in reach has enough neighbors in reach."""
    own, target = problem.pairs.owner, problem.pairs.target
    if problem.watched is not None:
        stuck = np.flatnonzero(problem.watched >= 0)
        own, target = np.append(own, stuck), np.append(target, problem.watched[stuck])
    science, near = (
        problem.xy[np.unique(target[members(problem, rule, what, own, target)])] for what in ("science", rule.what)
    )
    return bool((rule.distances(science, near, rule.k) <= rule.distance_mm).any())


def lack_of(problem, rule: Distribution, target_of: np.ndarray) -> int:
    """Return how many more science fibers of a plan would need neighbors so that the plan complies with a rule."""
    own = np.flatnonzero(target_of >= 0)
    target = target_of[own]
    science, near = (problem.xy[target[members(problem, rule, what, own, target)]] for what in ("science", rule.what))
    n_served = int((rule.distances(science, near, rule.k) <= rule.distance_mm).sum())
    return max(rule.least(len(science)) - n_served, 0)


def pairs_within(first: np.ndarray, second: np.ndarray, distance: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the rows of the points ``first`` and ``second`` of all pairs within a distance."""
    if len(first) == 0 or len(second) == 0:
        return np.empty((2, 0), dtype=np.int64)
    found = cKDTree(first).sparse_distance_matrix(cKDTree(second), distance * WIDER, output_type="ndarray")
    found = found[np.sqrt(((first[found["i"]] - second[found["j"]]) ** 2).sum(axis=1)) <= distance]
    return found["i"].astype(np.int64), found["j"].astype(np.int64)


class SpreadRows(NamedTuple):
    """The part of an integer program that describes a rule, with a variable for each science target.

    The variable of a target is 1 if the target has a fiber and enough neighbors. It is not necessary for targets that
    have enough neighbors, or too few, in every plan of the program.
    """

    k: int
    fraction: float
    science: np.ndarray
    """Columns of the candidates that are science fibers."""
    always: np.ndarray
    """Columns of the candidates that are science fibers and have enough neighbors in every plan."""
    n_fixed: int
    """Number of science fibers outside the program, minus those that have enough neighbors in every plan."""
    n_served: int
    own: csr_array
    """Columns of the candidates of the target of each variable, as ones; empty for targets with a fixed fiber."""
    near: csr_array
    """Columns of the candidates that are neighbors of the target of each variable, as ones."""
    is_fixed: np.ndarray
    n_near: np.ndarray
    """Number of fixed neighbors of the target of each variable."""

    @classmethod
    def of(cls, candidates, spread: Spread, rows: np.ndarray, others: np.ndarray) -> "SpreadRows":
        """Return the rows for the candidates ``rows``; the candidates ``others`` are in use in every plan."""
        xy, target, (rule, science, near) = candidates.problem.xy, candidates.options.target, spread
        column, neighbors = np.flatnonzero(science[rows]), np.flatnonzero(near[rows])
        fixed = target[others[science[others]]]
        targets, first = np.unique(np.append(target[rows[column]], fixed), return_index=True)
        is_fixed = first >= len(column)
        place, at = np.unique(target[rows[neighbors]], return_inverse=True)
        t, p = pairs_within(xy[targets], xy[place], rule.distance_mm)
        shape = len(targets), len(rows)
        near = csr_array((np.ones(len(t)), (t, p)), shape=(len(targets), len(place)))
        near = near @ csr_array((np.ones(len(at)), (at, neighbors)), shape=(len(place), len(rows)))
        own = csr_array((np.ones(len(column)), (np.searchsorted(targets, target[rows[column]]), column)), shape=shape)
        t, _ = pairs_within(xy[targets], xy[target[others[spread.near[others]]]], rule.distance_mm)
        n_near = np.bincount(t, minlength=len(targets))
        enough, possible = n_near >= rule.k, n_near + near.sum(axis=1) >= rule.k
        kept = np.flatnonzero(possible & ~enough)
        return cls(
            rule.k,
            rule.percent / 100,
            column,
            column[enough[np.searchsorted(targets, target[rows[column]])]],
            len(fixed),
            int((is_fixed & enough).sum()),
            own[kept],
            near[kept],
            is_fixed[kept],
            n_near[kept],
        )

    def __len__(self):
        return len(self.n_near)

    def values(self, x: np.ndarray) -> np.ndarray:
        """Return the variables of the targets for a plan, from the variables of the candidates."""
        n = self.own.shape[1]
        return (self.is_fixed | (self.own @ x[:n] > 0.5)) & (self.near @ x[:n] + self.n_near > self.k - 0.5)


def drop_neighbors(candidates, chosen: np.ndarray) -> np.ndarray:
    """Return a plan without the neighbors that a rule counts, for each rule that the plan violates."""
    options, problem = candidates.options, candidates.problem
    able = (np.diff(options.start) > 1) & ~np.append(problem.is_required, False)[options.target[chosen]]
    target_of = options.target[chosen]
    for rule, _, near in candidates.spreads:
        if lack_of(problem, rule, target_of):
            chosen = np.where(able & near[chosen], options.start[1:] - 1, chosen)
    return chosen


def add_neighbors(candidates, spread: Spread, most: np.ndarray, deadline: float, now, blocked, holder) -> None:
    """Assign neighbors to positioners until a plan complies with a rule, or no candidate has an effect, in place.

    The gain of a candidate is the number of science fibers that lack neighbors close to it. Among the candidates with
    at least half of the largest gain, each step assigns the one whose positioner gives up the least important target.
    ``most`` are the maxima of the requirements; ``now``, ``blocked`` and ``holder`` are the state of the plan
    (`stand`).
    """
    options, problem, held = candidates.options, candidates.problem, candidates.held
    rule, science, near = spread
    low = [group.requirement.minimum > 0 for group in problem.groups]
    keep = held[low].any(axis=0) | np.append(problem.is_required, False)[options.target]
    keep |= np.any([one.near for one in candidates.spreads], axis=0)
    able, fibers = np.flatnonzero(near), now[science[now]]
    own, alive = options.own[able], np.ones(len(fibers), dtype=bool)
    place, at = np.unique(options.target[able], return_inverse=True)
    pairs = pairs_within(problem.xy[options.target[fibers]], problem.xy[place], rule.distance_mm)
    close = csr_array((np.ones(len(pairs[0])), pairs), shape=(len(fibers), len(place))).tocsc()
    in_use = np.bincount(at[np.isin(able, now)], minlength=len(place))
    n_near = close @ in_use
    while left(deadline) > 0 and (alive & (n_near >= rule.k)).sum() < rule.least(int(alive.sum())):
        weight = np.where(alive & (n_near < rule.k), 1.0 / np.maximum(rule.k - n_near, 1), 0.0)
        gain = (close.T @ weight)[at]
        full = held[:, now].sum(axis=1) >= most
        full = (held[:, able] & ~held[:, now[own]])[full].any(axis=0)
        free = (blocked[able] == 0) & (holder[options.target[able]] < 0) & ~keep[now[own]] & ~full
        gain = np.where(free, gain, 0.0)
        if gain.max(initial=0.0) == 0:
            break
        best = int(np.lexsort((-gain, -np.where(gain >= gain.max() / 2, options.rank[now[own]], -1)))[0])
        alive &= fibers != now[own[best]]
        moves.put(own[best], able[best], options, now, blocked, holder)
        n_near[close.indices[close.indptr[at[best]] : close.indptr[at[best] + 1]]] += 1
