"""Plan files, which are TOML files with the values of keys, and the objects that keys describe."""

import hashlib
import json
import os
import re
import tomllib
from collections.abc import Callable, Collection
from contextvars import ContextVar
from dataclasses import MISSING, dataclass, fields, replace
from datetime import date, datetime
from pathlib import Path
from textwrap import wrap

import astropy.units as u
from astropy.table import QTable
from astropy.time import Time

from rfpsurvey._assignment.constraints.rule import Rule
from rfpsurvey._assignment.constraints.text import as_constraints
from rfpsurvey._common.read_documents import is_present, open_file, read_toml
from rfpsurvey._field.facts import versions
from rfpsurvey._instruments.instrument import Instrument, as_instrument
from rfpsurvey._instruments.margins import Margins
from rfpsurvey._instruments.states import describe_states
from rfpsurvey._sky.catalog import Catalog
from rfpsurvey._sky.conditions import SITES, ObservingConditions, location
from rfpsurvey._sky.partitions import PartitionedCatalog
from rfpsurvey._sky.time import to_time
from rfpsurvey._survey.key_types import Key, Part, add, find, located
from rfpsurvey._survey.tiling.columns import times_of_tiles, when_of
from rfpsurvey._survey.tiling.tiling import Tiling, in_passes
from rfpsurvey.errors import InputError, warn, warn_no_effect


def no_output(text: str) -> None:
    """Ignore a text, in place of a function that prints it."""


def model_of(
    keys, known_time: Callable[[], Time | None] | None = None, *, tell: Callable[[str], None] = no_output
) -> Instrument:
    """Return the instrument for its keys; ``tell`` is called with a summary of the states of its positioners.

    Without ``state_time``, the states in a TOML file and in the table ``broken`` are evaluated at the time that
    ``known_time`` returns, and the states in a log of DESI if these are the times of tiles.
    """
    time = asked = None if keys.state_time is None else to_time(keys.state_time, "state_time")
    described, has_log = keys.name.lower().endswith(".toml"), any(Path(keys.name).glob("desi-state_*"))
    if asked is None and known_time is not None and (described or has_log or keys.broken is not None):
        time = known_time()
    of_log = asked if time is None or time.isscalar else time  # a log is evaluated at the times of tiles
    model = as_instrument(keys.name, time if described else of_log, may_be_dated=True)
    model = model if keys.broken is None else model.with_states(keys.broken, time=time)
    if states := describe_states(model):
        tell(states)
    elif asked is not None:
        warn_no_effect("state_time", "because no states of positioners are given")
    return with_margins(model if keys.arm_model is None else model.with_arm_model(keys.arm_model), keys.margins)


def any_time() -> Time:
    """Return a time for instruments of which only properties are used that do not depend on time."""
    return Time(2000.0, format="jyear")


def conditions_of(given: dict) -> ObservingConditions | None:
    """Return the observing conditions for their keys, which replace the values of a file; None if there are no keys."""
    given = dict(given)
    if isinstance(site := given.get("site"), list) or "," in str(site):
        given["site"] = location(site if isinstance(site, list) else site.split(","))
    if (path := given.pop("path", None)) is not None:
        return ObservingConditions.read(path, **given)
    if given and "site" not in given:
        raise InputError(
            f"conditions.site must be given to compute refraction: [LONGITUDE, LATITUDE, HEIGHT] or {', '.join(SITES)}"
        )
    return ObservingConditions(**given) if given else None


def read_tiles(keys, *, tell: Callable[[str], None] = no_output) -> Tiling | None:
    """Return a table of tiles or centers, or None without a file; ``tell`` is called with the columns it uses."""
    columns, units = keys.columns or {}, keys.units or {}
    if keys.path is None:
        for name, value in {"columns": columns, "units": units, "hdu": keys.hdu, "select": keys.select}.items():
            if value:
                warn_no_effect(f"tiles.{name}", "without a table of tiles")
        return None
    tiling = Tiling.read(keys.path, columns, units, keys.hdu, keys.select)
    meta = tiling.table.meta
    if any(role != name for role, name in meta["columns"].items()):
        said = ", ".join(f"{role}: {name}" for role, name in meta["columns"].items())
        more = [f"; {name}: {meta[name]}" for name in ("omitted", "selected") if name in meta]
        tell(f"columns of tiles: {said}" + "".join(more))
    return tiling


def tiling_of(keys) -> Tiling | None:
    """Return the tiles of the planned passes; None if they have no table."""
    return in_passes(read_tiles(keys.tiles), keys.tiles.passes)


def tiles_under(tiling: Tiling, given: dict) -> Tiling:
    """Add the observing conditions for their keys, if any are given, to a tiling; return the tiling."""
    is_open = given and not {"time", "hour_angle"} & set(given)
    if is_open and when_of(tiling.table) is None and "mjd" in tiling.table.colnames:
        tiling = Tiling(QTable({**tiling.table, "time": tiling.times.isot}, meta=tiling.table.meta))
    if is_open and when_of(tiling.table) is not None:
        given = {**given, "hour_angle": 0 * u.hourangle}  # the time or hour angle in the table of tiles replaces it
    conditions = conditions_of(given)
    return tiling if conditions is None else tiling.with_conditions(conditions)


def time_of(conditions: ObservingConditions | None, epoch: object) -> Time | None:
    """Return the time of the observing conditions or, without such a time, the epoch; None if no time is known."""
    if conditions is not None and conditions.time is not None:
        return conditions.time
    return None if epoch is None else to_time(epoch, "epoch")


def time_of_tiles(tiling: Tiling | None, epoch: object, given: dict) -> Time | None:
    """Return the times of all tiles or, without times, the time of the epoch; None if no time is known."""
    if tiling is None:
        return time_of(conditions_of(given), epoch)
    times = times_of_tiles(tiles_under(tiling, given))
    return time_of(None, epoch) if times is None else times


def with_margins(model: Instrument, margins: dict) -> Instrument:
    """Return an instrument with the given margins or, if none are given, with its own margins."""
    given = dict(margins or {})
    if not given:
        return model
    start = Margins()
    if given.pop("published", False):
        start = model.published_margins
        if not start:
            raise InputError(
                "margins must give values, such as outer=0.1, because the description of the instrument has no margins"
            )
    return model.use_margins(replace(start, **given))


def read_catalog(keys, *, tell: Callable[[str], None] = no_output) -> Catalog | PartitionedCatalog:
    """Read a catalog from a file, or from a folder with the partitions of a catalog."""
    options = {name: getattr(keys, name) or {} for name in ("columns", "units", "fill")}
    options |= {"frame": keys.frame, "keep": keys.keep}
    if keys.path.is_dir():
        for name in ("hdu", "epoch", "select"):
            if getattr(keys, name) is not None:
                kind = "FITS files" if name == "hdu" else "files"
                raise InputError(f"{name} must be used only with {kind}, got the folder {keys.path}")
        parts = PartitionedCatalog(keys.path, **options)
        for name in ("collection", "columns"):
            if name in parts.meta:
                tell(f"{name}: {parts.meta[name]}")
        return parts
    catalog = Catalog.read(keys.path, **options, hdu=keys.hdu, select=keys.select)
    if "columns" in catalog.meta:
        tell(f"columns: {catalog.meta['columns']}")
    return catalog if keys.epoch is None else replace(catalog, epoch=keys.epoch)


def with_columns_of_rules(keys, options: dict, model: Instrument):
    """Return the keys of a catalog that also keep the columns of the catalog that the rules in the options use."""
    texts = [*(options.get("constraints") or ())]
    texts += [] if options.get("rules") is None else model.rules(options["rules"])
    names = [name for rule in as_constraints(texts) if isinstance(rule, Rule) for name in rule.columns]
    return replace(keys, keep=[*dict.fromkeys([*(keys.keep or ()), *names])]) if names and keys.path else keys


def warn_without_catalog(keys) -> None:
    """Issue a warning for each given key that describes a catalog, although no catalog is given."""
    for key in fields(keys):
        if key.name != "visits" and getattr(keys, key.name) != key.default:
            warn_no_effect(f"catalog.{key.name}", "without a catalog")


RECORD = "plan.toml"
"""Name of the plan file in the folder of a survey."""
INPUTS = "inputs"
"""Folder of the inputs that no other file describes, in the folder of a survey; their names contain checksums."""
STORED = re.compile(r"-([0-9a-f]{16})\.(?:fits|ecsv)$")
PLAN_FILE: ContextVar[Callable[[Path], str] | None] = ContextVar("PLAN_FILE", default=None)
"""Function of the folder of a survey that returns the text of its plan file, while a command plans the survey."""

WIDTH = 80
# Keys that plan files and records do not contain: they state how one run of a command treats its outputs.
OF_ONE_RUN = ("output.resume", "output.replan", "output.overwrite")


ABOUT_PATHS = "Paths are relative to the folder of this file."


@dataclass(frozen=True)
class Given:
    """The values of the keys of a command that were given, from which a plan file can be written."""

    command: str
    keys: dict
    values: dict

    def to_toml(self, folder: Path | None, *, documented: bool = False) -> str:
        """Return the text of a plan file in a folder; if ``documented``, with the help of all keys."""
        lines, table = [f"# Run this file with: rfpsurvey {self.command} FILE", f"# {ABOUT_PATHS}"], ""
        known = [key for key in self.keys.values() if not isinstance(key, Part) and key.name not in OF_ONE_RUN]
        tops = ["", *dict.fromkeys(key.name.partition(".")[0] for key in known)]

        def place(key: Key) -> tuple[int, int]:  # keys without a table first; the tables inside a table after its keys
            top, dot, inner = key.name.partition(".")
            return (tops.index(top) if dot else 0), inner.count(".")

        for key in sorted(known, key=place):
            if key.name not in self.values and not documented:
                continue
            head, _, name = key.name.rpartition(".")
            if head != table:
                table = head
                lines += ["", f"[{table}]"]
            if documented:
                lines += ["", *(f"# {line}" for line in wrap(_help(key), WIDTH - 2))]
            if key.name in self.values:
                lines.append(f"{name} = {_text(_moved(key, self.values[key.name], folder or Path()))}")
            else:
                lines.append(f"# {name} = {default_text(key)}")
        return "\n".join(lines) + "\n"

    def record(self, folder: Path, tables: Collection[str] = ("options",), outputs: Collection[str] = ()) -> str:
        """Return the text of a plan file with the version, and with the given and default values of keys.

        Of outputs, only ``outputs`` are written. Of the tables whose keys are parameters of a class of the library,
        only ``tables`` have default values. Without given values, other tables have no effect; their values could also
        be those of a file or of the instrument.
        """
        parts = tuple(f"{name}." for name, key in self.keys.items() if isinstance(key, Part) and name not in tables)
        plain = [key for key in self.keys.values() if isinstance(key, Key) and not key.name.startswith(parts)]
        values = {key.name: value for key in plain if (value := _default(key)) is not None} | self.values
        values = {name: value for name, value in values.items() if not name.startswith("output.") or name in outputs}
        text = Given(self.command, self.keys, values).to_toml(folder)
        version = versions()["rfpsurvey"]
        about = f"# rfpsurvey {version}; keys without a value have the default values of this version.\n"
        return text.replace(f"{ABOUT_PATHS}\n", f"{ABOUT_PATHS}\n{about}", 1)


def is_plan_file(path: object) -> bool:
    """Return whether the path in place of a catalog is the path of a plan file."""
    return Path(str(path)).suffix.lower() == ".toml"


def survey_folder(path: object) -> Path | None:
    """Return the path if it is the folder of a survey with a plan file, and None if it is no folder of a survey."""
    folder = Path(str(path))
    if not (folder / "survey.json").is_file():
        return None
    if not (folder / RECORD).is_file():
        raise InputError(
            f"{folder} must contain the file {RECORD}, got a survey that version 0.3 planned in Python; plan the rest "
            "with visits=Survey.state(...), or give the catalog and all options of the first plan, with --folder "
            f"{folder} --replan"
        )
    return folder


def add_file(keys: dict, values: dict, path: Path) -> None:
    """Add the values of all keys in a plan file, whose paths are relative to its folder, to ``values``."""
    content = read_toml(path)
    try:
        add(keys, values, "", content, path.parent)
    except InputError as error:
        raise type(error)(f"{path}: {error}") from None
    for value in values.values():
        if isinstance(value, str) and (match := STORED.search(value)) and Path(value).parent.name == INPUTS:
            _check_stored(path.parent / INPUTS / Path(value).name, match[1])


def _check_stored(path: Path, checksum: str) -> None:
    """Raise an error if an input that `plan_survey` wrote does not have the checksum in its name."""
    if not is_present(path):
        raise InputError(f"{path} is missing")
    with open_file(path) as file:
        if not hashlib.file_digest(file, "sha256").hexdigest().startswith(checksum):
            raise InputError(f"{path} is damaged (its checksum differs from the checksum in its name)")


def add_text(keys: dict, values: dict, text: str, earlier: set[str]) -> None:
    """Add the value in a text of the form KEY=VALUE to ``values``.

    The value has the syntax of TOML; other values are text. Values of lists are added to the ``earlier`` values, which
    are those of the names of keys for which this function was called before.
    """
    name, sign, value = (part.strip() for part in text.partition("="))
    if not (name and sign and value):
        raise InputError(f"--set must have the form KEY=VALUE, such as joint.time_limit=600, got {text!r}")
    key, entry_name = find(keys, name)
    parsed = _value(value)
    if isinstance(key, Key):
        is_table = isinstance(parsed, dict) and dict in key.kinds and not entry_name
        if key.texts_only(entry=bool(entry_name)) and not (is_table or isinstance(parsed, str | list)):
            parsed = value
        if list in key.kinds and key.name in earlier:
            before, new = (value if isinstance(value, list) else [value] for value in (values[key.name], parsed))
            parsed = [*before, *new]
        earlier.add(key.name)
    add(keys, values, name, parsed)


def _value(text: str) -> object:
    try:
        table = tomllib.loads(f"value = {text}")
    except (ValueError, RecursionError):
        return text
    # of the forms of numbers in TOML, only decimal numbers are likely to be intended on a command line
    unusual = re.search(r"\d_\d|\b0[box]", re.sub(r"'[^']*'|\"[^\"]*\"", "", text))
    return table["value"] if len(table) == 1 and not unusual else text


def _help(key: Key) -> str:
    """Return the help of a key, with the type and the limits of its values."""
    limits = key.field.option.limits()
    return f"{key.text.rstrip('.')}. Value: {key.words}{',' if limits and key.unit else ''}{limits}."


def _moved(key: Key, value: object, folder: Path) -> object:
    """Return the value of a key; relative paths, and paths in the folder of the plan file, are relative to it."""
    if not key.is_path or not isinstance(value, str):
        return value
    if Path(value).is_absolute():
        inside = Path(value).is_relative_to(folder.resolve())
        return Path(value).relative_to(folder.resolve()).as_posix() if inside else value
    is_name = located(value, Path(), always=not key.is_located) == value and not Path(value).exists()
    if value.startswith("example:") or (key.is_located and is_name):
        return value
    return Path(os.path.relpath(value, folder)).as_posix()


def default_text(key: Key) -> str:
    """Return the default value of a key in TOML, or dots if there is none."""
    value = _default(key)
    return "..." if value is None else _text(value)


def _default(key: Key) -> object:
    """Return the default value of a key, in the form in which TOML contains it, or None if there is none."""
    value = key.field.default
    if isinstance(value, u.Quantity):
        value = float(value.to_value(key.unit or value.unit))
    return None if value is MISSING or callable(value) or value == () else value


def _text(value: object) -> str:
    """Return a value in the syntax of TOML."""
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{_name(name)} = {_text(entry)}" for name, entry in value.items()) + " }"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_text, value)) + "]"
    if isinstance(value, date | datetime):
        return value.isoformat()
    if isinstance(value, bool | int):
        return json.dumps(value)
    if isinstance(value, float):
        return str(value)
    text = str(value).encode("utf-8", "surrogateescape").decode("utf-8", "replace")
    if text != str(value):
        warn(f"a plan file can contain only text in UTF-8; \ufffd replaces other bytes of {text}")
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def _name(name: str) -> str:
    return name if name.isascii() and name.replace("_", "a").replace("-", "a").isalnum() else _text(name)
