"""The command ``rfpsurvey select``."""

from time import perf_counter

import rfpsurvey as rs
from rfpsurvey._cli import _app, _main, _margins, _options, _process, _selections, _states, _surveys, _tiles
from rfpsurvey._outputs import check_output, check_separate
from rfpsurvey.allocation import DEFAULT_ALLOCATOR


@_main.app.command(epilog=_selections.SELECT_EXAMPLES)
def select(
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
    realizations: _selections.RealizationsOption = 128,
    allocator: _selections.SelectAllocatorOption = DEFAULT_ALLOCATOR,
    visits: _options.VisitsOption = None,
    passes: _options.SomePassesOption = None,
    epoch: _options.EpochOption = None,
    require: _options.RequireOption = None,
    required: _options.RequiredOption = None,
    keep_out: _options.KeepOutOption = None,
    sky_separation: _options.SkyOption = None,
    time_limit: _options.TimeLimitOption = 60.0,
    parked: _options.ParkedOption = True,
    lost: _options.LostOption = True,
    order: _options.OrderOption = "color",
    output: _selections.SelectOutputOption = None,
    folder: _selections.SelectFolderOption = None,
    resume: _selections.SelectResumeOption = False,
    workers: _options.WorkersOption = 1,
    processes: _options.ProcessesOption = False,
    scheduler: _options.SchedulerOption = None,
    seed: _options.SeedOption = 0,
    hdu: _options.HduOption = None,
    column: _options.ColumnOption = None,
    unit: _options.UnitOption = None,
    frame: _options.FrameOption = "icrs",
    fill: _options.FillOption = None,
    overwrite: _options.OverwriteOption = False,
) -> None:
    """Plan a survey many times with random subpriorities, and write the probability that each target is observed."""
    if output is not None:
        check_separate([output, folder and folder / "selection.fits"], (catalog, tiles, instrument, broken))
        check_output(output, (".fits",), overwrite=overwrite)
    tiling = _tiles.read_tiles(tiles, tiles_column, tiles_unit, tiles_hdu)
    model = _app.model_of(
        instrument, arm_model, broken, state_time, lambda: _states.time_of_tiles(tiling, epoch), margins
    )
    targets = _surveys.targets_of(catalog, model, seed, column, unit, frame, fill, None, hdu)
    if visits is not None:
        targets = _selections.with_visits(targets, visits)
    options = {
        "allocator": _app.allocation_options(
            allocator, require, sky_separation, time_limit, parked=parked, required=required, keep_out=keep_out
        ),
        "passes": passes,
        "epoch": epoch,
        "lost_in_collision": lost,
        "order": order,
        "folder": folder,
        "resume": resume,
        "rng": seed,
    }
    tiling = _surveys.tiles_of(tiling, targets, model)
    begin = perf_counter()
    kept = (
        "the checkpoints are stored in the folder; continue with --resume"
        if folder
        else "no results were stored, because --folder was not given"
    )
    _process.tell_if_interrupted(kept)
    with _surveys.workers(workers, scheduler, processes=processes) as executor:
        found = rs.selection_probabilities(
            targets, model, tiling, realizations, executor=executor, progress=True, **options
        )
    if output is not None:
        found.write(output, overwrite=overwrite)
    _selections.print_selection(found, allocator, perf_counter() - begin)
    for path in (output, None if folder is None else folder / "selection.fits"):
        if path is not None:
            print(f"wrote {path}")
