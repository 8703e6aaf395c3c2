"""Parts of plans and their files: columns, keywords that describe the projection, and the instrument."""

import re
from pathlib import Path
from typing import NamedTuple

import astropy.units as u
import numpy as np
from astropy.table import QTable, Table

from rfpsurvey._common.read_documents import is_present
from rfpsurvey._common.read_tables import is_number
from rfpsurvey._instruments.instrument import as_instrument, available_instruments
from rfpsurvey._sky.arrays import JOINED
from rfpsurvey.errors import InputError

PREFIX = "rfpsurvey."
ENTRIES = ("north_of", "projection", "conditions", "survey", "instrument_digest")
"""Entries of the ``meta`` of a plan that describe how it was made: the projection, the survey and the instrument."""
INSTRUMENT_FILE = "instrument_file"
"""Entry of the ``meta`` of a plan with the path of the file that describes its instrument."""
DIGEST = re.compile("[0-9a-f]{16}")


COLUMNS = dict.fromkeys(("positioner", "fiber_type", "target_id", "kind", "assigned"))
COLUMNS |= dict.fromkeys(("x", "y"), u.mm) | dict.fromkeys(("theta", "phi", "ra", "dec"), u.deg)
COLUMNS |= {"pm_ra": u.mas / u.yr, "pm_dec": u.mas / u.yr, "priority": None}
"""Common columns of all plans, in this order, with their units; ``theta`` to ``priority`` are optional."""


class Native(NamedTuple):
    """The description of a column of a file of another program."""

    name: str
    type: str
    """NumPy type or FITS format of the column in a new file."""
    common: str = ""
    """Name of the column in a plan, if it is one of `COLUMNS`, whose unit it then has."""
    required: bool = False
    """Whether each file has the column."""
    usual: object = None
    """Value of fibers for which a plan has no value, in a new file; None if the value differs between fibers."""
    kinds: str = ""
    """Kinds of NumPy types that the column can have in files; empty if this is not checked."""

    @property
    def unit(self) -> u.UnitBase | None:
        """Unit of the column, or None."""
        return COLUMNS.get(self.common)


def make_plan(columns: dict, native: dict, *, format: str, instrument: str, header: dict, **meta) -> QTable:  # noqa: A002
    """Return the table of a plan.

    ``columns`` contains the common columns of all plans (`COLUMNS`) as quantities, or as arrays without units in the
    units of `COLUMNS`. ``native`` contains the other columns of the file. Entries of ``meta`` that are None are
    omitted. A column of the file that has the name of a common column is renamed (`own_name`).
    """
    table = QTable()
    for name, unit in COLUMNS.items():
        if name in columns:
            table[name] = columns[name] if unit is None else u.Quantity(columns[name], unit, copy=True)
    for name, values in native.items():
        table[own_name(name)] = values
    entries = {"format": format, "instrument": instrument, **meta, "header": dict(header)}
    table.meta = {name: value for name, value in entries.items() if value is not None}
    return table


def own_name(name: str) -> str:
    """Return the name in a plan of a column of a file; columns with the name of a common column are renamed."""
    return f"{name}_in_file" if name in COLUMNS else name


def texts_of_lost(plan: QTable, known: set[str], format: str, *, several_roles: bool = False) -> list[str]:  # noqa: A002
    """Return texts on all columns except ``known`` of a plan and on its header, if a format cannot represent them.

    ``several_roles`` is whether the format can represent targets with several roles.
    """
    names = [name for name in plan.colnames if name not in known]
    texts = [f"the column{'s' if len(names) > 1 else ''} {', '.join(names)}"] if names else []
    if plan.meta["format"] not in (format, "tile") and plan.meta["header"]:
        texts.append("the keywords of the header")
    kinds = np.asarray(plan["kind"]).astype(str)
    if not several_roles and (several := np.unique(kinds[np.isin(kinds, JOINED)])).size:
        lost = sorted({role for kind in several.tolist() for role in kind.split("+")[:-1]})
        texts.append(f"the role{'s' * (len(lost) > 1)} {' and '.join(lost)} of targets that have several roles")
    return texts


def to_type(values: np.ndarray, dtype: str, what: str) -> np.ndarray:
    """Return values as integers or floats of a NumPy type; raise an error if this type cannot represent a value."""
    values, dtype = np.asarray(values), np.dtype(dtype)
    if values.dtype == dtype:
        return values
    if dtype.kind == "f":
        limit, numbers = np.finfo(dtype).max, values.astype(float)
        wrong = np.isfinite(numbers) & (np.abs(numbers) > limit)
        range_of = f"numbers from {-limit:g} to {limit:g}"
    else:
        low, high = np.iinfo(dtype).min, np.iinfo(dtype).max
        range_of = f"whole numbers from {low} to {high}"
        # integers and text are converted by Python, whose integers have no limits
        numbers = np.array([_whole(value) for value in values.ravel().tolist()], dtype=object).reshape(values.shape)
        wrong = np.array([not (n is not None and low <= n <= high) for n in numbers.flat]).reshape(values.shape)
    if wrong.any():
        raise InputError(f"{what} must be {range_of}, got {values[wrong].flat[0]}")
    return numbers.astype(dtype)


def _whole(value: object) -> int | None:
    """Return a number or text as an integer; None if it is not a whole number."""
    try:
        number = int(value)
        return number if isinstance(value, str) or number == value else None
    except (ValueError, OverflowError, TypeError):
        return None


def to_keywords(meta: dict) -> dict:
    """Return keywords of a file that contain the description of the projection in the ``meta`` of a plan."""
    keywords = {}

    def add(name, value):
        if isinstance(value, dict):
            for key, entry in value.items():
                add(f"{name}.{key}", entry)
        elif value is not None:
            keywords[name] = value

    for name in ENTRIES:
        add(PREFIX + name, meta.get(name))
    return keywords


def from_keywords(header: dict) -> dict:
    """Return the entries of the ``meta`` of a plan that `to_keywords` wrote to a file."""
    entries: dict = {}
    for name, value in header.items():
        if not name.lower().startswith(PREFIX):
            continue
        *groups, last = name[len(PREFIX) :].split(".")
        entry = entries
        for group in groups:
            entry = entry.setdefault(group, {}) if isinstance(entry, dict) else {}
        if isinstance(entry, dict):
            is_text_of_number = groups[:1] == ["conditions"] and isinstance(value, str) and is_number(value)
            entry[last] = float(value) if is_text_of_number else value
    return {name: entries[name] for name in ENTRIES if name in entries}


def without_keywords(header: dict) -> dict:
    """Return the keywords of a file without those that `to_keywords` wrote."""
    return {name: value for name, value in header.items() if not name.lower().startswith(PREFIX)}


def instrument_file(digest: str) -> str:
    """Return the name of the file of an instrument that is not a preset, in the folder of its plans."""
    return f"instrument-{digest}.ecsv"


def _about_instrument(table: Table) -> tuple[object, str]:
    """Return the name and the digest of the instrument that a plan or a tile records; empty text if there is none."""
    provenance = table.meta.get("provenance")
    if isinstance(provenance, dict):
        about = provenance.get("instrument", {})
        name, digest = (about.get(entry) for entry in ("name", "digest")) if isinstance(about, dict) else ("", "")
    else:
        name, digest = table.meta.get("instrument"), table.meta.get("instrument_digest")
    return name, digest if isinstance(digest, str) and DIGEST.fullmatch(digest) else ""


def find_instrument_file(table: Table, path: Path) -> None:
    """Add to the ``meta`` of a plan the path of the file of its instrument, if the folder of the plan contains it."""
    _, digest = _about_instrument(table)
    table.meta.pop(INSTRUMENT_FILE, None)
    if digest and is_present(file := path.with_name(instrument_file(digest))):
        table.meta[INSTRUMENT_FILE] = str(file)


def recorded_instrument(table: Table) -> str | None:
    """Return the path or the preset of the instrument with which a plan was made; None if it is not known.

    An error is raised for the plan of a survey, which would be scored with an instrument other than its own.
    """
    name, digest = _about_instrument(table)
    if path := table.meta.get(INSTRUMENT_FILE):
        return path
    is_preset = bool(digest) and name in available_instruments()
    if is_preset and as_instrument(name).provenance["digest"] == digest:
        return name
    if digest and survey_entry(table):
        raise InputError(
            f"instrument must be given, because the plan was not made with an unchanged preset, and its folder lacks "
            f"the file {instrument_file(digest)}, got none"
        )
    return None


def survey_entry(table: Table) -> dict:
    """Return the entry ``survey`` of a plan or a tile that was exported from a survey; an empty dict for others."""
    provenance = table.meta.get("provenance")
    entries = provenance.get("parameters", {}) if isinstance(provenance, dict) else table.meta
    entry = entries.get("survey") if isinstance(entries, dict) else None
    return entry if isinstance(entry, dict) else {}


def check_instrument(plan: QTable, path: Path, what: str, *names: str) -> None:
    """Raise an error unless a plan is for one of the instruments whose plans a file format contains."""
    instrument = plan.meta["instrument"]
    if instrument not in names:
        raise InputError(f"{path}: the instrument of {what} must be {' or '.join(names)}, got {instrument}")


def to_wok(x, y, position_angle: float) -> tuple:
    """Convert focal coordinates of points to wok coordinates; the position angle is in degrees.

    The +y axis of focal coordinates points north. Focal coordinates are wok coordinates rotated clockwise by the
    position angle.
    """
    c, s = np.cos(np.deg2rad(position_angle)), np.sin(np.deg2rad(position_angle))
    with np.errstate(invalid="ignore"):  # infinite coordinates become NaN
        return c * x - s * y, s * x + c * y
