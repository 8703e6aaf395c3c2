"""``rfpsurvey tile``."""

import rfpsurvey as rs
from rfpsurvey._cli import _app, _options
from rfpsurvey.instrument import as_instrument


@_app.app.command(epilog=_options.TILE_EXAMPLES)
def tile(
    catalog: _options.CatalogArgument = None,
    region: _options.RegionOption = None,
    instrument: _options.InstrumentOption = "lamost",
    method: _options.TilingMethodOption = "hexagonal",
    passes: _options.PassesOption = 1,
    completeness: _options.CompletenessOption = None,
    fibers: _options.FibersOption = None,
    n_tiles: _options.NTilesOption = None,
    visits: _options.VisitsOption = None,
    seed: _options.SeedOption = 0,
    column: _options.ColumnOption = None,
    unit: _options.UnitOption = None,
    frame: _options.FrameOption = "icrs",
    fill: _options.FillOption = None,
    output: _options.TilingOutputOption = None,
    plot: _options.TilingPlotOption = None,
    report: _options.ReportOption = None,
    overwrite: _options.OverwriteOption = False,
) -> None:
    """Decide where the tiles of a survey go."""
    _app.check_outputs(output, plot, report, overwrite=overwrite)
    model = as_instrument(instrument)
    if region is not None and catalog is not None:
        raise rs.InputError("give a catalog or --region, not both")
    if region is not None:
        field = rs.Region.parse(region)
    else:
        field, _ = _app.targets_and_center(catalog, None, model, seed, column, unit, frame, fill)
    options = {"passes": passes, "completeness": completeness, "fibers": fibers, "n_tiles": n_tiles, "rng": seed}
    options["visits"] = visits
    tiling = rs.place_tiles(field, model, method=method, **options)
    _app.finish_tiling(tiling, field, output, plot, report, overwrite=overwrite)
