"""The plan of ``repair``, from which `decide` starts if arms are long or if time is short."""

from contextlib import suppress
from typing import NamedTuple

import numpy as np

from rfpsurvey.allocation._candidates import Candidates
from rfpsurvey.allocation._clock import OutOfTimeError, left, now
from rfpsurvey.allocation._local_search import match, movable_candidates, pick, repair_collisions, repair_nearby, trim
from rfpsurvey.allocation._methods import lamost_rule
from rfpsurvey.allocation._problem import AllocationProblem

# Largest number of collisions of candidates.
MOST_PAIRS = 20_000_000
# Time in seconds that steps of the search may always take, even if the time limit is shorter.
AT_LEAST = 0.1
# Information on a search that only uses local moves.
LOCAL = {"model": "local moves", "n_open": 0, "n_parts": 0, "n_programs": 0}


class Found(NamedTuple):
    """The result of a search."""

    chosen: np.ndarray
    """Candidate that each positioner uses; -1 if no candidate was found within the time limit."""
    values: np.ndarray
    bounds: np.ndarray
    complete: bool
    meta: dict
    least: float = 0.0
    """Lower bound of the cost, as in `Solution`."""


def values_of(candidates: Candidates, chosen: np.ndarray) -> np.ndarray:
    """Return the values of the objectives of a plan."""
    return candidates.problem.level_values(candidates.options.target[chosen])


class Repaired(NamedTuple):
    """The plan of the allocator ``repair``."""

    target_of: np.ndarray
    side: np.ndarray


def repaired_plan(problem: AllocationProblem, everything: Candidates, whole: bool) -> Repaired:
    """Return the plan of the allocator ``repair``.

    If it takes too long to find all collisions, the plan only uses the candidates ``everything``.
    """
    before = lamost_rule(problem).target_of_positioner
    if whole:
        candidates = movable_candidates(problem, before)
        first, seconds = pick(candidates, trim(problem, before)), max(left(problem.deadline), AT_LEAST)
        with suppress(OutOfTimeError):
            candidates, plan = repair_nearby(candidates, first, seconds=seconds, most_pairs=MOST_PAIRS)
            return Repaired(candidates.options.target[plan], candidates.side[plan])
    deadline = max(problem.deadline, now() + AT_LEAST)
    plan = repair_collisions(everything, pick(everything, trim(problem, before)), deadline)
    return Repaired(everything.options.target[plan], everything.side[plan])


def local_optimum(problem: AllocationProblem, everything: Candidates) -> Found | None:
    """Return a plan from local moves if it is as good as the best plan that ignores collisions; otherwise, return None.

    The plan does not depend on the order in which the targets were given.
    """
    if problem.groups:
        return None
    repaired = repaired_plan(problem, everything, True)
    best = everything.problem.level_values(match(everything))
    plan, is_whole = plan_of(everything, repaired, np.inf)
    if not is_whole or (values_of(everything, plan) < best).any():
        return None
    return Found(plan, best, best, True, LOCAL)


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
    used: Candidates, chosen: np.ndarray, everything: Candidates, repaired: Repaired, deadline: float
) -> tuple[Candidates, np.ndarray]:
    """Return the better of a plan of the candidates ``used`` and the plan of ``repair``, and its candidates."""
    values, best = everything.problem.level_values(repaired.target_of), (used, chosen)
    # the candidates ``used`` are fewer, but may lack some of the candidates of the plan of ``repair``
    for some in (everything, used):
        if tuple(values) > tuple(values_of(*best)) or (some is used and best[0] is everything):
            plan, _ = plan_of(some, repaired, deadline)
            if tuple(values_of(some, plan)) >= tuple(values_of(*best)):
                best = some, plan
    return best


def unproven(candidates: Candidates, repaired: Repaired) -> Found:
    """Return the plan of ``repair`` as the result of a search without upper bounds."""
    plan, _ = plan_of(candidates, repaired, np.inf)
    values = values_of(candidates, plan)
    return Found(plan, values, np.full(len(values), np.inf), True, LOCAL)
