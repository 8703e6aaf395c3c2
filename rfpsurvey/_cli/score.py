"""``rfpsurvey score``."""

from pathlib import Path
from typing import Annotated

import typer

import rfpsurvey as rs
from rfpsurvey._cli import _app

EXAMPLES = """\b
Examples:
  rfpsurvey score plan.ecsv --instrument sdss_apo
  rfpsurvey score designs.ecsv --instrument sdss_lco --select design_id=503246 --equinox J2022.0
"""


@_app.app.command(epilog=EXAMPLES)
def score(
    assignment: Annotated[Path, typer.Argument(help="Table: positioner (or hole) and position of each target.")],
    instrument: Annotated[str, typer.Option(help="Preset, or the path of a TOML file.")] = "lamost",
    center: Annotated[str | None, typer.Option(help="Field center, ICRS; else the table's racen, deccen.")] = None,
    pa: Annotated[float | None, typer.Option(help="Position angle, deg; else the table's position_angle.")] = None,
    equinox: Annotated[str | None, typer.Option(help="Measure the position angle from the north of this date.")] = None,
    epoch: Annotated[str | None, typer.Option(help="Move targets to this epoch.")] = None,
    positions: Annotated[str | None, typer.Option(help="focal_plane or sky, where the table has both.")] = None,
    select: Annotated[list[str] | None, typer.Option(help="COLUMN=VALUE: look at these rows only.")] = None,
    column: Annotated[list[str] | None, typer.Option(help="ROLE=NAME, as positioner=hole.")] = None,
    unit: Annotated[list[str] | None, typer.Option(help="ROLE=UNIT of a column without one, as x=mm.")] = None,
    output: Annotated[Path | None, typer.Option(help="Write the tile, .fits or .ecsv.")] = None,
    plot: Annotated[Path | None, typer.Option(help="Draw the focal plane, .png, .pdf or .svg.")] = None,
    overwrite: Annotated[bool, typer.Option(help="Replace files that exist.")] = False,
) -> None:
    """Find the collisions in an assignment that another planner made."""
    import astropy.units as u

    _app.check_outputs(output, plot, overwrite=overwrite)
    table = _app.select_rows(_app.read_table(assignment), _app.parse_pairs(select, "--select"))
    tile = rs.score_tile(
        table,
        _app.load_instrument(instrument),
        center=None if center is None else _app.parse_center(center),
        position_angle=None if pa is None else pa * u.deg,
        equinox=equinox,
        epoch=epoch,
        positions=positions,
        columns=_app.parse_pairs(column, "--column"),
        units=_app.parse_pairs(unit, "--unit"),
    )
    _app.finish(tile, output, plot, overwrite=overwrite)
