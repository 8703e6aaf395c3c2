"""Functions that several commands share: they parse options, read input files, and check output files."""

from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import fields, replace
from pathlib import Path
from types import SimpleNamespace

import astropy.units as u
from astropy.time import Time

import rfpsurvey as rs
from rfpsurvey._cli._print import PICTURES, print_text
from rfpsurvey._io import check_fits_text, is_fits, read_table
from rfpsurvey._outputs import WRITABLE, check_output, check_separate
from rfpsurvey._readers import is_csv
from rfpsurvey._units import to_center
from rfpsurvey.catalog import UNITS, as_catalog, select_rows, to_time
from rfpsurvey.constraints import Rule, as_constraints
from rfpsurvey.errors import check_choice, used_elsewhere, warn_no_effect
from rfpsurvey.instrument import as_instrument, describe_states
from rfpsurvey.observing import SITES, location
from rfpsurvey.plans import is_plan, native_format, read_plan
from rfpsurvey.survey import JOINT, VisitRule
from rfpsurvey.tiling import times_of_tiles

DEFAULT_CENTER = "06h20m00s +23d00m00s"


def parse_center(text: str | None):
    """Convert the text of the option --center to the field center; return None if the option is not given."""
    return None if text is None else to_center(text, "--center")


def model_of(keys, known_time: Callable[[], Time | None] | None = None) -> "rs.Instrument":
    """Return the instrument for its keys, and print a summary of the states of its positioners.

    Without ``state_time``, the states in a TOML file and in the table ``broken`` are evaluated at the time that
    ``known_time`` returns.
    """
    time = asked = None if keys.state_time is None else to_time(keys.state_time, "state_time")
    described = keys.name.lower().endswith(".toml")
    if asked is None and known_time is not None and (described or keys.broken is not None):
        time = known_time()
    model = as_instrument(keys.name, time if described else asked)
    model = model if keys.broken is None else model.with_states(keys.broken, time=time)
    if states := describe_states(model):
        print_text(states)
    elif asked is not None:
        warn_no_effect("state_time", "because no states of positioners are given")
    return with_margins(model if keys.arm_model is None else model.with_arm_model(keys.arm_model), keys.margins)


def conditions_of(given: dict) -> "rs.ObservingConditions | None":
    """Return the observing conditions for their keys, which replace the values of a file; None if there are no keys."""
    given = dict(given)
    if isinstance(site := given.get("site"), list) or "," in str(site):
        given["site"] = location(site if isinstance(site, list) else site.split(","))
    path = given.pop("path", None)
    if path is not None:
        return rs.ObservingConditions.read(path, **given)
    if given and "site" not in given:
        raise rs.InputError(
            f"conditions.site must be given to compute refraction: [LONGITUDE, LATITUDE, HEIGHT] or {', '.join(SITES)}"
        )
    return rs.ObservingConditions(**given) if given else None


def tiles_under(tiling: "rs.Tiling", given: dict) -> "rs.Tiling":
    """Add the observing conditions for their keys, if any are given, to a tiling; return the tiling."""
    if given and not {"time", "hour_angle"} & set(given) and rs.tiling.when_of(tiling.table) is not None:
        given = {**given, "hour_angle": 0 * u.hourangle}  # the time or hour angle in the table of tiles replaces it
    conditions = conditions_of(given)
    return tiling if conditions is None else tiling.with_conditions(conditions)


def time_of(conditions: "rs.ObservingConditions | None", epoch: object) -> Time | None:
    """Return the time of the observing conditions or, without such a time, the epoch; None if no time is known."""
    if conditions is not None and conditions.time is not None:
        return conditions.time
    return None if epoch is None else to_time(epoch, "epoch")


def time_of_tiles(tiling: "rs.Tiling | None", epoch: object, given: dict) -> Time | None:
    """Return the times of all tiles or, without times, the time of the epoch; None if no time is known."""
    if tiling is None:
        return time_of(conditions_of(given), epoch)
    times = times_of_tiles(tiles_under(tiling, given))
    return time_of(None, epoch) if times is None else times


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


def allocator_of(options: dict, joint: dict) -> "rs.AllocationOptions | rs.JointOptions":
    """Return the parameter ``allocator`` of `plan_survey` for the keys of the allocator and of a joint plan."""
    if options.get("allocator") == JOINT:
        first = rs.AllocationOptions(**{**options, "allocator": rs.JointOptions.allocator})
        return rs.JointOptions(**joint, allocator=first)
    for name in joint:
        warn_no_effect(f"joint.{name}", "without --allocator joint")
    return rs.AllocationOptions(**options)


def with_margins(model: "rs.Instrument", margins: dict) -> "rs.Instrument":
    """Return an instrument with the given margins or, if none are given, with its own margins."""
    given = dict(margins or {})
    if not given:
        return model
    start = rs.Margins()
    if given.pop("published", False):
        start = model.published_margins
        if not start:
            raise rs.InputError(
                "margins must give values, such as outer=0.1, because the description of the instrument has no margins"
            )
    return model.use_margins(replace(start, **given))


def instrument_of(table, name: str | None, read: Callable[[str], "rs.Instrument"]) -> "rs.Instrument":
    """Return the instrument ``name`` or, if it is None, the instrument named in the table; ``read`` reads it."""
    provenance = table.meta.get("provenance")
    own = provenance.get("instrument", {}).get("name") if isinstance(provenance, dict) else None
    if own is None and is_plan(table):
        name = name or table.meta.get("instrument")
    if not name and own is None:
        known = ", ".join(rs.available_instruments())
        raise rs.InputError(f"--instrument must name the instrument of the assignment: {known}, or a TOML file")
    instrument = read(name or own)
    if own is not None and own != instrument.name:
        raise rs.InputError(f"--instrument must be the instrument of the tile, {own}, got {instrument.name}")
    return instrument


def read_catalog(keys):
    """Read a catalog from a file, or from a folder with the partitions of a catalog."""
    options = {name: getattr(keys, name) or {} for name in ("columns", "units", "fill")}
    options |= {"frame": keys.frame, "keep": keys.keep}
    if keys.path.is_dir():
        for name in ("hdu", "epoch", "select"):
            if getattr(keys, name) is not None:
                kind = "FITS files" if name == "hdu" else "files"
                raise rs.InputError(f"{name} must be used only with {kind}, got the folder {keys.path}")
        parts = rs.catalog.PartitionedCatalog(keys.path, **options)
        for name in ("collection", "columns"):
            if name in parts.meta:
                print_text(f"{name}: {parts.meta[name]}")
        return parts
    catalog = rs.Catalog.read(keys.path, **options, hdu=keys.hdu, select=keys.select)
    print_text(f"columns: {catalog.meta['columns']}")
    return catalog if keys.epoch is None else replace(catalog, epoch=keys.epoch)


def with_columns_of_rules(keys, options: dict, model: "rs.Instrument"):
    """Return the keys of a catalog that also keep the columns of the catalog that the rules in the options use."""
    texts = [*(options.get("constraints") or ())]
    texts += [] if options.get("rules") is None else model.rules(options["rules"])
    names = [name for one in as_constraints(texts) if isinstance(one, Rule) for name in one.columns]
    return replace(keys, keep=[*dict.fromkeys([*(keys.keep or ()), *names])]) if names and keys.path else keys


def warn_without_catalog(keys) -> None:
    """Issue a warning for each given key that describes a catalog, although no catalog is given."""
    for one in fields(keys):
        if one.name != "visits" and getattr(keys, one.name) != one.default:
            warn_no_effect(f"catalog.{one.name}", "without a catalog")


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
