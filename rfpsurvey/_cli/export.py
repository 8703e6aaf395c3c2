"""The commands ``rfpsurvey export`` and ``convert``, which write plans in the formats of observatories."""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

import rfpsurvey as rs
from rfpsurvey._cli import application as _main
from rfpsurvey._cli.command import command
from rfpsurvey._cli.results import MOST_ROWS, is_verbose, print_text
from rfpsurvey._common.files import check_parent, check_separate
from rfpsurvey._field.plan_files import FORMATS, TABLE, as_plan, read_plan, write_plan
from rfpsurvey._survey.export import tile_at
from rfpsurvey._survey.key_types import Located
from rfpsurvey.errors import listed, number_of


@dataclass(frozen=True, kw_only=True)
class ExportKeys:
    """The keys of the command.

    Parameters
    ----------
    folder : Path, optional
        Folder of a survey, which rfpsurvey survey --folder wrote.
    tiles : str, optional
        Tiles to export: numbers or names and ranges of numbers, such as 12-20 or 3,5,7-9. By default, all tiles that
        have a plan.
    output : Path, optional
        Folder of the files, which is made if it does not exist.
    overwrite : bool, optional
        Replace existing files.
    alternates : int, optional
        Also write, for each file, a table with up to this number of alternates of each fiber.
    """

    folder: Path | None = None
    tiles: str | None = None
    format: Annotated[str, f"Format of the files: {listed([*FORMATS, TABLE])}, or that of an installed package."] = (
        TABLE
    )
    output: Path = Path()
    instrument: Annotated[
        str | None,
        Located,
        "Instrument of the survey, if it was given in Python and is not a preset.",
    ] = None
    overwrite: bool = False
    alternates: int | None = None


@command(ExportKeys, "tiles format output overwrite alternates", argument="folder", strict=True)
def export(keys: ExportKeys) -> list[str]:
    r"""Write tiles of a survey to files in the format of an observatory, one file for each tile.

    Examples
    --------
    rfpsurvey export plan --tiles 12-20 --format confsummary --output night1
    rfpsurvey export plan --tiles 3,5,7-9 --format fiberassign
    rfpsurvey export plan --format table --output tiles --strict
    rfpsurvey export plan --tiles 12 --alternates 3
    """
    if keys.folder is None:
        raise rs.InputError("folder must be given: the folder of a survey")
    names = ("tiles", "format", "output", "instrument", "overwrite", "alternates")
    options = {name: getattr(keys, name) for name in names}
    table = rs.Survey.read(keys.folder).export(**options, progress=sys.stderr.isatty())
    most = len(table) if is_verbose() else MOST_ROWS
    for row in table[:most]:
        numbers = f"{row['n_assigned']} of {row['n_positioners']} positioners have a target"
        unmet = f"; not met: {row['unmet']}" if row["unmet"] else ""
        unmet += f"; alternates: {row['alternates']}" if keys.alternates else ""
        print_text(f"tile {row['tile']}: {row['file']}, {numbers}, {row['n_colliding']} in collision{unmet}")
    if len(table) > most:
        print(f"and {number_of(len(table) - most, 'more file')}")
    n_left = len(table.meta["left_out"])
    total = f"{number_of(len(table), 'file')} with {int(table['n_assigned'].sum())} targets written to {keys.output}"
    print(total + (f"; {number_of(n_left, 'tile')} left out" if n_left else ""))
    return [text for text in table["unmet"].tolist() if text]


@_main.app.command(cls=_main.Command)
@_main.with_level
def convert(
    source: Annotated[
        Path,
        typer.Argument(
            help="File to convert: a plan of another program, a tile (.fits or .ecsv), or the file of a tile in the "
            "folder of a survey."
        ),
    ],
    target: Annotated[Path, typer.Argument(help="New file, such as confSummary-26.par.gz or plan.ecsv.")],
    format: Annotated[  # noqa: A002
        str | None,
        typer.Option(
            help="Format of the new file: confsummary, fiberassign, pfsdesign, table, or a format of an installed "
            "package. By default, the extension of the file name determines the format."
        ),
    ] = None,
    overwrite: Annotated[bool, typer.Option(help="Replace existing files.")] = False,
) -> None:
    """Convert a plan to the format of another program.

    Examples
    --------
    rfpsurvey convert confSummary-26.par plan.ecsv
    rfpsurvey convert tile.fits confSummary-26.par.gz
    rfpsurvey plan targets.fits --instrument fp-metrology.csv --output tile.fits
    rfpsurvey convert tile.fits fiberassign-000001.fits --format fiberassign
    rfpsurvey convert plan/tiles/000/000007.fits confSummary-18.par
    """
    check_separate([target], [source])
    check_parent(target)
    tile, planned = tile_at(source) or (None, None)
    plan = read_plan(source) if tile is None else as_plan(tile)
    write_plan(plan, target, format=format, overwrite=overwrite)
    if planned is not None:
        planned.put_instruments(target.parent)
    n_assigned, n = int(plan["assigned"].sum()), len(plan)
    instrument = f" of {plan.meta['instrument']}" if plan.meta.get("instrument") else ""
    print(f"{target}: {n_assigned} of {n} fibers{instrument} have a target")
