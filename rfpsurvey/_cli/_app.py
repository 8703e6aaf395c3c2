"""Functions that several commands share: they parse options, read input files, and check output files."""

import re
from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from pathlib import Path

import astropy.units as u
from astropy.time import Time

import rfpsurvey as rs
from rfpsurvey._cli._margins import with_margins
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
from rfpsurvey._io import check_fits_text, read_table, suffix_of
from rfpsurvey._outputs import WRITABLE, check_output, check_separate
from rfpsurvey._units import to_center
from rfpsurvey.catalog import UNITS, as_catalog, is_example, to_time
from rfpsurvey.errors import check_choice, listed, used_elsewhere, warn_no_effect
from rfpsurvey.instrument import as_instrument, describe_states
from rfpsurvey.plans import is_plan, native_format, read_plan

__all__ = [
    "allocation_options",
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
    "model_of",
    "parse_center",
    "parse_pairs",
    "print_table",
    "read_assignment",
    "read_catalog",
    "read_targets",
    "seed_of",
    "targets_and_center",
    "to_mm",
    "units_of",
    "warn_without_catalog",
]

DEFAULT_CENTER = "06h20m00s +23d00m00s"


def parse_center(text: str | None):
    """Convert the text of the option --center to the field center; return None if the option is not given."""
    return None if text is None else to_center(text, "--center")


FORMS = {
    "--column": "ROLE=NAME",
    "--unit": "ROLE=UNIT",
    "--tiles-column": "ROLE=NAME",
    "--tiles-unit": "ROLE=UNIT",
    "--fill": "ROLE=VALUE",
    "--select": "COLUMN=VALUE",
    "--objective": "COLUMN=DIRECTION",
}


def parse_pairs(pairs: list[str] | None, option: str) -> dict[str, str]:
    """Convert options of the form NAME=VALUE to a dict."""
    found = {}
    for pair in pairs or []:
        name, sign, value = pair.partition("=")
        if not sign or not name or not value:
            raise rs.InputError(f"{option} must have the form {FORMS[option]}, got {pair!r}")
        found[name] = value
    return found


def model_of(
    instrument: str,
    arm_model: str | None = None,
    broken: Path | None = None,
    state_time: str | None = None,
    known_time: Callable[[], Time | None] | None = None,
    margins: str | None = None,
) -> "rs.Instrument":
    """Return an instrument with the options --arm-model, --broken and --margins; print a summary of the states.

    Without --state-time, the states in a TOML file and in the table of --broken are evaluated at the time that
    ``known_time`` returns.
    """
    time = asked = None if state_time is None else to_time(state_time, "--state-time")
    described = instrument.lower().endswith(".toml")
    if asked is None and known_time is not None and (described or broken is not None):
        time = known_time()
    model = as_instrument(instrument, time if described else asked)
    model = model if broken is None else model.with_states(broken, time=time)
    if states := describe_states(model):
        print(states)
    elif asked is not None:
        warn_no_effect("--state-time", "because no states of positioners are given")
    return with_margins(model if arm_model is None else model.with_arm_model(arm_model), margins)


def instrument_of(table, name: str | None, read: Callable[[str], "rs.Instrument"]) -> "rs.Instrument":
    """Return the instrument ``name`` or, if it is None, the instrument named in the table; ``read`` reads it."""
    provenance = table.meta.get("provenance")
    own = provenance.get("instrument", {}).get("name") if isinstance(provenance, dict) else None
    if own is None and is_plan(table):
        return read(name or table.meta["instrument"])
    if name is None and own is None:
        known = ", ".join(rs.available_instruments())
        raise rs.InputError(f"--instrument must name the instrument of the assignment: {known}, or a TOML file")
    instrument = read(name or own)
    if own is not None and own != instrument.name:
        raise rs.InputError(f"--instrument must be the instrument of the tile, {own}, got {instrument.name}")
    return instrument


def read_catalog(path: Path, column, unit, frame: str, fill, keep: list[str] | None = None, hdu: str | None = None):
    """Read a catalog from a file, or from a folder with the partitions of a catalog."""
    columns, units, fill = parse_pairs(column, "--column"), parse_pairs(unit, "--unit"), parse_pairs(fill, "--fill")
    if path.is_dir():
        if hdu is not None:
            raise rs.InputError(f"--hdu must be used only with FITS files, got the folder {path}")
        parts = rs.PartitionedCatalog(path, columns=columns, units=units, frame=frame, fill=fill, keep=keep)
        for name in ("collection", "columns"):
            if name in parts.meta:
                print(f"{name}: {parts.meta[name]}")
        return parts
    common = re.fullmatch(r"J\d+(\.\d+)?", columns.get("epoch", ""))  # the value is an epoch, not the name of a column
    if common:
        del columns["epoch"]
    catalog = rs.Catalog.read(path, columns=columns, units=units, frame=frame, fill=fill, keep=keep, hdu=hdu)
    print(f"columns: {catalog.meta['columns']}")
    return replace(catalog, epoch=common[0]) if common else catalog


def warn_without_catalog(**given) -> None:
    """Issue a warning for each given option that describes a catalog, although no catalog is given."""
    for name, value in given.items():
        if value and (name, value) != ("frame", "icrs"):
            warn_no_effect(f"--{name}", "without a catalog")


def seed_of(path: Path | str | None) -> AbstractContextManager[None]:
    """Return a context without warnings that the seed has no effect if it is also the seed of synthetic targets."""
    return used_elsewhere("rng") if path is None else nullcontext()


def targets_and_center(path, center, model, seed, column, unit, frame, fill, keep=None, hdu=None):
    """Read a catalog, or generate one if ``path`` is None; return the catalog and the field center (or None)."""
    field = parse_center(center)
    if path is None:
        warn_without_catalog(column=column, unit=unit, frame=frame, fill=fill, keep=keep, hdu=hdu)
        field = parse_center(DEFAULT_CENTER) if field is None else field
        return rs.synthetic_catalog("poisson", field, model.field_radius, density=model.target_density, rng=seed), field
    return as_catalog(read_catalog(path, column, unit, frame, fill, keep, hdu)), field


def _parse_circle(text: str) -> "rs.Region":
    """Convert text such as "95.0,23.0,0.01" (RA, Dec, radius in deg) to a circle; the text may begin with "cap"."""
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
    """Convert command-line options to an object of the class `AllocationOptions`."""
    own = require is not None and "instrument" in require
    if own and len(require) > 1:
        raise rs.InputError(
            "--require instrument must be the only option --require: it adds all requirements of the instrument"
        )
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
        subpriority=int(subpriority) if subpriority and re.fullmatch(r"\d{1,40}", subpriority) else subpriority,
    )


def read_assignment(path: Path, select: list[str] | None, hdu: str | None = None):
    """Read a table, and select the rows that match all pairs COLUMN=VALUE; values are compared as text."""
    if native_format(path) is None or hdu is not None:
        table = read_table(path, hdu, "; to read another table, give --hdu")
    else:
        table = read_plan(path)
    for name, value in parse_pairs(select, "--select").items():
        if name not in table.colnames:
            raise rs.InputError(f"--select: there is no column {name!r}; the columns are: {listed(table.colnames)}")
        table = table[[str(getattr(v, "value", v)) == value for v in table[name]]]
        if len(table) == 0:
            raise rs.InputError(f"--select {name}={value} selects no row")
    table.meta.update(file=path.name, select=", ".join(select or []))
    return table


def units_of(path: Path, unit: list[str] | None) -> dict[str, str]:
    """Return the units given with --unit; for CSV files, add the default units of all other columns."""
    usual = {role: str(u) for role, u in UNITS.items()} if suffix_of(path) in (".csv", ".tsv") else {}
    return {**usual, **parse_pairs(unit, "--unit")}


def to_mm(value: float | None):
    """Convert a length in mm to a Quantity; return None if the length is None."""
    return None if value is None else value * u.mm


def read_targets(name: str, hdu: str | None = None):
    """Read a catalog if ``name`` is a file or an example; otherwise return ``name``, a kind of random targets."""
    is_catalog = Path(name).suffix or is_example(name)
    return read_catalog(Path(name), None, None, "icrs", None, hdu=hdu) if is_catalog else name


def check_outputs(
    output: Path | None,
    plot: Path | None = None,
    report: Path | None = None,
    quality: Path | None = None,
    *,
    overwrite: bool,
    inputs: Iterable = (),
) -> None:
    """Raise an error if an output file cannot be written; commands call this function before they compute anything.

    ``inputs`` contains the paths of inputs, which outputs must not replace; values that are not paths are ignored.
    """
    check_separate((output, plot, report, quality), inputs)
    if output is not None:
        check_output(output, WRITABLE, overwrite=overwrite)
    for path in (plot, quality):
        if path is not None:
            check_output(path, PICTURES, overwrite=overwrite)
    if report is not None:
        rs.report.check_report(report, overwrite=overwrite)


def check_targets(color: str | None, plot: Path | None, catalog: "rs.Catalog | None" = None) -> None:
    """Raise an error if the targets in the plot cannot be colored as requested with the option --targets."""
    if color is None:
        return
    check_choice(color, rs.plot.COLORINGS, "--targets")
    if plot is None:
        raise rs.InputError("--targets colors the targets in a plot, and must be used with --plot")
    if catalog is not None and color in ("category", "priority") and getattr(catalog, color) is None:
        raise rs.InputError(
            f"--targets {color} needs the column {color}, which the catalog does not have; if the column has another "
            f"name, use --column {color}=NAME"
        )


def check_text(catalog: "rs.Catalog", instrument: "rs.Instrument", center, output: Path | None) -> None:
    """Raise an error if the output is a FITS file and the targets of the field have text that FITS cannot store."""
    if output is None or suffix_of(output) != ".fits" or len(catalog) == 0:
        return
    center = catalog.mean_direction if center is None else center
    targets = catalog.within(center, instrument.field_radius)
    columns = {"category": targets.category, **targets.arrays.extra}
    columns = {f"values of {name!r}": values for name, values in columns.items() if values is not None}
    columns = {"positioner ids": instrument.focal_plane.id, "target ids": targets.id, **columns}
    check_fits_text(columns, "write .ecsv instead")


def check_chart(plot: Path, report: Path | None, *, overwrite: bool) -> Path:
    """Return the path of the .ecsv file that is written beside a plot; raise an error if a file cannot be written."""
    output = plot.with_suffix(".ecsv")
    check_outputs(output, plot, report, overwrite=overwrite)
    return output
