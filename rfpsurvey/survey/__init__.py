"""Whole surveys: tile after tile, until targets are observed as often as they are wanted."""

from rfpsurvey.survey._plan import plan_survey
from rfpsurvey.survey._survey import Survey

__all__ = ["Survey", "plan_survey"]
