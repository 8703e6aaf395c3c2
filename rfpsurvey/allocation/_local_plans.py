"""The plan of ``repair``, from which `decide` starts if arms are long or if time is short."""

from collections.abc import Callable
from contextlib import suppress
from typing import NamedTuple

import numpy as np

from rfpsurvey.allocation._answer import AllocationAnswer
from rfpsurvey.allocation._candidates import Candidates
from rfpsurvey.allocation._clock import OutOfTimeError, now
from rfpsurvey.allocation._idle import separate_idle_arms
from rfpsurvey.allocation._local_search import match, movable_candidates, pick, repair_collisions, repair_nearby, trim
from rfpsurvey.allocation._objectives import is_sum_maximized, levels_of, offset_of, with_subpriorities
from rfpsurvey.allocation._problem import AllocationProblem
from rfpsurvey.allocation._rules import plan_lamost_rule
from rfpsurvey.focal_plane import elbow_names

# Largest number of collisions of candidates.
MOST_PAIRS = 20_000_000
# Time in seconds that steps of the search may always take, even if the time limit is shorter.
AT_LEAST = 0.1
# Information on a search that only uses local moves.
LOCAL = {"model": "local moves", "n_open": 0, "n_parts": 0, "n_programs": 0}


class Found(NamedTuple):
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


def local_optimum(problem: AllocationProblem, candidates: Candidates) -> Found | None:
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
    return Found(plan, best, best, LOCAL)


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
