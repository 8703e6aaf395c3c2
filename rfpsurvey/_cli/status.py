"""The command ``rfpsurvey status``."""

from pathlib import Path
from types import SimpleNamespace
from typing import Annotated

import typer
from astropy.table import QTable

import rfpsurvey as rs
from rfpsurvey._cli import _app, _main, _print
from rfpsurvey.errors import number_of
from rfpsurvey.survey import state_in, status_facts, survey_status, verify_survey

MOST_FAILURES = 20
"""Largest number of positioners with repeated failures that are printed."""


@_main.app.command(cls=_main.Command)
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
        _print.print_table(records)
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
    survey, state = rs.Survey.read(folder), state_in(folder, tell=_print.print_text, until=until)
    progress = survey_status(survey, state)
    with _print.files(
        outputs,
        write=state.write,
        draw=lambda: rs.plot.plot_survey_status(progress)[0].figure,
        report=(progress, {}),
    ):
        _print.print_facts(status_facts(progress), 24)
        print("tiles of each pass by state:")
        _print.print_table(QTable(rows=progress.meta["tiles"]))
        if progress.meta["areas"]:
            print("visits of each area on the sky (right ascension and declination in deg):")
            areas = QTable(rows=progress.meta["areas"])
            areas.remove_columns(["n_targets", "n_complete", "n_failed", "n_left"])
            _print.print_table(areas)
        if len(progress) > 1:
            print("visits of each class of targets:")
            short = progress.copy()
            short.rename_columns(progress.colnames, [name.removeprefix("n_") for name in progress.colnames])
            _print.print_table(short)
        if progress.meta["failures"]:
            print("positioners whose visits failed in several tiles:")
            _print.print_table(QTable(rows=progress.meta["failures"][:MOST_FAILURES]))
        if until is None and not progress.meta["is_planned"]:
            _print.print_text(
                "the last plan does not take all recorded events into account; to plan the rest: rfpsurvey survey "
                f"{folder} --replan"
            )
