"""The survey in a folder that the command ``survey`` wrote, and its state."""

from pathlib import Path

import rfpsurvey as rs
from rfpsurvey._cli import _app, _plan_file, _surveys
from rfpsurvey._cli._keys import build, keys_of
from rfpsurvey._cli.survey import SurveyKeys
from rfpsurvey.instrument import as_instrument
from rfpsurvey.survey import SurveyState, VisitRule

__all__ = ["state_of", "survey_and_state", "values_of"]


def values_of(path: Path | None) -> dict | None:
    """Return the values of the keys in the plan file of a survey, or None if the path is not the folder of a survey."""
    folder = None if path is None else _plan_file.survey_folder(path)
    if folder is None:
        return None
    values: dict = {}
    _plan_file.add_file(keys_of(SurveyKeys), values, folder / _plan_file.RECORD)
    return values


def state_of(folder: Path, keys: SurveyKeys, targets, until: str | None = None) -> SurveyState:
    """Return the state of the survey in a folder, for its keys and its targets."""
    return SurveyState.read(folder, targets, rule=VisitRule(**keys.rule), visits=keys.catalog.visits, until=until)


def survey_and_state(folder: Path, until: str | None) -> "tuple[rs.Survey, SurveyState]":
    """Return the survey in a folder, and its state, for the catalog and the rule in its plan file."""
    survey = rs.Survey.read(folder)
    keys = build(SurveyKeys, values_of(folder))
    model = _app.model_of(keys.instrument) if keys.catalog.path is None else as_instrument(keys.instrument.name)
    return survey, state_of(folder, keys, _surveys.targets_of(keys, model), until)
