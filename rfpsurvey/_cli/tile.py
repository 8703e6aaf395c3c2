"""The command ``rfpsurvey tile``."""

import sys
from dataclasses import dataclass
from typing import Annotated

import astropy.units as u

import rfpsurvey as rs
from rfpsurvey import inputs
from rfpsurvey._cli import _app, _print
from rfpsurvey._cli._command import Given, command
from rfpsurvey._methods import help_of
from rfpsurvey.region import Region
from rfpsurvey.survey import read_tiles
from rfpsurvey.tiling import METHODS


@dataclass(frozen=True)
class CentersKeys(inputs.TableKeys):
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

    catalog: inputs.SurveyCatalogKeys
    instrument: inputs.InstrumentKeys
    tiles: CentersKeys
    options: inputs.Options
    output: inputs.TableOutputKeys
    region: Region | None = None
    exclude: list[Region] | None = None
    method: Annotated[str, f"Method of placing tiles: {help_of(METHODS)}."] = "hexagonal"
    passes: int = 1
    completeness: float | None = None
    n_tiles: int | None = None
    fibers: int | None = None
    radius: u.Quantity[u.deg] | None = None
    lost_in_collision: inputs.Lost = True
    rng: inputs.Seed = 0


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
        inputs.warn_without_catalog(keys.catalog)
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
            centers=rs.tiling.Centers(
                read_tiles(tiles, tell=_print.print_text), tiles.declination, tiles.position_angle
            ),
            exclude=keys.exclude or [],
            visits=keys.catalog.visits,
            progress=sys.stderr.isatty(),
            rng=keys.rng,
        )
    _print.finish_tiling(tiling, {"region": inside, "targets": None if field is inside else field}, keys.output)


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
