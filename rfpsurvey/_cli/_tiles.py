"""Command-line options for tables of tiles and of centers of tiles, and the function that reads these tables."""

from pathlib import Path
from typing import Annotated

import typer

import rfpsurvey as rs
from rfpsurvey._cli import _app
from rfpsurvey.errors import warn_no_effect

__all__ = ["CentersOption", "TilesColumnOption", "TilesHduOption", "TilesOption", "TilesUnitOption", "read_tiles"]

CentersOption = Annotated[
    Path | None,
    typer.Option(
        help="Table of permitted centers of tiles, with at least the columns ra and dec. With --method=given, a "
        "tile is placed at each of these centers."
    ),
]
TilesOption = Annotated[
    Path | None,
    typer.Option(
        help="Table of tiles, with at least the columns ra and dec, or other usual names such as racen and deccen. By "
        "default, two hexagonal coverings of the catalog are used."
    ),
]
TilesColumnOption = Annotated[
    list[str] | None,
    typer.Option(
        help="Name of a column of the table of tiles or centers and its role, ROLE=NAME. The roles are tile "
        "(the identifier), ra, dec, position_angle and pass."
    ),
]
TilesUnitOption = Annotated[
    list[str] | None,
    typer.Option(help="Unit of a column of the table of tiles or centers that has no unit, ROLE=UNIT, such as ra=deg."),
]
TilesHduOption = Annotated[
    str | None,
    typer.Option(
        help="Number or name (EXTNAME) of the table of tiles or centers in a FITS file with several tables.",
    ),
]


def read_tiles(
    path: Path | None, column: list[str] | None, unit: list[str] | None, hdu: str | None
) -> "rs.Tiling | None":
    """Read a table of tiles or centers, and print which columns have other names; without a file, return None."""
    columns, units = _app.parse_pairs(column, "--tiles-column"), _app.parse_pairs(unit, "--tiles-unit")
    if path is None:
        for name, value in {"column": columns, "unit": units, "hdu": hdu}.items():
            if value:
                warn_no_effect(f"--tiles-{name}", "without a table of tiles")
        return None
    tiling = rs.Tiling.read(path, columns, units, hdu)
    meta = tiling.table.meta
    if any(role != name for role, name in meta["columns"].items()):
        said = ", ".join(f"{role}: {name}" for role, name in meta["columns"].items())
        print(f"columns of tiles: {said}" + (f"; omitted: {meta['omitted']}" if "omitted" in meta else ""))
    return tiling
