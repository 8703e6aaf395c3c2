"""Estimates of collision probabilities by several methods."""

from rfpsurvey.probability._collision_probability import collision_probability
from rfpsurvey.probability._methods import METHODS
from rfpsurvey.probability._options import Precision, RandomTargets
from rfpsurvey.probability._plugin import find_method
from rfpsurvey.probability._question import Estimate, ProbabilityQuestion
from rfpsurvey.probability._run import rate_interval
from rfpsurvey.probability._simulate import QUEUEING
from rfpsurvey.probability._surrogate import (
    AXES,
    interior_probability,
    outside_box,
    surrogate_probability,
    surrogate_spline,
)
from rfpsurvey.probability._targets import Source, make_source

__all__ = [
    "AXES",
    "METHODS",
    "QUEUEING",
    "Estimate",
    "Precision",
    "ProbabilityQuestion",
    "RandomTargets",
    "Source",
    "collision_probability",
    "find_method",
    "interior_probability",
    "make_source",
    "outside_box",
    "rate_interval",
    "surrogate_probability",
    "surrogate_spline",
]
