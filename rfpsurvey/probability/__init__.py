"""How likely collisions are: a table of methods behind `collision_probability`."""

from rfpsurvey.probability._collision_probability import collision_probability
from rfpsurvey.probability._estimate import Estimate
from rfpsurvey.probability._fit import PolynomialFit, fit_polynomial
from rfpsurvey.probability._methods import ESTIMANDS, METHODS
from rfpsurvey.probability._plugin import ProbabilityQuestion, find_method
from rfpsurvey.probability._run import Progress, rate_interval
from rfpsurvey.probability._surrogate import make_surrogate, surrogate_probability

__all__ = [
    "ESTIMANDS",
    "METHODS",
    "Estimate",
    "PolynomialFit",
    "ProbabilityQuestion",
    "Progress",
    "collision_probability",
    "find_method",
    "fit_polynomial",
    "make_surrogate",
    "rate_interval",
    "surrogate_probability",
]
