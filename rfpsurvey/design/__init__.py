"""Design studies of arms, pitch and clearance: a table of methods behind `explore_designs`."""

from rfpsurvey.design._explore import explore_designs
from rfpsurvey.design._losses import ESTIMANDS, METHODS
from rfpsurvey.design._options import LossOptions
from rfpsurvey.design._sensitivities import design_sensitivities

__all__ = ["ESTIMANDS", "METHODS", "LossOptions", "design_sensitivities", "explore_designs"]
