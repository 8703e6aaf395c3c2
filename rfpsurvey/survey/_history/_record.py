"""Convert a table of observations, or of changes to tiles or targets, to events, and append them to a survey."""

import os
import re
from pathlib import Path

import astropy.units as u
import numpy as np
from astropy.table import QTable, Table

from rfpsurvey import _io
from rfpsurvey._folder import LOCK, locked, read_index
from rfpsurvey._units import to_dimensionless, to_flags, to_labels
from rfpsurvey.catalog import as_table
from rfpsurvey.errors import InputError, check_choice, listed, short
from rfpsurvey.survey._folder import part_name
from rfpsurvey.survey._history._configuration import is_configuration, visits_of_configuration
from rfpsurvey.survey._history._events import (
    ADDED,
    BAD,
    DONE,
    DROPPED,
    PARTLY,
    PLANNED,
    STATES,
    Events,
    TileEvent,
    read_events,
    to_date,
)
from rfpsurvey.survey._history._replay import TileStates
from rfpsurvey.survey._history._targets import NUMBERS, TEXTS, target_changes
from rfpsurvey.survey._history._tiles import add_tiles
from rfpsurvey.tiling import Tiling

ROLES = {
    "tile": ("tile", "tileid", "tile_id"),
    "state": ("state", "status", "obsstatus"),
    "good": ("good", "on_target"),
    "date": ("date", "zdate", "lastnight", "night"),
    "fraction": ("fraction",),
    "positioner": ("positioner", "positioner_id"),
    "target": ("target", "target_id", "targetid"),
    "reason": ("reason",),
    "ra": ("ra", "tilera"),
    "dec": ("dec", "tiledec"),
    "position_angle": ("position_angle", "pa"),
    "pass": ("pass",),
}
"""Names of columns, by role; case is ignored."""
SYNONYMS = {
    **{name: name for name in STATES},
    **dict.fromkeys(("obsend", "complete", "completed", "observed", "good"), DONE),
    **dict.fromkeys(("obsstart", "partial", "started"), PARTLY),
    **dict.fromkeys(("failed", "rejected"), BAD),
    **dict.fromkeys(("", "unobs", "unobserved", "pending"), ""),
}
"""States of tiles in tables, and the state of the survey that each of them stands for; "" changes nothing."""


def record(
    survey, table: object, *, enough: float = 1.0, tile: object = None, columns: dict[str, str] | None = None
) -> dict[str, int]:
    """Append events to the folder of a survey; see `Survey.record`."""
    if survey.folder is None:
        raise InputError("record needs a survey in a folder, got a survey that was planned without a folder")
    folder = Path(survey.folder)
    if is_configuration(table):
        table = visits_of_configuration(table, survey, tile)
    else:
        table = _io.read_table(table) if isinstance(table, str | os.PathLike) else as_table(table)[0]
    table = _renamed(table, columns or {})
    roles = _roles_of(table)
    if tile is not None and "tile" in roles:
        raise InputError(
            f"tile must be given only for a table without a column of tiles, got the column {roles['tile']!r}"
        )
    with locked(folder, folder / LOCK):
        events = read_events(folder)
        history = _History(survey, folder, events)
        changes, tiles, n_known, n_ignored = None, [], 0, 0
        if tile is None and "tile" not in roles:
            changes = target_changes(table, events, survey)
        else:
            tiles, n_known, n_ignored = _tile_events(table, roles, history, enough, tile)
            if any(event.state == ADDED for event in tiles):
                names = ["tile", "ra", "dec", "position_angle", "pass"]
                add_tiles(Tiling(QTable(survey.tiles[names], meta={})), history.states.added)  # checks all positions
        n_events = len(tiles) + (0 if changes is None else len(changes))
        if n_events:
            events.append(tiles, changes, history.n_targets, history.n_tiles_before)
    return {"n_events": n_events, "n_known": n_known, "n_ignored": n_ignored}


class _History:
    """What is known about the tiles of a survey before a table is recorded."""

    def __init__(self, survey, folder: Path, events: Events):
        self.survey, self.events, self.states = survey, events, TileStates(events.of_tiles())
        self._names = np.asarray(survey.tiles["tile"]).astype(str).tolist()
        self.row_of = {name: row for row, name in enumerate(self._names)}
        for row, event in self.states.added.items():
            self.row_of.setdefault(event.tile, row)
        self.n_tiles = self.n_tiles_before = max(len(self._names), 1 + max(self.states.added, default=-1))
        added = [n + int((table["target_row"] >= n).sum()) for n, table in events.target_tables]
        self.n_targets = max(len(survey.outcomes), *added, 0)
        self._known = read_index(folder)
        applied = survey.provenance.get("events", {}).get("n_files", 0)
        self.planned_until = max((one.date for file in events.files[:applied] for one in file.tiles), default="")

    def visits(self, row: int, name: str) -> QTable:
        """Return the visits of the present plan of a tile."""
        if row >= len(self._names):
            raise InputError(f"tile {name} has no plan yet; plan the survey again before its observations are recorded")
        return self.survey.tile(name)

    def plan(self, row: int) -> str:
        """Return the checksum of the present plan of a tile."""
        return self._known[part_name(row)][-1][1]

    def place(self, row: int) -> np.ndarray:
        """Return the right ascension, declination, position angle (deg) and pass of a tile."""
        if row in self.states.added:
            return np.array(self.states.added[row].place)
        one = self.survey.tiles[row]
        return np.array([one[name].to_value(u.deg) for name in ("ra", "dec", "position_angle")] + [one["pass"]])


def _renamed(table: Table, columns: dict[str, str]) -> Table:
    """Return a table whose columns with the given names, by role, have the names of their roles."""
    for role, name in columns.items():
        check_choice(role, (*ROLES, "visits", "dropped", *NUMBERS, *TEXTS), "role of a column")
        if name not in table.colnames:
            raise InputError(f"columns must name columns of the table ({listed(table.colnames)}), got {name!r}")
    others = [name for name in table.colnames if name.lower() not in columns and name not in columns.values()]
    named = {role: table[name] for role, name in columns.items()}
    return Table({**named, **{name: table[name] for name in others}}, copy=False) if columns else table


def _roles_of(table: Table) -> dict[str, str]:
    """Return a dict from the roles of the columns of a table to their names."""
    lower = {name.lower(): name for name in reversed(table.colnames)}
    return {role: lower[one] for role, names in ROLES.items() for one in reversed(names) if one in lower}


def _tile_events(
    table: Table, roles: dict, history: _History, enough: float, tile: object
) -> tuple[list[TileEvent], int, int]:
    """Return the new events of tiles, and the numbers of known events and of tiles without an observation."""
    n = len(table)
    names = (
        np.full(n, str(tile)) if tile is not None else np.asarray(to_labels(table[roles["tile"]], "tile")).astype(str)
    )
    columns = {
        "state": _states(table, roles),
        "good": None if "good" not in roles else to_flags(table[roles["good"]], roles["good"]).tolist(),
        "date": [to_date(one) for one in table[roles["date"]]] if "date" in roles else [""] * n,
        "fraction": _fractions(table, roles),
        "reason": _texts(table, roles.get("reason")) or [""] * n,
        "positioner": _texts(table, roles.get("positioner")),
        "target": _texts(table, roles.get("target")),
    }
    events, n_known, n_ignored = [], 0, 0
    for (name, date), rows in _groups(names.tolist(), columns["date"]).items():
        whole = [k for k in rows if not any(columns[one] and columns[one][k] for one in ("positioner", "target"))]
        if len(whole) > 1:
            raise InputError(f"a table must have one row for each tile and date, got {len(whole)} rows for tile {name}")
        state, fraction = _state_of(columns, whole, enough, name)
        if not state:
            n_ignored += 1
            continue
        event = _event(state, name, date, fraction, history, (table, roles, whole))
        if state in (DONE, PARTLY, BAD):
            event = event._replace(failed=_failures(columns, [k for k in rows if k not in whole], event, history))
        same = _present(event, history.states)
        if same == event:
            n_known += 1
            continue
        history.states.add(event)
        events.append(event)
    return events, n_known, n_ignored


def _groups(names: list[str], dates: list[str]) -> dict[tuple[str, str], list[int]]:
    """Return the rows of each tile and date; rows without a date belong to the only date of their tile."""
    known: dict[str, set] = {}
    for name, date in zip(names, dates, strict=True):
        known.setdefault(name, set()).add(date)
    groups: dict[tuple[str, str], list[int]] = {}
    for row, (name, date) in enumerate(zip(names, dates, strict=True)):
        others = known[name] - {""}
        if not date and len(others) > 1:
            raise InputError(f"date must be given in all rows of tile {name}, which has several dates, got no date")
        groups.setdefault((name, date or max(others, default="")), []).append(row)
    return groups


def _state_of(columns: dict, whole: list[int], enough: float, name: str) -> tuple[str, float]:
    """Return the state of a tile, and the fraction of its exposure, for the row of the tile."""
    if not whole:
        return DONE, 1.0
    row = whole[0]
    fraction = columns["fraction"][row]
    if columns["state"] is not None:
        return columns["state"][row], fraction
    if columns["good"] is not None and not columns["good"][row]:
        return BAD, fraction
    if fraction <= 0:
        return BAD, fraction
    return (DONE if fraction >= enough else PARTLY), fraction


def _event(state: str, name: str, date: str, fraction: float, history: _History, source: tuple) -> TileEvent:
    """Return the event of a tile without failed positioners, or raise an error if it is not possible."""
    states = history.states
    if state == ADDED:
        return _addition(name, history, *source)
    if name not in history.row_of:
        raise InputError(
            f"tile must be a tile of the survey, such as {next(iter(history.row_of), 'none')}, got {name!r}"
        )
    row = history.row_of[name]
    if state == PLANNED:
        return TileEvent(row, name, PLANNED, date, 0.0)
    done = [one for one in states.of(row) if one.state == DONE]
    if state == DROPPED:
        if done:
            raise InputError(f"tile {name} must not be dropped, because it was observed{_on(done[0].date)}")
        return TileEvent(row, name, DROPPED, date, 0.0)
    earlier = [one for one in states.of(row) if one.date == date]
    if earlier and (date or earlier[-1].state == DONE or earlier[-1].plan == history.plan(row)):
        return TileEvent(row, name, state, date, fraction, earlier[-1].plan)
    if done:
        raise InputError(
            f"tile {name} was already observed{_on(done[0].date)}; to correct this record, give the same date, got "
            f"{date or 'no date'!r}"
        )
    history.visits(row, name)
    kept = isinstance(states.state_of(row), TileEvent)  # a tile that was partly observed keeps its plan
    if date and history.planned_until and date <= history.planned_until and not kept:
        raise InputError(
            f"the observation of tile {name} on {date} must be later than {history.planned_until}, because its plan "
            "was made with the events up to this date"
        )
    return TileEvent(row, name, state, date, fraction, history.plan(row))


def _addition(name: str, history: _History, table: Table, roles: dict, whole: list[int]) -> TileEvent:
    """Return the event of a new tile, or of a tile with a new position."""
    lacking = [one for one in ("ra", "dec") if one not in roles]
    if lacking:
        raise InputError(f"an added tile must have the columns ra and dec, got no {' and '.join(lacking)}")
    if np.asarray(history.survey.tiles["tile"]).dtype.kind in "iu" and not re.fullmatch(r"[0-9]{1,18}", name):
        raise InputError(f"the names of added tiles must be whole numbers, as those of the survey, got {name!r}")
    row = history.row_of.get(name)
    place = [] if row is None else history.place(row).tolist()
    for k, one in enumerate(("ra", "dec", "position_angle", "pass")):
        if one in roles:
            value = table[roles[one]][whole[0]]
            value = float(u.Quantity(value, u.deg).value) if one != "pass" else int(value)
            place[k : k + 1] = [value]
        elif row is None:
            place.append(1 if one == "pass" else 0.0)
    if not (np.isfinite(place).all() and -90 <= place[1] <= 90):
        raise InputError(f"the position of tile {name} must be finite angles, got {short(place[:3])}")
    place[0], place[3] = place[0] % 360, int(place[3])
    if row is None:
        row = history.row_of[name] = history.n_tiles
        history.n_tiles += 1
    elif np.array_equal(history.place(row), place):
        return history.states.added.get(row, TileEvent(row, name, ADDED, place=tuple(place)))
    elif history.states.of(row):
        raise InputError(f"tile {name} must not be moved, because an observation of it was recorded")
    return TileEvent(row, name, ADDED, place=tuple(place))


def _present(event: TileEvent, states: TileStates) -> TileEvent | None:
    """Return the recorded event that an equal event would repeat."""
    if event.state == ADDED:
        return states.added.get(event.row)
    if event.state == DROPPED:
        return event if event.row in states.dropped else None
    if event.state == PLANNED:
        return None if states.of(event.row) or event.row in states.dropped else event
    return next((one for one in states.of(event.row) if one.observation == event.observation), None)


def _failures(columns: dict, rows: list[int], event: TileEvent, history: _History) -> dict[str, str]:
    """Return the positioners that failed, with the reason for each of them."""
    failed = {}
    if not rows:
        return failed
    visits = history.visits(event.row, event.tile)
    ids = {
        "positioner": np.asarray(visits["positioner"]).astype(str),
        "target": np.asarray(visits["target_id"]).astype(str),
    }
    positioner_of = {
        what: dict(zip(names.tolist(), ids["positioner"].tolist(), strict=True)) for what, names in ids.items()
    }
    for k in rows:
        what = "positioner" if columns["positioner"] and columns["positioner"][k] else "target"
        name = columns[what][k]
        if name not in positioner_of[what]:
            raise InputError(f"{what} must be a {what} of tile {event.tile} with a visit, got {name!r}")
        if columns["good"] is None or not columns["good"][k]:
            failed[positioner_of[what][name]] = columns["reason"][k]
    return dict(sorted(failed.items()))


def _states(table: Table, roles: dict) -> list[str] | None:
    words = _texts(table, roles.get("state"))
    if words is None:
        return None
    return [SYNONYMS[check_choice(word.lower(), SYNONYMS, "state of a tile")] for word in words]


def _fractions(table: Table, roles: dict) -> list[float]:
    if "fraction" not in roles:
        return [1.0] * len(table)
    values = np.ma.filled(np.ma.asarray(to_dimensionless(table[roles["fraction"]], "fraction")), np.nan).astype(float)
    if not (values >= 0).all():
        raise InputError(f"fraction must be a number of at least 0, got {values[~(values >= 0)][0]:g}")
    return values.tolist()


def _texts(table: Table, name: str | None) -> list[str] | None:
    """Return the values of a column as text; empty text for missing values."""
    if name is None:
        return None
    column = np.ma.asarray(table[name])
    missing = np.ma.getmaskarray(column)
    return ["" if gone else str(one) for one, gone in zip(np.asarray(column).tolist(), missing, strict=True)]


def _on(date: str) -> str:
    return f" on {date}" if date else ""
