"""The built-in allocators: functions that take an allocation problem and return its solution, and their records."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from rfpsurvey._assignment import rules as _rules
from rfpsurvey._assignment.answer import AllocationAnswer, Level
from rfpsurvey._assignment.before_and_after import is_plan
from rfpsurvey._assignment.clock import searching
from rfpsurvey._assignment.constraints.constraint import AS_GOAL, EXACTLY, ONLY_CHECKED, Abilities
from rfpsurvey._assignment.distribution import lost_to_rules
from rfpsurvey._assignment.local_search import match, movable_candidates, pick, repair_nearby, trim
from rfpsurvey._assignment.objectives import with_subpriorities
from rfpsurvey._assignment.problem import AllocationProblem
from rfpsurvey._common.descriptions import Method, table_of
from rfpsurvey._instruments.reach import elbow_names
from rfpsurvey.errors import check_choice, check_switch

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
    answer = repaired(problem, steady=is_plan(problem.options.start))
    if problem.distributions:
        target_of = answer.target_of_positioner
        free = repair(replace(problem, options=problem.options.without("distributions"))).target_of_positioner
        answer.meta["n_lost_to_rules"] = lost_to_rules(problem, free, target_of)
    return answer


def repaired(problem: AllocationProblem, *, steady: bool) -> AllocationAnswer:
    """Return the plan of `repair`; with ``steady``, targets are not exchanged for equally good targets."""
    start = problem.start()
    before, elbows = start.target_of_positioner, start.handedness
    all_candidates = movable_candidates(problem, before)
    side = None if elbows is None else np.where(elbows == "left", -1.0, 1.0)
    first = pick(all_candidates, trim(problem, before), side)
    candidates, chosen = repair_nearby(all_candidates, first, steady=steady)
    target_of, had = candidates.options.target[chosen], before >= 0
    worse = problem.rank_of(target_of) > problem.rank_of(before)  # a less important target, or none
    n_moved, n_dropped = ((had & some).sum() for some in (~worse & (target_of != before), worse))
    meta = {"n_before": int(had.sum()), "n_moved": int(n_moved), "n_dropped": int(n_dropped)}
    levels = _bounded(problem, target_of, None if problem.any_goals else match(all_candidates))
    return AllocationAnswer(target_of, elbow_names(candidates.side[chosen]), None, levels, meta)


_COMMON = ("required", "subpriority", "requirements")
_SEARCH = (*_COMMON, "objective", "time_limit", "programs")
METHODS = table_of(
    Allocator(
        "balanced",
        _rules.plan_balanced,
        ("subpriority", "rng"),
        "ignores priorities",
        makes_queues=True,
        uses_priorities=False,
        is_random=True,
        rule=_rules.balanced,
    ),
    Allocator("nearest", _rules.plan_nearest, ("required", "subpriority"), rule=_rules.nearest),
    Allocator(
        "lamost_rule", _rules.plan_lamost_rule, _COMMON, "the rule of LAMOST", counts="goal", rule=_rules.lamost_rule
    ),
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
    from rfpsurvey._assignment.spread import decide

    programs = problem.options.programs
    with searching(float("inf") if programs is None else programs):
        return decide(problem, **options)


def _bounded(problem, target_of, blind):
    """Return the objectives of a plan; their upper bounds are the values of a second plan, which ignores collisions.

    Without a second plan, the bounds of the numbers of targets are unknown.
    """
    levels, known, most = [], blind is not None, {} if blind is None else problem.values(blind)
    for name, value in problem.values(target_of).items():
        levels.append(Level(name, value, most[name] if known else np.nan))
        known = known and value == most[name]
    return with_subpriorities(problem, levels, target_of)
