"""Rules on the distribution of fibers: the science fibers that lack neighbors, in plans and in local moves."""

from typing import NamedTuple

import numpy as np

from rfpsurvey._kernels import repair as moves
from rfpsurvey._roles import has_role
from rfpsurvey.allocation._clock import left
from rfpsurvey.constraints import Distribution

# Factor by which the distance is increased when pairs are searched, because of rounding errors.
WIDER = 1 + 1e-9


class Spread(NamedTuple):
    """The candidates that a rule on the distribution of fibers concerns."""

    rule: Distribution
    science: np.ndarray  # whether each candidate is a science fiber of the rule
    near: np.ndarray  # whether each candidate can be a neighbor of a science fiber


def members(problem, rule: Distribution, what: str, owner: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Return whether assignments are of a kind or category, and use the fiber type of a rule."""
    is_member = np.append(has_role(problem.kind, what) | (problem.category == what), False)[target]
    if rule.fiber_type:
        is_member &= problem.fiber_of(owner, target) == problem.focal_plane.fiber_types.index(rule.fiber_type)
    return is_member


def is_possible(problem, rule: Distribution) -> bool:
    """Return whether at least one science target in reach has enough neighbors in reach."""
    owner, target = problem.pairs.owner, problem.pairs.target
    if problem.watched is not None:
        stuck = np.flatnonzero(problem.watched >= 0)
        owner, target = np.append(owner, stuck), np.append(target, problem.watched[stuck])
    science, near = (
        problem.xy[np.unique(target[members(problem, rule, what, owner, target)])] for what in ("science", rule.what)
    )
    return bool((rule.distances(science, near, rule.k) <= rule.distance_mm).any())


def lack_of(problem, rule: Distribution, target_of: np.ndarray) -> int:
    """Return how many more science fibers of a plan would need neighbors so that the plan complies with a rule."""
    owner = np.flatnonzero(target_of >= 0)
    target = target_of[owner]
    science, near = (problem.xy[target[members(problem, rule, what, owner, target)]] for what in ("science", rule.what))
    n_served = int((rule.distances(science, near, rule.k) <= rule.distance_mm).sum())
    return max(rule.least(len(science)) - n_served, 0)


def lost_to_rules(problem, free: np.ndarray, target_of: np.ndarray) -> int:
    """Return how many more science targets than a plan another plan, which ignores the rules, observes."""
    most, n = (int(problem.science[plan[plan >= 0]].sum()) for plan in (free, target_of))
    return most - n


def pairs_within(first: np.ndarray, second: np.ndarray, distance: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the rows of the points ``first`` and ``second`` of all pairs within a distance."""
    from scipy.spatial import cKDTree

    if len(first) == 0 or len(second) == 0:
        return np.empty((2, 0), dtype=np.int64)
    pairs = cKDTree(first).sparse_distance_matrix(cKDTree(second), distance * WIDER, output_type="ndarray")
    pairs = pairs[np.sqrt(((first[pairs["i"]] - second[pairs["j"]]) ** 2).sum(axis=1)) <= distance]
    return pairs["i"].astype(np.int64), pairs["j"].astype(np.int64)


def drop_neighbors(candidates, chosen: np.ndarray) -> np.ndarray:
    """Return a plan without the neighbors that a rule counts, for each rule that the plan violates."""
    options, problem = candidates.options, candidates.problem
    able = (np.diff(options.start) > 1) & ~np.append(problem.is_required, False)[options.target[chosen]]
    target_of = options.target[chosen]
    for rule, _, near in candidates.spreads:
        if lack_of(problem, rule, target_of):
            chosen = np.where(able & near[chosen], options.start[1:] - 1, chosen)
    return chosen


def add_neighbors(candidates, spread: Spread, deadline: float, now, blocked, holder) -> None:
    """Assign neighbors to positioners until a plan complies with a rule, or no candidate has an effect, in place.

    The gain of a candidate is the number of science fibers that lack neighbors close to it. Among the candidates with
    at least half of the largest gain, each step assigns the one whose positioner gives up the least important target.
    ``now``, ``blocked`` and ``holder`` are the state of the plan (`stand`).
    """
    from scipy.sparse import csr_array

    options, problem, held = candidates.options, candidates.problem, candidates.held
    rule, science, near = spread
    if not lack_of(problem, rule, options.target[now]):
        return
    least, most = candidates.limits
    keep = np.append(problem.is_required, False)[options.target]
    keep |= np.any([spread.near for spread in candidates.spreads], axis=0)
    able, fibers = np.flatnonzero(near), now[science[now]]
    owner, alive = options.owner[able], np.ones(len(fibers), dtype=bool)
    place, at = np.unique(options.target[able], return_inverse=True)
    pairs = pairs_within(problem.xy[options.target[fibers]], problem.xy[place], rule.distance_mm)
    close = csr_array((np.ones(len(pairs[0])), pairs), shape=(len(fibers), len(place))).tocsc()
    in_use = np.bincount(at[np.isin(able, now)], minlength=len(place))
    n_near = close @ in_use
    while left(deadline) > 0 and (alive & (n_near >= rule.k)).sum() < rule.least(int(alive.sum())):
        # a neighbor counts as a fraction of a fiber that lacks several neighbors
        weight = np.where(alive & (n_near < rule.k), 1.0 / np.maximum(rule.k - n_near, 1), 0.0)
        gain = (close.T @ weight)[at]
        some = np.flatnonzero(gain)
        some = some[(blocked[able[some]] == 0) & (holder[options.target[able[some]]] < 0) & ~keep[now[owner[some]]]]
        count = held[:, now].sum(axis=1)
        before, after = held[:, now[owner[some]]], held[:, able[some]]
        wrong = (after & ~before)[count >= most].any(axis=0) | before[(least > 0) & (count <= least)].any(axis=0)
        some = some[~wrong]
        if len(some) == 0:
            break
        some = some[gain[some] >= gain[some].max() / 2]
        best = some[np.lexsort((-gain[some], -options.rank[now[owner[some]]]))[0]]
        alive &= fibers != now[owner[best]]
        moves.put(owner[best], able[best], options, now, blocked, holder)
        n_near[close.indices[close.indptr[at[best]] : close.indptr[at[best] + 1]]] += 1


def drop_unserved(candidates, spread: Spread, now, blocked, holder) -> None:
    """Remove the least important science fibers that lack neighbors until a plan complies with a rule, in place.

    ``now``, ``blocked`` and ``holder`` are the state of the plan (`stand`).
    """
    options, problem, rule = candidates.options, candidates.problem, spread.rule
    fibers, near = now[spread.science[now]], now[spread.near[now]]
    apart = rule.distances(problem.xy[options.target[fibers]], problem.xy[options.target[near]], rule.k)
    lacking = fibers[apart > rule.distance_mm]
    for c in lacking[np.argsort(-options.rank[lacking], kind="stable")]:
        idle = options.start[options.owner[c] + 1] - 1
        if lack_of(problem, rule, options.target[now]) > 0 and blocked[idle] == 0 and c != idle:
            moves.put(options.owner[c], idle, options, now, blocked, holder)
