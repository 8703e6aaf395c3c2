"""The command ``rfpsurvey select``."""

from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import Annotated

import numpy as np

import rfpsurvey as rs
from rfpsurvey import inputs
from rfpsurvey._cli import _app, _print, _process, _surveys
from rfpsurvey._cli._command import Given, command
from rfpsurvey._cli.survey import values_of
from rfpsurvey._outputs import check_separate
from rfpsurvey._settings import option
from rfpsurvey.inputs import Part, build
from rfpsurvey.selection import selection_facts
from rfpsurvey.survey import SurveyKeys, allocator_of, read_tiles, state_in, targets_of, tiles_of


@dataclass(frozen=True)
class SelectOutputKeys(inputs.OutputKeys):
    """The files that the command writes.

    Parameters
    ----------
    path : Path, optional
        Write the selection probabilities, and the bits that record in which realizations each target is observed
        (.fits).
    folder : Path, optional
        Folder for checkpoints and for the result, selection.fits.
    resume : bool, optional
        Continue the unfinished computation in the folder.
    plot : Path, optional
        Plot a histogram of the selection probabilities (.png, .pdf or .svg).
    """

    path: Path | None = None
    folder: Path | None = None
    resume: bool = False


@dataclass(frozen=True, kw_only=True)
class SelectKeys(inputs.WorkerKeys):
    """The keys of the command.

    Parameters
    ----------
    n_realizations : int, optional
        Number of realizations. A multiple of 64 is best, since each integer of the output stores 64 realizations.
    """

    catalog: inputs.SurveyCatalogKeys
    instrument: inputs.InstrumentKeys
    tiles: inputs.TilesKeys
    options: inputs.SurveyOptions
    joint: Annotated[dict, Part(rs.JointOptions, omit=("allocator",))]
    output: SelectOutputKeys
    n_realizations: int = option(128, low=1)
    order: inputs.Order = "color"
    epoch: inputs.Epoch = None
    lost_in_collision: inputs.Lost = True
    rng: inputs.Seed = 0


@command(
    SelectKeys,
    "tiles.path instrument.name n_realizations options.allocator options.constraints catalog.visits epoch "
    "output.path output.folder output.resume workers rng catalog.columns output.plot output.report "
    "output.overwrite",
    argument="catalog.path",
)
def select(keys: SelectKeys, given: Given) -> None:
    r"""Plan a survey many times with random subpriorities, and write the probability that each target is observed.

    Examples
    --------
    rfpsurvey select --n-realizations 64 --output selection.fits
    rfpsurvey select galaxies.fits --instrument desi --tiles tiles.ecsv \
        --workers 2 --folder selection
    rfpsurvey select galaxies.fits --instrument desi --tiles tiles.ecsv \
        --workers 2 --folder selection --resume
    rfpsurvey select galaxies.fits --tiles tiles.ecsv --plot selection.png \
        --report selection.html
    rfpsurvey select galaxies.fits --tiles tiles.ecsv \
        --set lost_in_collision=false --output selection.fits
    rfpsurvey select survey_folder --output selection.fits
    """
    values = values_of(keys.catalog.path)
    survey = None if values is None else build(SurveyKeys, values)
    if survey is not None:  # the keys have the values of the survey, unless they are given
        values.pop("options.subpriority", None)  # each realization has its own subpriorities
        shared = {name: v for name, v in values.items() if name in given.keys and not name.startswith("output.")}
        asked = {name: v for name, v in given.values.items() if name != "catalog.path"}
        place, keys = keys.catalog.path, build(SelectKeys, shared | asked)
    output, folder = keys.output.path, keys.output.folder
    stored = folder and folder / "selection.fits"
    paths = keys.catalog.path, keys.tiles.path, keys.instrument.name, keys.instrument.broken
    check_separate([output, stored], paths)
    _app.check_outputs(keys.output, paths, (".fits",))
    tiling = read_tiles(keys.tiles, tell=_print.print_text)
    model = _app.model_of(keys.instrument, lambda: inputs.time_of_tiles(tiling, keys.epoch, {}))
    targets = targets_of(keys, model, tell=_print.print_text)
    if survey is not None:
        visits = {} if keys.catalog.visits is None else {"visits": keys.catalog.visits}
        targets = state_in(place, catalog=targets, **visits)
    elif keys.catalog.visits is not None:
        targets = _with_visits(targets, keys.catalog.visits)
    options = _surveys.options_of(keys) | {"allocator": allocator_of(keys.options, keys.joint)}
    tiling = tiles_of(tiling, targets if survey is None else targets.first, model)
    tiling = tiling if survey is None else inputs.tiles_under(tiling, survey.conditions)
    begin = perf_counter()
    kept = "the checkpoints are stored in the folder; continue with --resume"
    _process.tell_if_interrupted(kept if folder else "no results were stored, because --folder was not given")
    with _surveys.workers(keys) as executor:
        selection = rs.selection_probabilities(
            targets, model, tiling, keys.n_realizations, executor=executor, progress=True, **options
        )
    seconds = perf_counter() - begin
    with _print.files(
        keys.output,
        write=selection.write,
        draw=lambda: rs.plot.plot_selection(selection).figure,
        report=(selection, {"data": output or stored}),
    ):
        _print_selection(selection, selection.provenance["parameters"]["allocator"], seconds)
        if stored is not None:
            print(f"wrote {stored}")


def _with_visits(targets, visits: int):
    """Return a copy of a catalog in which every target requires the given number of visits."""
    if isinstance(targets, rs.catalog.PartitionedCatalog):
        raise rs.InputError("visits cannot be used with a partitioned catalog; add the column visits to the catalog")
    return replace(targets, visits=np.full(len(targets), visits))


def _print_selection(selection: "rs.SelectionProbabilities", allocator: str, seconds: float) -> None:
    """Print the summary of selection probabilities, one value per line."""
    s = selection.summary
    _print.print_model(selection.provenance["instrument"]["name"], allocator, s, selection.provenance["parameters"])
    _print.print_facts(selection_facts(selection))
    plans = s["n_tiles"] * s["n_realizations"]
    print(f"computing time {seconds:.1f} s, {1e3 * seconds / plans:.2f} ms per tile and realization")
