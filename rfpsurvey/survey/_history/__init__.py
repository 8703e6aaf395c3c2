"""The history of a survey: recorded events, and the state of targets and tiles that follows from them."""

from rfpsurvey.survey._history._catalogs import digest_of, extra_digest, first_visits, in_memory
from rfpsurvey.survey._history._continue import begin, state_columns
from rfpsurvey.survey._history._rule import VisitRule
from rfpsurvey.survey._history._state import SurveyState

__all__ = [
    "SurveyState",
    "VisitRule",
    "begin",
    "digest_of",
    "extra_digest",
    "first_visits",
    "in_memory",
    "state_columns",
]
