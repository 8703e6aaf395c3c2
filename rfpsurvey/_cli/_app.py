"""Functions that several commands share: they parse options, read input files, and check output files."""

from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager, nullcontext
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import rfpsurvey as rs
from rfpsurvey._cli._print import PICTURES, print_text
from rfpsurvey._io import check_fits_text, is_fits, read_table
from rfpsurvey._outputs import WRITABLE, check_output, check_separate
from rfpsurvey._readers import is_csv
from rfpsurvey._units import to_center
from rfpsurvey.catalog import UNITS, as_catalog, select_rows
from rfpsurvey.errors import check_choice, used_elsewhere
from rfpsurvey.inputs import model_of as model_from_keys
from rfpsurvey.inputs import read_catalog as catalog_from_keys
from rfpsurvey.inputs import warn_without_catalog
from rfpsurvey.instrument import as_instrument
from rfpsurvey.plans import is_plan, native_format, read_plan
from rfpsurvey.survey import DEFAULT_CENTER, VisitRule, allocator_of

model_of = partial(model_from_keys, tell=print_text)
read_catalog = partial(catalog_from_keys, tell=print_text)


def parse_center(text: str | None):
    """Convert the text of the option --center to the field center; return None if the option is not given."""
    return None if text is None else to_center(text, "--center")


def check_names(keys) -> None:
    """Raise an error if the instrument, the arm model or an allocator of a plan file is unknown, or an option is wrong.

    Files that the keys name are not read, except the description of the instrument.
    """
    if keys.instrument.name is not None:
        model = as_instrument(keys.instrument.name)
        if keys.instrument.arm_model is not None:
            model.with_arm_model(keys.instrument.arm_model)
    if hasattr(keys, "joint"):
        allocator_of(keys.options, keys.joint)
        VisitRule(**{name: value for name, value in keys.rule.items() if name != "table"})
    else:
        options = getattr(keys, "options", {})
        rs.AllocationOptions(**(options if isinstance(options, dict) else vars(options)))
    for name in getattr(keys, "allocators", None) or ():
        rs.AllocationOptions(name)


def instrument_of(table, name: str | None, read: Callable[[str], "rs.Instrument"]) -> "rs.Instrument":
    """Return the instrument ``name`` or, if it is None, the instrument named in the table; ``read`` reads it."""
    provenance = table.meta.get("provenance")
    name_in_table = provenance.get("instrument", {}).get("name") if isinstance(provenance, dict) else None
    if name_in_table is None and is_plan(table):
        name = name or table.meta.get("instrument")
    if not name and name_in_table is None:
        known = ", ".join(rs.available_instruments())
        raise rs.InputError(f"--instrument must name the instrument of the assignment: {known}, or a TOML file")
    instrument = read(name or name_in_table)
    if name_in_table is not None and name_in_table != instrument.name:
        raise rs.InputError(f"--instrument must be the instrument of the tile, {name_in_table}, got {instrument.name}")
    return instrument


def seed_of(path: Path | str | None) -> AbstractContextManager[None]:
    """Return a context without warnings that the seed has no effect if it is also the seed of synthetic targets."""
    return used_elsewhere("rng") if path is None else nullcontext()


def targets_and_center(keys, center: str | None, model: "rs.Instrument", seed: int):
    """Read a catalog, or generate one if no path is given; return the catalog and the field center (or None)."""
    field = parse_center(center)
    if keys.path is None:
        warn_without_catalog(keys)
        field = parse_center(DEFAULT_CENTER) if field is None else field
        return rs.synthetic_catalog("poisson", field, model.field_radius, density=model.target_density, rng=seed), field
    return as_catalog(read_catalog(keys)), field


def read_assignment(keys):
    """Read a table, and select the rows with the given values of columns."""
    if native_format(keys.path) is None or keys.hdu is not None:
        table = read_table(keys.path, keys.hdu, "; to read another table, give --set catalog.hdu=NAME")
    else:
        table = read_plan(keys.path)
    table, _ = select_rows(table, keys.select)
    select = ", ".join(f"{name}={value}" for name, value in (keys.select or {}).items())
    table.meta.update(file=keys.path.name, select=select)
    return table


def units_of(path: Path, units: dict[str, str] | None) -> dict[str, str]:
    """Return the given units; for CSV files, add the default units of all other columns."""
    usual = {role: str(u) for role, u in UNITS.items()} if is_csv(path) else {}
    return {**usual, **(units or {})}


def check_outputs(output, inputs: Iterable = (), writable: Iterable[str] | None = WRITABLE) -> None:
    """Raise an error if an output file cannot be written; commands call this function before they compute anything.

    ``output`` contains the keys of the outputs, and ``inputs`` the paths of inputs, which outputs must not replace;
    values that are not paths are ignored. If ``writable`` is None, the library checks the table.
    """
    path, quality = getattr(output, "path", None), getattr(output, "quality", None)
    check_separate((path, output.plot, output.report, quality), inputs)
    if path is not None and writable is not None:
        check_output(path, writable, overwrite=output.overwrite)
    for figure in (output.plot, quality):
        if figure is not None:
            check_output(figure, PICTURES, overwrite=output.overwrite)
    if output.report is not None:
        rs.report.check_report(output.report, overwrite=output.overwrite)


def check_targets(output, catalog: "rs.Catalog | None" = None) -> None:
    """Raise an error if the targets in the plot cannot be colored as the key ``output.targets`` requests."""
    color = output.targets
    if color is None:
        return
    check_choice(color, rs.plot.COLORINGS, "output.targets")
    if output.plot is None:
        raise rs.InputError("output.targets colors the targets in a plot, and must be used with --plot")
    if catalog is not None and color in ("category", "priority") and getattr(catalog, color) is None:
        raise rs.InputError(
            f"output.targets={color} needs the column {color}, which the catalog does not have; if the column has "
            f"another name, use --column {color}=NAME"
        )


def check_text(catalog: "rs.Catalog", instrument: "rs.Instrument", center, output: Path | None) -> None:
    """Raise an error if the output is a FITS file and the targets of the field have text that FITS cannot store."""
    if output is None or not is_fits(output) or len(catalog) == 0:
        return
    center = catalog.mean_direction if center is None else center
    targets = catalog.within(center, instrument.field_radius)
    columns = {"category": targets.category, **targets.arrays.extra}
    columns = {f"values of {name!r}": values for name, values in columns.items() if values is not None}
    columns = {"positioner ids": instrument.focal_plane.id, "target ids": targets.id, **columns}
    check_fits_text(columns, "write .ecsv instead")


def check_chart(output):
    """Return the keys of the outputs with the path of the .ecsv file beside the plot; check all files."""
    output = SimpleNamespace(**vars(output), path=output.plot.with_suffix(".ecsv"))
    check_outputs(output)
    return output
