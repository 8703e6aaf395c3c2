"""Who observes what: a table of methods behind `allocate`."""

from rfpsurvey.allocation._allocate import OBJECTIVES, allocate
from rfpsurvey.allocation._allocation import Allocation
from rfpsurvey.allocation._methods import METHODS
from rfpsurvey.allocation._plugin import AllocationProblem, find_method, packages
from rfpsurvey.allocation._problem import Level
from rfpsurvey.allocation._requirements import Requirement, Shortfall, as_requirements, sentences

__all__ = [
    "METHODS", "OBJECTIVES", "Allocation", "AllocationProblem", "Level", "Requirement", "Shortfall", "allocate",
    "as_requirements", "find_method", "packages", "sentences",
]  # fmt: skip
