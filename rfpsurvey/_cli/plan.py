"""``rfpsurvey plan``."""

from pathlib import Path
from typing import Annotated

import typer

import rfpsurvey as rs
from rfpsurvey._cli import _app

EXAMPLES = """\b
Examples:
  rfpsurvey plan
  rfpsurvey plan stars.fits --center "06h20m00s +23d00m00s" --output tile.fits --plot tile.png
  rfpsurvey plan stars.csv --instrument sdss_apo --center "95.0 23.0" --pa 40 --epoch 2026.5
"""


@_app.app.command(epilog=EXAMPLES)
def plan(
    catalog: Annotated[
        Path | None,
        typer.Argument(help="FITS, ECSV, CSV, VOTable or Parquet. None: a synthetic Poisson catalog."),
    ] = None,
    instrument: Annotated[str, typer.Option(help="Preset, or the path of a TOML file.")] = "lamost",
    center: Annotated[str, typer.Option(help="Field center, ICRS.")] = "06h20m00s +23d00m00s",
    pa: Annotated[float, typer.Option(help="Position angle of +y, deg from north to east.")] = 0.0,
    equinox: Annotated[str | None, typer.Option(help="Measure --pa from the north of this date, as J2026.0.")] = None,
    epoch: Annotated[str | None, typer.Option(help="Move targets to this epoch, as 2026.5 or 2026-07-01.")] = None,
    allocator: Annotated[str, typer.Option(help="lamost or balanced.")] = "lamost",
    seed: Annotated[int, typer.Option(help="Seed of random numbers.")] = 0,
    column: Annotated[list[str] | None, typer.Option(help="ROLE=NAME, as id=star; priority=-rank flips it.")] = None,
    unit: Annotated[list[str] | None, typer.Option(help="ROLE=UNIT of a column without one, as ra=deg.")] = None,
    frame: Annotated[str, typer.Option(help="Frame of the catalog's coordinates.")] = "icrs",
    output: Annotated[Path | None, typer.Option(help="Write the tile, .fits or .ecsv.")] = None,
    plot: Annotated[Path | None, typer.Option(help="Draw the focal plane, .png, .pdf or .svg.")] = None,
    overwrite: Annotated[bool, typer.Option(help="Replace files that exist.")] = False,
) -> None:
    """Assign one field and find the arms that collide."""
    import astropy.units as u

    _app.check_outputs(output, plot, overwrite=overwrite)
    model, field = _app.load_instrument(instrument), _app.parse_center(center, equinox)
    if catalog is None:
        targets = rs.synthetic_catalog(
            "poisson", field.icrs, model.field_radius, density=model.target_density, rng=seed
        )
    else:
        names, units = _app.parse_pairs(column, "--column"), _app.parse_pairs(unit, "--unit")
        targets = rs.Catalog.read(catalog, columns=names, units=units, frame=frame)
    tile = rs.plan_tile(targets, model, field, position_angle=pa * u.deg, epoch=epoch, allocator=allocator, rng=seed)
    _app.finish(tile, output, plot, overwrite=overwrite)
