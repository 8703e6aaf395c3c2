"""Warnings about options of an allocation that have no effect, and about requirements that cannot be met."""

from collections.abc import Callable, Sequence

import numpy as np

from rfpsurvey._roles import JOINED, KINDS, has_role
from rfpsurvey._units import is_seed_given
from rfpsurvey.allocation._methods import METHODS
from rfpsurvey.allocation._plugin import find_improving
from rfpsurvey.constraints import ONLY_CHECKED, Rule, hint_of_name
from rfpsurvey.errors import listed, warn, warn_no_effect, warn_of_unused
from rfpsurvey.focal_plane import FocalPlane


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
