"""The command-line application, and functions that all commands share."""

import os
import re
import signal
import sys
import warnings
from concurrent.futures import BrokenExecutor
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import astropy.units as u
import typer

import rfpsurvey as rs
from rfpsurvey._cli._compiling import announce_compilation
from rfpsurvey._cli._print import (
    PICTURES,
    files,
    finish,
    finish_comparison,
    finish_estimate,
    finish_table,
    finish_tiling,
    print_table,
)
from rfpsurvey._io import WRITABLE, check_fits_text, check_output, read_table, suffix_of
from rfpsurvey._units import to_center
from rfpsurvey.catalog import UNITS, as_catalog, is_example
from rfpsurvey.errors import check_choice
from rfpsurvey.instrument import as_instrument
from rfpsurvey.plans import is_plan, native_format, read_plan
from rfpsurvey.plot import COLORINGS
from rfpsurvey.report import check_report

__all__ = [
    "allocation_options",
    "app",
    "check_chart",
    "check_outputs",
    "check_targets",
    "check_text",
    "files",
    "finish",
    "finish_comparison",
    "finish_estimate",
    "finish_table",
    "finish_tiling",
    "instrument_of",
    "main",
    "parse_center",
    "parse_pairs",
    "print_table",
    "read_assignment",
    "read_catalog",
    "read_targets",
    "targets_and_center",
    "to_mm",
    "units_of",
]

# The exit code that a shell reports for a program that writes to a closed pipe.
READER_GONE = 141
DEFAULT_CENTER = "06h20m00s +23d00m00s"

app = typer.Typer(
    help="Assign targets to theta-phi fiber positioners and score the collisions of their arms.",
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    add_completion=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _print_version(wanted: bool) -> None:
    if wanted:
        print(f"rfpsurvey {rs.__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool,
        typer.Option("--version", help="Print the version and exit.", callback=_print_version, is_eager=True),
    ] = False,
) -> None:
    pass


def main() -> None:
    """Run the command line; if the input is invalid, print a one-sentence message and exit with the code 2."""
    warnings.showwarning = lambda message, *_: print(f"rfpsurvey: warning: {message}", file=sys.stderr)
    warnings.filterwarnings("ignore", module="astropy")
    warnings.simplefilter("always", rs.RfpsurveyWarning)
    announce_compilation()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # exit handlers remove incomplete outputs
    code = 0
    try:
        app()
    except SystemExit as stop:  # typer raises this at the end, also after a closed pipe
        code = READER_GONE if isinstance(stop.__context__, BrokenPipeError) else stop.code
    except BrokenPipeError:
        code = READER_GONE
    except (rs.InputError, OSError, BrokenExecutor) as error:
        code = _complain(error)
    sys.exit(_flush(code))


def _complain(error: Exception) -> int:
    """Print a one-sentence message, and return the exit code for invalid input."""
    with suppress(BrokenPipeError):
        print(f"rfpsurvey: {_with_options(' '.join(str(error).split()), sys.argv[1:])}", file=sys.stderr)
    return 2


def _with_options(text: str, words: list[str]) -> str:
    """Return an error message in which the options that the user typed replace the names of parameters."""
    typed = {word.partition("=")[0] for word in words if word.startswith("--")}

    def option(match: re.Match) -> str:
        name = OPTIONS.get(match[0], "--" + match[0].replace("_", "-"))
        return name if name in typed else match[0]

    text = re.sub(r"^[a-z_]+(?= must )", option, text)
    return re.sub(r"(?<![\w'=-])[a-z]+(_[a-z]+)+(?![\w'=(])", option, text)


def _flush(code: int) -> int:
    """Flush the output while errors can still be reported, and return the exit code."""
    for stream in filter(None, (sys.__stdout__, sys.__stderr__)):
        try:
            stream.flush()
        except OSError as error:
            gone = isinstance(error, BrokenPipeError)
            code = READER_GONE if gone else _complain(error)
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())  # the interpreter flushes again
        except ValueError:  # the stream is closed
            pass
    return code


def parse_center(text: str | None):
    """Convert the text of an option to the field center; None if the option is not given."""
    return None if text is None else to_center(text, "--center")


OPTIONS = {
    "rotation": "--pa",
    "position_angle": "--pa",
    "standard_error": "--precision",
    "passes": "--pass",
    "targets_per_positioner": "--targets",
    "n_realizations": "--realizations",
    "requirements": "--require",
}
"""Parameters whose command-line options have other names, and these options."""
FORMS = {
    "--column": "ROLE=NAME",
    "--unit": "ROLE=UNIT",
    "--fill": "ROLE=VALUE",
    "--select": "COLUMN=VALUE",
    "--objective": "COLUMN=DIRECTION",
}


def parse_pairs(pairs: list[str] | None, option: str) -> dict[str, str]:
    """Convert options of a form such as NAME=VALUE to a dict."""
    found = {}
    for pair in pairs or []:
        name, sign, value = pair.partition("=")
        if not sign or not name or not value:
            raise rs.InputError(f"{option} must have the form {FORMS[option]}, got {pair!r}")
        found[name] = value
    return found


def instrument_of(table, name: str | None) -> "rs.Instrument":
    """Return the instrument with a given name; without a name, return the instrument that the file of a tile names."""
    provenance = table.meta.get("provenance")
    own = provenance.get("instrument", {}).get("name") if isinstance(provenance, dict) else None
    if own is None and is_plan(table):
        return as_instrument(name or table.meta["instrument"])
    if name is None and own is None:
        known = ", ".join(rs.available_instruments())
        raise rs.InputError(f"--instrument must name the instrument of the assignment: {known}, or a TOML file")
    instrument = as_instrument(name or own)
    if own is not None and own != instrument.name:
        raise rs.InputError(f"the tile was made for {own}, and cannot be scored for {instrument.name}")
    return instrument


def read_catalog(path: Path, column, unit, frame: str, fill, keep: list[str] | None = None):
    """Return the catalog of a file, or of a folder of partitions."""
    columns, units, fill = parse_pairs(column, "--column"), parse_pairs(unit, "--unit"), parse_pairs(fill, "--fill")
    if path.is_dir():
        return rs.PartitionedCatalog(path, columns=columns, units=units, frame=frame, fill=fill, keep=keep)
    common = re.fullmatch(r"J\d+(\.\d+)?", columns.get("epoch", ""))  # an epoch instead of a column
    if common:
        del columns["epoch"]
    catalog = rs.Catalog.read(path, columns=columns, units=units, frame=frame, fill=fill, keep=keep)
    return replace(catalog, epoch=common[0]) if common else catalog


def targets_and_center(path, center, model, seed, column, unit, frame, fill, keep=None):
    """Return a catalog, which is read or synthetic, and the field center, or None for the center of the catalog."""
    field = parse_center(center)
    if path is None:
        field = parse_center(DEFAULT_CENTER) if field is None else field
        return rs.synthetic_catalog("poisson", field, model.field_radius, density=model.target_density, rng=seed), field
    return as_catalog(read_catalog(path, column, unit, frame, fill, keep)), field


def _parse_circle(text: str) -> "rs.Region":
    """Convert text such as "95.0,23.0,0.01" (degrees) to a circle; the word cap may precede the numbers."""
    words = text.replace(",", " ").split()
    try:
        return rs.Region.parse(" ".join(words if words[:1] == ["cap"] else ["cap", *words]))
    except rs.InputError as error:
        raise rs.InputError(
            f"--keep-out must be RA,DEC,RADIUS in deg, such as 95.0,23.0,0.01, got {text!r} ({error})"
        ) from None


def allocation_options(
    allocator: str,
    require,
    sky_separation: float | None,
    time_limit: float,
    *,
    objective="priority",
    parked=True,
    required: list[str] | None = None,
    keep_out: list[str] | None = None,
    subpriority: str | None = None,
) -> "rs.AllocationOptions":
    """Convert the options of a command to the options of an allocation."""
    own = require is not None and "instrument" in require
    if own and len(require) > 1:
        raise rs.InputError("--require instrument stands for all requirements of the instrument: give no others")
    if sky_separation is not None:
        sky_separation = sky_separation * u.arcsec
    return rs.AllocationOptions(
        allocator,
        requirements="instrument" if own else require,
        sky_separation=sky_separation,
        objective=objective,
        time_limit=time_limit * u.s,
        parked_obstacles=parked,
        required=required,
        keep_out=[_parse_circle(text) for text in keep_out or []],
        subpriority=int(subpriority) if subpriority and subpriority.isdecimal() else subpriority,
    )


def read_assignment(path: Path, select: list[str] | None):
    """Read a table, and select the rows whose columns have the given values; values are compared as text."""
    table = read_table(path) if native_format(path) is None else read_plan(path)
    for name, value in parse_pairs(select, "--select").items():
        if name not in table.colnames:
            raise rs.InputError(f"--select: there is no column {name!r}; the columns are: {', '.join(table.colnames)}")
        table = table[[str(getattr(v, "value", v)) == value for v in table[name]]]
        if len(table) == 0:
            raise rs.InputError(f"--select {name}={value} selects no row")
    table.meta.update(file=path.name, select=", ".join(select or []))
    return table


def units_of(path: Path, unit: list[str] | None) -> dict[str, str]:
    """Return the given units; for CSV files, which contain no units, add the usual units of all other columns."""
    usual = {role: str(u) for role, u in UNITS.items()} if suffix_of(path) in (".csv", ".tsv") else {}
    return {**usual, **parse_pairs(unit, "--unit")}


def to_mm(value: float | None):
    """Convert a number of mm to a Quantity; None remains None."""
    return None if value is None else value * u.mm


def read_targets(name: str):
    """Read a catalog from a file; return the name of a kind of random targets unchanged."""
    return rs.Catalog.read(name) if Path(name).suffix or is_example(name) else name


def check_outputs(
    output: Path | None,
    plot: Path | None = None,
    report: Path | None = None,
    quality: Path | None = None,
    *,
    overwrite: bool,
) -> None:
    """Raise an error if an output cannot be written; this is called before any work is done."""
    if output is not None:
        check_output(output, WRITABLE, overwrite=overwrite)
    for path in (plot, quality):
        if path is not None:
            check_output(path, PICTURES, overwrite=overwrite)
    if report is not None:
        check_report(report, overwrite=overwrite)


def check_targets(color: str | None, plot: Path | None, catalog: "rs.Catalog | None" = None) -> None:
    """Raise an error if a column cannot determine the colors of targets; this is called before any work is done."""
    if color is None:
        return
    check_choice(color, COLORINGS, "--targets")
    if plot is None:
        raise rs.InputError("--targets needs a plot to draw them in: give --plot")
    if catalog is not None and color in ("category", "priority") and getattr(catalog, color) is None:
        raise rs.InputError(f"--targets {color} needs a {color}, which the catalog does not have: give --column")


def check_text(catalog: "rs.Catalog", instrument: "rs.Instrument", center, output: Path | None) -> None:
    """Raise an error if FITS cannot contain text of the targets of a field; this is called before any work is done."""
    if output is None or suffix_of(output) != ".fits" or len(catalog) == 0:
        return
    center = catalog.mean_direction if center is None else center
    targets = catalog.within(center, instrument.field_radius)
    columns = {"category": targets.category, **targets.arrays.extra}
    columns = {f"values of {name!r}": values for name, values in columns.items() if values is not None}
    columns = {"positioner ids": instrument.focal_plane.id, "target ids": targets.id, **columns}
    check_fits_text(columns, "write .ecsv instead")


def check_chart(plot: Path, report: Path | None, *, overwrite: bool) -> Path:
    """Return the path of the table beside a plot; raise an error if one of the outputs cannot be written."""
    check_outputs(None, plot, report, overwrite=overwrite)
    return check_output(plot.with_suffix(".ecsv"), WRITABLE, overwrite=overwrite)
