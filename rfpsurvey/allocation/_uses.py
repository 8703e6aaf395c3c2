"""The options that each allocator uses, and warnings about options without effect."""

from collections.abc import Collection, Sequence
from dataclasses import fields

from rfpsurvey._units import is_seed_given
from rfpsurvey.allocation._constraints import abilities_of
from rfpsurvey.constraints import ONLY_CHECKED
from rfpsurvey.errors import listed, warn_no_effect, warn_of_unused
from rfpsurvey.focal_plane import FocalPlane

__all__ = [
    "ALLOCATORS",
    "ONLY_SOME",
    "OPTIONS",
    "USES",
    "given_options",
    "uses_with",
    "warn_of_parked",
    "warn_of_unused_options",
]

_COMMON = ("required", "subpriority", "requirements")
_SEARCH = ("objective", "time_limit")
USES: dict[str, Collection[str]] = {
    "balanced": ("subpriority", "rng"),
    "nearest": ("required", "subpriority"),
    "lamost": _COMMON,
    "sdss": (*_COMMON, *_SEARCH),
    "optimal": (*_COMMON, *_SEARCH),
    "repair": (*_COMMON, "start"),
}
"""Names of the options that each built-in allocator uses.

The table does not contain the options that affect the results of every allocator: ``parked_obstacles``, ``keep_out``
and, if a requirement counts sky positions, ``sky_separation``. The allocator ``repair`` also uses the options of the
allocator from which it starts.
"""
ALLOCATORS = tuple(USES)
"""Built-in allocators."""
OPTIONS = (*_COMMON, *_SEARCH, "start", "rng", "parked_obstacles")
"""Options that not all allocators, or not all instruments, use."""
ONLY_SOME = (*_SEARCH, "start")
"""Options that have their default values in the record of a plan whose allocator does not use them."""


def given_options(options: object) -> list[str]:
    """Return the names of the fields of a dataclass, except the first field, that do not have their default values."""
    return [one.name for one in fields(options)[1:] if getattr(options, one.name) != one.default]


def uses_with(options) -> dict[str, Collection[str]]:
    """Return the names of the options that each allocator uses with the given value of ``start``."""
    if isinstance(options.start, str) and options.start not in USES:
        return {name: used for name, used in USES.items() if name != "repair"}  # a plugin may use every option
    more = USES[options.start] if isinstance(options.start, str) else ()
    return {**USES, "repair": {*USES["repair"], *more}}


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
    independent = ("parked_obstacles", "keep_out", "sky_separation", "constraints")
    given = [*(name for name in given_options(first) if name not in independent), *also]
    given += ["rng"] if is_seed_given(rng) else []
    warn_of_unused(given, [one.allocator for one in options], uses_with(first), "allocator")
    _warn_of_only_checked(options)
    if plane is not None and not first.parked_obstacles:
        warn_of_parked(plane)


def _warn_of_only_checked(options: Sequence) -> None:
    """Issue a warning for each constraint that no allocator honors; the results only state how it is violated."""
    abilities, first = [abilities_of(one.allocator) for one in options], options[0]
    if None in abilities:  # allocators that are not built in may honor every constraint
        return
    for one in first.all_constraints:
        is_checked = "obstacles" in one.parts or one in first.constraints
        if is_checked and all(one.honored(able) == ONLY_CHECKED for able in abilities):
            users = [name for name in ALLOCATORS if one.honored(abilities_of(name)) != ONLY_CHECKED]
            name = f"'{one}'" if one in first.constraints else one.name
            chosen = " and ".join(repr(name) for name in dict.fromkeys(option.allocator for option in options))
            who = f"{listed(users)} can honor it" if users else "no allocator honors it"
            warn_no_effect(name, f"with the allocator {chosen}, except that plans are checked; {who}")


def warn_of_parked(plane: FocalPlane) -> None:
    """Issue a warning that ``parked_obstacles`` has no effect if no positioner of a focal plane can be an obstacle."""
    if not plane.arrays.idle(True).parked.any():
        warn_no_effect("parked_obstacles", "because no positioner has two arms of equal length")
