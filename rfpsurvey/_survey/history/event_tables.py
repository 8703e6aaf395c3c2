"""Convert a table of observations, or of changes to tiles, to events; names, states, dates and texts of its columns."""

import re

import numpy as np
from astropy.table import Table

from rfpsurvey._common.io import check_fits_text
from rfpsurvey._common.units import to_labels, to_plain
from rfpsurvey._survey.history.checks import check_possible, is_known, with_swaps_of
from rfpsurvey._survey.history.event_files import History, on_date
from rfpsurvey._survey.history.events import TileEvent, TileState, grouped, to_date
from rfpsurvey._survey.history.targets import IDS, NUMBERS, TEXTS, flag_codes, to_numbers
from rfpsurvey._survey.tiling.columns import when_of
from rfpsurvey.errors import MOST_WHOLE, InputError, check_choice, listed, short, warn

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
    "swaps": ("swaps",),
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
        check_choice(role, (*ROLES, "visits", "dropped", "until", *NUMBERS, *TEXTS), "role of a column")
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
    n, words = len(table), texts_of(table, roles.get("state"))
    return {
        "state": words and [SYNONYMS[check_choice(word.lower(), SYNONYMS, "state of a tile")] for word in words],
        **{role: _flags(table, roles, role) for role in ("good", "replaces", "swaps")},
        "date": [*map(to_date, table[roles["date"]])] if "date" in roles else [""] * n,
        "fraction": to_numbers(table[roles["fraction"]], "fraction").tolist() if "fraction" in roles else None,
        "reason": texts_of(table, roles.get("reason")) or [""] * n,
        **{role: texts_of(table, roles.get(role)) for role in (*VISITS, "plan", "generation")},
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


def texts_of(table: Table, name: str | None) -> list[str] | None:
    """Return the values of a column as text; empty text for missing values."""
    if name is None:
        return None
    values = to_plain(table[name], name)
    missing = np.isnan(values) if values.dtype.kind == "f" else np.zeros(len(values), dtype=bool)
    if values.dtype.kind == "f" and (values[~missing] == np.floor(values[~missing])).all():
        values = np.where(missing, 0, values).astype(np.int64)  # integers with missing values
    return ["" if gone else str(value).strip() for value, gone in zip(values.tolist(), missing.tolist(), strict=True)]


NAMED = ("plan", "generation", "target")
"""Roles of columns that determine the plan with which a tile was observed."""
MOST_FRACTION = 10
"""Largest fraction of an exposure; larger numbers are usually percentages."""


def tile_events(
    table: Table,
    roles: dict,
    history: History,
    enough: float,
    tile: object,
    *,
    replaces: bool = False,
    swaps: bool = False,
) -> tuple[list[TileEvent], int, int]:
    """Return the new events of tiles, and the numbers of known events and of tiles without an observation."""
    n = len(table)
    names = [str(tile)] * n if tile is not None else to_labels(table[roles["tile"]], "tile").astype(str).tolist()
    columns = columns_of(table, roles)
    events, n_known, n_ignored = [], 0, 0
    is_visit = [any(columns[role] and columns[role][k] for role in VISITS) for k in range(n)]
    columns["swaps"] = [
        visit and (swaps or bool(columns["swaps"] and columns["swaps"][k])) for k, visit in enumerate(is_visit)
    ]
    # a table of visits alone states that their tiles were observed
    usual = TileState.DONE if all(is_visit) and not (columns["state"] or columns["fraction"]) else ""
    groups = groups_of(names, columns["date"])
    place = {name: (history.row_of.get(name, history.n_tiles), len(name), name) for name, _ in groups}

    def order(group: tuple[str, str]) -> tuple:
        """Return a key for sorting: observations of a night have the order of the table, other events that of tiles."""
        words = [] if columns["state"] is None else [columns["state"][k] for k in groups[group]]
        is_observed = not {TileState.ADDED, TileState.DROPPED, TileState.PLANNED} & {*words}
        return group[1], is_observed, (min(groups[group]),) if is_observed else place[group[0]]

    for name, date in sorted(groups, key=order):
        rows = groups[name, date]
        whole = [k for k in rows if not is_visit[k]]
        if len(whole) > 1:
            raise InputError(f"a table must have one row for each tile and date, got {len(whole)} rows for tile {name}")
        state, fraction = _state_of(columns, whole, rows, enough, history.of(name), date, usual)
        if not state:
            if len(rows) > len(whole):
                # raises an error if this date is not possible
                _event(TileState.DONE, name, date, fraction, history, {})
                raise InputError(
                    f"the state of tile {name}{on_date(date)} must be given in a row without a positioner or target, "
                    f"got {'no state' if whole else 'only rows of visits'}"
                )
            n_ignored += 1
            continue
        swapped = [k for k in rows if columns["swaps"][k]]
        named = {role: {columns[role][k] for k in rows if columns[role]} - {""} for role in NAMED}
        if columns["target"]:  # the targets of swaps are not those of the plan
            named["target"] = {columns["target"][k] for k in rows if k not in swapped} - {""}
        if state == TileState.ADDED:
            event = _addition(name, history, table, roles, whole)
        else:
            event = _event(state, name, date, fraction, history, named)
        if state in (TileState.DONE, TileState.PARTLY, TileState.BAD):
            is_repeated = any(earlier.date == date for earlier in history.of(name))
            discards = replaces or any(columns["replaces"] and columns["replaces"][k] for k in rows)
            event = event._replace(has_state=bool(whole) or not is_repeated, replaces=discards)
            event = with_swaps_of(columns, swapped, event, history)
            event = _with_failures(columns, [k for k in rows if k not in whole], event, history, roles)
        if is_known(event, history):
            n_known += 1
            continue
        check_possible(event, history)
        history.states.add(event)
        events.append(event)
    return events, n_known, n_ignored


def _state_of(
    columns: dict, whole: list[int], rows: list[int], enough: float, earlier: list[TileEvent], date: str, usual: str
) -> tuple[str, float]:
    """Return the state of a tile, and the fraction of its exposure, from the row of the tile.

    Without this row, the tile has the state that was recorded before for this date. If the tile was not begun before,
    it has the state ``usual``. ``earlier`` contains the recorded observations of the tile.
    """
    for row in rows:
        if columns["state"] is not None and row not in whole and columns["state"][row]:
            raise InputError(
                f"the state of a tile must be in a row without a positioner or target, got {columns['state'][row]!r} "
                "in a row with one; whether a visit was successful is stated by good"
            )
    if not whole:
        known = [(event.state, event.fraction) for event in earlier if event.date == date]
        is_begun = any(event.state in (TileState.DONE, TileState.PARTLY) for event in earlier)
        return known[-1] if known else ("" if is_begun else usual, 1.0)
    row = whole[0]
    fraction = 1.0 if columns["fraction"] is None else columns["fraction"][row]
    if not 0 <= fraction <= MOST_FRACTION:
        raise InputError(f"fraction must be a number from 0 to {MOST_FRACTION}, where 1 is complete, got {fraction:g}")
    if columns["state"] is not None:
        return columns["state"][row], fraction
    good = True if columns["good"] is None else columns["good"][row]
    if good is None:
        raise InputError("good must be given for every tile, got a missing value")
    if not good or fraction == 0:
        return TileState.BAD, fraction
    return (TileState.DONE if fraction >= enough else TileState.PARTLY), fraction


def _event(state: str, name: str, date: str, fraction: float, history: History, values: dict) -> TileEvent:
    """Return the event of a tile without failed positioners, or raise an error if it is not possible.

    ``values`` contains the digests of plans, the generations and the targets in the table, by role (`NAMED`).
    """
    states, row = history.states, history.find_row(name)
    if state in (TileState.PLANNED, TileState.DROPPED):
        return TileEvent(row, name, state, date, 0.0)
    earlier = [event for event in states.of(row) if event.date == date]
    targets = values.pop("target", set())
    for what, texts in values.items():
        if len(texts) > 1:
            raise InputError(
                f"{what} must be the same in all rows of tile {name}{on_date(date)}, got {listed(sorted(texts))}"
            )
    named = {what: text for what, texts in values.items() for text in texts}
    chosen = history.choose_plan(row, name, date, named, targets) if named else None
    if chosen and any(event.plan != chosen[0] for event in earlier if date):
        got = listed(f"{what} {value!r}" for what, value in named.items())
        raise InputError(f"plan must be that of the recorded observation of tile {name}{on_date(date)}, got {got}")
    past = [event for event in history.past.get(row, ()) if event.has_state]
    is_repeated = date or any((event.state, event.date, event.fraction) == (state, date, fraction) for event in past)
    present = [plan for plan, _ in history.plans(row)][-1:]
    if earlier and (is_repeated or earlier[-1].state == TileState.DONE or [earlier[-1].plan] == present):
        return TileEvent(row, name, state, date, fraction, earlier[-1].plan, made_with=earlier[-1].made_with)
    if done := [event for event in states.of(row) if event.state == TileState.DONE]:
        raise InputError(
            f"tile {name} was already observed{on_date(done[0].date)}; to correct this record, give the same date, got "
            f"{date or 'no date'!r}"
        )
    chosen, n_files = chosen or history.choose_plan(row, name, date, {}, targets)
    event = TileEvent(row, name, state, date, fraction, chosen, made_with=n_files)
    history.events.visits(event)  # raises an error if the file of the tile is missing or damaged
    return event


def _addition(name: str, history: History, table: Table, roles: dict, whole: list[int]) -> TileEvent:
    """Return the event of a new tile, or of a tile with a new position."""
    if lacking := [role for role in ("ra", "dec") if role not in roles]:
        raise InputError(f"an added tile must have the columns ra and dec, got no {' and '.join(lacking)}")
    if np.asarray(history.survey.tiles["tile"]).dtype.kind in "iu" and not re.fullmatch(r"0|[1-9][0-9]{0,17}", name):
        raise InputError(f"the names of added tiles must be whole numbers, as those of the survey, got {name!r}")
    check_fits_text({"names of added tiles": [name]}, "omit these tiles")
    row, when = history.row_of.get(name), when_of(history.survey.tiles)
    if row is None and when is not None:
        text = "tiles must be added only to a survey without observing conditions and times of tiles"
        raise InputError(f"{text}, got one with {when}")
    place = [] if row is None else history.place(row).tolist()
    for k, role in enumerate(("ra", "dec", "position_angle", "pass")):
        if role in roles:
            place[k : k + 1] = [float(to_numbers(table[roles[role]][whole[:1]], role)[0])]
        elif row is None:
            place.append(1.0 if role == "pass" else 0.0)
    if not (np.isfinite(place[:3]).all() and -90 <= place[1] <= 90):
        raise InputError(f"the position of tile {name} must be finite angles, got {short(place[:3])}")
    if not (abs(place[3]) < MOST_WHOLE and place[3] == int(place[3])):
        raise InputError(f"the pass of tile {name} must be a whole number, got {place[3]:g}")
    place[0], place[3] = place[0] % 360, int(place[3])
    if row is None:
        row = history.row_of[name] = history.n_tiles
        history.n_tiles += 1
    elif np.array_equal(history.place(row), place):
        return history.states.added.get(row, TileEvent(row, name, TileState.ADDED, place=tuple(place)))
    return TileEvent(row, name, TileState.ADDED, place=tuple(place))


def _with_failures(columns: dict, rows: list[int], event: TileEvent, history: History, roles: dict) -> TileEvent:
    """Return the event with the positioners that failed, and those that were successful, according to the table."""
    if not rows:
        return event
    failed, good, visits = {}, set(), history.events.observed(event.after(history.earlier(event)))[0]
    positioners, targets = (list(map(str, visits[name].tolist())) for name in ("positioner", "target_id"))
    positioners_of = {
        what: grouped(zip(names, positioners, strict=True))
        for what, names in (("positioner", positioners), ("target", targets))
    }
    if columns["spectrograph"]:
        group_of = history.groups(roles["spectrograph"])
        of_visits = grouped((group_of[name], name) for name in positioners)
        positioners_of["spectrograph"] = dict.fromkeys(group_of.values(), ()) | of_visits
    pairs = {*zip(positioners, targets, strict=True)}
    for k in rows:
        what = next(role for role in VISITS if columns[role] and columns[role][k])
        name = columns[what][k]
        if name not in positioners_of[what]:
            is_group = what == "spectrograph"
            among = f"a {roles[what]} of the instrument" if is_group else f"a {what} of tile {event.tile} with a visit"
            raise InputError(f"{what} must be {among}, got {name!r}")
        if what == "target" and len(positioners_of[what][name]) > 1:
            raise InputError(
                f"positioner must be given for target {name} of tile {event.tile}, because "
                f"{len(positioners_of[what][name])} targets of this tile have this identifier, got only the target"
            )
        target = columns["target"][k] if what == "positioner" and columns["target"] else ""
        if target and (name, target) not in pairs:
            raise InputError(f"target must be that of positioner {name} of tile {event.tile}, got {target!r}")
        stated = columns["good"][k] if columns["good"] else None
        if not (columns["swaps"][k] if stated is None else stated):  # swaps are successful unless the table states it
            failed |= dict.fromkeys(positioners_of[what][name], columns["reason"][k])
        else:
            good.update(positioners_of[what][name])
    return event._replace(failed=dict(sorted(failed.items())), good=tuple(sorted(good)))
