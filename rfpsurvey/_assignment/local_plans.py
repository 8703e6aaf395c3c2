"""The plan of ``repair``, from which `decide` starts if arms are long or if time is short, and poses of idle arms."""

from collections.abc import Callable
from contextlib import suppress
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array, hstack, vstack

from rfpsurvey._assignment.answer import AllocationAnswer
from rfpsurvey._assignment.candidates import Candidates
from rfpsurvey._assignment.clock import OutOfTimeError, left, now, share
from rfpsurvey._assignment.clusters import program_of
from rfpsurvey._assignment.local_search import (
    match,
    movable_candidates,
    pick,
    repair_collisions,
    repair_nearby,
    stand,
    trim,
)
from rfpsurvey._assignment.objectives import DIGITS, is_sum_maximized, levels_of, offset_of, with_subpriorities
from rfpsurvey._assignment.problem import AllocationProblem
from rfpsurvey._assignment.rules import plan_lamost_rule
from rfpsurvey._assignment.solver import maximize
from rfpsurvey._instruments.reach import elbow_names
from rfpsurvey._kernels import repair as moves

# Positioners that are changed at the same time have at most this many candidates in total.
SIZE = 2000
# Fraction of the remaining time that one integer program may take.
FOR_ONE = 0.25


def separate_idle_arms(candidates: Candidates, chosen: np.ndarray, deadline: float, *, keep_cost: bool) -> np.ndarray:
    """Return a plan with the same values of all objectives and as few collisions between idle arms as possible.

    The number of these collisions is minimal if there are at most ``SIZE`` candidates. Otherwise, the
    number may not be minimal, because the positioners around each collision are optimized separately. Positioners
    change only if the number decreases. If the targets have subpriorities, the sum of subpriorities of the changed
    positioners is then the largest sum with this number of collisions; with ``keep_cost``, it does not decrease.

    Parameters
    ----------
    candidates : Candidates
        All candidates; the last candidate of each positioner is its idle arm.
    chosen : ndarray of int, shape (n_positioners,)
        Candidate of each positioner.
    deadline : float
        Value of `now` at which the search ends.
    keep_cost : bool
        Whether the cost, which stands for the sum of the subpriorities, takes precedence over these collisions.

    Returns
    -------
    ndarray of int, shape (n_positioners,)
        Candidate of each positioner.
    """
    pairs, idle = candidates.idle_pairs, candidates.options.start[1:] - 1
    now, blocked, _ = state = stand(candidates, chosen)
    if (blocked[now] > 0).any():
        return chosen
    xy, load = candidates.problem.focal_plane.arrays.xy, np.diff(candidates.options.start)
    tried = np.zeros(pairs.shape[1], dtype=bool)
    while left(deadline) > 0:
        bad = np.flatnonzero((now[pairs] == idle[pairs]).all(axis=0) & ~tried)
        if len(bad) == 0:
            break
        center = xy[pairs[:, bad[0]]].mean(axis=0)
        order = np.argsort(((xy - center) ** 2).sum(axis=1), kind="stable")
        # the two positioners of the collision are always members
        members = np.sort(order[np.cumsum(load[order]) <= max(SIZE, load[order[:2]].sum())])
        tried[bad[0]] = True
        tried |= len(members) == len(xy)
        try:
            _separate(candidates, members, state, share(deadline, FOR_ONE), keep_cost)
        except OutOfTimeError:
            break
    return now


def _separate(candidates, members, state, deadline, keep_cost):
    """Minimize the collisions between the idle arms of some positioners in place, while all other arms are fixed."""
    options, idle = candidates.options, candidates.options.start[1:] - 1
    before = after = state[0][members].copy()
    try:
        program = program_of(candidates, members, *state, deadline)
        x = _fewest(program, candidates.idle_pairs, idle, state[0], program.variables(before), deadline, keep_cost)
        if x is not None and len(program.chosen(x)) == len(members):
            after = program.chosen(x)
    finally:  # `program_of` takes the candidates from the members before it can run out of time
        for c in after:
            moves.put(options.owner[c], c, options, *state)


def _fewest(program, pairs, idle, now, x, deadline, keep_cost):
    """Return the variables of the plan with the fewest collisions of idle arms, among plans as good as plan ``x``.

    None is returned if no plan has fewer of these collisions than plan ``x``.
    """
    variable = program.index[idle[pairs]]  # of each idle arm; -1 for positioners that are not members
    linked = variable[:, (variable >= 0).all(axis=0)]
    cost, unit = np.zeros(program.n), np.ones(linked.shape[1])
    for member, fixed in ((0, 1), (1, 0)):
        alone = (variable[member] >= 0) & (now[pairs[fixed]] == idle[pairs[fixed]])
        np.add.at(cost, variable[member][alone], 1.0)
    costs = [csr_array(-np.round(program.costs, DIGITS)[None])] if keep_cost else []
    kept = vstack([program.matrix, *costs], format="csr")
    rows = _with_pairs(_with_least(program.rows, kept, kept @ x), linked)
    goal, most = np.append(-cost, -unit), np.append(program.most, unit)
    settings = {"integral": True, "gap": 0.0}
    fewest, _ = maximize(rows, goal, most, deadline, **settings)
    # the numbers of collisions are whole numbers
    if fewest is None or -goal @ fewest > cost @ x + (x[linked[0]] * x[linked[1]]).sum() - 0.5:
        return None
    if program.problem.subpriority is not None:
        rows = _with_least(rows, csr_array(goal[None]), goal @ fewest)
        best, _ = maximize(rows, np.append(-program.costs, 0.0 * unit), most, deadline, **settings)
        fewest = fewest if best is None else best
    return fewest[: program.n]


def _with_least(rows, matrix, least):
    """Return constraints with additional constraints: ``matrix`` times the variables is at least ``least``."""
    present, low, high = rows
    high = np.append(high, np.full(matrix.shape[0], np.inf))
    return vstack([present, matrix], format="csr"), np.append(low, least), high


def _with_pairs(rows, linked):
    """Return constraints with a variable for each pair of variables, which is 1 if both variables of the pair are 1."""
    matrix, low, high = rows
    n = linked.shape[1]
    unit, row = np.ones(n), np.arange(n)
    # the sum of the pair minus the new variable is at most 1; the new variable is 0 otherwise, because it has a cost
    link = csr_array((np.tile(unit, 2), (np.tile(row, 2), linked.ravel())), shape=(n, matrix.shape[1]))
    link = hstack([link, csr_array((-unit, (row, row)), shape=(n, n))], format="csr")
    wide = hstack([matrix, csr_array((matrix.shape[0], n))], format="csr")
    return vstack([wide, link], format="csr"), np.append(low, np.full(n, -np.inf)), np.append(high, unit)


# Largest number of collisions of candidates.
MOST_PAIRS = 20_000_000
# Time in seconds that steps of the search may always take, even if the time limit is shorter.
AT_LEAST = 0.1
# Information on a search that only uses local moves.
LOCAL = {"model": "local moves", "n_open": 0, "n_parts": 0, "n_programs": 0}


class SearchResult(NamedTuple):
    """The result of a search."""

    chosen: np.ndarray | None  # candidate that each positioner uses; None if no plan was found within the time limit
    values: np.ndarray
    bounds: np.ndarray
    meta: dict
    least: float = 0.0  # lower bound of the cost, as in `Solution`


def values_of(candidates: Candidates, chosen: np.ndarray) -> np.ndarray:
    """Return the values of the objectives of a plan."""
    return candidates.problem.level_values(candidates.options.target[chosen])


class Repaired(NamedTuple):
    """The plan of the allocator ``repair``."""

    target_of: np.ndarray
    side: np.ndarray


def repaired_plan(problem: AllocationProblem, given: Candidates) -> Repaired:
    """Return the plan of the allocator ``repair``, whose time is not limited.

    If there are too many collisions of candidates, the plan only uses the candidates ``given``.
    """
    before = plan_lamost_rule(problem).target_of_positioner
    candidates = movable_candidates(problem, before)
    with suppress(OutOfTimeError):
        candidates, plan = repair_nearby(candidates, pick(candidates, trim(problem, before)), most_pairs=MOST_PAIRS)
        return Repaired(candidates.options.target[plan], candidates.side[plan])
    deadline = max(problem.deadline, now() + AT_LEAST)
    plan = repair_collisions(given, pick(given, trim(problem, before)), deadline)
    return Repaired(given.options.target[plan], given.side[plan])


def local_optimum(problem: AllocationProblem, candidates: Candidates) -> SearchResult | None:
    """Return a plan from local moves if it is as good as the best plan that ignores collisions; otherwise, return None.

    The plan does not depend on the order in which the targets were given.
    """
    if problem.groups:
        return None
    repaired = repaired_plan(problem, candidates)
    best = candidates.problem.level_values(match(candidates))
    plan, is_whole = plan_of(candidates, repaired, np.inf)
    if not is_whole or (values_of(candidates, plan) < best).any():
        return None
    return SearchResult(plan, best, best, LOCAL)


def plan_of(candidates: Candidates, repaired: Repaired, deadline: float) -> tuple[np.ndarray, bool]:
    """Return the candidates of the plan of ``repair``, and whether there is a candidate for each of its targets.

    Positioners whose candidate is missing receive other targets, or no target.
    """
    plan = pick(candidates, *repaired)
    missing = ((plan < 0) & (repaired.target_of >= 0)).any()
    if missing:
        return repair_collisions(candidates, plan, deadline), False
    return np.where(plan < 0, candidates.options.start[1:] - 1, plan), True


def better_of(
    used: Candidates, chosen: np.ndarray, candidates: Candidates, repaired: Repaired, deadline: float
) -> tuple[Candidates, np.ndarray]:
    """Return the better of a plan of the candidates ``used`` and the plan of ``repair``, and its candidates."""
    values, best = candidates.problem.level_values(repaired.target_of), (used, chosen)
    # the candidates ``used`` are fewer, but may lack some of the candidates of the plan of ``repair``
    for some in (candidates, used):
        if tuple(values) > tuple(values_of(*best)) or (some is used and best[0] is candidates):
            plan, _ = plan_of(some, repaired, deadline)
            if tuple(values_of(some, plan)) >= tuple(values_of(*best)):
                best = some, plan
    return best


def answer_of(
    given: AllocationProblem,
    problem: AllocationProblem,
    used: Candidates,
    chosen: np.ndarray,
    repaired: Repaired | None,
    kept: np.ndarray,
    upper: Callable,
    least: float,
    meta: dict,
) -> AllocationAnswer:
    """Return a plan, or the plan of ``repair`` if it is better, as the answer of an allocator.

    ``problem`` is the problem ``given`` without the classes that have no candidates; ``kept`` are the numbers of the
    other classes. If collisions of idle arms are known, their number is reduced. ``upper`` returns upper bounds of the
    objectives from their values, and ``least`` is a lower bound of the cost of all plans of equal value.
    """
    if used.idle_pairs is not None and used.idle_pairs.size:
        end = max(problem.deadline, now() + AT_LEAST)
        chosen = separate_idle_arms(used, chosen, end, keep_cost=is_sum_maximized(given))
    target_of, side = used.options.target[chosen], used.side[chosen]
    if repaired is not None and tuple(problem.level_values(repaired.target_of)) > tuple(values_of(used, chosen)):
        target_of, side = repaired  # this plan uses a candidate that was left out
    values = problem.level_values(target_of)
    levels = levels_of(given, offset_of(problem), kept, values, np.maximum(upper(values), values))
    levels = with_subpriorities(given, levels, target_of, least)
    return AllocationAnswer(target_of, elbow_names(side), None, levels, meta)
