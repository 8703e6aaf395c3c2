"""Constraints on the plans of fields: excluded targets, obstacles, targets that take precedence, and counts."""

from rfpsurvey._assignment.constraints.constraint import Constraint
from rfpsurvey._assignment.constraints.counts import Group
from rfpsurvey._assignment.constraints.field import ConstraintField, Verdict
from rfpsurvey._assignment.constraints.motion import Motion
from rfpsurvey._assignment.constraints.requirement import Requirement
from rfpsurvey._assignment.constraints.rule import Rule
from rfpsurvey._assignment.constraints.rules import Contrast, Distribution, MagnitudeLimits
from rfpsurvey._assignment.constraints.stars import BrightStars, GuideStars
from rfpsurvey._assignment.constraints.targets import KeepOut, Required
from rfpsurvey._assignment.constraints.text import as_constraints

__all__ = [
    "BrightStars",
    "Constraint",
    "ConstraintField",
    "Contrast",
    "Distribution",
    "Group",
    "GuideStars",
    "KeepOut",
    "MagnitudeLimits",
    "Motion",
    "Required",
    "Requirement",
    "Rule",
    "Verdict",
    "as_constraints",
]
