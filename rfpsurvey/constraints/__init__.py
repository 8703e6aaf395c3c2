"""Constraints on the plans of fields: excluded targets, obstacles, targets that take precedence, and counts."""

from rfpsurvey._roles import KINDS
from rfpsurvey.constraints._abilities import AS_GOAL, EXACTLY, ONLY_CHECKED, Abilities
from rfpsurvey.constraints._constraint import Constraint, ConstraintField
from rfpsurvey.constraints._distribution import Distribution
from rfpsurvey.constraints._group import Group
from rfpsurvey.constraints._keep_out import KeepOut, as_circles, circle_text
from rfpsurvey.constraints._motion import law_of
from rfpsurvey.constraints._required import Required, as_required, mark_required
from rfpsurvey.constraints._requirement import Requirement, as_requirements, check_counts, hint_of_name
from rfpsurvey.constraints._rule import Rule, check_unit
from rfpsurvey.constraints._shortfall import Shortfall, sentences
from rfpsurvey.constraints._text import BUILT_IN, answer, as_constraints, named_plugins
from rfpsurvey.constraints._verdict import FAIL, NOT_CHECKABLE, PASS, Verdict, count_verdicts, verdict_table

__all__ = [
    "AS_GOAL",
    "EXACTLY",
    "FAIL",
    "KINDS",
    "NOT_CHECKABLE",
    "ONLY_CHECKED",
    "PASS",
    "Abilities",
    "Constraint",
    "ConstraintField",
    "Distribution",
    "Group",
    "KeepOut",
    "Required",
    "Requirement",
    "Rule",
    "Shortfall",
    "Verdict",
    "answer",
    "as_circles",
    "as_constraints",
    "as_required",
    "as_requirements",
    "check_counts",
    "check_unit",
    "circle_text",
    "count_verdicts",
    "hint_of_name",
    "law_of",
    "mark_required",
    "named_plugins",
    "sentences",
    "verdict_table",
]

# every constraint of the package is public
globals().update({one.__name__: one for one in BUILT_IN.values()})
