"""Surveys of many tiles, which observe each target the requested number of times."""

from rfpsurvey.survey._cadences import Cadences
from rfpsurvey.survey._columns import survey_facts
from rfpsurvey.survey._continue import continue_survey
from rfpsurvey.survey._history._catalogs import visits_without_rule
from rfpsurvey.survey._history._diff import diff_surveys
from rfpsurvey.survey._history._rule import VisitRule
from rfpsurvey.survey._history._state import SurveyState
from rfpsurvey.survey._history._status import status_facts, survey_status
from rfpsurvey.survey._joint._options import JOINT, JointOptions, as_joint
from rfpsurvey.survey._joint._plan import plan_jointly
from rfpsurvey.survey._plan import plan_survey, prepare_request
from rfpsurvey.survey._plan_file import (
    DEFAULT_CENTER,
    SurveyKeys,
    allocator_of,
    call_of,
    keys_in,
    read_tiles,
    state_in,
    targets_of,
    tiles_of,
)
from rfpsurvey.survey._request import Request
from rfpsurvey.survey._rounds import run_rounds
from rfpsurvey.survey._stored import verify_survey
from rfpsurvey.survey._survey import Survey
from rfpsurvey.survey._work import Job, reach_of, work

__all__ = [
    "DEFAULT_CENTER",
    "JOINT",
    "Cadences",
    "Job",
    "JointOptions",
    "Request",
    "Survey",
    "SurveyKeys",
    "SurveyState",
    "VisitRule",
    "allocator_of",
    "as_joint",
    "call_of",
    "continue_survey",
    "diff_surveys",
    "keys_in",
    "plan_jointly",
    "plan_survey",
    "prepare_request",
    "reach_of",
    "read_tiles",
    "run_rounds",
    "state_in",
    "status_facts",
    "survey_facts",
    "survey_status",
    "targets_of",
    "tiles_of",
    "verify_survey",
    "visits_without_rule",
    "work",
]
