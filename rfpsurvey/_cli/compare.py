"""The command ``rfpsurvey compare``."""

import sys
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from textwrap import fill as wrap
from typing import Annotated

import astropy.units as u
import typer

import rfpsurvey as rs
from rfpsurvey._cli import _app, _examples, _main, _margins, _options, _states
from rfpsurvey._executors import released
from rfpsurvey._io import write_table
from rfpsurvey.allocation import DEFAULT_ALLOCATOR
from rfpsurvey.compare import COMPARED, parts_of
from rfpsurvey.errors import listed
from rfpsurvey.plot import draw_instruments


@_main.app.command(epilog=_examples.COMPARE_EXAMPLES)
def compare(
    instruments: Annotated[
        list[str] | None, typer.Argument(help="Names of presets, or paths of TOML files. By default, all presets.")
    ] = None,
    arm_model: _options.ArmModelOption = None,
    broken: _states.BrokenOption = None,
    state_time: _states.StateTimeOption = None,
    margins: _margins.MarginsOption = None,
    catalog: Annotated[
        Path | None,
        typer.Option(
            help="Catalog for all instruments, a file or example:anticenter. By default, synthetic Poisson "
            "targets are used."
        ),
    ] = None,
    center: _options.CenterOption = None,
    pa: _options.PaOption = 0.0,
    epoch: _options.EpochOption = None,
    targets: Annotated[
        float | None, typer.Option(help="Number of synthetic targets per positioner. By default, 1.")
    ] = None,
    density: Annotated[
        float | None, typer.Option(help="Number of synthetic targets per deg2, in place of --targets.")
    ] = None,
    realizations: Annotated[
        int | None, typer.Option(help="Number of synthetic fields per instrument. By default, 4.")
    ] = None,
    allocator: Annotated[
        list[str] | None,
        typer.Option(help=f"Allocator; may be repeated. By default, the allocators {listed(COMPARED)} are used."),
    ] = None,
    require: _options.RequireOption = None,
    required: _options.RequiredOption = None,
    keep_out: _options.KeepOutOption = None,
    sky_separation: _options.SkyOption = None,
    time_limit: _options.TimeLimitOption = 60.0,
    seed: _options.SeedOption = 0,
    workers: _options.WorkersOption = 1,
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
    """Compare the patrol areas, fibers and collisions of instruments, and the targets lost to collisions."""
    _app.check_outputs(output, plot, report, overwrite=overwrite, inputs=(*(instruments or ()), catalog, broken))
    if broken is not None and len(instruments or ()) != 1:
        raise rs.InputError(
            "--broken must be used with one instrument, because instruments have different identifiers; to compare "
            "several instruments, write TOML files with the entry layout.states"
        )
    models = [
        _app.model_of(name, arm_model, broken, state_time, lambda: _states.time_of(None, epoch), margins)
        for name in instruments or (rs.available_instruments() if arm_model or margins else ())
    ]
    if catalog is None:
        _app.warn_without_catalog(column=column, unit=unit, frame=frame, fill=fill, hdu=hdu)
    options = _app.allocation_options(
        DEFAULT_ALLOCATOR, require, sky_separation, time_limit, required=required, keep_out=keep_out
    )
    with released(ThreadPoolExecutor(workers)) as pool:
        table = rs.compare_instruments(
            "poisson" if catalog is None else _app.read_catalog(catalog, column, unit, frame, fill, hdu=hdu),
            models or None,
            center=_app.parse_center(center),
            allocators=allocator or COMPARED,
            targets_per_positioner=targets,
            density=None if density is None else density / u.deg**2,
            n_realizations=realizations,
            rng=seed,
            executor=pool if workers > 1 else None,
            progress=sys.stderr.isatty(),
            options=options,
            position_angle=pa * u.deg,
            epoch=epoch,
        )
    with _app.files(
        overwrite=overwrite,
        output=(output, partial(write_table, table)),
        plot=(plot, lambda: draw_instruments(table)),
        report=(report, table, {"data": output}),
    ):
        print(table.meta["way"])
        for name, model in ({} if margins is None else table.meta["instruments"]).items():
            values = ", ".join(f"{key} {value:g}" for key, value in model.get("margins", {}).items())
            print(f"margins of {name}: {values or 'none'}")
        for title, part in parts_of(table).items():
            print(f"\n{title}")
            _app.print_table(part)
        print(f"\n{wrap(table.meta['comparable'], 100)}")
