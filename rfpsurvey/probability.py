"""Estimates of collision probabilities by several methods."""

from rfpsurvey._studies.collision_probability import collision_probability
from rfpsurvey._studies.methods import METHODS
from rfpsurvey._studies.question import Estimate, ProbabilityQuestion
from rfpsurvey._studies.surrogate import surrogate_probability, surrogate_spline
from rfpsurvey._studies.targets import Precision, RandomTargets

__all__ = [
    "METHODS",
    "Estimate",
    "Precision",
    "ProbabilityQuestion",
    "RandomTargets",
    "collision_probability",
    "surrogate_probability",
    "surrogate_spline",
]
