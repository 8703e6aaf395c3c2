"""Surveys of many tiles, which observe each target the requested number of times."""

from rfpsurvey.survey._joint import JointOptions
from rfpsurvey.survey._plan import plan_survey
from rfpsurvey.survey._survey import Survey

__all__ = ["JointOptions", "Survey", "plan_survey"]
