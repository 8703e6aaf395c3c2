"""The command ``rfpsurvey survey``."""

from rfpsurvey._cli import _app, _conditions, _examples, _joint, _main, _margins, _options, _states, _surveys, _tiles
from rfpsurvey.allocation import DEFAULT_ALLOCATOR


@_main.app.command(epilog=_examples.SURVEY_EXAMPLES)
def survey(
    catalog: _options.SurveyCatalogArgument = None,
    tiles: _tiles.TilesOption = None,
    tiles_hdu: _tiles.TilesHduOption = None,
    tiles_column: _tiles.TilesColumnOption = None,
    tiles_unit: _tiles.TilesUnitOption = None,
    instrument: _options.InstrumentOption = "lamost",
    arm_model: _options.ArmModelOption = None,
    broken: _states.BrokenOption = None,
    state_time: _states.StateTimeOption = None,
    margins: _margins.MarginsOption = None,
    allocator: _options.AllocatorOption = DEFAULT_ALLOCATOR,
    visits: _options.VisitsOption = None,
    passes: _options.SomePassesOption = None,
    epoch: _options.EpochOption = None,
    conditions: _conditions.ConditionsOption = None,
    site: _conditions.SiteOption = None,
    time: _conditions.TilesTimeOption = None,
    hour_angle: _conditions.TilesHourAngleOption = None,
    wavelength: _conditions.WavelengthOption = None,
    exposure_time: _conditions.ExposureOption = None,
    require: _options.RequireOption = None,
    required: _options.RequiredOption = None,
    keep_out: _options.KeepOutOption = None,
    sky_separation: _options.SkyOption = None,
    time_limit: _options.TimeLimitOption = 60.0,
    subpriority: _options.SubpriorityOption = None,
    parked: _options.ParkedOption = True,
    lost: _options.LostOption = True,
    order: _options.OrderOption = "color",
    joint_gap: _joint.GapOption = None,
    joint_iterations: _joint.IterationsOption = None,
    joint_time: _joint.JointTimeOption = None,
    fixed: _joint.FixedOption = None,
    folder: _options.FolderOption = None,
    resume: _options.ResumeOption = False,
    workers: _options.WorkersOption = 1,
    processes: _options.ProcessesOption = False,
    scheduler: _options.SchedulerOption = None,
    seed: _options.SeedOption = 0,
    hdu: _options.HduOption = None,
    column: _options.ColumnOption = None,
    unit: _options.UnitOption = None,
    frame: _options.FrameOption = "icrs",
    keep: _options.KeepOption = None,
    fill: _options.FillOption = None,
    plot: _options.SurveyPlotOption = None,
    quality: _options.SurveyQualityOption = None,
    report: _options.ReportOption = None,
    overwrite: _options.OverwriteOption = False,
) -> None:
    """Plan the tiles of a survey so that as many targets as possible are observed the requested number of times."""
    _app.check_outputs(
        None, plot, report, quality, overwrite=overwrite, inputs=(catalog, tiles, instrument, broken, conditions)
    )
    seen = conditions, site, time, hour_angle, wavelength, exposure_time
    tiling = _tiles.read_tiles(tiles, tiles_column, tiles_unit, tiles_hdu)
    model = _app.model_of(
        instrument, arm_model, broken, state_time, lambda: _states.time_of_tiles(tiling, epoch, *seen), margins
    )
    targets = _surveys.targets_of(catalog, model, seed, column, unit, frame, fill, keep, hdu)
    options = {
        "allocator": _app.allocation_options(
            allocator,
            require,
            sky_separation,
            time_limit,
            parked=parked,
            required=required,
            keep_out=keep_out,
            subpriority=subpriority,
        ),
        "visits": visits,
        "passes": passes,
        "epoch": epoch,
        "lost_in_collision": lost,
        "order": _joint.joint_order(order, joint_gap, joint_iterations, joint_time, fixed),
        "folder": folder,
        "resume": resume,
        "rng": seed,
    }
    tiling = _surveys.tiles_of(tiling, targets, model)
    tiling = _conditions.tiles_under(tiling, *seen)
    with _app.seed_of(catalog), _surveys.workers(workers, scheduler, processes=processes) as executor:
        _surveys.run(targets, tiling, model, executor, options, plot, quality, report, overwrite=overwrite)
