"""The command ``rfpsurvey tile``."""

import sys

import astropy.units as u

import rfpsurvey as rs
from rfpsurvey._cli import _app, _examples, _main, _margins, _options, _states


@_main.app.command(epilog=_examples.TILE_EXAMPLES)
def tile(
    catalog: _options.CatalogArgument = None,
    region: _options.RegionOption = None,
    exclude: _options.ExcludeOption = None,
    instrument: _options.InstrumentOption = "lamost",
    arm_model: _options.ArmModelOption = None,
    broken: _states.BrokenOption = None,
    state_time: _states.OwnStateTimeOption = None,
    margins: _margins.MarginsOption = None,
    method: _options.TilingMethodOption = "hexagonal",
    passes: _options.PassesOption = 1,
    completeness: _options.CompletenessOption = None,
    n_tiles: _options.NTilesOption = None,
    centers: _options.CentersOption = None,
    declination: _options.DeclinationOption = None,
    pa: _options.TilingPaOption = None,
    allocator: _options.TilingAllocatorOption = None,
    require: _options.RequireOption = None,
    sky_separation: _options.SkyOption = None,
    time_limit: _options.TimeLimitOption = 60.0,
    parked: _options.ParkedOption = True,
    lost: _options.LostOption = True,
    fibers: _options.FibersOption = None,
    radius: _options.RadiusOption = None,
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
    """Place the tiles of a survey."""
    _app.check_outputs(output, plot, report, overwrite=overwrite, inputs=(catalog, centers, instrument, broken))
    model = _app.model_of(instrument, arm_model, broken, state_time, margins=margins)
    inside = None if region is None else rs.Region.parse(region)
    field = inside
    if catalog is not None or region is None:
        field, _ = _app.targets_and_center(catalog, None, model, seed, column, unit, frame, fill)
        field = field if inside is None else _targets_inside(field, inside)
    _margins.check_use(margins, by_positioners=field is not inside and (allocator or not (fibers or radius)))
    tiling = rs.place_tiles(
        field,
        model,
        method=method,
        passes=passes,
        completeness=completeness,
        n_tiles=n_tiles,
        fibers=rs.tiling.Fibers(fibers, lost_in_collision=lost),
        allocator=_options_of(allocator, require, sky_separation, time_limit, parked, given=fibers or radius),
        radius=None if radius is None else radius * u.deg,
        centers=_centers(centers, declination, pa),
        exclude=[rs.Region.parse(one) for one in exclude or []],
        visits=visits,
        progress=sys.stderr.isatty(),
        rng=seed,
    )
    shown = {"region": inside, "targets": None if field is inside else field}
    _app.finish_tiling(tiling, shown, output, plot, report, overwrite=overwrite)


def _targets_inside(catalog: "rs.Catalog", region: "rs.Region") -> "rs.Catalog":
    """Return the targets inside a region."""
    inside = region.contains(catalog.coord)
    if not inside.any():
        raise rs.InputError(
            f"--region must contain at least one target, but none of the {len(catalog)} targets is inside"
        )
    return catalog[inside]


def _centers(path, declination, pa):
    """Return the constraints on the centers of tiles from the command-line options."""
    return rs.tiling.Centers(
        None if path is None else rs.Tiling.read(path),
        None if declination is None else declination * u.deg,
        None if pa is None else pa * u.deg,
    )


def _options_of(allocator, require, sky_separation, time_limit, parked, *, given):
    """Return the options of an allocation, or None if all options have their default values."""
    asked = require is not None or sky_separation is not None or not parked
    if allocator is None and given and asked:
        raise rs.InputError(
            "--allocator must be given if --fibers or --radius is combined with --require, --sky-separation or "
            "--no-parked"
        )
    if allocator is None and not asked:
        return None
    return _app.allocation_options(allocator or "lamost", require, sky_separation, time_limit, parked=parked)
