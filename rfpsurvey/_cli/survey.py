"""The command ``rfpsurvey survey``."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import rfpsurvey as rs
from rfpsurvey._cli import _app, _conditions, _examples, _groups, _surveys
from rfpsurvey._cli._command import Given, command
from rfpsurvey._cli._keys import Part


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
    plot: Path | None = None
    quality: Path | None = None


@dataclass(frozen=True, kw_only=True)
class SurveyKeys(_groups.WorkerKeys):
    """The keys of the command."""

    catalog: _groups.SurveyCatalogKeys
    instrument: _groups.InstrumentKeys
    tiles: _groups.TilesKeys
    options: _groups.SurveyOptions
    joint: Annotated[dict, Part(rs.JointOptions, omit=("allocator",))]
    rule: _groups.Rule
    conditions: _groups.Conditions
    output: SurveyOutputKeys
    order: _groups.Order = "color"
    cadences: _groups.CadenceTable = None
    epoch: _groups.Epoch = None
    lost_in_collision: _groups.Lost = True
    rng: _groups.Seed = 0


@command(
    SurveyKeys,
    "tiles.path instrument.name options.allocator options.constraints catalog.visits tiles.passes epoch "
    "catalog.columns output.folder output.resume output.replan workers rng output.plot output.report output.overwrite",
    argument="catalog.path",
    epilog=_examples.SURVEY_EXAMPLES,
)
def survey(keys: SurveyKeys, given: Given) -> None:
    """Plan the tiles of a survey so that as many targets as possible are observed the requested number of times."""
    _surveys.check_replan(keys)
    paths = keys.catalog.path, keys.tiles.path, keys.instrument.name, keys.instrument.broken, keys.cadences
    _app.check_outputs(keys.output, (*paths, keys.conditions.get("path")))
    tiling = _surveys.read_tiles(keys.tiles)
    model = _app.model_of(keys.instrument, lambda: _conditions.time_of_tiles(tiling, keys.epoch, keys.conditions))
    targets = _surveys.targets_of(keys, model)
    options = {
        "allocator": _app.allocator_of(keys.options, keys.joint),
        "visits": _surveys.visits_of(keys, targets),
        "passes": keys.tiles.passes,
        "epoch": keys.epoch,
        "lost_in_collision": keys.lost_in_collision,
        "order": keys.order,
        "folder": keys.output.folder,
        "resume": keys.output.resume or keys.output.replan,
        "rng": keys.rng,
    }
    tiling = _conditions.tiles_under(_surveys.tiles_of(tiling, targets, model), keys.conditions)
    with _app.seed_of(keys.catalog.path), _surveys.workers(keys) as executor:
        _surveys.run(targets, tiling, model, executor, options, keys.output, given)
