"""The commands ``rfpsurvey tile``, ``score`` and ``paths``."""

import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import astropy.units as u
from astropy.time import Time

import rfpsurvey as rs
from rfpsurvey._cli import command as _app
from rfpsurvey._cli import results as _results
from rfpsurvey._cli.command import command
from rfpsurvey._common.descriptions import help_of
from rfpsurvey._common.files import WRITABLE, has_ending
from rfpsurvey._common.read_tables import import_parquet
from rfpsurvey._field.recorded import north_of_date
from rfpsurvey._sky.region import Region
from rfpsurvey._survey import key_groups, key_objects
from rfpsurvey._survey.key_objects import Given, read_tiles
from rfpsurvey._survey.key_types import Located
from rfpsurvey._survey.tiling.place import METHODS


@dataclass(frozen=True)
class CentersKeys(key_groups.TableKeys):
    """The centers of tiles.

    Parameters
    ----------
    declination : Quantity or list[float], optional
        Lowest and highest declination of the center of a tile.
    position_angle : Quantity, optional
        Position angle of the +y axis of the focal plane, from north toward east. By default, the position angles in the
        table of centers are used, or 0 if the table has none.
    """

    declination: u.Quantity[u.deg] | list[float] | None = None
    position_angle: u.Quantity[u.deg] | None = None


@dataclass(frozen=True, kw_only=True)
class TileKeys:
    """The keys of the command.

    Parameters
    ----------
    region : Region, optional
        Region: 'cap RA DEC RADIUS', 'box RA1 RA2 DEC1 DEC2', 'polygon RA DEC ...' (deg), or sky. With a catalog, only
        the targets inside the region are used.
    exclude : list[Region], optional
        Regions to exclude; the targets and the area inside are ignored.
    passes : int, optional
        Number of passes, for methods that cover the field.
    completeness : float, optional
        Stop placing tiles when this fraction of the requested visits (0 to 1) is reached.
    n_tiles : int, optional
        Largest number of tiles.
    fibers : int, optional
        Largest number of targets per tile. Without an allocator, every fiber is assumed to reach every target of the
        field.
    radius : Quantity, optional
        Radius of a tile, in place of the radius of the instrument. With this key, every fiber is assumed to reach every
        target of the tile.
    """

    catalog: key_groups.SurveyCatalogKeys
    instrument: key_groups.InstrumentKeys
    tiles: CentersKeys
    options: key_groups.Options
    output: key_groups.TableOutputKeys
    region: Region | None = None
    exclude: list[Region] | None = None
    method: Annotated[str, f"Method of placing tiles: {help_of(METHODS)}."] = "hexagonal"
    passes: int = 1
    completeness: float | None = None
    n_tiles: int | None = None
    fibers: int | None = None
    radius: u.Quantity[u.deg] | None = None
    lost_in_collision: key_groups.Lost = True
    rng: key_groups.Seed = 0


@command(
    TileKeys,
    "region instrument.name method passes completeness n_tiles tiles.path=--centers options.allocator "
    "options.constraints catalog.visits catalog.columns rng output.path output.plot output.report output.overwrite",
    argument="catalog.path",
)
def tile(keys: TileKeys, _: Given) -> None:
    r"""Place the tiles of a survey.

    Examples
    --------
    rfpsurvey tile --region "box 180 240 25 45" --passes 2 --output tiles.ecsv \
        --report tiles.html
    rfpsurvey tile --region sky --method spiral --instrument desi
    rfpsurvey tile stars.fits --method network_flow --completeness 0.95 \
        --allocator repair
    rfpsurvey tile stars.fits --method given --centers tiles.ecsv
    rfpsurvey tile stars.fits --region "cap 95 23 5" \
        --set tiles.declination="[-10, 60]"
    rfpsurvey tile stars.fits --set radius=1.5 --set fibers=400
    """
    tiles = keys.tiles
    _app.check_outputs(keys.output, (keys.catalog.path, tiles.path, keys.instrument.name, keys.instrument.broken))
    model = _app.model_of(keys.instrument)
    field = inside = keys.region
    if keys.catalog.path is not None or inside is None:
        field, _ = _app.targets_and_center(keys.catalog, None, model, keys.rng)
        field = field if inside is None else _targets_inside(field, inside)
    else:
        key_objects.warn_without_catalog(keys.catalog)
    by_fibers = keys.fibers or keys.radius is not None
    if keys.instrument.margins and (field is inside or (by_fibers and "allocator" not in keys.options)):
        raise rs.InputError(
            "margins must be given only if positioners observe the targets of a catalog; add --allocator, and leave "
            "out fibers and radius"
        )
    with _app.seed_of(keys.catalog.path or inside):
        tiling = rs.place_tiles(
            field,
            model,
            method=keys.method,
            passes=keys.passes,
            completeness=keys.completeness,
            n_tiles=keys.n_tiles,
            fibers=rs.tiling.Fibers(keys.fibers, lost_in_collision=keys.lost_in_collision),
            allocator=_options_of(keys.options, by_fibers=by_fibers),
            radius=keys.radius,
            centers=rs.tiling.Centers(read_tiles(tiles, tell=_results.tell), tiles.declination, tiles.position_angle),
            exclude=keys.exclude or [],
            visits=keys.catalog.visits,
            progress=sys.stderr.isatty(),
            rng=keys.rng,
        )
    _results.finish_tiling(tiling, {"region": inside, "targets": None if field is inside else field}, keys.output)


def _targets_inside(catalog: "rs.Catalog", region: "rs.Region") -> "rs.Catalog":
    """Return the targets inside a region."""
    inside = region.contains(catalog.coord)
    if not inside.any():
        raise rs.InputError(
            f"--region must contain at least one target, but none of the {len(catalog)} targets is inside"
        )
    return catalog[inside]


def _options_of(given: dict, *, by_fibers: bool) -> "rs.AllocationOptions | None":
    """Return the options of an allocation, or None if all options have their default values."""
    options = rs.AllocationOptions(**given)
    asked = options.changed()
    if "allocator" not in given and by_fibers and asked:
        raise rs.InputError(
            "--allocator must be given if fibers or radius is combined with options of an allocation, got "
            f"{', '.join(asked)}"
        )
    return None if "allocator" not in given and not asked else options


@dataclass(frozen=True)
class AssignmentKeys(key_groups.TableKeys):
    """The plan that is scored.

    Parameters
    ----------
    path : Path, optional
        Plan of another program, or a table with the positioner (or hole) and position of each target.
    columns : dict[str, str], optional
        Names of columns of the table by their roles, such as ra=RA_TARG.
    units : dict[str, str], optional
        Units of columns that have no unit, by role, such as ra=deg.
    hdu : str or int, optional
        Number or name (EXTNAME) of the table in a FITS file with several tables.
    """


@dataclass(frozen=True)
class ScoreInstrumentKeys(key_groups.StateKeys):
    """The instrument of the plan.

    Parameters
    ----------
    name : str, optional
        Instrument: the name of a preset, the path of a TOML file, or the path of the calibration files of a real
        instrument. By default, the instrument named in the plan or tile is used; for an exported plan or a tile in the
        folder of a survey, the instrument of the survey.
    """

    name: Annotated[str | None, Located] = None


@dataclass(frozen=True, kw_only=True)
class ScoreKeys:
    """The keys of the command.

    Parameters
    ----------
    center : str, optional
        Field center (ICRS). By default, the values racen and deccen in the columns or the header of the table.
    position_angle : Quantity, optional
        Position angle. By default, the value position_angle in the columns or the header of the table.
    positions : str, optional
        Target positions to use: focal_plane or sky.
    missing : str, optional
        Treatment of assigned rows without a position: refuse, or skip (score the other rows).
    parked_obstacles : bool, optional
        Whether parked arms of idle positioners are obstacles, if both arms of a positioner are equally long. The
        default is true, or the value of the survey for its tiles.
    """

    catalog: AssignmentKeys
    instrument: ScoreInstrumentKeys
    options: key_groups.ConstraintKeys
    output: key_groups.TableOutputKeys
    center: str | None = None
    position_angle: u.Quantity[u.deg] | None = None
    equinox: key_groups.Equinox = None
    epoch: key_groups.Epoch = None
    positions: str | None = None
    missing: str = "refuse"
    parked_obstacles: bool | None = None


@command(
    ScoreKeys,
    "instrument.name center position_angle epoch positions missing options.constraints options.rules catalog.select "
    "catalog.columns output.path output.plot output.report output.overwrite",
    argument="catalog.path",
    strict=True,
)
def score(keys: ScoreKeys, _: Given) -> list[str]:
    r"""Find the collisions in an assignment that was made by another program.

    Examples
    --------
    rfpsurvey score confSummary-26.par.gz
    rfpsurvey score confSummary-26.par.gz --instrument sloanFlatCMM
    rfpsurvey score plan.ecsv --instrument sdss_apo
    rfpsurvey score designs.ecsv --instrument sdss_lco \
        --set catalog.select.design_id=503246 --set equinox=J2022.0
    rfpsurvey score tile.fits --constraint sky=20/spectrograph --strict
    rfpsurvey score plan/tiles/000/000007.fits
    """
    tile, _ = _scored(keys)
    _results.finish(tile, keys.output)
    if _results.is_verbose():
        _results.print_text(f"columns: {tile.provenance['catalog']['columns']}")
    return tile.summary.get("unmet", [])


def _scored(keys: ScoreKeys, writable: tuple[str, ...] = WRITABLE) -> tuple["rs.Tile", "rs.Instrument"]:
    """Return the plan of a file as a tile, and its instrument, after a check of the paths of all outputs."""
    path = keys.catalog.path
    if path is None:
        raise rs.InputError("catalog.path must be given: the file of the plan")
    _app.check_outputs(keys.output, (path, keys.instrument.name, keys.instrument.broken), writable)
    table, model = _app.read_assignment(keys.catalog)
    options = {name: getattr(keys, name) for name in ("positions", "epoch", "missing", "parked_obstacles")}
    if keys.center is None:
        options["equinox"] = keys.equinox
    else:
        options["center"] = north_of_date(_app.parse_center(keys.center), keys.equinox)
    options["position_angle"] = keys.position_angle
    options |= {"columns": keys.catalog.columns or {}, "units": _app.units_of(path, keys.catalog.units)}

    def read(name: str) -> "rs.Instrument":
        return _app.model_of(replace(keys.instrument, name=name), lambda: _time_of(table, keys.epoch))

    if model is None or any(vars(keys.instrument).values()):
        model = _app.instrument_of(table, keys.instrument.name, read)
    constraints = keys.options.constraints
    if keys.options.rules is not None:
        constraints = [*(constraints or ()), *model.rules(keys.options.rules)]
    return rs.score_tile(table, model, **options, constraints=constraints), model


@dataclass(frozen=True)
class PathsOutputKeys(key_groups.FileKeys):
    """The files that the command writes.

    Parameters
    ----------
    report : Path, optional
        Write an HTML report on the plan that shows the motion of the arms.
    """

    report: Path | None = None


@dataclass(frozen=True, kw_only=True)
class PathsKeys(ScoreKeys):
    """The keys of the command.

    Parameters
    ----------
    step : Quantity, optional
        Largest change of a joint angle in a step of the planner.
    margin : Quantity, optional
        Length that is added to the minimum separation while paths are planned.
    rng : int, optional
        Seed of random numbers.
    examine : bool, optional
        Examine whether two arms without a path have one without the other arms, or are certainly interlocked; this can
        take a minute per group of arms.
    """

    output: PathsOutputKeys
    step: u.Quantity[u.deg] = 4 * u.deg
    margin: u.Quantity[u.mm] = 0.05 * u.mm
    rng: int = 1
    examine: bool = False


@command(
    PathsKeys,
    "instrument.name center position_angle step margin rng examine output.path output.report output.overwrite",
    argument="catalog.path",
)
def paths(keys: PathsKeys, _: Given) -> None:
    r"""Plan paths of all arms between the folded poses and a plan, and prove that no arms collide.

    The plan is a tile, or a plan of another program. The output file contains the motion from the folded poses to the
    plan, and its exact reversal.

    Examples
    --------
    rfpsurvey paths tile.fits --output paths.ecsv
    rfpsurvey paths confSummary-26.par.gz --output paths.fits
    rfpsurvey paths tile.fits --report motion.html
    rfpsurvey paths plan.ecsv --instrument sdss_apo --examine
    """
    if keys.output.path is not None and has_ending(keys.output.path, (".parquet",)):
        import_parquet()  # an error is raised before the paths are planned
    tile, model = _scored(keys, (*WRITABLE, ".parquet"))
    made = tile.paths(model, step=keys.step, margin=keys.margin, rng=keys.rng, examine=keys.examine)
    page = {"data": keys.catalog.path, "paths": made}
    with _results.files(keys.output, write=made.write, report=(tile, page)):
        n = int(made.assigned.sum())
        speed = f"{made.meta['speed_deg_s']:.4g} deg / s" + ", which is assumed" * made.meta["speed_is_assumed"]
        print(f"{made.n_arriving} of {n} arms with a target reach it ({made.n_arriving / max(n, 1):.2%})")
        print(f"duration {made.duration.to_value(u.s):.1f} s, at a speed of the joints of {speed}")
        separation = model.focal_plane.arrays.separation
        _results.print_text(
            f"smallest distance of two arms {made.smallest_distance.to_value(u.mm):.3f} mm, minimum separation "
            f"{separation:.3f} mm (proven at all times)"
        )
        groups = [*made.groups]
        for ids, reason in groups if _results.is_verbose() else groups[: _results.MOST_ROWS]:
            _results.print_text(f"{', '.join(ids)}: {reason}")
        print(f"{len(made.time)} break points of {len(made.arrives)} arms")


def _time_of(table, epoch: object) -> Time | None:
    """Return the time of the observing conditions that a tile records or, without such a time, the epoch."""
    provenance = table.meta.get("provenance")
    recorded = provenance.get("parameters", {}).get("conditions") if isinstance(provenance, dict) else None
    return key_objects.time_of(None if recorded is None else rs.ObservingConditions.from_record(recorded), epoch)
