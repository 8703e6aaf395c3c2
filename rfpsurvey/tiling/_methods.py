"""The dict of the methods that place tiles, and the options that each method uses."""

from functools import partial

from rfpsurvey.errors import InputError, warn_no_effect, warn_of_unused
from rfpsurvey.tiling._cover import cover_targets
from rfpsurvey.tiling._covering import hexagonal, spiral
from rfpsurvey.tiling._greedy import density_gradient, max_density, mean_shift
from rfpsurvey.tiling._network import sdss
from rfpsurvey.tiling._visit import visit_given

GIVEN = "given"

# Coverings of a region, which require no targets.
COVERINGS = {"hexagonal": hexagonal, "spiral": spiral}

# Each method is a function that takes a TilingProblem and returns a TilingState.
METHODS = {
    **{name: partial(cover_targets, make=make) for name, make in COVERINGS.items()},
    "max_density": max_density,
    "density_gradient": density_gradient,
    "mean_shift": mean_shift,
    "sdss": sdss,
    GIVEN: visit_given,
}

# Names of the options that each method uses. The table does not contain the options that all methods use.
USES = {name: ("passes",) if name in COVERINGS else () for name in METHODS}


def warn_of_unused_passes(method: str, passes: int, *, has_goal: bool) -> None:
    """Issue a warning if a number of passes is given that has no effect."""
    if passes != 1:
        warn_of_unused(["passes"], [method], USES, "method")
        if method in COVERINGS and has_goal:
            warn_no_effect("passes", "if n_tiles or completeness is given, which then determine the number of passes")


def check_region_options(method: str, goals: dict, unused: dict) -> None:
    """Raise an error if a method cannot cover a region or reach the goals; issue warnings about unused options."""
    if method not in COVERINGS and method != GIVEN:
        raise InputError(f"the method {method!r} needs targets, got a Region; {' and '.join(COVERINGS)} cover regions")
    for name, value in goals.items():
        if value is not None:
            raise InputError(f"{name} applies only to targets, and a region has none")
    for name, value in unused.items():
        if value is not None:
            warn_no_effect(name, "on a region, which has no targets")
