"""Plans without proof of optimality: the best plan that ignores collisions, and local moves that remove collisions."""

import numpy as np

from rfpsurvey._kernels import allocation as rules
from rfpsurvey._kernels import repair as moves
from rfpsurvey.allocation._candidates import Candidates
from rfpsurvey.allocation._clock import left
from rfpsurvey.allocation._distribution import add_neighbors, drop_neighbors
from rfpsurvey.allocation._problem import AllocationProblem, with_watched

ROUNDS = 10
# Number of collisions of candidates that are tested before the clock is read again.
BATCH = 2_000_000
# Number of candidates per positioner from which finding the collisions of only some candidates saves time.
CROWDED = 3


def match(candidates: Candidates) -> np.ndarray:
    """Return the target of each positioner in the best plan that ignores collisions and requirements."""
    options, problem = candidates.options, candidates.problem
    n, m = len(options.start) - 1, len(problem.xy)
    classes = problem.rank
    if problem.any_required:
        classes = classes - problem.is_required * (len(problem.classes) + 2)
    target_of, positioner_of = np.empty(n, dtype=np.int64), np.empty(m, dtype=np.int64)
    able = np.flatnonzero(np.diff(options.t_indptr))  # in a crowded field, few targets have candidates
    order = able[np.argsort(classes[able], kind="stable")]
    rules.match(order, options.t_indptr, options.own[options.t_candidate], target_of, positioner_of)
    return target_of


def pick(candidates: Candidates, target_of: np.ndarray, side: np.ndarray | None = None) -> np.ndarray:
    """Return the candidate of each positioner for given targets and elbows, or -1 if there is no such candidate."""
    options = candidates.options
    fits = (options.target >= 0) & (options.target == target_of[options.own])
    if side is not None:
        fits &= candidates.side == side[options.own]
    chosen = np.full(len(target_of), -1)
    rows = np.flatnonzero(fits)[::-1]
    chosen[options.own[rows]] = rows
    return chosen


def trim(problem: AllocationProblem, target_of: np.ndarray) -> np.ndarray:
    """Remove the least important targets from a plan until the plan does not exceed the maximum of any requirement."""
    target_of = with_watched(problem, target_of).copy()
    for group in problem.groups:
        most = group.requirement.maximum
        if most is None:
            continue
        own = np.flatnonzero(target_of >= 0)
        own = own[group.holds(target_of[own], problem.spectrograph_of(own, target_of[own]), own)]
        # The sky positions that stuck fibers observe cannot be removed.
        own = own[np.lexsort((problem.rank_of(target_of[own]), problem.focal_plane.arrays.usable[own]))]
        extra = own[most:]
        target_of[extra[problem.focal_plane.arrays.usable[extra]]] = -1
    return target_of


def repair_nearby(everything: Candidates, chosen: np.ndarray) -> tuple[Candidates, np.ndarray, int, int]:
    """Return candidates, and the result of `repair_collisions` for them, which is the same as for all candidates.

    The collisions of ``everything`` are not yet known. Only positioners that collide, or that have no target of the
    best class in reach, can change the plan: they can move, or move a positioner that touches them or shares a target
    with them. Therefore, all other positioners only need the candidates that they use.
    """
    options, problem = everything.options, everything.problem
    idle = options.start[1:] - 1
    plan = np.where(chosen < 0, idle, chosen)
    if len(everything) > CROWDED * len(plan) and not problem.any_goals:
        keep = np.zeros(len(everything), dtype=bool)
        keep[plan] = keep[idle] = True
        used = everything.where(keep).with_collisions()
        now, blocked, _ = stand(used, np.searchsorted(np.flatnonzero(keep), plan))
        active = (blocked[now] > 0) | (options.rank[plan] > _best_rank(options))
        near, first, second = active.copy(), *problem.focal_plane.arrays.neighbors.T
        near[second[active[first]]] = near[first[active[second]]] = True
        shared = np.zeros(len(problem.xy) + 1, dtype=bool)  # the last element is for idle arms
        shared[options.target[active[options.own]]] = True
        shared[-1] = False
        near[options.own[shared[options.target]]] = True
        keep |= near[options.own]
        some = everything.where(keep).with_collisions()
        found = repair_collisions(some, np.searchsorted(np.flatnonzero(keep), plan), active=active, near=near)
        if found is not None:
            return some, *found
    everything = everything.with_collisions()
    return everything, *repair_collisions(everything, plan)


def repair_collisions(
    candidates: Candidates, chosen: np.ndarray, deadline: float = np.inf, *, active=None, near=None
) -> tuple[np.ndarray, int, int] | None:
    """Return a plan without collisions, the number of moved positioners, and the number of lost targets.

    If ``near`` is given, it marks the positioners that may move; ``active`` marks those whose neighbors are all in
    ``near``. None is returned if any other positioner would have to move.

    A positioner in a collision is moved to a new candidate that is at least as good as its previous candidate. If there
    is no such candidate, the positioner can lose its target. The last candidate of each positioner must be its idle
    arm. A positioner with the value -1 in ``chosen`` begins with its idle arm.
    """
    options, held = candidates.options, candidates.held
    groups = candidates.problem.groups
    chosen = np.where(chosen < 0, options.start[1:] - 1, chosen)
    now, *state = stand(candidates, drop_neighbors(candidates, chosen) if candidates.spreads else chosen)
    # whether each candidate counts toward a minimum
    counted = held[[group.requirement.minimum > 0 for group in groups]].any(axis=0)
    most = np.array([np.inf if g.requirement.maximum is None else g.requirement.maximum for g in groups], dtype=float)

    def order():
        """Return the positioners in the order in which they give up their targets.

        Targets that count toward no minimum are first. Among these targets, and among all other targets, less important
        targets are first.
        """
        return np.lexsort((-options.rank[now], counted[now]))

    counts = _repair(options, order(), now, *state, deadline, active, near)
    if counts is None:
        return None
    for spread in candidates.spreads:
        add_neighbors(candidates, spread, most, deadline, now, *state)
    count = held[:, now].sum(axis=1)
    for g, group in enumerate(groups):
        need = group.requirement.minimum - count[g]
        if need > 0:
            first = order()
            first = first[~counted[now[first]]]
            moves.fill_group(first, need, g, held, count, most, options, now, *state)
    for spread in candidates.spreads:
        add_neighbors(candidates, spread, most, deadline, now, *state)
    return now, *counts


def improve(candidates: Candidates, chosen: np.ndarray, deadline: float = np.inf) -> np.ndarray:
    """Return a plan without collisions, improved by local moves that give positioners more important targets."""
    now, *state = stand(candidates, chosen)
    order = np.argsort(-candidates.options.rank[now], kind="stable")
    _repair(candidates.options, order, now, *state, deadline)
    return now


def _repair(options, order, now, blocked, holder, deadline, active=None, near=None):
    """Remove collisions and assign better targets, in place; return the numbers of moved positioners and lost targets.

    After the deadline, each remaining collision is removed by taking the target from one of the positioners, and no
    better targets are assigned. ``active`` and ``near`` are the masks of `repair_collisions`.
    """
    moved, fixed = 0, np.diff(options.start) == 1
    if near is not None:
        fixed |= ~near
    for some in _batches(options, order):
        if left(deadline) == 0:
            break
        moved += int(moves.settle(options, some, fixed, now, blocked, holder))
    dropped = int(moves.drop(options, order, fixed, now, blocked, holder))
    if near is not None and (
        (blocked[now] > 0)[~near].any() or (options.rank[now] > _best_rank(options))[~active].any()
    ):
        return None
    parts = _batches(options, order[::-1].copy())
    for _ in range(ROUNDS):
        changed = False
        for some in parts:
            if left(deadline) == 0:
                return moved, dropped
            changed |= moves.gain(options, some, now, blocked, holder)
        if not changed:
            break
    return moved, dropped


def _best_rank(options):
    """Return the class of the best candidate of each positioner."""
    return np.minimum.reduceat(options.rank, options.start[:-1]) if len(options.start) > 1 else options.rank


def _batches(options, order):
    """Divide positioners into batches whose candidates have about ``BATCH`` collisions."""
    if options.indptr[-1] + len(options.own) < BATCH:
        return [order]
    ends = options.indptr[options.start]
    work = np.cumsum((np.diff(ends) + np.diff(options.start))[order])
    return np.split(order, np.flatnonzero(np.diff(work // BATCH)) + 1) if len(order) else []


def stand(candidates, chosen):
    """Return the state of the plan ``chosen``, which local moves update.

    The state consists of the candidate of each positioner, the number of arms in use that collide with each candidate,
    and the positioner of each target.
    """
    now = np.full(len(chosen), -1)
    blocked, holder = np.zeros(len(candidates), dtype=np.int64), np.full(max(len(candidates.problem.xy), 1), -1)
    moves.put_all(chosen, candidates.options, now, blocked, holder)
    return now, blocked, holder
