"""The dict of the methods that place tiles."""

from functools import partial

from rfpsurvey.tiling._cover import cover_targets
from rfpsurvey.tiling._covering import hexagonal, spiral
from rfpsurvey.tiling._greedy import density_gradient, max_density, mean_shift
from rfpsurvey.tiling._network import sdss
from rfpsurvey.tiling._visit import visit_given

__all__ = ["COVERINGS", "GIVEN", "METHODS"]

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
