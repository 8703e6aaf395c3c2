"""The commands ``rfpsurvey survey``, ``record``, ``status`` and ``diff``."""

from collections import Counter
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Annotated

import numpy as np
import typer
from astropy.table import QTable

import rfpsurvey as rs
from rfpsurvey._cli import application as _main
from rfpsurvey._cli import command as _app
from rfpsurvey._cli import results as _results
from rfpsurvey._cli.command import command
from rfpsurvey._cli.results import print_facts, print_text, tell
from rfpsurvey._common.io import write_table
from rfpsurvey._common.read_tables import is_number, parse_number
from rfpsurvey._survey import key_objects
from rfpsurvey._survey.history.diff import diff_surveys
from rfpsurvey._survey.history.status import status_facts, survey_status
from rfpsurvey._survey.key_objects import Given
from rfpsurvey._survey.key_types import keys_of
from rfpsurvey._survey.plan_file import SurveyKeys, call_of, state_in
from rfpsurvey._survey.stored import verify_survey
from rfpsurvey.errors import listed, number_of


@command(
    SurveyKeys,
    "tiles.path instrument.name options.allocator options.constraints catalog.visits tiles.passes epoch "
    "catalog.columns output.folder output.resume output.replan workers rng output.plot output.report output.overwrite",
    argument="catalog.path",
    strict=True,
)
def survey(keys: SurveyKeys, given: Given) -> list[str]:
    r"""Plan the tiles of a survey so that as many targets as possible are observed the requested number of times.

    Examples
    --------
    rfpsurvey survey
    rfpsurvey survey stars.fits --tiles tiles.ecsv --visits 2 --workers 2 \
        --folder plan --report plan.html
    rfpsurvey survey stars.fits --tiles tiles.ecsv --visits 2 --workers 2 \
        --folder plan --resume
    rfpsurvey survey stars.fits --allocator repair \
        --constraint "required 4711" --constraint "keep_out 95.0 23.1 0.01"
    rfpsurvey survey stars.fits --allocator joint --set joint.time_limit=600 \
        --folder plan
    rfpsurvey survey stars.fits --tiles tiles.ecsv --visits 2 --folder plan \
        --write-plan plan.toml
    rfpsurvey survey plan.toml --workers 2
    rfpsurvey survey stars.fits --tiles tiles.ecsv --folder plan \
        --set rule.after_success=4 --set rule.retries=2
    rfpsurvey survey plan --replan --report rest.html
    rfpsurvey survey hats_catalog --tiles tiles.ecsv \
        --set scheduler=tcp://10.0.0.1:8786 --folder plan
    """
    _check_replan(keys)
    paths = keys.catalog.path, keys.tiles.path, keys.instrument.name, keys.instrument.broken, keys.cadences
    _app.check_outputs(keys.output, (*paths, keys.conditions.get("path")))
    call = call_of(keys, tell=tell)
    with _app.seed_of(keys.catalog.path), _results.workers(keys) as executor:
        options = {"folder": keys.output.folder, "resume": keys.output.resume or keys.output.replan}
        return _results.run(executor, call | options, keys.output, given).summary["unmet"]


def _check_replan(keys) -> None:
    """Raise an error if the rest of a survey is to be planned, but there is no survey."""
    folder = keys.output.folder
    if keys.output.replan and (folder is None or not (folder / "survey.json").is_file()):
        raise rs.InputError(
            "--replan must be used with the folder of a survey, such as rfpsurvey survey FOLDER --replan, got "
            f"{folder or keys.catalog.path or 'no folder'}"
        )


def values_of(path: Path | None) -> dict | None:
    """Return the values of the keys in the plan file of a survey, or None if the path is not the folder of a survey."""
    folder = None if path is None else key_objects.survey_folder(path)
    if folder is None:
        return None
    values: dict = {}
    key_objects.add_file(keys_of(SurveyKeys), values, folder / key_objects.RECORD)
    return values


@_main.app.command(cls=_main.Command)
@_main.with_level
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
    swaps: Annotated[
        bool,
        typer.Option(
            "--swaps",
            help="Each row with a positioner and a target states that this target was observed in place of the planned "
            "one.",
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
        if replaces or swaps or allow_future or column or tile is not None or enough != "1":
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
    columns = _app.pairs(column or [], "--column", "ROLE=NAME")
    least = parse_number(enough) if is_number(enough) else enough
    options = {"note": note, "replaces": replaces, "allow_future": allow_future, "dry_run": dry_run, "swaps": swaps}
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


MOST_FAILURES = 20
"""Largest number of positioners with repeated failures that are printed."""


@_main.app.command(cls=_main.Command)
@_main.with_level
def status(
    folder: Annotated[Path, typer.Argument(help="Folder of a survey, which rfpsurvey survey --folder wrote.")],
    until: Annotated[
        str | None,
        typer.Option(help="Ignore observations after this date, such as 2026-01-31; entries without a date are kept."),
    ] = None,
    output: Annotated[
        Path | None, typer.Option(help="Write a table with the state of each target (.fits or .ecsv).")
    ] = None,
    plot: Annotated[
        Path | None,
        typer.Option(help="Plot the visits and tiles by date, and the visits of each class (.png, .pdf or .svg)."),
    ] = None,
    report: Annotated[Path | None, typer.Option(help="Write a report as a self-contained page (.html).")] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace existing files.")] = False,
    events: Annotated[
        bool, typer.Option("--events", help="List all records (rfpsurvey record), with their numbers, and exit.")
    ] = False,
    verify: Annotated[
        bool, typer.Option("--verify", help="Check all files, list those that are missing or damaged, and exit.")
    ] = False,
) -> None:
    """Print what a survey has observed, what is planned, and what remains.

    The report shows the tiles and the completeness after each night, the fibers of each tile, and those that the last
    plan of the rest changed.

    Examples
    --------
    rfpsurvey status plan
    rfpsurvey status plan --until 2026-01-31 --output targets.fits
    rfpsurvey status plan --plot status.png --report status.html
    rfpsurvey status plan --events
    rfpsurvey status plan --verify
    """
    n_options = sum(value is not None for value in (until, output, plot, report))
    if (verify and (events or n_options)) or (events and n_options):
        name = "--verify" if verify else "--events"
        raise rs.InputError(f"{name} must be given without other options, got other options")
    if events:
        records = rs.Survey.read(folder).events()
        records.remove_columns(["rows"])
        _results.print_table(records)
        return
    if verify:
        damaged = verify_survey(folder)
        for row in damaged:
            print(f"{row['file']}: {row['problem']}; {row['remedy']}")
        for name in damaged.meta["others"]:
            print(f"{name}: does not belong to the survey, and is not used")
        print(f"{number_of(len(damaged), 'file')} missing or damaged")
        raise typer.Exit(len(damaged) > 0)
    outputs = SimpleNamespace(path=output, plot=plot, report=report, overwrite=overwrite)
    _app.check_outputs(outputs)
    survey, state = rs.Survey.read(folder), state_in(folder, tell=_results.tell, until=until)
    progress = survey_status(survey, state)
    with _results.files(
        outputs,
        write=state.write,
        draw=lambda: rs.plot.plot_survey_status(progress)[0].figure,
        report=(state, {}),
    ):
        _results.print_facts(status_facts(progress, is_short=not _results.is_verbose()), 24)
        if _results.is_verbose():
            _print_tables(progress)
        if until is None and not progress.meta["is_planned"]:
            _results.print_text(
                "the last plan does not take all recorded events into account; to plan the rest: rfpsurvey survey "
                f"{folder} --replan"
            )


def _print_tables(progress: QTable) -> None:
    """Print the progress by pass, by area and by class, and the positioners that failed."""
    print("tiles of each pass by state:")
    _results.print_table(QTable(rows=progress.meta["tiles"]))
    if progress.meta["areas"]:
        print("visits of each area on the sky (right ascension and declination in deg):")
        areas = QTable(rows=progress.meta["areas"])
        areas.remove_columns(["n_targets", "n_complete", "n_failed", "n_left"])
        _results.print_table(areas)
    if len(progress) > 1:
        print("visits of each class of targets:")
        short = progress.copy()
        short.rename_columns(progress.colnames, [name.removeprefix("n_") for name in progress.colnames])
        _results.print_table(short)
    if progress.meta["failures"]:
        print("positioners whose visits failed in several tiles:")
        _results.print_table(QTable(rows=progress.meta["failures"][:MOST_FAILURES]))


@_main.app.command(cls=_main.Command)
@_main.with_level
def diff(
    first: Annotated[Path, typer.Argument(help="Folder of a survey, such as a copy of its first plan.")],
    second: Annotated[Path, typer.Argument(help="Folder of another plan of the survey.")],
    output: Annotated[
        Path | None, typer.Option(help="Write a table with a row for each tile and each fiber that changed.")
    ] = None,
    report: Annotated[Path | None, typer.Option(help="Write a report as a self-contained page (.html).")] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace existing files.")] = False,
) -> None:
    """List the tiles and fibers that differ between two plans of a survey, and the reasons.

    The report is that of rfpsurvey status SECOND, with the fibers that differ.

    Examples
    --------
    rfpsurvey diff before plan
    rfpsurvey diff before plan --output changes.ecsv --report changes.html
    """
    outputs = SimpleNamespace(path=output, plot=None, report=report, overwrite=overwrite)
    _app.check_outputs(outputs)
    table = diff_surveys(first, second)
    state = None if report is None else state_in(second, tell=_results.tell)
    with _results.files(outputs, write=partial(write_table, table), report=(state, {"changes": table})):
        _print_differences(table, first, second)


def _print_differences(table: QTable, first: Path, second: Path) -> None:
    """Print the tiles and fibers that differ between two plans."""
    n_tiles = table.meta["n_tiles"]
    if len(table) == 0:
        print(f"the plans are the same: {number_of(n_tiles[0], 'tile')}")
    for folder, n in zip((first, second), table.meta["n_later_files"], strict=True):
        if n:
            _results.print_text(f"events that were recorded in {folder} after its last plan are not compared")
    is_tile = np.asarray(table["positioner"]) == ""
    for what, rows in (("tiles", is_tile), ("fibers", ~is_tile)):
        counts = Counter(np.asarray(table["reason"])[rows].tolist()).most_common()
        _results.print_facts({f"{what}: {reason}": n for reason, n in counts})
    numbers = Counter(np.asarray(table["tile"])[~is_tile].tolist())
    words = {tile: [] for tile in dict.fromkeys(np.asarray(table["tile"]).tolist())}
    for tile, reason in zip(table["tile"][is_tile].tolist(), table["reason"][is_tile].tolist(), strict=True):
        words[tile].append(reason)
    for tile, n in numbers.items():
        words[tile].append(f"{number_of(n, 'fiber')} changed")
    most = len(words) if _results.is_verbose() else _results.MOST_ROWS
    for tile in list(words)[:most]:
        _results.print_text(f"tile {tile}: {', '.join(words[tile])}")
    if len(words) > most:
        print(f"and {number_of(len(words) - most, 'more tile')}")
