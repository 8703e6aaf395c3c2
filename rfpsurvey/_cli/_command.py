"""Commands whose options are keys: the decorator of the functions of commands, and their record in plan files."""

from collections.abc import Callable
from inspect import Parameter, Signature
from pathlib import Path
from typing import Annotated, Any

import typer

from rfpsurvey import inputs
from rfpsurvey._cli import _app, _main
from rfpsurvey._io import write_bytes
from rfpsurvey._outputs import check_output
from rfpsurvey._readers import is_number
from rfpsurvey.errors import InputError
from rfpsurvey.inputs import Given, Key, Part, add, build, keys_of

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
                inputs.add_text(keys, {}, f"{name}{'.' if is_entry else '='}{value}", set())
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
) -> Callable:
    """Return a decorator that makes a command of a function of an object of the dataclass ``cls``.

    ``options`` contains the names of the keys that have an option (see `_spelled`), and ``argument`` is the name of the
    key of the words without an option. If the latter is ``catalog.path``, the command also accepts a plan file, and
    calls the function with a second argument, `Given`.
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
                function(settings, *([given] if with_file else []))

        parameters = [] if argument is None else [_argument(keys[argument])]
        parameters += [_option(keys[name], text) for name, text in spelled.items()]
        parameters += _further(Given(title, keys, {}), with_file=with_file)
        call.__signature__ = Signature(parameters)
        call.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
        call.__name__, call.__doc__, call.keys = function.__name__, function.__doc__, keys
        (app or _main.app).command(title, cls=Command, epilog=epilog)(call)
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
    if typed.get("replan_") and word is not None and (folder := inputs.survey_folder(word)) is not None:
        inputs.add_file(keys, values, folder / inputs.RECORD)
        add(keys, values, "output.folder", word)  # the folder may have been moved or copied
        word = None
    elif "write_plan" in typed and word is not None and inputs.is_plan_file(word):
        inputs.add_file(keys, values, Path(word))
        word = None
    for text in typed["set"] or []:
        inputs.add_text(keys, values, text, earlier)
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
                inputs.add_text(keys, values, f"{name}={entry}", earlier)
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
    """Return the help of a key, with its default value."""
    shown = inputs.default_text(key).strip('"')
    return key.text if shown in ("...", "false") else f"{key.text} By default, {shown}."


def _argument(key: Key) -> Parameter:
    """Return the parameter of the words without an option."""
    info = typer.Argument(help=_help(key), metavar=key.name.partition(".")[0].upper())
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
