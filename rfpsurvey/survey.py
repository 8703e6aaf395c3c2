"""Surveys of many tiles, which observe each target the requested number of times."""

from rfpsurvey._survey.cadences import Cadences
from rfpsurvey._survey.continue_survey import continue_survey
from rfpsurvey._survey.footprints import to_moc, to_regions
from rfpsurvey._survey.history.diff import diff_surveys
from rfpsurvey._survey.history.rule import VisitRule
from rfpsurvey._survey.history.state import SurveyState
from rfpsurvey._survey.history.status import survey_status
from rfpsurvey._survey.joint.fixed import JointOptions
from rfpsurvey._survey.plan import plan_survey
from rfpsurvey._survey.stored import verify_survey
from rfpsurvey._survey.survey import Survey

__all__ = [
    "Cadences",
    "JointOptions",
    "Survey",
    "SurveyState",
    "VisitRule",
    "continue_survey",
    "diff_surveys",
    "plan_survey",
    "survey_status",
    "to_moc",
    "to_regions",
    "verify_survey",
]
