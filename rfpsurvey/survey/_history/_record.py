"""Convert a table of observations, or of changes to tiles or targets, to events, and append them to a survey."""

import os
from numbers import Number
from pathlib import Path

import numpy as np
from astropy.table import QTable

from rfpsurvey import _io
from rfpsurvey._folder import LOCK, locked, read_index, remove_temporary
from rfpsurvey.catalog import as_table
from rfpsurvey.errors import InputError, check_switch, listed, refusal
from rfpsurvey.survey._folder import EVENTS, TABLES
from rfpsurvey.survey._history._columns import columns_of_catalog, renamed, roles_of, warn_of_others
from rfpsurvey.survey._history._configuration import is_configuration, visits_of_configuration
from rfpsurvey.survey._history._events import (
    ADDED,
    BAD,
    DONE,
    DROPPED,
    PARTLY,
    PLANNED,
    TileEvent,
    read_events,
    read_request,
)
from rfpsurvey.survey._history._targets import DROPPED as IS_DROPPED
from rfpsurvey.survey._history._targets import IS_ADDED, target_changes
from rfpsurvey.survey._history._tile_events import History, tile_events
from rfpsurvey.survey._history._tiles import add_tiles
from rfpsurvey.survey._survey import Survey
from rfpsurvey.tiling import Tiling

RESULTS = ("state", "good", "date", "fraction", "positioner", "target")
"""Roles of columns of which a table of observations has at least one; other tables can be lists of tiles."""
CHANGES = {
    DONE: "tiles observed",
    PARTLY: "tiles partly observed",
    BAD: "tiles whose observation was bad",
    DROPPED: "tiles dropped",
    PLANNED: "tiles whose records are canceled",
    ADDED: "tiles added or moved",
}


def record(survey, table: object, *, enough: float, tile: object, columns: dict | None, dry_run: bool) -> dict:
    """Append events to the folder of a survey; see `Survey.record`."""
    if isinstance(enough, bool) or not isinstance(enough, Number) or not 0 < enough < np.inf:
        raise refusal("enough must be a number above 0", enough, Number)
    check_switch(dry_run, "dry_run")
    if survey.folder is None:
        raise InputError("record needs a survey in a folder, got a survey that was planned without a folder")
    if "cadences" in survey.provenance["parameters"]:
        raise InputError("what was observed must be recorded in a survey without cadences, got one with cadences")
    folder = Path(survey.folder)
    if is_configuration(table):
        table = visits_of_configuration(table, survey, tile)
    else:
        table = _io.read_table(table) if isinstance(table, str | os.PathLike) else as_table(table)[0]
    table = renamed(table, columns or {})
    roles = roles_of(table)
    if "tile" in roles or tile is not None:
        warn_of_others(table, roles)
    if tile is not None and "tile" in roles:
        raise InputError(
            f"tile must be given only for a table without a column of tiles, got the column {roles['tile']!r}"
        )
    if ("tile" in roles or tile is not None) and not {*RESULTS} & {*roles}:
        raise InputError(
            f"a table of observations must have one of the columns {listed(RESULTS)}, got {listed(table.colnames)}; to "
            "record that tiles are finished, add a column state with the value done"
        )
    with locked(folder, folder / LOCK):
        events = read_events(folder)
        if not dry_run:
            remove_temporary(folder / EVENTS)
            for path in {*(folder / EVENTS).glob("*.fits")} - {
                folder / EVENTS / str(one.targets) for one in events.files
            }:
                path.unlink()  # a process was killed before it wrote the file of events
        survey = _present_survey(survey, folder)
        history = History(survey, folder, events)
        changes, tiles, n_known, n_ignored = None, [], 0, 0
        if tile is None and "tile" not in roles:
            table = renamed(table, columns_of_catalog(table, survey.provenance["catalog"].get("columns", "")))
            changes, n_known = target_changes(table, events, survey)
        else:
            dropped = {*history.states.dropped}
            tiles, n_known, n_ignored = tile_events(table, roles, history, enough, tile)
            states = history.states
            if any(event.state == ADDED for event in tiles) or (states.added and dropped - {*states.dropped}):
                names = ["tile", "ra", "dec", "position_angle", "pass"]
                first = Tiling(QTable({**survey.tiles[names], "state": np.full(len(survey.tiles), DROPPED)}))
                add_tiles(first, states.added, states.dropped)  # checks all positions
        n_events = len(tiles) + (0 if changes is None else len(changes))
        if n_events and not dry_run:
            numbers = {"n_targets": history.n_targets, "n_tiles": history.n_tiles_before}
            events.append(tiles, changes, n_applied=history.n_applied, **numbers)
    return {"n_events": n_events, "n_known": n_known, "n_ignored": n_ignored, "changes": _changes(tiles, changes)}


def _changes(tiles: list[TileEvent], targets: QTable | None) -> dict[str, list[str]]:
    """Return the identifiers of the tiles and targets that events change, by the kind of the change."""
    found: dict[str, list[str]] = {}
    for event in tiles:
        found.setdefault(CHANGES[event.state], []).append(event.tile)
        failed = event.failed if event.stated is None else event.stated
        if failed:
            found.setdefault("failed visits", []).extend(f"{event.tile}/{name}" for name in failed)
    for row in () if targets is None else targets:
        state = {1: "dropped", IS_ADDED: "added"}.get(int(row[IS_DROPPED]), "changed")
        found.setdefault(f"targets {state}", []).append(str(row["target_id"]))
    return found


def _present_survey(survey: Survey, folder: Path) -> Survey:
    """Return the survey in a folder, which may have been planned again after ``survey`` was read."""
    request = read_request(folder)
    is_present = survey.provenance.get("events") == request.get("events")
    is_present &= str(request.get("tiles")).startswith(f"{len(survey.tiles)} ")
    return survey if is_present and {*TABLES} <= {*read_index(folder)} else Survey.read(folder)
