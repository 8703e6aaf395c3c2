"""Optimal plans that follow rules on the distribution of fibers, with bounds from the problem without these rules."""

from dataclasses import replace
from functools import partial

import numpy as np

from rfpsurvey._assignment import objectives as _objectives
from rfpsurvey._assignment import search as _search
from rfpsurvey._assignment.answer import AllocationAnswer, Level
from rfpsurvey._assignment.candidates import Candidates
from rfpsurvey._assignment.clock import OutOfTimeError, left, share
from rfpsurvey._assignment.clusters import improve_by_clusters, improve_members, program_of, upper_of_part
from rfpsurvey._assignment.distribution import lost_to_rules
from rfpsurvey._assignment.local_plans import LOCAL, answer_of, plan_of, repaired_plan, values_of
from rfpsurvey._assignment.local_search import pick, repair_collisions, stand
from rfpsurvey._assignment.problem import AllocationProblem

# Fractions of the remaining time: for the problem without the rules, for the plan with the same science targets, for
# clusters before the integer program of all positioners, and for this program.
FOR_FREE, FOR_OTHERS, FOR_CLUSTERS, FOR_PROGRAM = 0.4, 0.3, 0.5, 0.7
# Problems with more candidates are divided into clusters before the integer program of all positioners.
SMALL = 2000
# Largest number of missing fibers, as a fraction of the positioners, of a plan that clusters improve.
FEW = 0.02
# Number of candidates of the first clusters. With rules, programs of the same size take more time.
SIZE = 500


def decide(problem: AllocationProblem, *, collide: bool, **options) -> AllocationAnswer:
    """Return the best plan found within the time limit, with bounds; the parameters are those of `_search.decide`.

    If ``collide`` is true, the plan follows the rules on the distribution of fibers. The number of science fibers that
    lack neighbors counts like the number of fibers that requirements lack.
    """
    if not problem.distributions:
        return _search.decide(problem, collide=collide, **options)
    free = replace(problem, options=problem.options.without("distributions"))
    if not collide:
        return _search.decide(free, collide=False, **options)
    answer = _search.decide(replace(free, deadline=share(problem.deadline, FOR_FREE)), collide=True, **options)
    levels = list(answer.levels)
    if not free.groups:
        levels.insert(problem.level_names.index("requirements"), Level("requirements", 0.0, 0.0))
    n = len(problem.level_names)  # without the sum of the subpriorities
    values, bounds = np.array([level[1:] for level in levels[:n]]).T
    if (problem.level_values(answer.target_of_positioner) == values).all():
        return answer._replace(levels=levels)
    k = problem.level_names.index("requirements")
    if values[k] < bounds[k]:
        bounds[k + 1 :] = np.inf  # without the rules, a plan with these values may lack fewer fibers
    return _follow(problem, answer, values, bounds, **options)


def _follow(problem, free, values, bounds, *, squared_cost, **_) -> AllocationAnswer:
    """Return the best plan that follows the rules; ``free`` is a plan without the rules, with values and bounds."""
    given, deadline = problem, problem.deadline
    problem = _objectives.with_cost(problem)
    candidates, whole = _search._candidates_in_time(problem, collide=True, squared_cost=squared_cost)
    repaired = repaired_plan(given, candidates)
    problem, candidates, kept = _objectives.with_used_classes(problem, candidates)
    offset = _objectives.offset_of(given)
    rows = np.concatenate([np.arange(offset), offset + kept, np.arange(offset + len(given.classes), len(values))])
    known, limits = [(values[rows], bounds[rows])], _objectives.matching_limits(problem, candidates if whole else None)
    upper = partial(_upper, problem, limits, known)

    def is_best(plan):
        values = values_of(candidates, plan)
        return bool((values >= upper(values)).all())

    plans = [*_first_plans(candidates, free, upper, is_best, deadline), plan_of(candidates, repaired, deadline)[0]]
    chosen = max(plans, key=lambda plan: tuple(values_of(candidates, plan)))
    if len(candidates) > SMALL:
        chosen = improve_by_clusters(candidates, chosen, share(deadline, FOR_CLUSTERS), is_best, upper, SIZE)
    least, meta = 0.0, {**LOCAL, "n_open": int((np.diff(candidates.options.start) > 1).sum()), "n_parts": 1}
    if squared_cost or not is_best(chosen):
        solution = _solve(candidates, chosen, upper, share(deadline, FOR_PROGRAM), squared_cost)
        if solution is not None:
            meta |= {"model": "integer program", "n_programs": solution.n_programs}
            if solution.chosen is not None:
                chosen = chosen.copy()
                chosen[candidates.options.owner[solution.chosen]] = solution.chosen
            if whole and not candidates.preselection.n_left_out:
                known.append((solution.values, solution.bounds))
                least = solution.least if (solution.values >= solution.bounds).all() else 0.0
        if not is_best(chosen):
            chosen = improve_by_clusters(candidates, chosen, deadline, is_best, upper, SIZE)
    meta |= {"n_candidates": len(candidates), "n_conflicts": candidates.pairs.shape[1]}
    answer = answer_of(given, problem, candidates, chosen, repaired, kept, upper, least, meta)
    meta["n_lost_to_rules"] = lost_to_rules(given, free.target_of_positioner, answer.target_of_positioner)
    return answer


def _first_plans(candidates: Candidates, free: AllocationAnswer, upper, is_best, deadline: float) -> list[np.ndarray]:
    """Return plans from which the search can begin, made from a plan without the rules."""
    problem, options = candidates.problem, candidates.options
    first = pick(candidates, free.target_of_positioner, np.where(free.handedness == "left", -1.0, 1.0))
    plans = [repair_collisions(candidates, first, deadline)]
    plan, blocked, _ = stand(candidates, np.where(first < 0, options.start[1:] - 1, first))
    if len(candidates) <= SMALL or (blocked[plan] > 0).any():
        return plans
    # all targets that are not science targets are chosen again, such that they are neighbors
    free_positioners = np.flatnonzero(options.rank[plan] >= len(problem.classes))
    plans.append(improve_members(candidates, plan, free_positioners, deadline, upper))
    missing = -values_of(candidates, plans[-1])[problem.level_names.index("requirements")]
    if 0 < missing <= FEW * len(plan):
        plans.append(improve_by_clusters(candidates, plans[-1], share(deadline, FOR_OTHERS), is_best, upper, SIZE))
    return plans


def _upper(problem: AllocationProblem, limits: np.ndarray, known: list, values: np.ndarray) -> np.ndarray:
    """Return an upper bound of each objective, given the values of all earlier objectives.

    ``known`` contains values of plans, and bounds of each objective for plans with the same earlier values.
    """
    limit = _objectives.conditional_bounds(problem, values, limits, 0)
    for reached, bounds in known:
        same = np.append(True, np.cumprod(values == reached)[:-1] > 0)
        limit = np.where(same, np.minimum(limit, bounds), limit)
    return limit


def _solve(candidates: Candidates, chosen, upper, deadline: float, squared_cost: bool) -> _objectives.Solution | None:
    """Return the plan of the integer program of all positioners; None if the program is too large."""
    options, state = candidates.options, stand(candidates, chosen)
    members = np.flatnonzero(np.diff(options.start) > 1)
    first = chosen[members]
    if np.diff(options.start)[members].sum() > _search.LARGEST or left(deadline) == 0:
        return None
    settings = {"integral": True, "squared_cost": squared_cost}
    try:
        program = program_of(candidates, members, *state, deadline)
        part, base = upper_of_part(candidates, state[0], upper)
        solution = _objectives.pursue(program, first, deadline, None, upper=part, **settings)
    except OutOfTimeError:
        return None
    least = solution.least + options.cost[state[0][np.diff(options.start) == 1]].sum()
    return solution._replace(values=solution.values + base, bounds=solution.bounds + base, least=least)
