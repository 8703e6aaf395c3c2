"""Rules that limit all candidates of a plan: the distribution of fibers, and arms that unfold without collisions."""

from typing import NamedTuple

import numpy as np

from rfpsurvey._assignment.clock import left
from rfpsurvey._assignment.constraints.rules import Distribution
from rfpsurvey._instruments import moves as _moves
from rfpsurvey._instruments.find_collisions import obstacle_tests
from rfpsurvey._instruments.reach import Reach
from rfpsurvey._kernels import repair as moves
from rfpsurvey._kernels.motion import Moves
from rfpsurvey._sky.arrays import has_role


class Motion:
    """The motion of the arms of a problem, from their folded poses to their targets.

    Folded arms without a target have the directions in which they collide with the fewest candidates.

    Parameters
    ----------
    problem : AllocationProblem
        The allocation problem.
    """

    def __init__(self, problem):
        self.problem, self.same_speed = problem, problem.options.motion_law == "same_speed"
        columns, parked = problem.focal_plane.arrays, problem.parked_obstacles
        self._idle = _moves.idle_moves(columns, parked)
        self._turning = _moves.Turning(columns, self._idle)
        if not _moves.stays_folded(columns, parked).any():
            return
        indptr, target, r2 = problem.pairs.by_positioner
        owner = np.repeat(np.arange(len(problem.focal_plane)), np.diff(indptr))
        target = target[np.lexsort((r2, owner))]  # the directions must not depend on the order of the targets
        side = columns.sides(problem.xy[target], owner, problem.fiber_of(owner, target))
        moves = self.moves(owner, target, side)
        self._idle = _moves.turn_idle_arms(columns, self._idle, self._turning, indptr, moves, self.same_speed)

    def moves(self, owner: np.ndarray, target: np.ndarray, side: np.ndarray, idle: np.ndarray | None = None) -> Moves:
        """Return the motion of each candidate; ``idle`` contains the indices of the idle arms of all positioners."""
        points, real = np.full((len(owner), 2), np.nan), np.ones(len(owner), dtype=bool)
        if idle is not None:
            real[idle] = False
        points[real] = self.problem.xy[target[real]]
        columns, fiber = self.problem.focal_plane.arrays, self.problem.fiber_of(owner, target)
        moves = _moves.solve_moves(columns, owner, fiber, points, side)
        return moves if idle is None else _moves.joined(moves, idle, self._idle, np.arange(len(idle)))

    def obstacle_hits(self, owner: np.ndarray, moves: Moves) -> np.ndarray:
        """Return the pairs (arm, obstacle) that collide while arms unfold; ``owner`` is the positioner of each arm."""
        plane = self.problem.focal_plane
        test = obstacle_tests(plane.arrays.obstacle_pairs, owner)
        return test[_moves.unfolding_obstacles(plane, moves, owner, test)]

    def turns(self, owner: np.ndarray, moves: Moves) -> np.ndarray:
        """Return whether each folded arm can turn to its direction; the positioners ``owner`` are sorted."""
        center = self.problem.focal_plane.arrays.xy[owner]
        return self._turning.allows(owner, np.arctan2(moves.y - center[:, 1], moves.x - center[:, 0]))

    def allowed(self, owner: np.ndarray, target: np.ndarray, side: np.ndarray) -> np.ndarray:
        """Return whether the arm of each candidate can turn and unfold without a collision with obstacles.

        The candidates must be sorted by positioner; idle arms are allowed.
        """
        plane = self.problem.focal_plane
        near, allowed = np.zeros(len(plane), dtype=bool), np.ones(len(owner), dtype=bool)
        near[plane.arrays.obstacle_pairs[:, 0]] = near[self._turning.examined] = True
        rows = np.flatnonzero(near[owner] & (target >= 0))
        if len(rows):
            moves = self.moves(owner[rows], target[rows], side[rows])
            allowed[rows] = self.turns(owner[rows], moves)
            allowed[rows[self.obstacle_hits(owner[rows], moves)[:, 0]]] = False
        return allowed

    def reachable(self, reach: Reach) -> Reach:
        """Return the pairs (positioner, target) for which at least one pose is `allowed`."""
        columns, n = self.problem.focal_plane.arrays, len(reach.owner)
        order = np.argsort(reach.owner, kind="stable")
        owner, target = reach.owner[order], reach.target[order]
        fiber, points = self.problem.fiber_of(owner, target), self.problem.xy[target]
        if columns.plane.positioner.handedness == "both":
            free = np.zeros(n, dtype=bool)
            for side in (1.0, -1.0):
                allowed = self.allowed(owner, target, np.full(n, side))
                free |= allowed & columns.poses_allowed(owner, points, side, fiber)
        else:
            free = self.allowed(owner, target, columns.sides(points, owner, fiber))
        keep = np.empty(n, dtype=bool)
        keep[order] = free
        return reach if keep.all() else reach.where(keep)


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
