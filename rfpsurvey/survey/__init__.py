"""Surveys of many tiles, which observe each target the requested number of times."""

from rfpsurvey.survey._cadences import Cadences
from rfpsurvey.survey._columns import survey_facts
from rfpsurvey.survey._history._diff import diff_surveys
from rfpsurvey.survey._history._rule import VisitRule
from rfpsurvey.survey._history._state import SurveyState
from rfpsurvey.survey._history._status import status_facts, survey_status
from rfpsurvey.survey._joint._options import JOINT, JointOptions
from rfpsurvey.survey._plan import plan_survey, prepare_request
from rfpsurvey.survey._request import Request
from rfpsurvey.survey._run import in_order
from rfpsurvey.survey._stored import verify_survey
from rfpsurvey.survey._survey import Survey
from rfpsurvey.survey._work import Job, reach_of, work

__all__ = [
    "JOINT",
    "Cadences",
    "Job",
    "JointOptions",
    "Request",
    "Survey",
    "SurveyState",
    "VisitRule",
    "diff_surveys",
    "in_order",
    "plan_survey",
    "prepare_request",
    "reach_of",
    "status_facts",
    "survey_facts",
    "survey_status",
    "verify_survey",
    "work",
]
