"""The commands ``rfpsurvey select`` and ``potential``."""

import sys
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Annotated

import astropy.units as u
import numpy as np

import rfpsurvey as rs
from rfpsurvey._cli import command as _app
from rfpsurvey._cli import process as _process
from rfpsurvey._cli import results as _results
from rfpsurvey._cli.command import command
from rfpsurvey._cli.survey import values_of
from rfpsurvey._common.files import WRITABLE, check_output, check_separate
from rfpsurvey._common.io import write_table
from rfpsurvey._common.settings import option
from rfpsurvey._survey import key_groups, key_objects
from rfpsurvey._survey.key_objects import Given, read_tiles
from rfpsurvey._survey.key_types import Part, build
from rfpsurvey._survey.plan_file import SurveyKeys, allocator_of, state_in, targets_of, tiles_of
from rfpsurvey._survey.selection.probabilities import selection_facts
from rfpsurvey.errors import number_of


@dataclass(frozen=True)
class SelectOutputKeys(key_groups.OutputKeys):
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
class SelectKeys(key_groups.WorkerKeys):
    """The keys of the command.

    Parameters
    ----------
    n_realizations : int, optional
        Number of realizations. A multiple of 64 is best, since each integer of the output stores 64 realizations.
    """

    catalog: key_groups.SurveyCatalogKeys
    instrument: key_groups.InstrumentKeys
    tiles: key_groups.TilesKeys
    options: key_groups.SurveyOptions
    joint: Annotated[dict, Part(rs.JointOptions, omit=("allocator",))]
    output: SelectOutputKeys
    n_realizations: int = option(128, low=1)
    order: key_groups.Order = "color"
    epoch: key_groups.Epoch = None
    lost_in_collision: key_groups.Lost = True
    rng: key_groups.Seed = 0


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
    tiling = read_tiles(keys.tiles, tell=_results.tell)
    model = _app.model_of(keys.instrument, lambda: key_objects.time_of_tiles(tiling, keys.epoch, {}))
    of_catalog = keys if survey is None else replace(survey, catalog=keys.catalog, options=keys.options)
    targets = targets_of(of_catalog, model, tell=_results.tell)
    if survey is not None:
        visits = {} if keys.catalog.visits is None else {"visits": keys.catalog.visits}
        targets = state_in(place, catalog=targets, **visits)
    elif keys.catalog.visits is not None:
        targets = _with_visits(targets, keys.catalog.visits)
    options = _results.options_of(keys) | {"allocator": allocator_of(keys.options, keys.joint)}
    tiling = tiles_of(tiling, targets if survey is None else targets.first, model)
    tiling = tiling if survey is None else key_objects.tiles_under(tiling, survey.conditions)
    begin = perf_counter()
    kept = "the checkpoints are stored in the folder; continue with --resume"
    _process.tell_if_interrupted(kept if folder else "no results were stored, because --folder was not given")
    with _results.workers(keys) as executor:
        selection = rs.selection_probabilities(
            targets, model, tiling, keys.n_realizations, executor=executor, progress=True, **options
        )
    seconds = perf_counter() - begin
    with _results.files(
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
    _results.print_model(selection.provenance["instrument"]["name"], allocator, s, selection.provenance["parameters"])
    _results.print_facts(selection_facts(selection))
    plans = s["n_tiles"] * s["n_realizations"]
    _results.tell(f"computing time {seconds:.1f} s, {1e3 * seconds / plans:.2f} ms per tile and realization")


@dataclass(frozen=True)
class PotentialOutputKeys:
    """The files that the command writes.

    Parameters
    ----------
    path : Path, optional
        Write all pairs of a positioner and a point in reach, with the tile of each pair (.fits), or the random catalog
        (.fits, .ecsv or .parquet).
    overwrite : bool, optional
        Replace existing files.
    """

    path: Path | None = None
    overwrite: bool = False


@dataclass(frozen=True, kw_only=True)
class PotentialKeys(key_groups.WorkerKeys):
    """The keys of the command.

    Parameters
    ----------
    survey : Path, optional
        Folder of a survey that was planned with these tiles. In each tile, positioners whose target is lost to a
        collision reach no point. Without a table of tiles, the tiles of the survey are used.
    density : float, optional
        Instead of the points of a catalog, draw this number of random points per deg2. The catalog contains the targets
        of the survey, and the output contains the points in reach, with the completeness of the survey.
    veto : list[Region], optional
        With density: regions without points, such as 'cap 95.1 23.2 0.05' (deg).
    """

    catalog: key_groups.CatalogKeys
    instrument: key_groups.InstrumentKeys
    tiles: key_groups.TilesKeys
    output: PotentialOutputKeys
    survey: Path | None = None
    density: float | None = None
    veto: list[rs.Region] | None = None
    epoch: key_groups.Epoch = None
    rng: key_groups.Seed = 0


@command(
    PotentialKeys,
    "tiles.path instrument.name survey density veto tiles.passes epoch workers rng catalog.columns output.path "
    "output.overwrite",
    argument="catalog.path",
)
def potential(keys: PotentialKeys, _: Given) -> None:
    r"""Find the tiles and positioners that reach each point of a catalog of random points.

    Examples
    --------
    rfpsurvey potential random.fits --instrument desi --tiles tiles.ecsv \
        --output potential.fits
    rfpsurvey potential random.fits --instrument desi --survey plan \
        --workers 2 --output potential.fits
    rfpsurvey potential targets.fits --instrument desi --survey plan \
        --density 2500 --veto "cap 95.1 23.2 0.05" --output random.fits
    """
    output = keys.output.path
    if output is not None:
        paths = keys.catalog.path, keys.tiles.path, keys.instrument.name, keys.instrument.broken, keys.survey
        check_separate([output], paths)
        check_output(output, (".fits",) if keys.density is None else WRITABLE, overwrite=keys.output.overwrite)
    if keys.veto and keys.density is None:
        raise rs.InputError("veto must be used with --density, which is the number of random points per deg2")
    survey, tiles = None, keys.tiles
    if keys.survey is not None:
        survey = rs.Survey.read(keys.survey)
        tiles = tiles if tiles.path else replace(tiles, path=keys.survey / "tiles.fits")
    tiling = read_tiles(tiles, tell=_results.tell)
    model = _app.model_of(keys.instrument, lambda: key_objects.time_of_tiles(tiling, keys.epoch, {}))
    points = targets_of(keys, model, tell=_results.tell)
    tiling = tiles_of(tiling, points, model)
    if keys.density is not None:
        _draw(keys, points, model, tiling, survey)
        return
    options = {"passes": tiles.passes, "epoch": keys.epoch, "survey": survey, "progress": True}
    begin = perf_counter()
    _process.tell_if_interrupted("no results were stored")
    with _results.workers(keys) as executor:
        potential_pairs = rs.selection.potential_assignments(points, model, tiling, executor=executor, **options)
        n_tiles = potential_pairs.n_tiles()
        written = None if output is None else potential_pairs.write(output, overwrite=keys.output.overwrite)
    print(f"{model.name}, {number_of(len(potential_pairs), 'tile')}, {number_of(len(n_tiles), 'point')}")
    numbers = enumerate(np.bincount(n_tiles).tolist())
    _results.print_facts({f"points in reach in {number_of(n, 'tile')}": number for n, number in numbers if number})
    _results.print_facts({"mean number of tiles per point": n_tiles.mean()})
    print(f"computing time {perf_counter() - begin:.1f} s")
    if written is not None:
        print(f"wrote {output}: {number_of(written, 'pair')} of a positioner and a point")


def _draw(keys: PotentialKeys, targets, model: "rs.Instrument", tiling: "rs.Tiling", survey) -> None:
    """Draw a random catalog, write it, and print its numbers."""
    if keys.tiles.passes:
        tiling = rs.Tiling(tiling.table[np.isin(tiling.table["pass"], keys.tiles.passes)])
    options = {"density": keys.density / u.deg**2, "survey": survey, "veto": keys.veto or (), "rng": keys.rng}
    with _results.workers(keys) as executor:
        table = rs.selection.random_catalog(
            targets, model, tiling, executor=executor, progress=sys.stderr.isatty(), **options
        )
    with _results.files(keys.output, write=partial(write_table, table)):
        labels = {"n_drawn": "points drawn", "n_vetoed": "vetoed", "n_out_of_reach": "out of reach"}
        facts = {label: table.meta[name] for name, label in labels.items()} | {"points": len(table)}
        if survey is not None:
            facts["mean completeness"] = float(table["completeness"].mean())
        _results.print_facts(facts)
