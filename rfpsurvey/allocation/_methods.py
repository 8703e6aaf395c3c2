"""The built-in allocators: functions that take an allocation problem and return its solution, and their records."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from rfpsurvey._kernels.allocation import fill_quota
from rfpsurvey._methods import Method, table_of
from rfpsurvey.allocation import _rules
from rfpsurvey.allocation._answer import AllocationAnswer, Level
from rfpsurvey.allocation._clock import searching
from rfpsurvey.allocation._distribution import lost_to_rules
from rfpsurvey.allocation._given import changes_of, is_plan
from rfpsurvey.allocation._local_search import match, movable_candidates, pick, repair_nearby, trim
from rfpsurvey.allocation._objectives import DIGITS, scale_of, with_subpriorities
from rfpsurvey.allocation._problem import AllocationProblem, with_watched
from rfpsurvey.allocation._rules import RuleProblem
from rfpsurvey.constraints import AS_GOAL, EXACTLY, ONLY_CHECKED, Abilities
from rfpsurvey.errors import check_choice, check_switch
from rfpsurvey.focal_plane import elbow_names

LEVELS = {"exactly": EXACTLY, "goal": AS_GOAL, "no": ONLY_CHECKED}


@dataclass(frozen=True)
class Allocator(Method):
    """An allocator, and the properties of its plans; the default values are those of a function without a record."""

    avoids_collisions: bool = False  # whether no arm with a target collides with another arm or an obstacle
    searches: bool = False  # whether a search, which ends at the time limit, proves that no plan is better
    counts: str = "no"  # whether the plan meets requirements ``exactly``, as a ``goal``, or not (``no``)
    distribution: str = "no"  # the same for rules on the distribution of fibers
    makes_queues: bool = False  # whether the allocator makes a queue of targets for each positioner
    uses_priorities: bool = True  # whether targets with a larger priority are more important
    breaks_ties: bool = False  # whether targets are sorted by a hash first, so that their order has no influence
    plans_jointly: bool = False  # whether a joint plan of a survey can replace the allocator
    keeps_plan: bool = False  # whether the allocator changes as few fibers of a given plan as possible
    is_random: bool = False  # whether plans without subpriorities are random
    rule: Callable | None = None  # plans many realizations of a survey; None if each is a complete survey

    def __post_init__(self):
        for name in ("avoids_collisions", "searches", "makes_queues", "uses_priorities"):
            check_switch(getattr(self, name), name)
        for name in ("counts", "distribution"):
            check_choice(getattr(self, name), LEVELS, f"value of {name}")

    @property
    def improves(self) -> bool:
        """Whether the allocator improves the plan of another allocator."""
        return self.options is not None and "start" in self.options

    @property
    def abilities(self) -> Abilities:
        """How the allocator honors constraints."""
        collisions = EXACTLY if self.avoids_collisions else ONLY_CHECKED
        required = AS_GOAL if self.uses("required") else ONLY_CHECKED
        return Abilities(collisions, required, LEVELS[self.counts], LEVELS[self.distribution], collisions)


def balanced(problem: AllocationProblem) -> AllocationAnswer:
    """Distribute targets to queues of nearly equal length, and draw one target from each queue.

    Each science target, in catalog order, is added to the shortest queue among the positioners that reach it; ties are
    decided by the distance, then by the row of the positioner. One target of each queue is drawn uniformly and
    observed. Priorities and requirements are ignored.
    """
    return _by_rule(problem, _rules.balanced, by_priority=False)


def nearest(problem: AllocationProblem) -> AllocationAnswer:
    """Assign the targets of one class after the other; in each class, assign the closest pairs first.

    If subpriorities are given, assign each target of a class, in order of subpriority, to the closest free positioner.
    Requirements are ignored.
    """
    return _by_rule(problem, _rules.nearest)


def lamost_rule(problem: AllocationProblem) -> AllocationAnswer:
    """Assign the targets of one class after the other; in each round, every free positioner nominates one target.

    In each class, every free positioner nominates its nearest unassigned target, until no nominations are possible. If
    several positioners nominate a target, the target is assigned to the positioner with the fewest unassigned targets
    (of any class) in reach; ties are decided by the distance, then by the row of the positioner. The requirements are
    then met one after the other: first by idle positioners, then by positioners that give up the least important
    targets.
    """
    answer = _by_rule(problem, _rules.lamost_rule)
    _fill_quotas(problem, answer.target_of_positioner)
    return answer


def network_flow(problem: AllocationProblem) -> AllocationAnswer:
    """Maximize the number of targets, one class after the other, by network flow; then minimize squared distances.

    The distances are those from the centers of the positioners; arms may collide. If subpriorities are given, the last
    step maximizes the sum of the subpriorities of the science targets instead.
    """
    return _search(problem, collide=False, integral=False, squared_cost=True)


def optimal(problem: AllocationProblem) -> AllocationAnswer:
    """Maximize the number of targets, one class after the other, such that no arm with a target collides.

    The optimum is proven. An arm with a target avoids all other arms and obstacles, and idle arms that are obstacles:
    arms of parked positioners (if ``parked_obstacles`` is True), and arms of disabled and stuck positioners. If
    subpriorities are given, the last objective is the sum of the subpriorities of the science targets. Among plans of
    equal value, a plan in which few idle arms collide with each other is preferred; idle arms may still collide with
    obstacles. If ``start`` is a plan, the last step minimizes the number of changed fibers.
    """
    has_last = problem.subpriority is not None or is_plan(problem.options.start)
    return _search(problem, collide=True, squared_cost=has_last)


def repair(problem: AllocationProblem) -> AllocationAnswer:
    """Remove the collisions of the plan of another allocator, ``start``, by local moves."""
    start = problem.start()
    before, elbows = start.target_of_positioner, start.handedness
    all_candidates = movable_candidates(problem, before)
    side = None if elbows is None else np.where(elbows == "left", -1.0, 1.0)
    first = pick(all_candidates, trim(problem, before), side)
    candidates, chosen = repair_nearby(all_candidates, first, steady=is_plan(problem.options.start))
    target_of, had = candidates.options.target[chosen], before >= 0
    worse = problem.rank_of(target_of) > problem.rank_of(before)  # a less important target, or none
    n_moved, n_dropped = ((had & some).sum() for some in (~worse & (target_of != before), worse))
    meta = {"n_before": int(had.sum()), "n_moved": int(n_moved), "n_dropped": int(n_dropped)}
    if problem.distributions:
        free = repair(replace(problem, options=problem.options.without("distributions"))).target_of_positioner
        meta["n_lost_to_rules"] = lost_to_rules(problem, free, target_of)
    levels = _bounded(problem, target_of, None if problem.any_goals else match(all_candidates))
    return AllocationAnswer(target_of, elbow_names(candidates.side[chosen]), None, levels, meta)


_COMMON = ("required", "subpriority", "requirements")
_SEARCH = (*_COMMON, "objective", "time_limit", "programs")
METHODS = table_of(
    Allocator(
        "balanced",
        balanced,
        ("subpriority", "rng"),
        "ignores priorities",
        makes_queues=True,
        uses_priorities=False,
        is_random=True,
        rule=_rules.balanced,
    ),
    Allocator("nearest", nearest, ("required", "subpriority"), rule=_rules.nearest),
    Allocator("lamost_rule", lamost_rule, _COMMON, "the rule of LAMOST", counts="goal", rule=_rules.lamost_rule),
    Allocator("network_flow", network_flow, _SEARCH, "network flow", searches=True, counts="exactly"),
    Allocator(
        "optimal",
        optimal,
        _SEARCH,
        "a proven optimum without collisions",
        avoids_collisions=True,
        searches=True,
        counts="exactly",
        distribution="exactly",
        breaks_ties=True,
        plans_jointly=True,
        keeps_plan=True,
    ),
    Allocator(
        "repair",
        repair,
        (*_COMMON, "start", "moves"),
        "lamost_rule, followed by local moves that remove collisions",
        avoids_collisions=True,
        counts="goal",
        distribution="goal",
        breaks_ties=True,
    ),
)
"""Built-in allocators by name.

The options of an allocator do not include the options that affect the results of every allocator:
``parked_obstacles``, ``keep_out`` and, if a requirement counts sky positions, ``sky_separation``.
"""
OPTIONS = (*dict.fromkeys(name for method in METHODS.values() for name in method.options), "parked_obstacles")
"""Options that not all allocators, or not all instruments, use."""


DEFAULT_ALLOCATOR = "repair"
"""The allocator of plans, tilings and surveys unless the user chooses another one."""


def name_of_best() -> str:
    """Return the name of the allocator that assigns the largest number of targets if collisions are ignored."""
    return next(name for name, method in METHODS.items() if method.searches and not method.avoids_collisions)


def _search(problem, **options):
    from rfpsurvey.allocation._spread import decide  # imported on first use, because it imports solvers

    programs = problem.options.programs
    with searching(float("inf") if programs is None else programs):
        return decide(problem, **options)


def with_cost(problem: AllocationProblem) -> AllocationProblem:
    """Return the problem; if the targets have subpriorities, replace the squared distance of each pair by a cost.

    The larger the subpriority of a science target, the lower the cost of its pairs. With ``optimal`` and a given plan,
    the sum of the costs is smallest for the plan that changes the fewest fibers (see `changes_of`).
    """
    if problem.options.method.keeps_plan and is_plan(problem.options.start):
        pairs, before = problem.pairs, problem.start(with_lost=True).target_of_positioner
        return replace(problem, pairs=replace(pairs, r2=changes_of(before, pairs.owner, pairs.target)))
    if problem.subpriority is None:
        return problem
    order = np.arange(len(problem.rank))  # the rows make the costs different if subpriorities are equal
    most, size = scale_of(problem)
    cost = np.where(problem.science, most - problem.subpriority, 0.0) / max(size, 1e-300)
    cost = np.round(cost, DIGITS) + order * (10.0 ** -(DIGITS + 1) / max(len(order), 1))
    return replace(problem, pairs=replace(problem.pairs, r2=cost[problem.pairs.target]))


def _bounded(problem, target_of, blind):
    """Return the objectives of a plan; their upper bounds are the values of a second plan, which ignores collisions.

    Without a second plan, the bounds of the numbers of targets are unknown.
    """
    levels, known, most = [], blind is not None, {} if blind is None else problem.values(blind)
    for name, value in problem.values(target_of).items():
        levels.append(Level(name, value, most[name] if known else np.nan))
        known = known and value == most[name]
    return with_subpriorities(problem, levels, target_of)


def _by_rule(problem, rule, *, by_priority=True):
    """Return the plan of a rule; the rows of the targets are already in order of subpriority."""
    n, n_sharing = len(problem.rank), problem.focal_plane.arrays.n_sharing
    is_required = problem.is_required if by_priority and problem.any_required else None
    rank, number = problem.rank if by_priority else np.zeros(n, np.int64), np.zeros(n, np.uint64)
    given = problem.pairs, rank, problem.science, is_required, number, n_sharing
    by_distance = problem.subpriority is None
    answer = rule(RuleProblem.of(*given, by_distance=by_distance), np.zeros(n), np.ones(n, np.bool_), problem.rng)
    return answer._replace(target_of_positioner=with_watched(problem, answer.target_of_positioner))


def _fill_quotas(problem, target_of):
    """Change a plan in place such that it meets the requirements as far as possible.

    The function uses idle positioners first, then the positioners of the least important targets.
    """
    plane, reach = problem.focal_plane, problem.pairs
    used, owner_of = np.flatnonzero(target_of >= 0), np.full(len(problem.rank), -1)
    owner_of[target_of[used]] = used
    locked = ~plane.arrays.usable
    locked[used] |= problem.is_required[target_of[used]]
    for requirement in problem.requirements:
        groups = [group for group in problem.groups if group.requirement is requirement and requirement.minimum > 0]
        if not groups:
            continue
        by_fiber, counting = plane.spectrograph.ndim > 1 and requirement.per == "spectrograph", None
        for group in groups:
            if group.targets is not counting:
                counting, rows = group.targets, reach.where(group.holds_target(reach.target, reach.owner))
            part = rows
            if by_fiber:
                part = rows.where(problem.spectrograph_of(rows.owner, rows.target) == group.spectrograph)
            indptr, target, r2 = part.by_positioner
            inside = np.diff(indptr) > 0
            if not by_fiber and group.spectrograph is not None:
                inside &= plane.spectrograph == group.spectrograph
            if group.fibers is not None:
                inside &= group.fibers
            used = np.flatnonzero(target_of >= 0)
            counted = used[group.holds(target_of[used], problem.spectrograph_of(used, target_of[used]), used)]
            locked[counted] = True
            rank = problem.rank_of(target_of)
            able = np.flatnonzero(~locked & inside)
            order = able[np.argsort(-rank[able], kind="stable")]
            need = requirement.minimum - len(counted)
            fill_quota(order, need, indptr, target, r2, group.targets, locked, target_of, owner_of)
