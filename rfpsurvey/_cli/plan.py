"""The command ``rfpsurvey plan``."""

import sys

import astropy.units as u
import typer

import rfpsurvey as rs
from rfpsurvey._cli import _app, _conditions, _examples, _main, _margins, _options, _states
from rfpsurvey.allocation import DEFAULT_ALLOCATOR, end_on_interrupt
from rfpsurvey.tile import north_of_date


@_main.app.command(epilog=_examples.PLAN_EXAMPLES)
def plan(
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
    allocator: _options.AllocatorOption = DEFAULT_ALLOCATOR,
    conditions: _conditions.ConditionsOption = None,
    site: _conditions.SiteOption = None,
    time: _conditions.TimeOption = None,
    hour_angle: _conditions.HourAngleOption = None,
    wavelength: _conditions.WavelengthOption = None,
    exposure_time: _conditions.ExposureOption = None,
    projection: _conditions.ProjectionOption = None,
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
    keep: _options.KeepOption = None,
    fill: _options.FillOption = None,
    output: _options.OutputOption = None,
    plot: _options.PlotOption = None,
    targets: _options.TargetsOption = None,
    quality: _options.QualityOption = None,
    report: _options.ReportOption = None,
    overwrite: _options.OverwriteOption = False,
) -> None:
    """Assign the targets of a field to fibers, and find the arms that collide."""
    _app.check_outputs(
        output, plot, report, quality, overwrite=overwrite, inputs=(catalog, instrument, broken, conditions)
    )
    _app.check_targets(targets, plot)
    seen = _conditions.conditions_of(conditions, site, time, hour_angle, wavelength, exposure_time)
    model = _app.model_of(instrument, arm_model, broken, state_time, lambda: _states.time_of(seen, epoch), margins)
    sky, field = _app.targets_and_center(catalog, center, model, seed, column, unit, frame, fill, keep, hdu)
    if field is None and equinox is not None:
        field = sky.mean_direction
    _app.check_targets(targets, plot, sky)
    options = _app.allocation_options(
        allocator,
        require,
        sky_separation,
        time_limit,
        objective=objective,
        parked=parked,
        required=required,
        keep_out=keep_out,
        subpriority=subpriority,
    )
    _app.check_text(sky, model, field, output)
    with _app.seed_of(catalog), end_on_interrupt() as interrupted:
        tile = rs.plan_tile(
            sky,
            model,
            north_of_date(field, equinox),
            position_angle=pa * u.deg,
            epoch=epoch,
            allocator=options,
            conditions=seen,
            projection=projection,
            progress=options.method.searches and sys.stderr.isatty(),
            rng=seed,
        )
        ended_early = interrupted.is_set()
    if ended_early:
        print(
            "rfpsurvey: interrupted; the output is the best plan that was found before the interruption",
            file=sys.stderr,
        )
    _app.finish(tile, output, plot, report, overwrite=overwrite, targets=targets, quality=quality)
    if ended_early:
        raise typer.Exit(130)
