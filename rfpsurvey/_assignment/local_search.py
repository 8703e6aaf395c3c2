"""Plans without proof of optimality: the best plan that ignores collisions, and local moves that remove collisions."""

import numpy as np

from rfpsurvey._assignment.candidates import Candidates, find_candidates
from rfpsurvey._assignment.clock import left
from rfpsurvey._assignment.distribution import add_neighbors, drop_neighbors, drop_unserved, pairs_within
from rfpsurvey._assignment.problem import AllocationProblem, with_watched
from rfpsurvey._kernels import allocation as rules
from rfpsurvey._kernels import repair as moves
from rfpsurvey._kernels.eject import Goals, Plan, eject, new_move

ROUNDS = 10
# Rounds of ejection moves, rounds without a better plan after which they end, and probability of a move to an equally
# good target: for arms that reach beyond the adjacent positioners, for their last stage, in which the sum of the
# subpriorities counts, for shorter arms, and for fewer than SMALL positioners, which take little time.
LONG_ARMS, LONG_ARMS_LAST, SHORT_ARMS, FEW_ARMS = (100, 20, 0.3), (32, 10, 0.5), (2, 2, 0.1), (300, 60, 0.3)
# Rounds of moves to better or nearer targets at the end, for long arms or few positioners, and for others.
NEAR_LONG, NEAR_SHORT = 8, 1
# Mean number of positioners that share targets with a positioner, up to which arms are short: the six adjacent ones.
ADJACENT, SMALL = 6, 300
# Number of rounds before the clock is read again, and first number of the random numbers.
TOGETHER, SEED = 4, 20
# Largest number of lost targets of the best class that are tried again at the expense of less important targets.
MOST_LOST = 8
# Number of collisions of candidates that are tested before the clock is read again.
BATCH = 2_000_000
# Number of candidates per positioner from which finding the collisions of only some candidates saves time.
CROWDED = 3


def movable_candidates(problem: AllocationProblem, before: np.ndarray) -> Candidates:
    """Return the candidates for moves from the plan ``before``; the collisions of two arms are not yet found.

    Ejection moves prefer near targets among equally good ones, so that their candidates have costs.
    """
    is_ejection = problem.options.moves == "ejection"
    return find_candidates(problem, keep_target=before, most_pairs=0, squared_cost=is_ejection)


def match(candidates: Candidates) -> np.ndarray:
    """Return the target of each positioner in the best plan that ignores collisions and requirements."""
    options, problem = candidates.options, candidates.problem
    classes = problem.rank
    if problem.any_required:
        # required targets are more important than all classes
        classes = classes - problem.is_required * (len(problem.classes) + 2)
    able = np.flatnonzero(np.diff(options.t_indptr))  # in a crowded field, few targets have candidates
    order = able[np.argsort(classes[able], kind="stable")]
    return rules.match(order, options.t_indptr, options.owner[options.t_candidate], len(options.start) - 1)


def pick(candidates: Candidates, target_of: np.ndarray, side: np.ndarray | None = None) -> np.ndarray:
    """Return the candidate of each positioner for given targets and elbows, or -1 if there is no such candidate."""
    options = candidates.options
    fits = (options.target >= 0) & (options.target == target_of[options.owner])
    if side is not None:
        fits &= candidates.side == side[options.owner]
    chosen = np.full(len(target_of), -1)
    rows = np.flatnonzero(fits)[::-1]  # the first candidate that fits is the last to be written
    chosen[options.owner[rows]] = rows
    return chosen


def trim(problem: AllocationProblem, target_of: np.ndarray) -> np.ndarray:
    """Remove the least important targets from a plan until the plan does not exceed the maximum of any requirement."""
    target_of = with_watched(problem, target_of).copy()
    for group in problem.groups:
        most = group.requirement.maximum
        if most is None:
            continue
        owner = np.flatnonzero(target_of >= 0)
        owner = owner[group.holds(target_of[owner], problem.spectrograph_of(owner, target_of[owner]), owner)]
        # The sky positions that stuck fibers observe cannot be removed.
        owner = owner[np.lexsort((problem.rank_of(target_of[owner]), problem.focal_plane.arrays.usable[owner]))]
        extra = owner[most:]
        target_of[extra[problem.focal_plane.arrays.usable[extra]]] = -1
    return target_of


def repair_nearby(
    candidates: Candidates, chosen: np.ndarray, *, steady: bool = False, **limits: float
) -> tuple[Candidates, np.ndarray]:
    """Return candidates, and the result of `repair_collisions` for them, in less time than for all candidates.

    The collisions of ``candidates`` are not yet known. A positioner only needs the candidate that it uses, unless it
    collides, has no target of the best class in reach, touches a positioner of this kind, or shares a target with it.
    Exchange moves change no other positioners. ``limits`` are those of `Candidates.with_collisions`.
    """
    options, problem = candidates.options, candidates.problem
    idle = options.start[1:] - 1
    plan = np.where(chosen < 0, idle, chosen)
    if len(candidates) > CROWDED * len(plan) and not problem.any_goals:
        keep = np.zeros(len(candidates), dtype=bool)
        keep[plan] = keep[idle] = True
        used = candidates.where(keep).with_collisions(**limits)
        now, blocked, _ = stand(used, np.searchsorted(np.flatnonzero(keep), plan))
        active = (blocked[now] > 0) | (options.rank[plan] > _best_rank(options))
        # near: active positioners, their neighbors, and positioners that reach a target of an active positioner
        near, first, second = active.copy(), *problem.focal_plane.arrays.neighbors.T
        near[second[active[first]]] = near[first[active[second]]] = True
        shared = np.zeros(len(problem.xy) + 1, dtype=bool)  # the last element is for idle arms
        shared[options.target[active[options.owner]]] = True
        shared[-1] = False
        near[options.owner[shared[options.target]]] = True
        keep |= near[options.owner]
        some = candidates.where(keep).with_collisions(**limits)
        first = np.searchsorted(np.flatnonzero(keep), plan)
        repaired = repair_collisions(some, first, active=active, near=near, steady=steady)
        if repaired is not None:
            return some, repaired
    candidates = candidates.with_collisions(**limits)
    return candidates, repair_collisions(candidates, plan, steady=steady)


def repair_collisions(
    candidates: Candidates,
    chosen: np.ndarray,
    deadline: float = np.inf,
    *,
    active: np.ndarray | None = None,
    near: np.ndarray | None = None,
    steady: bool = False,
) -> np.ndarray | None:
    """Return a plan without collisions.

    If ``near`` is given, it marks the positioners that may move; ``active`` marks those whose neighbors are all in
    ``near``. None is returned if any other positioner would have to move. With ``steady``, targets are not exchanged
    for equally good targets unless the plan gets better.

    A positioner in a collision is moved to a new candidate that is at least as good as its previous candidate. If there
    is no such candidate, the positioner can lose its target. The last candidate of each positioner must be its idle
    arm. A positioner with the value -1 in ``chosen`` begins with its idle arm.
    """
    options, is_exchange = candidates.options, candidates.problem.options.moves == "exchange"
    chosen = np.where(chosen < 0, options.start[1:] - 1, chosen)
    now, *state = stand(candidates, drop_neighbors(candidates, chosen) if candidates.spreads else chosen)
    first = _order(candidates, now)
    # with requirements and rules, ejection moves find better plans if they begin after exchanges
    n_rounds = ROUNDS if is_exchange or candidates.problem.any_goals else 0
    if not _repair(options, first, now, *state, deadline, n_rounds, active, near):
        return None
    _meet_goals(candidates, now, *state, deadline)
    if is_exchange:
        return now
    now = improve(candidates, now, deadline, near=near, steady=steady)
    return _recover(candidates, now, deadline, steady) if candidates.problem.any_goals else now


def _order(candidates, now):
    """Return the positioners in the order in which they give up their targets.

    Targets that count toward no minimum are first. Among these targets, and among all other targets, less important
    targets are first.
    """
    return np.lexsort((-candidates.options.rank[now], candidates.counted[now]))


def _meet_goals(candidates, now, blocked, holder, deadline):
    """Change a plan, in place, such that it meets the requirements and rules as far as possible."""
    state, held, least = (now, blocked, holder), candidates.held, candidates.limits[0]
    for spread in candidates.spreads:
        add_neighbors(candidates, spread, deadline, *state)
    count = held[:, now].sum(axis=1)
    for g in range(len(count)):
        need = least[g] - count[g]
        if need > 0:
            first = _order(candidates, now)
            first = first[~candidates.counted[now[first]]]
            moves.fill_group(first, need, g, held, count, candidates.limits[1], candidates.options, *state)
    # candidates of requirements may have replaced neighbors
    for spread in candidates.spreads:
        add_neighbors(candidates, spread, deadline, *state)


def _recover(candidates, chosen, deadline, steady):
    """Return a plan with targets of the best class that a plan lacks, if only few of them are lost to other goals."""
    options, values, held = candidates.options, candidates.problem.level_values, candidates.held
    wanted = np.unique(options.target[options.rank == 0])
    lost = np.setdiff1d(wanted, options.target[chosen])
    if len(lost) > MOST_LOST:
        return chosen
    for c in np.flatnonzero(np.isin(options.target, lost) & (options.rank == 0)):
        now, blocked, holder = state = stand(candidates, chosen)
        excluded = options.excluded[options.indptr[c] : options.indptr[c + 1]]
        displaced = options.owner[excluded[now[options.owner[excluded]] == excluded]]
        if holder[options.target[c]] >= 0 or (np.diff(options.start)[displaced] == 1).any() or left(deadline) == 0:
            continue
        for j in displaced:
            moves.put(j, -1, options, *state)
        moves.put(options.owner[c], c, options, *state)
        for j in displaced:
            idle = options.start[j + 1] - 1
            best = moves.best_free(j, idle, options, *state)
            moves.put(j, idle if best < 0 else best, options, *state)
        _meet_goals(candidates, *state, deadline)
        for spread in candidates.spreads:
            drop_unserved(candidates, spread, *state)
        if (blocked[now] > 0).any() or (held[:, now].sum(axis=1) > candidates.limits[1]).any():
            continue
        if tuple(values(options.target[now])) > tuple(values(options.target[chosen])):
            chosen = improve(candidates, now, deadline, steady=steady)
    return chosen


def improve(
    candidates: Candidates,
    chosen: np.ndarray,
    deadline: float = np.inf,
    *,
    near: np.ndarray | None = None,
    steady: bool = False,
) -> np.ndarray:
    """Return a plan without collisions, improved by ejection moves; the parameters are those of `repair_collisions`."""
    options, problem = candidates.options, candidates.problem
    goals, fixed, order = _goals(candidates), np.diff(options.start) == 1, np.arange(len(chosen))
    if near is not None:
        fixed |= ~near
    plan, move = _plan(candidates, chosen, goals), new_move(goals.n_classes)
    plain, progress = goals._replace(worth=np.zeros(len(options.owner))), np.array([SEED, 0], dtype=np.uint64)
    is_small, is_long = len(chosen) < SMALL, problem.focal_plane.arrays.n_sharing.mean() > ADJACENT
    stages = [(plain, *(FEW_ARMS if is_small else LONG_ARMS))] if is_small or is_long else []
    if goals.worth.any() or not stages:
        stages.append((goals, *(LONG_ARMS_LAST if stages else SHORT_ARMS)))
    if not (steady or goals.worth.any()):  # with subpriorities, hardly any plans are equally good
        n_last = NEAR_LONG if is_small or is_long else NEAR_SHORT
        stages.append((goals, n_last, n_last, 1.0))
    for some, n_rounds, patience, equal in stages:
        progress[1] = 0
        together, equal = min(n_rounds, TOGETHER), 0.0 if steady else equal
        for _ in range(0, n_rounds, together):
            if left(deadline) == 0 or progress[1] >= patience:
                break
            eject(together, patience, equal, fixed, options, some, plan, move, order, progress)
    return plan.chosen


def _goals(candidates):
    """Return what counts in a plan in addition to the classes of targets."""
    problem, target, spreads = candidates.problem, candidates.options.target, candidates.spreads
    worth = np.zeros(len(problem.xy)) if problem.subpriority is None else problem.subpriority * problem.science
    rows = candidates.held_sparse.T.tocsr()
    indptr, close = [np.zeros((0, len(problem.xy) + 1), dtype=np.int64)], [np.empty(0, dtype=np.int64)]
    for spread in spreads:
        first, second = (np.unique(target[some]) for some in (spread.near, spread.science))
        i, j = pairs_within(problem.xy[first], problem.xy[second], spread.rule.distance_mm)
        n_close = np.bincount(first[i], minlength=len(problem.xy))
        indptr.append(sum(map(len, close)) + np.append(0, np.cumsum(n_close))[None])
        close.append(second[j[np.argsort(i, kind="stable")]])
    shape = len(spreads), len(target)
    return Goals(
        np.append(problem.is_required, False)[target],
        np.append(worth, 0.0)[target],
        rows.indptr.astype(np.int64),
        rows.indices.astype(np.int64),
        *candidates.limits,
        len(problem.classes),
        problem.objective == "count" and len(problem.classes) > 1,
        np.array([spread.science for spread in spreads], dtype=bool).reshape(shape),
        np.array([spread.near for spread in spreads], dtype=bool).reshape(shape),
        np.concatenate(indptr),
        np.concatenate(close),
        np.array([spread.rule.k for spread in spreads], dtype=np.int64),
        np.array([spread.rule.percent for spread in spreads], dtype=float),
    )


def _plan(candidates, chosen, goals):
    """Return a plan in the form that ejection moves update."""
    shape = len(candidates.spreads), len(candidates.problem.xy)
    n_near, is_used = np.zeros(shape, dtype=np.int64), np.zeros(shape, dtype=bool)
    for r, spread in enumerate(candidates.spreads):
        for c in chosen[spread.near[chosen]]:
            t = candidates.options.target[c]
            n_near[r, goals.close[goals.close_indptr[r, t] : goals.close_indptr[r, t + 1]]] += 1
        is_used[r, candidates.options.target[chosen[spread.science[chosen]]]] = True
    n_served = (is_used & (n_near >= goals.k[:, None])).sum(axis=1)
    count = candidates.held[:, chosen].sum(axis=1)
    return Plan(*stand(candidates, chosen), count, n_near, is_used, is_used.sum(axis=1), n_served)


def _repair(options, order, now, blocked, holder, deadline, n_rounds, active, near):
    """Remove collisions and assign better targets in at most ``n_rounds``, in place; return whether this was possible.

    After the deadline, each remaining collision is removed by taking the target from one of the positioners, and no
    better targets are assigned. ``active`` and ``near`` are the masks of `repair_collisions`.
    """
    fixed = np.diff(options.start) == 1
    if near is not None:
        fixed |= ~near
    for some in _batches(options, order):
        if left(deadline) == 0:
            break
        moves.settle(options, some, fixed, now, blocked, holder)
    moves.drop(options, order, fixed, now, blocked, holder)
    if near is not None and (
        (blocked[now] > 0)[~near].any() or (options.rank[now] > _best_rank(options))[~active].any()
    ):
        return False
    parts = _batches(options, order[::-1].copy())
    for _ in range(n_rounds):
        changed = False
        for some in parts:
            if left(deadline) == 0:
                return True
            changed |= moves.gain(options, some, now, blocked, holder)
        if not changed:
            break
    return True


def _best_rank(options):
    """Return the class of the best candidate of each positioner."""
    return np.minimum.reduceat(options.rank, options.start[:-1]) if len(options.start) > 1 else options.rank


def _batches(options, order):
    """Divide positioners into batches whose candidates have about ``BATCH`` collisions."""
    if options.indptr[-1] + len(options.owner) < BATCH:
        return [order]
    ends = options.indptr[options.start]
    work = np.cumsum((np.diff(ends) + np.diff(options.start))[order])
    return np.split(order, np.flatnonzero(np.diff(work // BATCH)) + 1) if len(order) else []


def stand(candidates, chosen):
    """Return the state of the plan ``chosen``, which local moves update.

    The state consists of the candidate of each positioner, the number of arms in use that collide with each candidate,
    and the positioner of each target.
    """
    return moves.put_all(np.asarray(chosen, dtype=np.int64), candidates.options, max(len(candidates.problem.xy), 1))
