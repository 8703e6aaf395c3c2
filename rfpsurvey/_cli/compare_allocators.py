"""The command ``rfpsurvey compare-allocators``."""

from pathlib import Path
from typing import Annotated

import astropy.units as u
import typer

import rfpsurvey as rs
from rfpsurvey._cli import _app, _examples, _main, _margins, _options, _states
from rfpsurvey.allocation import DEFAULT_ALLOCATOR
from rfpsurvey.tile import north_of_date


@_main.app.command(epilog=_examples.COMPARE_ALLOCATORS_EXAMPLES)
def compare_allocators(
    catalog: _options.CatalogArgument = None,
    instrument: _options.InstrumentOption = "lamost",
    arm_model: _options.ArmModelOption = None,
    broken: _states.BrokenOption = None,
    state_time: _states.StateTimeOption = None,
    margins: _margins.MarginsOption = None,
    center: _options.CenterOption = None,
    pa: _options.PaOption = 0.0,
    equinox: _options.EquinoxOption = None,
    epoch: _options.EpochOption = None,
    allocator: Annotated[
        list[str] | None,
        typer.Option(help="Allocator to compare; may be repeated. By default, all allocators are compared."),
    ] = None,
    require: _options.RequireOption = None,
    required: _options.RequiredOption = None,
    keep_out: _options.KeepOutOption = None,
    sky_separation: _options.SkyOption = None,
    objective: _options.ObjectiveOption = "priority",
    time_limit: _options.TimeLimitOption = 60.0,
    seed: _options.SeedOption = 0,
    subpriority: _options.SubpriorityOption = None,
    parked: _options.ParkedOption = True,
    hdu: _options.HduOption = None,
    column: _options.ColumnOption = None,
    unit: _options.UnitOption = None,
    frame: _options.FrameOption = "icrs",
    fill: _options.FillOption = None,
    output: Annotated[Path | None, typer.Option(help="Write the table (.fits or .ecsv).")] = None,
    plot: _options.ChartOption = None,
    report: _options.ReportOption = None,
    overwrite: _options.OverwriteOption = False,
) -> None:
    """Compare allocators on the same field."""
    _app.check_outputs(output, plot, report, overwrite=overwrite, inputs=(catalog, instrument, broken))
    model = _app.model_of(instrument, arm_model, broken, state_time, lambda: _states.time_of(None, epoch), margins)
    targets, field = _app.targets_and_center(catalog, center, model, seed, column, unit, frame, fill, hdu=hdu)
    options = _app.allocation_options(
        DEFAULT_ALLOCATOR,
        require,
        sky_separation,
        time_limit,
        objective=objective,
        parked=parked,
        required=required,
        keep_out=keep_out,
        subpriority=subpriority,
    )
    with _app.seed_of(catalog):
        table, plans = rs.compare_allocators(
            targets,
            model,
            north_of_date(field, equinox),
            allocators=allocator,
            options=options,
            return_tiles=True,
            position_angle=pa * u.deg,
            epoch=epoch,
            rng=seed,
        )
    _app.finish_comparison(table, plans, output, plot, report, overwrite=overwrite)
