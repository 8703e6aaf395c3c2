"""The command ``rfpsurvey tile``."""

import sys

import astropy.units as u

import rfpsurvey as rs
from rfpsurvey._cli import _app, _examples, _main, _margins, _options, _states, _tiles
from rfpsurvey.allocation import DEFAULT_ALLOCATOR, given_options


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
    centers: _tiles.CentersOption = None,
    tiles_hdu: _tiles.TilesHduOption = None,
    tiles_column: _tiles.TilesColumnOption = None,
    tiles_unit: _tiles.TilesUnitOption = None,
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
    hdu: _options.HduOption = None,
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
        field, _ = _app.targets_and_center(catalog, None, model, seed, column, unit, frame, fill, hdu=hdu)
        field = field if inside is None else _targets_inside(field, inside)
    else:
        _app.warn_without_catalog(column=column, unit=unit, frame=frame, fill=fill, hdu=hdu)
    _margins.check_use(margins, by_positioners=field is not inside and (allocator or not (fibers or radius)))
    with _app.seed_of(catalog or region):
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
            centers=_centers(_tiles.read_tiles(centers, tiles_column, tiles_unit, tiles_hdu), declination, pa),
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


def _centers(tiling, declination, pa):
    """Return the constraints on the centers of tiles from the command-line options."""
    return rs.tiling.Centers(
        tiling,
        None if declination is None else declination * u.deg,
        None if pa is None else pa * u.deg,
    )


def _options_of(allocator, require, sky_separation, time_limit, parked, *, given):
    """Return the options of an allocation, or None if all options have their default values."""
    name = allocator or DEFAULT_ALLOCATOR
    options = _app.allocation_options(name, require, sky_separation, time_limit, parked=parked)
    asked = given_options(options)
    if allocator is None and given and asked:
        raise rs.InputError(
            "--allocator must be given if --fibers or --radius is combined with --require, --sky-separation, "
            "--time-limit or --no-parked"
        )
    return None if allocator is None and not asked else options
