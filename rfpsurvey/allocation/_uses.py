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
    warn_of_unused(given, [one.method for one in options], known, "allocator")
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
    rules = (one for one in options.all_constraints if isinstance(one, Rule) and hasattr(one, "what"))
    asked = {one.what: one for one in (*(one for one in rules if one.what not in ("", *KINDS)), *options.needs)}
    if options.sky_separation is not None:
        asked.pop("sky", None)
    asked.pop("science", None)
    columns = [values for name in ("kind", "category") if asked and (values := column(name)) is not None]
    lacking = {what: one for what, one in asked.items() if not any(has_role(values, what).any() for values in columns)}
    if not lacking:
        return
    there = {"science", *(name for values in columns for name in np.unique(values).tolist())}
    categories = sorted(there - {*KINDS, *JOINED, ""})
    for what, one in lacking.items():
        hint = "set sky_separation to add blank sky positions" if what == "sky" else hint_of_name(what, there)
        if categories and not hint and what not in KINDS:
            hint = f"the catalog's categories are: {listed(categories, 8)}"
        word = "requirement" if one in options.needs else "rule"
        text = f"no target of the catalog is {what!r}, but the {word} '{one}' needs such targets"
        warn(text + (hint and f"; {hint}"))


def _warn_of_only_checked(options: Sequence, known: list) -> None:
    """Issue a warning for each constraint that no allocator honors; the results only state how it is violated."""
    methods, first = [one.method for one in options], options[0]
    if any(method.options is None for method in methods):  # allocators without a record may honor every constraint
        return
    own = {id(one) for one in first.constraints}  # comparing constraints could compare arrays
    for one in first.all_constraints:
        is_checked = ("obstacles" in one.parts or id(one) in own) and not one.before_fibers
        if is_checked and all(one.honored(method.abilities) == ONLY_CHECKED for method in methods):
            users = [method.name for method in known if one.honored(method.abilities) != ONLY_CHECKED]
            name = f"'{one}'" if id(one) in own else one.name
            chosen = f"{'s' if len(methods) > 1 else ''} {' and '.join(repr(method.name) for method in methods)}"
            who = f"{listed(users)} can honor it" if users else "no allocator honors it"
            warn_no_effect(name, f"with the allocator{chosen}, except that plans are checked; {who}")


def warn_of_parked(plane: FocalPlane) -> None:
    """Issue a warning that ``parked_obstacles`` has no effect if no positioner of a focal plane can be an obstacle."""
    if not plane.arrays.idle(True).parked.any():
        warn_no_effect("parked_obstacles", "because no positioner has two arms of equal length")
