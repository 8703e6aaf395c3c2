"""The command ``rfpsurvey convert``."""

from pathlib import Path
from typing import Annotated

import typer

from rfpsurvey._cli import _main
from rfpsurvey._outputs import check_parent, check_separate
from rfpsurvey.plans import read_plan, write_plan


@_main.app.command(cls=_main.Command)
def convert(
    source: Annotated[
        Path, typer.Argument(help="File to convert: a plan of another program, or a tile (.fits or .ecsv).")
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
    """
    check_separate([target], [source])
    check_parent(target)
    plan = read_plan(source)
    write_plan(plan, target, format=format, overwrite=overwrite)
    n_assigned, n = int(plan["assigned"].sum()), len(plan)
    instrument = f" of {plan.meta['instrument']}" if plan.meta.get("instrument") else ""
    print(f"{target}: {n_assigned} of {n} fibers{instrument} have a target")
