"""Design studies: how coverage and the fraction of fibers lost to collisions depend on arms, pitch and clearance."""

from rfpsurvey.design._around import design_improvements, explore_around
from rfpsurvey.design._explore import explore_designs
from rfpsurvey.design._losses import METHODS, SURROGATE_ERROR
from rfpsurvey.design._options import LossOptions
from rfpsurvey.design._rows import AXES
from rfpsurvey.design._sensitivities import design_sensitivities

__all__ = [
    "AXES",
    "METHODS",
    "SURROGATE_ERROR",
    "LossOptions",
    "design_improvements",
    "design_sensitivities",
    "explore_around",
    "explore_designs",
]
