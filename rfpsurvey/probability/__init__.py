"""How likely collisions are: a table of methods behind `collision_probability`."""

from rfpsurvey.probability._collision_probability import collision_probability
from rfpsurvey.probability._estimate import Estimate
from rfpsurvey.probability._methods import ESTIMANDS, METHODS

__all__ = ["ESTIMANDS", "METHODS", "Estimate", "collision_probability"]
