"""Convert a table of observations, or of changes to tiles or targets, to events, and append them to a survey.

Files of SDSS-V that state which fibers were on target are converted to tables of failed visits.
"""

import os
from dataclasses import replace
from datetime import UTC
from functools import partial
from getpass import getuser
from numbers import Integral, Number
from pathlib import Path

import numpy as np
from astropy.table import QTable, Table
from astropy.time import Time

from rfpsurvey._common import io as _io
from rfpsurvey._common.descriptions import Column, describe, table_of
from rfpsurvey._common.folder import LOCK, WAIT, locked, read_index, remove_temporary
from rfpsurvey._common.read_tables import read_table
from rfpsurvey._field.plan_files import native_format, read_plan
from rfpsurvey._sky.frames import as_table
from rfpsurvey._survey.continue_survey import cadences_in, groups_in, instruments_in, request_in, tiling_in
from rfpsurvey._survey.folder import TABLES, clock, read_request
from rfpsurvey._survey.generations import EVENTS, read_generations, replace_plan
from rfpsurvey._survey.history.checks import warn_of_dates
from rfpsurvey._survey.history.event_files import History, append_events, copied_bodies, read_events, write_copy
from rfpsurvey._survey.history.event_tables import check_others, columns_of_catalog, renamed, roles_of, tile_events
from rfpsurvey._survey.history.events import (
    EventFile,
    Events,
    TileEvent,
    TileState,
    add_tiles,
    check_not_future,
    grouped,
)
from rfpsurvey._survey.history.limits import adds_targets, check_limits, with_limits
from rfpsurvey._survey.history.replay import TileStates
from rfpsurvey._survey.history.targets import DROPPED, IS_ADDED, kinds_of, target_changes
from rfpsurvey._survey.survey import Survey
from rfpsurvey._survey.tiling.tiling import Tiling
from rfpsurvey.errors import InputError, check_switch, listed, number_of, refusal, warn

RESULTS = ("state", "good", "date", "fraction", "positioner", "target")
"""Roles of columns of which a table of observations has at least one; other tables can be lists of tiles."""
RECORDS = table_of(
    Column("number", "number of the record, or 0"),
    Column("generation", "number of the plan of the rest that was made after the records before it, or 0"),
    Column("time", "time of recording (UTC), or date of the plan"),
    Column("user", "user who recorded the table"),
    Column("table", "name of the table"),
    Column("note", "note of the user, or keys of the plan file that were changed for the plan"),
    Column("dates", "first and last date of the rows"),
    Column("n_tiles", "number of tiles"),
    Column("n_failed", "number of failed visits"),
    Column("n_targets", "number of changed targets"),
    Column("undoes", "number of the record that this record undoes, or 0"),
    Column("undone_by", "number of the record that undid this record, or 0"),
    Column("rows", "file in the folder of events with the rows of the table"),
)
CHANGES = {
    TileState.DONE: "tiles observed",
    TileState.PARTLY: "tiles partly observed",
    TileState.BAD: "tiles whose observation was bad",
    TileState.DROPPED: "tiles dropped",
    TileState.PLANNED: "tiles whose records are canceled",
    TileState.ADDED: "tiles added or moved",
}


def record(survey, table, *, enough, tile, columns, note, replaces, swaps, allow_future, dry_run) -> dict:
    """Append events to the folder of a survey; see `Survey.record`."""
    if isinstance(enough, bool) or not isinstance(enough, Number) or not 0 < enough < np.inf:
        raise refusal("enough must be a number above 0", enough, Number)
    for name, value in {"dry_run": dry_run, "replaces": replaces, "swaps": swaps, "allow_future": allow_future}.items():
        check_switch(value, name)
    folder, is_path = _folder_of(survey), isinstance(table, str | os.PathLike)
    told = _told(str(table) if is_path else "", note)
    if is_path and native_format(_io.to_path(table)) is not None:
        table = _visits_of_configuration(table, survey, tile)
    else:
        table = read_table(table) if is_path else as_table(table)[0]
    table = renamed(table, columns or {})
    roles = roles_of(table)
    named = columns_of_catalog(table, survey.provenance["catalog"].get("columns", ""))
    is_of_tiles = tile is not None or ("tile" in roles and not adds_targets(table, roles))
    if is_of_tiles:
        check_others(table, roles, named.get("target"))
    if tile is not None and "tile" in roles:
        raise InputError(
            f"tile must be given only for a table without a column of tiles, got the column {roles['tile']!r}"
        )
    if is_of_tiles and not {*RESULTS} & {*roles}:
        raise InputError(
            f"a table of observations must have one of the columns {listed(RESULTS)}, got {listed(table.colnames)}; to "
            "record that tiles are finished, add a column state with the value done"
        )
    with locked(folder, folder / LOCK, wait=WAIT):
        replace_plan(folder)
        events = _events_to_extend(folder, dry_run=dry_run)
        survey = _present_survey(survey, folder)
        history = History(survey, folder, events, partial(groups_in, folder), partial(request_in, folder))
        changes, tiles, n_known, n_ignored = None, [], 0, 0
        has_cadences = "cadences" in survey.provenance["parameters"]
        if not is_of_tiles:
            table = with_limits(renamed(table, named), roles, kinds_of(survey))
            changes, n_known = target_changes(table, events, survey)
            if has_cadences and (column := survey.provenance["rule_columns"][-1]) in changes.colnames:
                cadences_in(folder)._rows_of(changes[column])  # raises an error if a cadence is unknown
            check_limits(changes, history, partial(tiling_in, folder), has_cadences=has_cadences)
        else:
            dropped = {*history.states.dropped}
            tiles, n_known, n_ignored = tile_events(table, roles, history, enough, tile, replaces=replaces, swaps=swaps)
            states = history.states
            added = [event.tile for event in tiles if event.state == TileState.ADDED and event.row >= len(survey)]
            if added and has_cadences:
                raise InputError(
                    "added tiles of a survey with cadences must have times, and must therefore be in its table "
                    f"of tiles (--replan with tiles= or --tiles), got {listed(added)}"
                )
            if any(event.state == TileState.ADDED for event in tiles) or (states.added and dropped - {*states.dropped}):
                names = ["tile", "ra", "dec", "position_angle", "pass"]
                first = Tiling(QTable({**survey.tiles[names], "state": np.full(len(survey.tiles), TileState.DROPPED)}))
                add_tiles(first, states.added, states.dropped)  # checks all positions
        dates = [event.date for event in tiles] if changes is None else changes["date"].tolist()
        if not allow_future:
            check_not_future(dates)
        warn_of_dates(tiles, events, partial(instruments_in, folder))
        n_events = len(tiles) + (0 if changes is None else len(changes))
        if n_events and not dry_run:
            append_events(history, tiles, changes, table, told)
    return {"n_events": n_events, "n_known": n_known, "n_ignored": n_ignored, "changes": _changes(tiles, changes)}


def undo(survey, number: int, *, note: str, dry_run: bool) -> dict:
    """Append a file that undoes a file of events; see `Survey.undo`."""
    check_switch(dry_run, "dry_run")
    folder = _folder_of(survey)
    with locked(folder, folder / LOCK, wait=WAIT):
        replace_plan(folder)
        events = _events_to_extend(folder, dry_run=dry_run)
        n = len(events.files)
        if n == 0:
            raise InputError(f"{folder} must hold a record that can be undone, got a survey without records")
        if isinstance(number, bool) or not isinstance(number, Integral) or not 0 < number <= n:
            raise refusal(f"the number of the record to undo must be a whole number from 1 to {n}", number, Integral)
        if number in events.undone:
            raise InputError(
                f"record {number} was already undone by record {events.undone[number]}; to restore it, undo record "
                f"{events.undone[number]}"
            )
        history, told = History(_present_survey(survey, folder), folder, events, dict), _told("", note)
        file, undoes = events.files[number - 1], int(number)
        last = replace(file, tiles=(), targets=None, undoes=undoes)
        _check_undo(replace(events, files=(*events.files, last)), file, undoes)
        if not dry_run:
            append_events(history, [], None, None, told, undoes)
    changed = events.files[file.undoes - 1] if file.undoes else file
    targets = None if changed.targets is None else events.read_targets(changed.targets)
    return {"undone": undoes, "restored": file.undoes or 0, "changes": _changes(list(changed.tiles), targets)}


def _check_undo(events: Events, file: EventFile, undone: int) -> None:
    """Raise an error if later records depend on a file that was undone; ``events`` are the events afterward."""
    states, known = TileStates(()), set()
    moved = {event.row for event in file.tiles if event.place and event.row < file.n_tiles}
    for number, event in events.numbered():
        attempts = states.of(event.row)
        others = [attempt for attempt in attempts if attempt.observation != event.observation]
        is_done = any(attempt.state == TileState.DONE for attempt in others)
        same_date = [attempt for attempt in others if event.plan and attempt.date == event.date != ""]
        reasons = {
            "lists visits of an observation of tile {}": not event.has_state and event.observation not in known,
            "observes tile {} at its new position": bool(event.plan and event.row in moved and number > undone),
            "moves tile {}, which would be observed": bool(event.place and attempts),
            "observes tile {}, which would be finished": event.state == TileState.DONE and is_done,
            "drops tile {}, which would be finished": event.state == TileState.DROPPED and is_done,
            "states another plan of an observation of tile {}": bool(same_date),
        }
        if reason := next((reason for reason, applies in reasons.items() if applies), None):
            raise InputError(
                f"record {number} must be undone before record {undone}, because it {reason.format(event.tile)}"
            )
        states.add(event)
        known = {key for key in known if event.state != TileState.PLANNED or key[0] != event.row}
        known.add(event.observation)


def _folder_of(survey) -> Path:
    """Return the folder of a survey in which events can be recorded."""
    if survey.folder is None:
        raise InputError("record needs a survey in a folder, got a survey that was planned without a folder")
    return Path(survey.folder)


def _events_to_extend(folder: Path, *, dry_run: bool) -> Events:
    """Return the events in a locked folder; unless nothing will be written, remove what a killed process left."""
    bodies = copied_bodies(folder)
    events = read_events(folder, bodies=bodies)
    if not dry_run:
        remove_temporary(folder / EVENTS)
        if len(bodies) != len(events.files):
            write_copy(folder, [file.body for file in events.files])
        used = {name for file in events.files for name in file.others}
        for path in (folder / EVENTS).glob("*-*.*"):
            if path.name not in used:
                path.unlink()  # a process was killed before it wrote the file of events
    return events


def _told(name: str, note: str) -> dict[str, str]:
    """Return the name of the table, the time of recording, the user and the note."""
    if not isinstance(note, str):
        raise refusal("note must be text", note)
    try:
        user = getuser()
    except (KeyError, OSError, ImportError):  # no name is known
        user = ""
    return {"table": name, "time": clock().astimezone(UTC).isoformat(timespec="seconds"), "user": user, "note": note}


def events_table(survey) -> QTable:
    """Return a table of all records of a survey; see `Survey.events`."""
    events = read_events(_folder_of(survey))
    plans: dict[int, list[tuple]] = {}
    for plan in read_generations(events.folder)[1:]:
        row = (0, plan.number, plan.date, "", "", plan.edits, "", 0, 0, 0, 0, 0, "")
        plans.setdefault(plan.n_files, []).append(row)
    rows = plans.get(0, [])
    for number, file in enumerate(events.files, 1):
        targets = QTable() if file.targets is None else events.read_targets(file.targets)
        stated = [event.date for event in file.tiles] + (targets["date"].tolist() if len(targets) else [])
        first, last = (choose(filter(None, stated), default="") for choose in (min, max))
        told = [file.told.get(name, "") for name in ("time", "user", "table", "note")]
        counts = len({event.row for event in file.tiles}), sum(len(event.failed) for event in file.tiles), len(targets)
        undo = file.undoes or 0, events.undone.get(number, 0)
        dates = first if first == last else f"{first} to {last}"
        rows.append((number, 0, *told, dates, *counts, *undo, next(iter(file.others), "")))
        rows += plans.get(number, [])
    table = QTable(rows=rows, names=list(RECORDS)) if rows else QTable({name: [] for name in RECORDS})
    return describe(table, RECORDS)


def _changes(tiles: list[TileEvent], targets: QTable | None) -> dict[str, list[str]]:
    """Return the identifiers of the tiles and targets that events change, by the kind of the change."""
    changes = []
    for event in tiles:
        changes.append((CHANGES[event.state], event.tile))
        changes += [("failed visits", f"{event.tile}/{name}") for name in event.failed]
        changes += [("swapped targets", f"{event.tile}/{name}") for name in event.swaps]
    for row in () if targets is None else targets:
        state = {1: "dropped", IS_ADDED: "added"}.get(int(row[DROPPED]), "changed")
        changes.append((f"targets {state}", str(row["target_id"])))
    return grouped(changes)


def _present_survey(survey: Survey, folder: Path) -> Survey:
    """Return the survey in a folder, which may have been planned again after ``survey`` was read."""
    request = read_request(folder)
    is_present = survey.provenance.get("events") == request.get("events")
    is_present &= str(request.get("tiles")).startswith(f"{len(survey.tiles)} ")
    return survey if is_present and {*TABLES} <= {*read_index(folder)} else Survey.read(folder)


def _visits_of_configuration(path: str | os.PathLike, survey, tile: object) -> Table:
    """Return a table of the visits of a tile, which states whether each of them was successful.

    A visit failed if its fiber was not on target, had no target, or had another target than in the survey.
    """
    path = Path(path)
    plan = read_plan(path)
    if "on_target" not in plan.colnames:
        raise InputError(
            f"{path} must state which fibers were on target (a confSummaryF file of SDSS-V), got a plan in the format "
            f"{plan.meta['format']}"
        )
    if tile is None:
        raise InputError(f"tile must be given for {path}: the tile of the survey that it observed, got none")
    visits = survey.tile(tile)
    used = plan[np.asarray(plan["assigned"])]
    on_target = np.asarray(used["on_target"]) == 1
    positioners, targets = _texts_of(used)
    observed = dict(zip(positioners, zip(targets, on_target.tolist(), strict=True), strict=True))
    positioners, targets = _texts_of(visits)
    reasons, n_same, n_science = [], 0, 0
    for positioner, target, row in zip(positioners, targets, visits["target_row"].tolist(), strict=True):
        target_in_file, is_good = observed.get(positioner, (None, False))
        is_same = target_in_file is not None and (row < 0 or target_in_file == target)
        n_same, n_science = n_same + (is_same and row >= 0), n_science + (row >= 0)
        if target_in_file is None:
            reasons.append("no target in the file")
        elif not is_same:
            reasons.append("another target in the file")
        else:
            reasons.append("" if is_good else "not on target")
    if n_science and not n_same:
        raise InputError(
            f"{path} must be the file of tile {tile}, got a file in which no fiber has its target of the survey"
        )
    if not on_target.any():
        warn(f"no fiber of {path} was on target; therefore, all visits of tile {tile} are recorded as failed")
    if n_unused := len({*observed} - {*positioners}):
        warn(f"{number_of(n_unused, 'fiber')} of {path} with a target have no target in tile {tile}, and are ignored")
    mjd = plan.meta["header"].get("MJD")
    date = "" if mjd is None else Time(float(mjd), format="mjd", scale="utc").isot[:10]
    good = np.array([not reason for reason in reasons], dtype=bool)
    columns = {"positioner": visits["positioner"], "target": visits["target_id"], "good": good, "reason": reasons}
    return Table({**columns, "date": [date] * len(visits)})


def _texts_of(visits: Table) -> tuple[list[str], list[str]]:
    """Return the identifiers of the positioners and of the targets of visits as text."""
    return tuple(np.asarray(visits[name]).astype(str).tolist() for name in ("positioner", "target_id"))
