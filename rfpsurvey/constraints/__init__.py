"""Constraints on the plans of fields: excluded targets, obstacles, targets that take precedence, and counts."""

from rfpsurvey._roles import KINDS
from rfpsurvey.constraints._constraint import AS_GOAL, EXACTLY, ONLY_CHECKED, Abilities, Constraint
from rfpsurvey.constraints._counts import CountedTargets, Group, Shortfall, hint_of_name, sentences
from rfpsurvey.constraints._distribution import Distribution
from rfpsurvey.constraints._field import FAIL, NOT_CHECKABLE, PASS, ConstraintField, Verdict, verdict_table
from rfpsurvey.constraints._keep_out import KeepOut, as_circles, circle_text
from rfpsurvey.constraints._motion import law_of
from rfpsurvey.constraints._required import Required, as_required, mark_required
from rfpsurvey.constraints._requirement import Requirement, as_requirements, check_counts
from rfpsurvey.constraints._rule import Rule, check_unit
from rfpsurvey.constraints._text import BUILT_IN, answer, as_constraints, named_plugins, with_present_texts

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
    "CountedTargets",
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
    "hint_of_name",
    "law_of",
    "mark_required",
    "named_plugins",
    "sentences",
    "verdict_table",
    "with_present_texts",
]

# every constraint of the package is public
globals().update({constraint.__name__: constraint for constraint in BUILT_IN.values()})
