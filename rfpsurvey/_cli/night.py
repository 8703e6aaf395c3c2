"""The command ``rfpsurvey night``."""

import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import astropy.units as u
import numpy as np

import rfpsurvey as rs
from rfpsurvey._cli import command as _app
from rfpsurvey._cli import results as _results
from rfpsurvey._cli.command import command
from rfpsurvey._common.descriptions import help_of
from rfpsurvey._common.files import check_parent
from rfpsurvey._common.settings import option
from rfpsurvey._field.plan_files import FORMATS, TABLE
from rfpsurvey._instruments.instrument import as_instrument
from rfpsurvey._survey import key_objects
from rfpsurvey._survey.export import CHANGED
from rfpsurvey._survey.key_types import Located, Part
from rfpsurvey._survey.night.limits import NightLimits
from rfpsurvey._survey.night.merits import MERITS
from rfpsurvey._survey.night.order import METHODS
from rfpsurvey._survey.night.plan import night_facts, plan_night
from rfpsurvey._survey.night.settings import night_limits
from rfpsurvey.errors import listed, number_of

COLUMNS = ("tile", "start", "exposure_time", "airmass", "hour_angle", "moon_separation", "merit", "backups")


@dataclass(frozen=True)
class NightOutputKeys:
    """The files that the command writes.

    Parameters
    ----------
    path : Path, optional
        Write the table of the tiles (.fits, .ecsv or .parquet).
    report : Path, optional
        Write the report of the survey with a section on the night (.html).
    folder : Path, optional
        Write the tiles of the night to files in this folder, which is made if it does not exist.
    overwrite : bool, optional
        Replace existing files.
    """

    path: Path | None = None
    report: Path | None = None
    folder: Path | None = None
    format: Annotated[str, f"Format of the files of tiles: {listed([*FORMATS, TABLE])}, or that of a package."] = TABLE
    overwrite: bool = False


@dataclass(frozen=True, kw_only=True)
class NightKeys:
    """The keys of the command.

    Parameters
    ----------
    tiles : Path, optional
        Folder of a survey, which rfpsurvey survey --folder wrote, or a table of tiles.
    date : str, optional
        Local date of the evening, such as 2027-01-03.
    site : str, optional
        Name of the site, such as kitt peak. By default, that of the instrument.
    exposure_time : Quantity, optional
        Exposure time at airmass 1. By default, that of the instrument.
    overhead : Quantity, optional
        Time between two exposures. By default, that of the instrument.
    airmass_exponent : float, optional
        Exposure times are multiplied by the airmass to the power of this number.
    in_passes : bool, optional
        Observe a tile only after the tiles of earlier passes that overlap with it.
    update : bool, optional
        Plan the rest of the survey first if events were recorded after its last plan.
    slot : Quantity, optional
        Exposures begin at multiples of this time.
    backups : int, optional
        Number of other tiles that can be observed in place of each tile.
    time_limit : Quantity, optional
        Time limit of the method exact.
    """

    tiles: Path | None = None
    date: str | None = None
    instrument: Annotated[
        str | None, Located, "Instrument: a preset or a TOML file. By default, the preset of the survey."
    ] = None
    site: str | None = None
    limits: Annotated[dict, Part(NightLimits)]
    exposure_time: u.Quantity[u.s] | None = None
    overhead: u.Quantity[u.s] | None = None
    airmass_exponent: float | None = None
    merit: Annotated[str | None, f"Merit of the tiles of a survey: {help_of(MERITS)}, or the name of a plugin."] = None
    in_passes: bool = False
    method: Annotated[str, f"Method: {help_of(METHODS)}."] = option("greedy", choices=METHODS)
    update: bool = False
    slot: u.Quantity[u.s] = 30 * u.s
    backups: int = option(2, low=0, high=100)
    time_limit: u.Quantity[u.s] = 60 * u.s
    output: NightOutputKeys


@command(
    NightKeys,
    "date instrument site limits.max_airmass exposure_time overhead merit method backups in_passes update output.path "
    "output.report output.folder output.format output.overwrite",
    argument="tiles",
)
def night(keys: NightKeys) -> None:
    r"""Choose the tiles of a survey that are observed in a night, with their times, and write them to files.

    Examples
    --------
    rfpsurvey night plan --date 2027-01-03
    rfpsurvey night plan --date 2027-01-03 --max-airmass 1.5 --method exact
    rfpsurvey night plan --date 2027-01-03 --output night.ecsv --folder night \
        --format confsummary
    rfpsurvey night tiles.ecsv --date 2027-01-03 --instrument desi
    rfpsurvey night plan --date 2027-01-03 --set "limits.moon_separation=30 deg"
    """
    if keys.tiles is None or keys.date is None:
        raise rs.InputError("the folder of a survey, or a table of tiles, and --date must be given")
    survey, output = None, keys.output
    _app.check_outputs(output)
    if key_objects.survey_folder(keys.tiles) is not None:
        survey = rs.Survey.read(keys.tiles)
        survey = _planned(survey, progress=sys.stderr.isatty()) if keys.update else survey
    elif output.folder is not None or output.report is not None or keys.update:
        raise rs.InputError("--folder, --report and --update must be used with the folder of a survey")
    tiles = rs.Tiling.read(keys.tiles) if survey is None else survey
    instrument = keys.instrument or (None if survey is None else survey.provenance["instrument"]["name"])
    if keys.instrument is None and instrument not in rs.available_instruments():
        instrument = None
    names = ("site", "exposure_time", "overhead", "airmass_exponent", "merit", "in_passes", "method", "slot")
    options = {name: getattr(keys, name) for name in (*names, "backups", "time_limit")}
    plan = plan_night(tiles, keys.date, instrument=instrument, limits=_limits(keys.limits, instrument), **options)
    if output.folder is not None:
        check_parent(output.folder)
    with _results.files(
        output,
        write=plan.write,
        report=(None if survey is None else survey.state(), {"night": plan}),
    ):
        _print(plan)
    if output.folder is not None and len(plan):
        given = {"format": output.format, "output": output.folder, "overwrite": output.overwrite}
        given |= {} if keys.instrument is None else {"instrument": as_instrument(keys.instrument)}
        if has_conditions := bool(survey.provenance["parameters"].get("conditions")):
            given["times"] = plan.table["start"] + plan.table["exposure_time"] / 2
        files = survey.export([str(name) for name in plan.table["tile"]], **given)
        print(f"{number_of(len(files), 'file')} written to {output.folder}")
        if not has_conditions:
            print(
                "the positions do not depend on the time, because the survey was planned without observing conditions"
            )
        elif n_changed := int(files["n_changed"].sum()):
            path = output.folder / CHANGED
            text = (
                f"at these times, {number_of(n_changed, 'positioner')} cannot observe the planned targets; record the"
            )
            _results.print_text(f"{text} changes with the tiles: rfpsurvey record {keys.tiles} {path}")


def _planned(survey: rs.Survey, *, progress: bool) -> rs.Survey:
    """Return the survey with a plan that takes all events into account."""
    return survey if survey.status().meta["is_planned"] else survey.replan(progress=progress)


def _limits(given: dict, instrument: str | None) -> object:
    """Return the limits of the instrument, by program, with those that are given in place of its own."""
    if not given:
        return None
    if instrument is None:
        return NightLimits(**given)
    excluded = {"max_airmass": "min_altitude", "min_altitude": "max_airmass"}
    cleared = {excluded[name]: None for name in given if name in excluded and excluded[name] not in given}
    return {name: replace(limits, **cleared, **given) for name, limits in night_limits(instrument).items()}


def _print(plan) -> None:
    """Print the numbers and the tiles of a night."""
    _results.print_facts(night_facts(plan, is_short=not _results.is_verbose()), 12, 44)
    most = len(plan) if _results.is_verbose() else _results.MOST_ROWS
    table = plan.table[[name for name in COLUMNS if name in plan.table.colnames]][:most]
    table["start"] = np.asarray(table["start"].strftime("%H:%M:%S"), dtype=str)
    if len(table):
        _results.print_table(table)
    if len(plan) > most:
        print(f"and {number_of(len(plan) - most, 'more tile')}")
    reasons = plan.not_observed["reason"].tolist()
    counts = sorted({reason: reasons.count(reason) for reason in reasons}.items(), key=lambda item: -item[1])
    if counts:
        _results.print_text("not observed: " + ", ".join(f"{n} {reason}" for reason, n in counts))
