"""Columns of tables of observations: their names, states, dates and texts."""

import re

import numpy as np
from astropy.table import Table

from rfpsurvey._units import to_plain
from rfpsurvey.errors import InputError, check_choice, listed, warn
from rfpsurvey.survey._history._dates import to_date
from rfpsurvey.survey._history._events import TileState
from rfpsurvey.survey._history._targets import IDS, NUMBERS, TEXTS, flag_codes, to_numbers

ROLES = {
    "tile": ("tile", "tileid", "tile_id"),
    "state": ("state", "status", "obsstatus"),
    "good": ("good", "on_target"),
    "date": ("date", "zdate", "lastnight", "night", "mjd"),
    "fraction": ("fraction",),
    "positioner": ("positioner", "positioner_id"),
    "target": ("target", "target_id", "targetid"),
    "spectrograph": ("spectrograph", "petal", "module", "block"),
    "reason": ("reason",),
    "replaces": ("replaces",),
    "ra": ("ra", "tilera"),
    "dec": ("dec", "tiledec"),
    "position_angle": ("position_angle", "pa"),
    "pass": ("pass",),
    "plan": ("plan", "planid", "plan_id"),
    "generation": ("generation", "gener"),
}
"""Names of columns, by role; case is ignored."""
VISITS = ("positioner", "target", "spectrograph")
"""Roles of columns that state a visit of a tile, or all visits of a spectrograph."""
PARTS = {
    *("id", "objectid", "catalogid", "robot", "robotid", "fiber", "fiberid"),
    *("location", "locid", "hole", "holeid"),
}
"""Names, without underscores, of columns that state a part of a tile, which can be a target or a positioner."""
HARMLESS = ("timestamp", "version", "program", "archivedate")
"""Columns of tables of finished tiles of DESI that are ignored without a warning."""
SYNONYMS = {
    **{name: name for name in TileState.ALL},
    **dict.fromkeys(("obsend", "complete", "completed", "observed", "good"), TileState.DONE),
    **dict.fromkeys(("obsstart", "partial", "started"), TileState.PARTLY),
    **dict.fromkeys(("failed", "rejected"), TileState.BAD),
    **dict.fromkeys(("", "unobs", "unobserved", "pending"), ""),
}
"""States of tiles in tables, and the state of the survey that each of them stands for; "" changes nothing."""


def renamed(table: Table, columns: dict[str, str]) -> Table:
    """Return a table whose columns with the given names, by role, have the names of their roles.

    The name of the column of priorities can begin with ``-``, as for catalogs, if small numbers have precedence.
    """
    for role, name in columns.items():
        check_choice(role, (*ROLES, "visits", "dropped", *NUMBERS, *TEXTS), "role of a column")
        if name.removeprefix("-" if role == "priority" else "") not in table.colnames:
            raise InputError(f"columns must name columns of the table ({listed(table.colnames)}), got {name!r}")
    names = {role: name if name in table.colnames else name[1:] for role, name in columns.items()}
    others = [name for name in table.colnames if name.lower() not in columns and name not in names.values()]
    named = {role: table[name] for role, name in names.items()}
    if names.get("priority") != columns.get("priority"):  # a sign before the name reverses the order of priorities
        named["priority"] = -to_numbers(named["priority"], "priority")
    return Table({**named, **{name: table[name] for name in others}}, copy=False) if columns else table


def columns_of_catalog(table: Table, record: str) -> dict[str, str]:
    """Return the columns of a table of targets, by role, that have the names of the columns of the catalog.

    ``record`` is the entry ``columns`` of the provenance of the catalog. Positions, which can have other units, and
    roles whose own names the table has are omitted.
    """
    lower, columns = {name.lower() for name in table.colnames}, {}
    for role, name, sign in re.findall(r"(\w+): (.+?)( \(reversed sign\))?(?:, |$)", record):
        names = IDS if role == "id" else (role,)
        is_used = role in ("id", "priority", "subpriority", "visits", *TEXTS) and name in table.colnames
        if is_used and not {*names} & lower:
            columns[names[0]] = f"-{name}" if sign else name
    return columns


def roles_of(table: Table) -> dict[str, str]:
    """Return a dict from the roles of the columns of a table to their names."""
    lower = {name.lower(): name for name in reversed(table.colnames)}
    return {role: lower[name] for role, names in ROLES.items() for name in reversed(names) if name in lower}


def check_others(table: Table, roles: dict[str, str], id_name: str | None) -> None:
    """Issue a warning that lists the columns of a table that are not used, unless they are usual.

    Columns of parts of tiles, such as ``id_name``, are an error if there is no column of targets or positioners.
    """
    unused = [name for name in table.colnames if name not in roles.values() and name.lower() not in HARMLESS]
    parts = [name for name in unused if name == id_name or name.lower().replace("_", "") in PARTS]
    if parts and not {*VISITS} & {*roles}:
        raise InputError(
            f"a table of visits must have a column target or positioner, got the column {parts[0]!r}; state what it "
            f"is, for example columns={{'target': {parts[0]!r}}} (or --column target={parts[0]}), or omit this column "
            "if each row is a whole tile"
        )
    if unused:
        warn(f"columns that are not used: {listed(unused)}; used: {listed(roles.values())}")


def columns_of(table: Table, roles: dict[str, str]) -> dict[str, list | None]:
    """Return the values of the columns of observations by role; None for columns that the table lacks."""
    n, words = len(table), _texts(table, roles.get("state"))
    return {
        "state": words and [SYNONYMS[check_choice(word.lower(), SYNONYMS, "state of a tile")] for word in words],
        "good": _flags(table, roles, "good"),
        "replaces": _flags(table, roles, "replaces"),
        "date": [*map(to_date, table[roles["date"]])] if "date" in roles else [""] * n,
        "fraction": to_numbers(table[roles["fraction"]], "fraction").tolist() if "fraction" in roles else None,
        "reason": _texts(table, roles.get("reason")) or [""] * n,
        **{role: _texts(table, roles.get(role)) for role in (*VISITS, "plan", "generation")},
    }


def groups_of(names: list[str], dates: list[str]) -> dict[tuple[str, str], list[int]]:
    """Return the rows of each tile and date; rows without a date belong to the only date of their tile."""
    known: dict[str, set] = {}
    for name, date in zip(names, dates, strict=True):
        known.setdefault(name, set()).add(date)
    groups: dict[tuple[str, str], list[int]] = {}
    for row, (name, date) in enumerate(zip(names, dates, strict=True)):
        dates_of_tile = known[name] - {""}
        if not date and len(dates_of_tile) > 1:
            raise InputError(f"date must be given in all rows of tile {name}, which has several dates, got no date")
        groups.setdefault((name, date or max(dates_of_tile, default="")), []).append(row)
    return groups


def _flags(table: Table, roles: dict, role: str) -> list[bool | None] | None:
    """Return the values of a column of truth values, such as good; None for missing values."""
    if role not in roles:
        return None
    codes = flag_codes(table[roles[role]], roles[role]).tolist()
    return [None if code < 0 else code == 1 for code in codes]


def _texts(table: Table, name: str | None) -> list[str] | None:
    """Return the values of a column as text; empty text for missing values."""
    if name is None:
        return None
    values = to_plain(table[name], name)
    missing = np.isnan(values) if values.dtype.kind == "f" else np.zeros(len(values), dtype=bool)
    if values.dtype.kind == "f" and (values[~missing] == np.floor(values[~missing])).all():
        values = np.where(missing, 0, values).astype(np.int64)  # integers with missing values
    return ["" if gone else str(value).strip() for value, gone in zip(values.tolist(), missing.tolist(), strict=True)]
