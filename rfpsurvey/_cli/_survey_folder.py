"""The survey in a folder that the command ``survey`` wrote, and its state."""

from pathlib import Path

import rfpsurvey as rs
from rfpsurvey._cli import _app, _plan_file, _surveys
from rfpsurvey._cli._keys import build, keys_of
from rfpsurvey._cli.survey import SurveyKeys
from rfpsurvey.survey import SurveyState, VisitRule

__all__ = ["survey_and_state"]


def survey_and_state(folder: Path, until: str | None) -> "tuple[rs.Survey, SurveyState]":
    """Return the survey in a folder, and its state, for the catalog and the rule in its plan file."""
    survey, values = rs.Survey.read(folder), {}
    _plan_file.add_file(keys_of(SurveyKeys), values, _plan_file.survey_folder(folder) / _plan_file.RECORD)
    keys = build(SurveyKeys, values)
    model = _app.model_of(keys.instrument) if keys.catalog.path is None else None
    targets = _surveys.targets_of(keys.catalog, model, keys.rng)
    rule = VisitRule(**keys.rule)
    return survey, SurveyState.read(folder, targets, rule=rule, visits=keys.catalog.visits, until=until)
