"""Find optimal plans: remove unnecessary candidates, divide the others into independent parts, and solve each part."""

from dataclasses import replace
from functools import partial

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from rfpsurvey._assignment.answer import AllocationAnswer, Level
from rfpsurvey._assignment.before_and_after import best_pairs
from rfpsurvey._assignment.candidates import Candidates, find_candidates, reduced
from rfpsurvey._assignment.clock import OutOfTimeError, left, now, seconds_until, share
from rfpsurvey._assignment.clusters import Prices, bound_by_clusters, improve_by_clusters, weights_of
from rfpsurvey._assignment.local_plans import (
    AT_LEAST,
    LOCAL,
    MOST_PAIRS,
    Repaired,
    SearchResult,
    answer_of,
    better_of,
    local_optimum,
    plan_of,
    repaired_plan,
    values_of,
)
from rfpsurvey._assignment.local_search import improve, match, pick, repair_collisions, trim
from rfpsurvey._assignment.milp import Program
from rfpsurvey._assignment.objectives import (
    LARGE,
    Solution,
    conditional_bounds,
    is_sum_maximized,
    matching_limits,
    offset_of,
    pursue,
    with_cost,
    with_used_classes,
)
from rfpsurvey._assignment.problem import AllocationProblem
from rfpsurvey._assignment.relaxed import proven_values, relax
from rfpsurvey._assignment.rules import TIE_SEED, plan_lamost_rule

# Small parts are combined up to about this number of positioners, because each call of the solver takes time.
SMALLEST = 200
# Parts with more than this number of variables are not solved as one integer program, but divided into clusters.
LARGEST = 20_000
# Fractions of the time that are reserved for the bound on plans that use omitted candidates, and for the integer
# programs of clusters.
FOR_BOUND, FOR_CLUSTERS = 0.3, 0.25
# Fractions of the remaining time: for finding the collisions of the candidates, for adjusting the prices of one
# objective, and for the integer programs that give the bound of the first objective that is not proven.
FOR_CANDIDATES, FOR_PRICES, FOR_FIRST = 0.45, 0.25, 0.6
# The plan of ``repair`` is made before the search if finding the candidates takes more than the fraction LATE of the
# time limit, if the mean number of collisions per candidate exceeds LONG, or if there are more than LARGEST candidates;
# the search then starts from this plan. Otherwise, it is made only if the search does not prove an optimum.
LATE, LONG = 0.1, 12
# A plan without the requirements is searched, for a fraction of the time limit, if the plan of ``lamost_rule`` misses
# them by less than the fraction NEARLY.
FOR_FREE, NEARLY = 0.5, 0.1
# Fractions of the remaining time in which unnecessary candidates are removed, in which collisions are repaired, and in
# which the plan of ``repair`` is moved to the remaining candidates after the search.
FOR_REDUCTION, FOR_REPAIR, FOR_BETTER = 0.25, 0.5, 0.25
# Fraction of the remaining time in which bounds are found by linear programs.
FOR_LINEAR = 0.5
# Time in seconds after the deadline for local moves that give targets to idle positioners.
FOR_LAST = 0.1
# If it takes too long to find all collisions, only the best targets of each positioner are used. These numbers of best
# targets per positioner are tried one after the other.
FEWER = (32, 8, 2, 1)
# Time in seconds per reachable pair for finding the best targets of each positioner: a constant, and the time that is
# added for each of these best targets.
PAIR_SECONDS, SORT_SECONDS = 4e-8, 8e-9
# Largest number of objectives for which prices are adjusted.
MOST_BOUNDS = 8
# Bounds of numbers of targets are rounded down, unless they are this close to the next whole number.
ROUNDING = 1e-4


def decide(
    problem: AllocationProblem, *, collide: bool, integral: bool = True, squared_cost: bool = False
) -> AllocationAnswer:
    """Return the best plan found within the time limit, with bounds; if ``collide`` is true, arms must not collide.

    If ``collide`` is true, the plan is at least as good as the plan of ``repair``.
    """
    given, deadline = problem, problem.deadline
    if collide and problem.groups:
        answer = _without_requirements(problem, integral=integral, squared_cost=squared_cost)
        if answer is not None:
            return answer
        if problem.subpriority is None and any((group.targets & problem.science).any() for group in problem.groups):
            # With subpriorities, the requirements change no more targets than necessary. The order of rows is random.
            order = np.sort(np.random.default_rng(TIE_SEED).random(len(problem.xy)))[::-1]
            problem, squared_cost = replace(problem, subpriority=order), True
    problem = with_cost(problem)
    options = {"integral": integral, "squared_cost": squared_cost}
    options["relaxes"] = collide and bool(problem.groups) and is_sum_maximized(given)
    begin = now()
    candidates, whole = _candidates_in_time(problem, collide=collide, squared_cost=squared_cost)
    spent = now() - begin
    problem, candidates, kept = with_used_classes(problem, candidates)
    repaired = solution = None
    if collide:
        repaired, solution = _plan_locally(given, candidates, spent, whole=whole, squared_cost=squared_cost)
    n_left_out = candidates.preselection.n_left_out if whole else 0
    # Some time is reserved for clusters and, if candidates were omitted, for the bound on plans that use them.
    halt = share(deadline, 1 - FOR_CLUSTERS) if collide else deadline
    used, is_searched = candidates, solution is None
    if is_searched:
        end = share(halt, 1 - FOR_BOUND) if n_left_out else halt
        used, solution = _search(candidates, end, collide=collide, repaired=repaired, **options)
    chosen, bounds, bounding = solution.chosen, solution.bounds, used
    meta = {"n_candidates": len(candidates), "n_conflicts": candidates.pairs.shape[1], **solution.meta}
    proven = solution.values >= bounds
    if collide and n_left_out:
        meta["n_left_out"] = n_left_out
    if collide and n_left_out and is_searched:
        bounding, relaxed = _search(candidates.relaxed(), halt, collide=True, **options)
        bounds = relaxed.bounds
        proven = (solution.values >= bounds) & (relaxed.values >= bounds)
    values = values_of(used, chosen)
    if not (whole and proven.all()):
        first = int(np.argmin(proven)) if whole else 0
        bounds = np.where(np.arange(len(bounds)) <= first, bounds if whole else np.inf, np.inf)
        limits = matching_limits(problem, candidates if whole else None)
        if collide:
            if repaired is None:
                repaired = repaired_plan(given, candidates)
            used, chosen = better_of(used, chosen, candidates, repaired, share(deadline, FOR_BETTER))
            chosen, limits = _refine(used, chosen, bounding if whole else None, first, bounds, limits, deadline)
            values = values_of(used, chosen)
        bounds = np.minimum(bounds, conditional_bounds(problem, values, limits, first))
    # The preselection for plans without collisions may omit targets of lower cost than those that it keeps.
    least = solution.least if whole and proven.all() and not (collide and n_left_out) else 0.0
    if used is not candidates and collide and candidates.idle_pairs.size:
        picked = pick(candidates, used.options.target[chosen], used.side[chosen])
        used, chosen = candidates, np.where(picked < 0, candidates.options.start[1:] - 1, picked)
    return answer_of(given, problem, used, chosen, repaired, kept, lambda _: bounds, least, meta)


def _plan_locally(given, candidates, spent, *, whole, squared_cost):
    """Return the plan of ``repair``, and a solution that replaces the search; None for what is not made.

    ``spent`` is the time in seconds that finding the candidates took.
    """
    is_late, is_long = spent > LATE * given.time_limit, candidates.options.excluded.size > LONG * len(candidates)
    solution = local_optimum(given, candidates) if is_long and not is_late and whole and not squared_cost else None
    if solution is not None or not (is_long or is_late or (whole and len(candidates) > LARGEST)):
        return None, solution
    repaired = repaired_plan(given, candidates)
    if left(given.deadline) >= spent:
        return repaired, None
    plan, _ = plan_of(candidates, repaired, np.inf)
    values = values_of(candidates, plan)
    return repaired, SearchResult(plan, values, np.full(len(values), np.inf), LOCAL)


def _without_requirements(problem, **options):
    """Return the best plan of the problem without its requirements; return None if it does not meet the requirements.

    Requirements that are met anyway therefore have no influence on which of several equally good plans is returned.
    """
    free = replace(problem, options=problem.options.without("counts"), deadline=share(problem.deadline, FOR_FREE))
    if not problem.meets_requirements(plan_lamost_rule(free).target_of_positioner, NEARLY):
        return None
    answer = decide(free, collide=True, **options)
    if not problem.meets_requirements(answer.target_of_positioner):
        return None
    levels = list(answer.levels)
    levels.insert(problem.level_names.index("requirements"), Level("requirements", 0.0, 0.0))
    return answer._replace(levels=levels)


def _candidates_in_time(problem, *, collide, squared_cost):
    """Return the candidates, and whether the list of candidates is complete.

    If it takes too long to find all collisions, only the best targets of each positioner are used.
    """
    if not collide:
        return find_candidates(problem, collide=False, squared_cost=squared_cost), True
    deadline = problem.deadline
    for most in (None, *FEWER):
        last = most == FEWER[-1]
        sorting = 0.0 if most is None else (PAIR_SECONDS + SORT_SECONDS * most) * len(problem.pairs.owner)
        seconds = FOR_CANDIDATES * seconds_until(deadline)
        if not last and sorting > seconds:
            continue
        some = problem if most is None else replace(problem, pairs=best_pairs(problem, most))
        limits = {} if last else {"seconds": max(seconds, AT_LEAST), "most_pairs": MOST_PAIRS}
        try:
            candidates = find_candidates(some, squared_cost=squared_cost, **limits)
        except OutOfTimeError:
            continue
        return candidates, most is None
    raise AssertionError


def _refine(used, chosen, bounding, first, bounds, limits, deadline):
    """Improve a plan, and find smaller upper limits of the objectives, beginning with objective ``first``.

    The limit of a class applies to the number of targets of this class and of all earlier classes. The limits are
    computed for the candidates ``bounding``. If ``bounding`` is None, the limits do not change.
    """
    problem = used.problem

    def is_best(plan):
        values = values_of(used, plan)
        return bool((values >= np.minimum(bounds, conditional_bounds(problem, values, limits, first))).all())

    def better(plan):
        return plan if tuple(values_of(used, plan)) > tuple(values_of(used, chosen)) else chosen

    able, weights = [], []
    if bounding is not None:
        weights = weights_of(problem, bounding.options)
        able = [k for k in range(first, len(weights)) if weights[k] is not None]
        able = [able[k] for k in np.unique(np.linspace(0, len(able) - 1, MOST_BOUNDS).astype(int))] if able else []
    try:
        if able:
            prices, k = Prices(bounding, share(deadline, FOR_PRICES)), able[0]
            limits[k] = min(limits[k], _whole(prices.improve(weights[k], share(deadline, FOR_PRICES))))
            if not is_best(chosen):
                bound, plan = bound_by_clusters(bounding, prices, weights[k], share(deadline, FOR_FIRST))
                limits[k] = min(limits[k], _whole(bound))
                if bounding is used and len(weights) == 1:
                    chosen = better(repair_collisions(used, plan, deadline))
            end = share(deadline, FOR_PRICES)
            for k in able[1:]:
                limits[k] = min(limits[k], _whole(prices.improve(weights[k], end)))
            offset = offset_of(problem)
            # no more targets belong to the first classes than to these and further classes
            limits[offset:] = np.minimum.accumulate(limits[offset:][::-1])[::-1]
    except OutOfTimeError:
        pass
    return better(improve_by_clusters(used, chosen, deadline, is_best)), limits


def _whole(bound):
    """Return the largest whole number that does not exceed a bound, which may have rounding errors."""
    return np.floor(bound + ROUNDING)


def _search(candidates: Candidates, deadline: float, *, collide: bool, repaired: Repaired | None = None, **options):
    """Return the candidates that the search used, and the best plan that it found.

    The search starts from the plan ``repaired``, if it is given.
    """
    problem = candidates.problem
    used = candidates.where(reduced(candidates.options, share(deadline, FOR_REDUCTION)))
    blind = pick(used, match(used))
    # The plan ``start`` can be invalid if the idle arm of a positioner is not among the candidates.
    end = share(deadline, FOR_REPAIR)
    # the plan of ``repair`` is not improved again
    start = _plan(used, blind, collide, end) if repaired is None else plan_of(used, repaired, now())[0]
    solution = _solve(used, blind, start, deadline, collide=collide, **options)
    if solution.chosen is None:
        chosen = _plan(candidates, pick(candidates, trim(problem, match(candidates))), collide, deadline)
        return candidates, solution._replace(chosen=chosen, values=values_of(candidates, chosen))
    if (solution.values < solution.bounds).any() and collide and (solution.chosen != start).any():
        # If the time limit ended an integer program, idle positioners may still have free targets of later classes.
        return used, solution._replace(chosen=improve(used, solution.chosen, max(deadline, now() + FOR_LAST)))
    return used, solution


def _plan(candidates, chosen, collide, deadline):
    """Return an initial plan, which has no collisions if ``collide`` is true; positioners without a target are idle."""
    if collide:
        return repair_collisions(candidates, chosen, deadline)
    return np.where(chosen < 0, candidates.options.start[1:] - 1, chosen)


def _solve(candidates, blind, start, deadline, *, collide, integral, squared_cost, relaxes) -> SearchResult:
    """Solve the independent parts of a problem one after the other.

    ``blind`` contains the candidate of each positioner in a matching in which arms may collide, or -1 for no target.
    """
    problem, options = candidates.problem, candidates.options
    n_left = np.diff(options.start)
    chosen = np.where(n_left == 1, options.start[:-1], -1)
    known = chosen[chosen >= 0]
    values = bounds = problem.level_values(np.where(chosen < 0, -1, options.target[chosen]))
    # The requirements of a part also count the targets of the parts that are already solved.
    adds = np.array([name != "requirements" for name in problem.level_names])
    n_parts, n_programs, least = 0, 0, options.cost[known].sum()
    integers, complete = False, True
    parts = list(_parts(candidates, np.flatnonzero((n_left > 1)[options.owner])))
    for rows, edges in parts:
        mine = np.unique(options.owner[rows])
        tell = None if problem.tell is None else partial(_tell, problem.tell, n_parts, len(parts))
        if collide and len(rows) > LARGEST:
            part = _start_of_part(candidates, start[mine], blind[mine], edges, len(adds))
        else:
            try:
                program = Program(candidates, rows, known, edges, deadline)
                limit = None if problem.groups else program.reaches(program.variables(blind[mine][blind[mine] >= 0]))
                settings = {"integral": integral, "squared_cost": squared_cost, "tell": tell}
                if relaxes and program.n > LARGE:
                    settings["relaxed"] = relax(program, share(deadline, FOR_LINEAR))
                elif collide and problem.groups and program.n > LARGE:
                    settings["linear"] = partial(proven_values, program)
                part = pursue(program, start[mine], deadline, limit, **settings)
            except OutOfTimeError:
                part = _start_of_part(candidates, start[mine], blind[mine], edges, len(adds))
        values, bounds = np.where(adds, values, 0.0) + part.values, np.where(adds, bounds, 0.0) + part.bounds
        if part.chosen is None:
            complete = False
        else:
            chosen[options.owner[part.chosen]] = part.chosen
        n_parts, n_programs, least = n_parts + 1, n_programs + part.n_programs, least + part.least
        integers |= part.integral and part.n_programs > 0
    meta = {
        "model": "integer program" if integers else "linear program" if n_programs else "no search needed",
        "n_open": int((n_left > 1).sum()),
        "n_parts": n_parts,
        "n_programs": n_programs,
    }
    return SearchResult(chosen if complete else None, values, bounds, meta, least)


def _start_of_part(candidates, start, blind, edges, n_levels) -> Solution:
    """Return the initial plan of a part, with upper bounds from a matching in which arms may collide."""
    problem, options = candidates.problem, candidates.options
    if problem.groups:  # the initial plan may exceed the maximum of a requirement
        return Solution(None, np.full(n_levels, -np.inf), np.full(n_levels, np.inf), 0, False)
    in_use = np.zeros(len(candidates), dtype=bool)
    in_use[start] = True
    collides = (in_use[edges[0]] & in_use[edges[1]]).any()
    # Without requirements, the values only depend on the targets in use.
    values, best = (problem.level_values(options.target[used]) for used in (start, blind[blind >= 0]))
    bounds = best if (values == best).all() else np.full(len(values), np.inf)
    return Solution(None if collides else start, values, bounds, 0, False)


def _tell(tell, part: int, n_parts: int, level: int, n_levels: int) -> None:
    """Report the part of the problem and the objective that the search currently optimizes."""
    of_parts = f"part {part + 1} of {n_parts}, " if n_parts > 1 else ""
    tell((part + level / n_levels) / n_parts, f"{of_parts}objective {level + 1} of {n_levels}")


def _parts(candidates, rows):
    """Divide the candidates ``rows`` into independent parts, and yield the candidates and collisions of each part.

    Candidates of different parts neither collide nor have the same target. With requirements, there is only one part.
    """
    options, problem = candidates.options, candidates.problem
    if len(rows) == 0:
        return
    edges = candidates.pairs
    if len(rows) < len(candidates):
        undecided = np.zeros(len(candidates), dtype=bool)
        undecided[rows] = True
        edges = edges[:, undecided[edges[0]] & undecided[edges[1]]]
    if problem.groups:
        yield rows, edges
        return
    real = rows[options.target[rows] >= 0]
    real = real[np.argsort(options.target[real], kind="stable")]
    same = np.flatnonzero(options.target[real[:-1]] == options.target[real[1:]])
    first, second = options.owner[np.concatenate([edges, [real[same], real[same + 1]]], axis=1)]
    graph = coo_array((np.ones(len(first)), (first, second)), shape=2 * (len(options.start) - 1,))
    label = connected_components(graph, directed=False)[1]
    # Small parts are combined in the order of their labels.
    members = np.unique(options.owner[rows])
    names, size = np.unique(label[members], return_counts=True)
    batch = np.zeros(len(label), dtype=np.int64)
    batch[names] = np.concatenate([[0], np.cumsum(size)[:-1]]) // SMALLEST
    of_row, of_edge = batch[label[options.owner[rows]]], batch[label[options.owner[edges[0]]]]
    used = np.unique(of_row)
    for b in used:
        yield rows[of_row == b], edges[:, of_edge == b] if len(used) > 1 else edges
