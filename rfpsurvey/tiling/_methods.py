"""The table of the methods that place tiles, and checks of their options."""

from dataclasses import dataclass

from rfpsurvey._methods import Method, table_of
from rfpsurvey.errors import InputError, listed, warn_no_effect, warn_of_unused
from rfpsurvey.tiling._cover import cover_targets
from rfpsurvey.tiling._covering import hexagonal, spiral
from rfpsurvey.tiling._greedy import density_gradient, max_density, mean_shift
from rfpsurvey.tiling._network import network_flow
from rfpsurvey.tiling._problem import TilingProblem, TilingState, visit_given


@dataclass(frozen=True)
class TilingMethod(Method):
    """A method that places tiles."""

    covers: bool = False
    """Whether the function returns the centers of a covering, for which no targets are required."""
    needs_tiles: bool = False
    """Whether the method needs a list of tiles."""

    def place(self, problem: TilingProblem) -> TilingState:
        """Place the tiles for the targets of a problem."""
        return cover_targets(problem, self.function) if self.covers else self.function(problem)


METHODS = table_of(
    TilingMethod("hexagonal", hexagonal, ("passes",), "a covering without gaps", covers=True),
    TilingMethod("spiral", spiral, ("passes",), "a covering without gaps", covers=True),
    TilingMethod("max_density", max_density, summary="tile after tile, where most visits remain"),
    TilingMethod("density_gradient", density_gradient, summary="tile after tile, at maxima of the density"),
    TilingMethod("mean_shift", mean_shift, summary="tile after tile, at the mean of its targets"),
    TilingMethod("network_flow", network_flow, summary="network flow"),
    TilingMethod("given", visit_given, summary="a list of tiles", needs_tiles=True),
)
"""Methods that place tiles, by name. A function takes a `TilingProblem`, or makes the centers of a covering."""


def warn_of_unused_passes(method: TilingMethod, passes: int, *, has_goal: bool) -> None:
    """Issue a warning if a number of passes is given that has no effect."""
    if passes != 1:
        warn_of_unused(["passes"], [method], METHODS.values(), "method")
        if method.covers and has_goal:
            warn_no_effect("passes", "if n_tiles or completeness is given, which then determine the number of passes")


def check_region_options(method: TilingMethod, goals: dict, unused: dict) -> None:
    """Raise an error if a method cannot cover a region or reach the goals; issue warnings about unused options."""
    if not (method.covers or method.needs_tiles):
        able = listed(name for name, candidate in METHODS.items() if candidate.covers)
        raise InputError(f"the method {method.name!r} needs targets, got a Region; methods that cover regions: {able}")
    for name, value in goals.items():
        if value is not None:
            raise InputError(f"{name} applies only to targets, and a region has none")
    for name, value in unused.items():
        if value is not None:
            warn_no_effect(name, "on a region, which has no targets")
