"""Design studies: how coverage and the fraction of fibers lost to collisions depend on arms, pitch and clearance."""

from rfpsurvey._studies.design import LossOptions, explore_designs
from rfpsurvey._studies.design_around import design_improvements, design_sensitivities, explore_around

__all__ = ["LossOptions", "design_improvements", "design_sensitivities", "explore_around", "explore_designs"]
