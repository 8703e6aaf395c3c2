"""``rfpsurvey plan``."""

from pathlib import Path
from typing import Annotated

import astropy.units as u
import typer

import rfpsurvey as rs
from rfpsurvey._cli import _app, _options


@_app.app.command(epilog=_options.PLAN_EXAMPLES)
def plan(
    catalog: Annotated[
        Path | None, typer.Argument(help="FITS, ECSV, CSV, VOTable or Parquet. None: a synthetic Poisson catalog.")
    ] = None,
    instrument: _options.InstrumentOption = "lamost",
    center: Annotated[str | None, typer.Option(help="Field center, ICRS. None: the middle of the catalog.")] = None,
    pa: Annotated[float, typer.Option(help="Position angle of +y, deg from north to east.")] = 0.0,
    equinox: _options.EquinoxOption = None,
    epoch: _options.EpochOption = None,
    allocator: Annotated[str, typer.Option(help="lamost, or balanced (which does not look at priorities).")] = "lamost",
    seed: Annotated[int, typer.Option(help="Seed of random numbers.", min=0)] = 0,
    parked: _options.ParkedOption = True,
    column: _options.ColumnOption = None,
    unit: _options.UnitOption = None,
    frame: Annotated[str, typer.Option(help="Frame of the catalog's coordinates.")] = "icrs",
    output: _options.OutputOption = None,
    plot: _options.PlotOption = None,
    overwrite: _options.OverwriteOption = False,
) -> None:
    """Assign one field and find the arms that collide."""
    _app.check_outputs(output, plot, overwrite=overwrite)
    model = _app.load_instrument(instrument)
    targets, field = _app.targets_and_center(catalog, center, model, seed, column, unit, frame)
    options = {"position_angle": pa * u.deg, "equinox": equinox, "epoch": epoch, "parked_obstacles": parked}
    tile = rs.plan_tile(targets, model, field, allocator=allocator, rng=seed, **options)
    _app.finish(tile, output, plot, overwrite=overwrite)
