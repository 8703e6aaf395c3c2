"""Commands whose options are keys, and functions that several commands share."""

import re
from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager, nullcontext
from functools import partial
from inspect import Parameter, Signature
from pathlib import Path
from types import SimpleNamespace
from typing import Annotated, Any

import typer
from astropy.table import Table

import rfpsurvey as rs
from rfpsurvey._cli import application as _main
from rfpsurvey._cli import command as _app
from rfpsurvey._cli.results import PICTURES, tell
from rfpsurvey._common.files import WRITABLE, check_output, check_separate, is_csv, is_fits
from rfpsurvey._common.io import check_fits_text, write_bytes
from rfpsurvey._common.read_tables import is_number, read_table
from rfpsurvey._common.units import to_center
from rfpsurvey._field.plan_files import is_plan, native_format, read_plan
from rfpsurvey._field.plan_values import find_instrument_file, recorded_instrument
from rfpsurvey._instruments.instrument import as_instrument
from rfpsurvey._sky.columns import UNITS
from rfpsurvey._sky.frames import select_rows
from rfpsurvey._sky.partitions import as_catalog
from rfpsurvey._survey import key_objects
from rfpsurvey._survey.history.rule import VisitRule
from rfpsurvey._survey.key_objects import Given, warn_without_catalog
from rfpsurvey._survey.key_objects import model_of as model_from_keys
from rfpsurvey._survey.key_objects import read_catalog as catalog_from_keys
from rfpsurvey._survey.key_types import Key, Part, add, build, keys_of
from rfpsurvey._survey.plan_file import DEFAULT_CENTER, allocator_of
from rfpsurvey.errors import InputError, check_choice, used_elsewhere

model_of = partial(model_from_keys, tell=tell)
read_catalog = partial(catalog_from_keys, tell=tell)


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
    name = name or recorded_instrument(table)
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


def read_assignment(keys) -> "tuple[Table, rs.Instrument | None]":
    """Read a table, select the rows with the given values of columns, and return it.

    For the file of a tile in the folder of a survey, return its plan and the instrument of the survey.
    """
    from rfpsurvey._survey.export import tile_at  # most commands read no tiles of surveys

    tile, planned = (None, None) if keys.hdu is not None else tile_at(keys.path) or (None, None)
    if tile is not None:
        table = tile.table
    elif native_format(keys.path) is None or keys.hdu is not None:
        table = read_table(keys.path, keys.hdu, "; to read another table, give --set catalog.hdu=NAME")
        find_instrument_file(table, keys.path)
    else:
        table = read_plan(keys.path)
    table, _ = select_rows(table, keys.select)
    select = ", ".join(f"{name}={value}" for name, value in (keys.select or {}).items())
    table.meta.update(file=keys.path.name, select=select)
    return table, None if planned is None else next(iter(planned.stored.values()))[0]


def units_of(path: Path, units: dict[str, str] | None) -> dict[str, str]:
    """Return the given units; for CSV files, add the default units of all other columns."""
    usual = {role: str(u) for role, u in UNITS.items()} if is_csv(path) else {}
    return {**usual, **(units or {})}


def check_outputs(output, inputs: Iterable = (), writable: Iterable[str] | None = WRITABLE) -> None:
    """Raise an error if an output file cannot be written; commands call this function before they compute anything.

    ``output`` contains the keys of the outputs, and ``inputs`` the paths of inputs, which outputs must not replace;
    values that are not paths are ignored. If ``writable`` is None, the library checks the table.
    """
    path, plot, report, quality = (getattr(output, name, None) for name in ("path", "plot", "report", "quality"))
    check_separate((path, plot, report, quality), inputs)
    if path is not None and writable is not None:
        check_output(path, writable, overwrite=output.overwrite)
    for figure in (plot, quality):
        if figure is not None:
            check_output(figure, PICTURES, overwrite=output.overwrite)
    if report is not None:
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


UNMET = 1
"""Exit code of a command with the option --strict if a requirement or a constraint is not met."""
SPELLINGS = {
    "instrument.name": "--instrument",
    "tiles.path": "--tiles",
    "catalog.path": "--catalog",
    "catalog.columns": "--column",
    "options.constraints": "--constraint",
    "output.path": "--output",
    "targets.kind": "--targets",
    "precision.standard_error": "--precision",
    "allocators": "--allocator",
    "methods": "--method",
    "objectives": "--objective",
}
"""Options of keys whose names are not the last part of the name of the key."""


class Command(_main.Command):
    """A command; its message for an unknown option states how ``--set`` sets a key of this name."""

    def parse_args(self, ctx, args: list[str]) -> list[str]:
        """Parse the words of the command line."""
        words = [part for word in args for part in (word.split("=", 1) if word.startswith("--") else [word])]
        try:
            return super().parse_args(ctx, args)
        except Exception as error:
            option, keys = str(getattr(error, "option_name", "")), self.callback.keys
            named = [key for key in keys if f"--{key.rpartition('.')[2].replace('_', '-')}" == option]
            if named:
                value = words[words.index(option) + 1 :][:1] if option in words else []
                error.possibilities = [f"--set {key}=VALUE" for key in _possible_keys(keys, named, *value)][:1]
            raise


def _possible_keys(keys: dict[str, Key | Part], names: list[str], value: str = "") -> list[str]:
    """Return the names of the keys whose values can be of the kind of the given value."""
    possible = []
    for name in names:
        key = keys[name]
        if isinstance(key, Part):
            continue
        is_entry = dict in key.kinds and "=" in value
        try:
            if value and not value.startswith("--") and bool not in key.kinds:
                key_objects.add_text(keys, {}, f"{name}{'.' if is_entry else '='}{value}", set())
                if key.texts_only(entry=is_entry) and is_number(value):
                    continue
        except InputError:
            continue
        possible.append(f"{name}.NAME" if is_entry else name)
    return possible


def command(
    cls: type,
    options: str,
    *,
    argument: str | None = None,
    app=None,
    epilog: str | None = None,
    strict: bool = False,
) -> Callable:
    """Return a decorator that makes a command of a function of an object of the dataclass ``cls``.

    ``options`` contains the names of the keys that have an option (see `_spelled`), and ``argument`` is the name of the
    key of the words without an option. If the latter is ``catalog.path``, the command also accepts a plan file, and
    calls the function with a second argument, `Given`. If ``strict`` is true, the function returns texts on the
    requirements and constraints that are not met, and the command has the option ``--strict``.
    """
    keys = keys_of(cls)
    spelled = dict(_spelled(spelling) for spelling in options.split())
    with_file = argument == "catalog.path"

    def decorate(function: Callable) -> Callable:
        title = function.__name__.replace("_", "-")

        def call(**typed):
            given = Given(title, keys, {})
            _read(given, typed, argument, spelled)
            settings = build(cls, given.values)
            if with_file and typed["write_plan"] is not None:
                _app.check_names(settings)
                _write(given, typed["write_plan"], overwrite=settings.output.overwrite)
            else:
                unmet = function(settings, *([given] if with_file else []))
                if unmet and typed.get("strict"):
                    raise typer.Exit(UNMET)

        others = ["a plan file (.toml)"] * with_file
        others += ["the folder of a survey"] * (with_file and "output.folder" in keys)
        parameters = [] if argument is None else [_argument(keys[argument], others)]
        parameters += [_option(keys[name], text) for name, text in spelled.items()]
        parameters += _further(Given(title, keys, {}), with_file=with_file)
        if strict:
            info = typer.Option("--strict", help=f"Exit with the code {UNMET} if a requirement or a rule is not met.")
            parameters.append(_parameter("strict", bool, False, info))
        call.__signature__ = Signature(parameters)
        call.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
        call.__name__, call.__doc__, call.keys = function.__name__, function.__doc__, keys
        summary = (function.__doc__ or "").partition("\n")[0]  # typer would cut it
        (app or _main.app).command(title, cls=Command, epilog=epilog, short_help=summary)(_main.with_level(call))
        return function

    return decorate


def _spelled(text: str) -> tuple[str, str]:
    """Return the name of a key and its option, for the name or for text such as ``tiles.path=--centers``."""
    name, _, option = text.partition("=")
    return name, option or SPELLINGS.get(name) or "--" + name.rpartition(".")[2].replace("_", "-")


def _read(given: Given, typed: dict, argument: str | None, spelled: dict[str, str]) -> None:
    """Add the values of a plan file, of --set, and of all other options, which override each other in this order."""
    keys, values, earlier = given.keys, given.values, set[str]()
    word = typed.get("argument")
    if typed.get("replan_") and word is not None and (folder := key_objects.survey_folder(word)) is not None:
        key_objects.add_file(keys, values, folder / key_objects.RECORD)
        add(keys, values, "output.folder", word)  # the folder may have been moved or copied
        word = None
    elif "write_plan" in typed and word is not None and key_objects.is_plan_file(word):
        key_objects.add_file(keys, values, Path(word))
        word = None
    for text in typed["set"] or []:
        key_objects.add_text(keys, values, text, earlier)
    if word not in (None, []):
        add(keys, values, argument, word)
    for name, option in spelled.items():
        value, key = typed[_variable(option)], keys[name]
        if value in (None, False, []):
            continue
        if dict in key.kinds:
            value = pairs(value, option)
        for entry in value if isinstance(value, list) and dict not in key.kinds else [value]:
            if isinstance(entry, str):
                key_objects.add_text(keys, values, f"{name}={entry}", earlier)
            else:
                add(keys, values, name, entry)


def pairs(texts: list[str], option: str, form: str = "NAME=VALUE") -> dict[str, str]:
    """Convert options of the form NAME=VALUE to a dict."""
    values = {}
    for text in texts:
        name, sign, value = text.partition("=")
        if not (sign and name and value):
            raise InputError(f"{option} must have the form {form}, got {text!r}")
        values[name] = value
    return values


def _write(given: Given, path: Path, *, overwrite: bool) -> None:
    """Write the plan file of a command."""
    check_output(path, (".toml",), overwrite=overwrite)
    write_bytes(path, given.to_toml(path.parent, documented=True).encode())
    print(f"wrote {path}; to run the plan: rfpsurvey {given.command} {path}")


def _variable(option: str) -> str:
    return option.lstrip("-").replace("-", "_") + "_"


def _parameter(name: str, annotation: Any, default: object, info: Any) -> Parameter:
    return Parameter(name, Parameter.KEYWORD_ONLY, annotation=Annotated[annotation, info], default=default)


def _help(key: Key) -> str:
    """Return the help of a key, with its unit and its default value."""
    shown, text = key_objects.default_text(key).strip('"'), key.text
    shown = "the current folder" if shown == "." else shown
    if key.unit is not None and f"({key.unit}" not in text:
        text = re.sub(r"\.( |$)", rf" ({key.unit}).\1", text, count=1)
        shown = shown if shown == "..." else f"{float(shown):g} {key.unit}"
    return text if shown in ("...", "false") else f"{text} By default, {shown}."


def _argument(key: Key, others: list[str]) -> Parameter:
    """Return the parameter of the words without an option; ``others`` are further meanings of its value."""
    text = _help(key) + (f" Or {' or '.join(others)}." if others else "")
    info = typer.Argument(help=text, metavar=key.name.partition(".")[0].upper())
    return _parameter("argument", list[str] | None if list in key.kinds else str | None, None, info)


def _option(key: Key, option: str) -> Parameter:
    """Return the parameter of the option of a key."""
    several, is_flag = list in key.kinds or dict in key.kinds, next(iter(key.kinds)) is bool
    metavar = None if is_flag else "NAME=VALUE" if dict in key.kinds else _variable(option)[:-1].upper()
    info = typer.Option(option, help=_help(key) + " The option may be repeated." * several, metavar=metavar)
    annotation = bool if is_flag else list[str] | None if several else str | None
    return _parameter(_variable(option), annotation, False if is_flag else None, info)


def _further(given: Given, *, with_file: bool) -> list[Parameter]:
    """Return the parameters of the options that all commands have."""

    def print_keys(wanted: bool) -> None:
        if wanted:
            print(given.to_toml(None, documented=True), end="")
            raise typer.Exit

    text = (
        "Set a key, such as rng=1 or a key that has no option; --help-keys lists all keys. The value has the syntax of "
        "TOML; other values are text. The option may be repeated."
    )
    parameters = [_parameter("set", list[str] | None, None, typer.Option("--set", metavar="KEY=VALUE", help=text))]
    info = typer.Option(
        "--help-keys", help="List all keys with their help, and exit.", callback=print_keys, is_eager=True
    )
    parameters.append(_parameter("help_keys", bool, False, info))
    if with_file:
        info = typer.Option(help="Write a plan file (.toml) with the values of all keys, and exit without planning.")
        parameters.append(_parameter("write_plan", Path | None, None, info))
    return parameters
