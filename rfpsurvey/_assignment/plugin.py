"""Find allocators, check the return values of allocators that are not built in, and warn of options without effect."""

from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from functools import partial

import numpy as np

from rfpsurvey._assignment.answer import SUBPRIORITIES, AllocationAnswer
from rfpsurvey._assignment.before_and_after import is_plan
from rfpsurvey._assignment.constraints.constraint import ONLY_CHECKED
from rfpsurvey._assignment.constraints.counts import hint_of_name
from rfpsurvey._assignment.constraints.rule import Rule
from rfpsurvey._assignment.constraints.text import named_plugins
from rfpsurvey._assignment.methods import METHODS, OPTIONS, Allocator
from rfpsurvey._assignment.objectives import sum_of_subpriorities
from rfpsurvey._assignment.problem import AllocationProblem, with_watched
from rfpsurvey._common.plugins import Plugin, find_function, find_plugin
from rfpsurvey._common.units import is_seed_given, to_plain
from rfpsurvey._instruments.focal_plane import FocalPlane
from rfpsurvey._instruments.reach import elbow_names
from rfpsurvey._sky.arrays import JOINED, KINDS, has_role
from rfpsurvey.errors import INCONVERTIBLE, InputError, check_choice, listed, warn, warn_no_effect, warn_of_unused


def warn_of_unused_options(
    options: Sequence, plane: FocalPlane | None = None, rng: object = 0, also: Sequence[str] = ()
) -> None:
    """Issue a warning for each given option that no allocator uses.

    Parameters
    ----------
    options : sequence of AllocationOptions
        Options that differ only in the allocator.
    plane : FocalPlane, optional
        The focal plane; None if several focal planes are used.
    rng : int, Generator or None, optional
        Seed or random number generator of the plan.
    also : sequence of str, optional
        Names of further options that were given.
    """
    first = options[0]
    given = [*(name for name in first.changed() if name != "parked_obstacles"), *also]
    given += ["rng"] if is_seed_given(rng) else []
    known = [find_improving(name, first.start, first.moves) for name in METHODS]
    warn_of_unused(given, [settings.method for settings in options], known, "allocator")
    _warn_of_only_checked(options, known)
    if plane is not None and not first.parked_obstacles and not first.motion_law:
        warn_of_parked(plane)


def warn_of_lacks(options, column: Callable[[str], np.ndarray | None]) -> None:
    """Issue a warning for each requirement, and for each rule on a category, for which a catalog has no targets.

    Parameters
    ----------
    options : AllocationOptions
        Options with the requirements.
    column : callable
        Function that returns a column of the catalog (``kind`` or ``category``), or None without this column.
    """
    rules = [rule for rule in options.all_constraints if isinstance(rule, Rule)]
    rules = [rule for rule in rules if getattr(rule, "what", "") not in ("", *KINDS)]
    asked = {rule.what: rule for rule in (*rules, *options.needs)}
    if options.sky_separation is not None:
        asked.pop("sky", None)
    asked.pop("science", None)
    columns = [values for name in ("kind", "category") if asked and (values := column(name)) is not None]
    lacking = {what: rule for what, rule in asked.items() if not any(has_role(kind, what).any() for kind in columns)}
    if not lacking:
        return
    known = {"science", *(name for values in columns for name in np.unique(values).tolist())}
    categories = sorted(known - {*KINDS, *JOINED, ""})
    for what, rule in lacking.items():
        hint = "set sky_separation to add blank sky positions" if what == "sky" else hint_of_name(what, known)
        if categories and not hint and what not in KINDS:
            hint = f"the catalog's categories are: {listed(categories, 8)}"
        word = "requirement" if rule in options.needs else "rule"
        text = f"no target of the catalog is {what!r}, but the {word} '{rule}' needs such targets"
        warn(text + (hint and f"; {hint}"))


def _warn_of_only_checked(options: Sequence, known: list) -> None:
    """Issue a warning for each constraint that no allocator honors; the results only state how it is violated."""
    methods, first = [settings.method for settings in options], options[0]
    if any(method.options is None for method in methods):  # allocators without a record may honor every constraint
        return
    given_ids = {id(constraint) for constraint in first.constraints}  # comparing constraints could compare arrays
    for constraint in first.all_constraints:
        is_checked = ("obstacles" in constraint.parts or id(constraint) in given_ids) and not constraint.before_fibers
        if is_checked and all(constraint.honored(method.abilities) == ONLY_CHECKED for method in methods):
            users = [method.name for method in known if constraint.honored(method.abilities) != ONLY_CHECKED]
            name = f"'{constraint}'" if id(constraint) in given_ids else constraint.name
            chosen = f"{'s' if len(methods) > 1 else ''} {' and '.join(repr(method.name) for method in methods)}"
            who = f"{listed(users)} can honor it" if users else "no allocator honors it"
            warn_no_effect(name, f"with the allocator{chosen}, except that plans are checked; {who}")


def warn_of_parked(plane: FocalPlane) -> None:
    """Issue a warning that ``parked_obstacles`` has no effect if no positioner of a focal plane can be an obstacle."""
    if not plane.arrays.idle(True).parked.any():
        warn_no_effect("parked_obstacles", "because no positioner has two arms of equal length")


GROUP = "rfpsurvey.allocators"
"""Entry-point group by which packages add allocators."""
ELBOWS = ("right", "left")
DECLARED = {field.name for field in fields(Allocator)} - {
    "name",
    "function",
    "breaks_ties",
    "plans_jointly",
    "is_random",
    "rule",
}
"""Fields of an `Allocator` that a function which is not built in can declare as attributes."""


def find_allocator(given: str | Callable, *, what: str = "allocator", known: dict = METHODS) -> Allocator:
    """Return an allocator that is given by its name or as a function; ``known`` are the allowed built-in allocators."""
    if isinstance(given, str) and given in known:
        return known[given]
    plugin = find_function(GROUP, given, known, what)
    with plugin.answering():
        declared = {name: getattr(plugin.value, name) for name in DECLARED if hasattr(plugin.value, name)}
        for name in declared.get("options") or ():
            check_choice(name, OPTIONS, "option of an allocator")
        return Allocator(**{"name": plugin.name, "function": partial(_ask, plugin), "options": None, **declared})


def known_allocator(allocator: object) -> object:
    """Return the name of an allocator, or a function, unchanged; raise an error if the name is unknown."""
    find_allocator(allocator)
    return allocator


def find_improving(given: str | Callable, start: object, moves: str) -> Allocator:
    """Return an allocator; if it improves the plan of another allocator, it also has the properties of the other."""
    allocator = find_allocator(given)
    if allocator.improves and moves == "exchange":  # plans of version 0.3 depend on the order of targets
        allocator = replace(allocator, breaks_ties=False)
    if allocator.keeps_plan and is_plan(start):
        return replace(allocator, options=(*allocator.options, "start"))
    if not (allocator.improves and isinstance(start, str)):
        return allocator
    starter = find_allocator(start)
    options = None if starter.options is None else {*allocator.options, *starter.options}
    return replace(allocator, options=options, breaks_ties=allocator.breaks_ties or starter.breaks_ties)


def packages(options) -> dict[str, str]:
    """Return the names and versions of the packages that provide allocators or constraints of the options."""
    versions, uses_start = named_plugins(options.constraints), find_allocator(options.allocator).uses("start")
    for name in (options.allocator, options.start) if uses_start else (options.allocator,):
        if isinstance(name, str) and name not in METHODS:
            versions.update(find_plugin(GROUP, name, METHODS, "allocator").software)
    return versions


def _ask(plugin: Plugin, problem: AllocationProblem) -> AllocationAnswer:
    """Call an allocator of a user or of another package, and check its return value."""
    with plugin.answering():
        answer = plugin.value(problem)
        if not isinstance(answer, AllocationAnswer):
            is_pair = isinstance(answer, tuple) and len(answer) == 2
            answer = AllocationAnswer(*answer) if is_pair else AllocationAnswer(answer)
        target_of, elbows = _checked(problem, answer.target_of_positioner), answer.handedness
        if elbows is not None:
            elbows = _elbows(problem, target_of, elbows)
        target_of = with_watched(problem, target_of)
        _check_claims(problem, target_of, answer)
    meta = {**(answer.meta or {}), **({"software": plugin.software} if plugin.package else {})}
    return answer._replace(target_of_positioner=target_of, handedness=elbows, meta=meta)


def _check_claims(problem: AllocationProblem, target_of: np.ndarray, answer: AllocationAnswer) -> None:
    """Raise an error if values or bounds of objectives contradict the plan, or if queued targets are out of reach."""
    if answer.levels is not None:
        real = problem.values(target_of)
        given = {name: value for name, value, _ in answer.levels}
        if SUBPRIORITIES in given and problem.subpriority is not None:
            real[SUBPRIORITIES] = sum_of_subpriorities(problem, target_of)
        if given != real or any(bound < value for _, value, bound in answer.levels):
            raise InputError(
                f"levels must contain the values of the objectives of the plan, {real}, and bounds that are not "
                "below these values"
            )
    if answer.queues is not None:
        indptr, queue = (np.asarray(column) for column in answer.queues)
        n, pairs = len(target_of), problem.pairs
        fits = indptr.shape == (n + 1,) and indptr[0] == 0 and indptr[-1] == len(queue) and (np.diff(indptr) >= 0).all()
        owner = np.repeat(np.arange(n), np.diff(indptr)) if fits else None
        # pairs are compared as single numbers
        if not fits or not np.isin(queue * n + owner, pairs.target * n + pairs.owner).all():
            raise InputError(
                f"queues must contain indptr, shape ({n + 1},), and the rows of targets that the positioners reach"
            )


def _checked(problem: AllocationProblem, given: object) -> np.ndarray:
    """Return the target of each positioner from the return value of an allocator; raise an error if it is not valid."""
    n, n_targets = len(problem.focal_plane), len(problem.xy)
    target_of = _plain(given)
    if target_of.shape != (n,) or target_of.dtype.kind not in "iu":
        raise InputError(
            "an allocator must return the row of the target of each positioner or -1 (whole numbers of the "
            f"shape ({n},)), or a tuple of these numbers and the elbows; got {type(given).__name__} of the "
            f"shape {target_of.shape}"
        )
    strange = target_of[(target_of < -1) | (target_of >= n_targets)]
    if len(strange):
        raise InputError(f"targets must be rows from 0 to {n_targets - 1}, or -1 for no target, got {strange[0]}")
    target_of = target_of.astype(np.int64)
    if problem.watched is not None:  # answers based on `start` contain the sky positions that stuck fibers observe
        target_of[(problem.watched >= 0) & (target_of == problem.watched)] = -1
    owner = np.flatnonzero(target_of >= 0)
    used, counts = np.unique(target_of[owner], return_counts=True)
    if (counts > 1).any():
        twice = used[counts > 1][0]
        who = np.flatnonzero(target_of == twice)
        raise InputError(
            f"target {twice} must have at most one positioner, got the positioners {who[0]} and {who[1]} (rows)"
        )
    pairs = problem.pairs
    able = np.isin(target_of[owner] * n + owner, pairs.target * n + pairs.owner)
    if not able.all():
        first = owner[~able][0]
        idle = not problem.focal_plane.arrays.usable[first]
        why = (
            "the positioner is disabled or stuck"
            if idle
            else "the target is out of reach, is forbidden, or requires another fiber type"
        )
        raise InputError(f"positioner {first} (row) cannot observe target {target_of[first]}: {why}")
    return target_of


def _elbows(problem: AllocationProblem, target_of: np.ndarray, elbows: object) -> np.ndarray:
    """Return the elbows of all arms; raise an error if a positioner cannot reach its target with the given elbow."""
    plane, owner = problem.focal_plane, np.flatnonzero(target_of >= 0)
    names = _plain(elbows)
    if names.shape != target_of.shape or not np.isin(names[owner], ELBOWS).all():
        raise InputError(
            f"elbows must be 'right' or 'left' for each positioner with a target, shape ({len(plane)},), got {elbows!r}"
        )
    tips = np.vstack([problem.xy, [np.nan, np.nan]])[target_of]
    fiber = problem.fiber_of(np.arange(len(plane)), target_of)
    side, both_elbows = plane.arrays.sides(tips, fiber=fiber), plane.positioner.handedness == "both"
    side[owner] = np.where(names[owner] == "left", -1.0, 1.0)
    allowed = np.full(len(owner), both_elbows) | (names[owner] == plane.positioner.handedness)
    for sign in (1.0, -1.0):
        rows = np.flatnonzero(allowed & (side[owner] == sign))
        points = problem.xy[target_of[owner[rows]]]
        allowed[rows] = plane.arrays.poses_allowed(owner[rows], points, sign, fiber[owner[rows]])
    if not allowed.all():
        first = owner[~allowed][0]
        raise InputError(f"positioner {first} (row) cannot have the elbow {str(names[first])!r} at its target")
    return elbow_names(side)


def _plain(given: object) -> np.ndarray:
    """Convert the return value of an allocator to an array; if this is impossible, return an array of shape (0, 0)."""
    try:
        return to_plain(given)
    except INCONVERTIBLE:
        return np.empty((0, 0))
