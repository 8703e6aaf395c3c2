"""The command ``rfpsurvey potential``."""

from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter

import numpy as np

import rfpsurvey as rs
from rfpsurvey import inputs
from rfpsurvey._cli import _app, _print, _process, _surveys
from rfpsurvey._cli._command import Given, command
from rfpsurvey._outputs import check_output, check_separate
from rfpsurvey.errors import number_of
from rfpsurvey.survey import read_tiles, targets_of, tiles_of


@dataclass(frozen=True)
class PotentialOutputKeys:
    """The files that the command writes.

    Parameters
    ----------
    path : Path, optional
        Write all pairs of a positioner and a point in reach, with the tile of each pair (.fits).
    overwrite : bool, optional
        Replace existing files.
    """

    path: Path | None = None
    overwrite: bool = False


@dataclass(frozen=True, kw_only=True)
class PotentialKeys(inputs.WorkerKeys):
    """The keys of the command.

    Parameters
    ----------
    survey : Path, optional
        Folder of a survey that was planned with these tiles. In each tile, positioners whose target is lost to a
        collision reach no point. Without a table of tiles, the tiles of the survey are used.
    """

    catalog: inputs.CatalogKeys
    instrument: inputs.InstrumentKeys
    tiles: inputs.TilesKeys
    output: PotentialOutputKeys
    survey: Path | None = None
    epoch: inputs.Epoch = None
    rng: inputs.Seed = 0


@command(
    PotentialKeys,
    "tiles.path instrument.name survey tiles.passes epoch workers rng catalog.columns output.path output.overwrite",
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
    """
    output = keys.output.path
    if output is not None:
        paths = keys.catalog.path, keys.tiles.path, keys.instrument.name, keys.instrument.broken, keys.survey
        check_separate([output], paths)
        check_output(output, (".fits",), overwrite=keys.output.overwrite)
    survey, tiles = None, keys.tiles
    if keys.survey is not None:
        survey = rs.Survey.read(keys.survey)
        tiles = tiles if tiles.path else replace(tiles, path=keys.survey / "tiles.fits")
    tiling = read_tiles(tiles, tell=_print.print_text)
    model = _app.model_of(keys.instrument, lambda: inputs.time_of_tiles(tiling, keys.epoch, {}))
    points = targets_of(keys, model, tell=_print.print_text)
    tiling = tiles_of(tiling, points, model)
    options = {"passes": tiles.passes, "epoch": keys.epoch, "survey": survey, "progress": True}
    begin = perf_counter()
    _process.tell_if_interrupted("no results were stored")
    with _surveys.workers(keys) as executor:
        potential_pairs = rs.selection.potential_assignments(points, model, tiling, executor=executor, **options)
        n_tiles = potential_pairs.n_tiles()
        written = None if output is None else potential_pairs.write(output, overwrite=keys.output.overwrite)
    print(f"{model.name}, {number_of(len(potential_pairs), 'tile')}, {number_of(len(n_tiles), 'point')}")
    numbers = enumerate(np.bincount(n_tiles).tolist())
    _print.print_facts({f"points in reach in {number_of(n, 'tile')}": number for n, number in numbers if number})
    _print.print_facts({"mean number of tiles per point": n_tiles.mean()})
    print(f"computing time {perf_counter() - begin:.1f} s")
    if written is not None:
        print(f"wrote {output}: {number_of(written, 'pair')} of a positioner and a point")
