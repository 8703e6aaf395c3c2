"""The command ``rfpsurvey record``."""

from pathlib import Path
from typing import Annotated

import typer

import rfpsurvey as rs
from rfpsurvey._cli import _command, _main
from rfpsurvey._cli._print import print_facts, print_text
from rfpsurvey._readers import is_number, parse_number
from rfpsurvey.errors import listed, number_of


@_main.app.command(cls=_main.Command)
def record(
    folder: Annotated[Path, typer.Argument(help="Folder of a survey, which rfpsurvey survey --folder wrote.")],
    table: Annotated[
        Path | None,
        typer.Argument(
            help="Table of observations (FITS, ECSV, CSV, VOTable or Parquet) with the columns tile, state, date, "
            "fraction, positioner, target, spectrograph, good or reason, or with the columns of DESI (TILEID, ZDATE, "
            "OBSSTATUS, LASTNIGHT); table of changes to targets; or a confSummaryF file of SDSS-V."
        ),
    ] = None,
    enough: Annotated[
        str,
        typer.Option(
            metavar="ENOUGH",
            help="Smallest fraction of the exposure at which a tile counts as done; with a smaller fraction, it is "
            "partly observed. It has no effect on rows with a state.",
        ),
    ] = "1",
    tile: Annotated[str | None, typer.Option(help="The tile of all rows of a table without a column of tiles.")] = None,
    column: Annotated[
        list[str] | None,
        typer.Option(metavar="ROLE=NAME", help="Name of a column, such as date=night. The option may be repeated."),
    ] = None,
    note: Annotated[str, typer.Option(help="Note that is stored with the record.")] = "",
    replaces: Annotated[
        bool,
        typer.Option(
            "--replaces",
            help="Failed visits of the table replace those of earlier records of the same tile and date.",
        ),
    ] = False,
    allow_future: Annotated[
        bool, typer.Option("--allow-future", help="Accept dates that are later than tomorrow.")
    ] = False,
    undo: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            help="Undo the record with this number, which rfpsurvey status FOLDER --events lists, instead of recording "
            "a table.",
        ),
    ] = None,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Print what would change, without recording anything.")
    ] = False,
) -> None:
    """Record what was observed, or which tiles and targets changed, in the folder of a survey.

    Examples
    --------
    rfpsurvey record plan night1.ecsv
    rfpsurvey record plan mtl-done-tiles.ecsv
    rfpsurvey record plan night2.csv --column date=night --enough 0.9
    rfpsurvey record plan confSummaryF-998.par --tile 17
    rfpsurvey record plan new_targets.ecsv
    rfpsurvey record plan --undo 3 --note "wrong night" --dry-run
    """
    if (table is None) == (undo is None):
        raise rs.InputError(f"either a table or --undo must be given, got {'neither' if table is None else 'both'}")
    if undo is not None:
        if replaces or allow_future or column or tile is not None or enough != "1":
            raise rs.InputError("--undo must be given without options of tables, got such an option")
        said = rs.Survey.read(folder).undo(undo, note=note, dry_run=dry_run)
        _print_changes(said["changes"])
        if said["restored"]:
            print(f"record {said['restored']} takes effect again")
        if dry_run:
            print("nothing was undone (--dry-run)")
        else:
            print(f"record {undo} undone; to plan the rest: rfpsurvey survey {folder} --replan")
        return
    columns = _command.pairs(column or [], "--column", "ROLE=NAME")
    least = parse_number(enough) if is_number(enough) else enough
    options = {"note": note, "replaces": replaces, "allow_future": allow_future, "dry_run": dry_run}
    said = rs.Survey.read(folder).record(table, enough=least, tile=tile, columns=columns, **options)
    labels = {"n_events": "new events", "n_known": "already recorded", "n_ignored": "ignored (not observed)"}
    print_facts({label: said[name] for name, label in labels.items()})
    _print_changes(said["changes"])
    if dry_run:
        print("nothing was recorded (--dry-run)")
    elif said["n_events"]:
        print(f"{number_of(said['n_events'], 'event')} recorded; to plan the rest: rfpsurvey survey {folder} --replan")


def _print_changes(changes: dict[str, list[str]]) -> None:
    """Print the numbers of tiles and targets of each kind of change, and the first of them."""
    for kind, names in changes.items():
        print_text(f"{kind:<34}{len(names):>12}  {listed(names, 5)}")
