"""The command ``rfpsurvey survey``, and the survey in a folder that it wrote."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import rfpsurvey as rs
from rfpsurvey._cli import _app, _groups, _plan_file, _surveys
from rfpsurvey._cli._command import Given, command
from rfpsurvey._cli._keys import Part, build, keys_of
from rfpsurvey.instrument import as_instrument
from rfpsurvey.survey import SurveyState, VisitRule


@dataclass(frozen=True)
class SurveyOutputKeys(_groups.OutputKeys):
    """The files that the command writes.

    Parameters
    ----------
    folder : Path, optional
        Folder to which the finished tiles are written.
    resume : bool, optional
        Continue the survey in the folder, which is unfinished, or to which tiles are added after its own.
    replan : bool, optional
        Plan the rest of a survey, whose folder is given in place of the catalog, from the events that were recorded
        (rfpsurvey record). Observed tiles keep their plans. All options have the values of the first plan, unless
        they are given.
    plot : Path, optional
        Plot the tiles on the sky and the completeness (.png, .pdf or .svg).
    quality : Path, optional
        Plot the numbers of visits per priority class, of targets per outcome, and of fibers per kind of target (.png,
        .pdf or .svg).
    """

    folder: Path | None = None
    resume: bool = False
    replan: bool = False
    quality: Path | None = None


@dataclass(frozen=True, kw_only=True)
class SurveyKeys(_groups.WorkerKeys):
    """The keys of the command.

    Parameters
    ----------
    cadences : Path, optional
        Table of cadences; the catalog must have the column cadence, and the tiles the column time, date or mjd.
    """

    catalog: _groups.SurveyCatalogKeys
    instrument: _groups.InstrumentKeys
    tiles: _groups.TilesKeys
    options: _groups.SurveyOptions
    joint: Annotated[dict, Part(rs.JointOptions, omit=("allocator",))]
    rule: _groups.Rule
    conditions: _groups.Conditions
    output: SurveyOutputKeys
    order: _groups.Order = "color"
    cadences: Path | None = None
    epoch: _groups.Epoch = None
    lost_in_collision: _groups.Lost = True
    rng: _groups.Seed = 0


@command(
    SurveyKeys,
    "tiles.path instrument.name options.allocator options.constraints catalog.visits tiles.passes epoch "
    "catalog.columns output.folder output.resume output.replan workers rng output.plot output.report output.overwrite",
    argument="catalog.path",
)
def survey(keys: SurveyKeys, given: Given) -> None:
    r"""Plan the tiles of a survey so that as many targets as possible are observed the requested number of times.

    Examples
    --------
    rfpsurvey survey
    rfpsurvey survey stars.fits --tiles tiles.ecsv --visits 2 --workers 2 \
        --folder plan --report plan.html
    rfpsurvey survey stars.fits --tiles tiles.ecsv --visits 2 --workers 2 \
        --folder plan --resume
    rfpsurvey survey stars.fits --allocator repair \
        --constraint "required 4711" --constraint "keep_out 95.0 23.1 0.01"
    rfpsurvey survey stars.fits --allocator joint --set joint.time_limit=600 \
        --folder plan
    rfpsurvey survey stars.fits --tiles tiles.ecsv --visits 2 --folder plan \
        --write-plan plan.toml
    rfpsurvey survey plan.toml --workers 2
    rfpsurvey survey stars.fits --tiles tiles.ecsv --folder plan \
        --set rule.after_success=4 --set rule.retries=2
    rfpsurvey survey plan --replan --report rest.html
    rfpsurvey survey hats_catalog --tiles tiles.ecsv \
        --set scheduler=tcp://10.0.0.1:8786 --folder plan
    """
    _surveys.check_replan(keys)
    paths = keys.catalog.path, keys.tiles.path, keys.instrument.name, keys.instrument.broken, keys.cadences
    _app.check_outputs(keys.output, (*paths, keys.conditions.get("path")))
    tiling = _surveys.read_tiles(keys.tiles)
    model = _app.model_of(keys.instrument, lambda: _app.time_of_tiles(tiling, keys.epoch, keys.conditions))
    targets = _surveys.targets_of(keys, model)
    options = _surveys.options_of(keys) | {"resume": keys.output.resume or keys.output.replan}
    options["allocator"] = _app.allocator_of(keys.options, keys.joint)
    options["visits"] = _surveys.visits_of(keys, targets)
    tiling = _app.tiles_under(_surveys.tiles_of(tiling, targets, model), keys.conditions)
    with _app.seed_of(keys.catalog.path), _surveys.workers(keys) as executor:
        _surveys.run(targets, tiling, model, executor, options, keys.output, given)


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
