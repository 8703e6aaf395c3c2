"""Convert a table of observations, or of changes to tiles or targets, to events, and append them to a survey.

Files of SDSS-V that state which fibers were on target are converted to tables of failed visits.
"""

import os
from numbers import Number
from pathlib import Path

import numpy as np
from astropy.table import QTable, Table
from astropy.time import Time

from rfpsurvey import _io
from rfpsurvey._folder import LOCK, locked, read_index, remove_temporary
from rfpsurvey.catalog import as_table
from rfpsurvey.errors import InputError, check_switch, listed, number_of, refusal, warn
from rfpsurvey.plans import native_format, read_plan
from rfpsurvey.survey._folder import EVENTS, TABLES, read_request
from rfpsurvey.survey._history._columns import check_others, columns_of_catalog, renamed, roles_of
from rfpsurvey.survey._history._events import TileEvent, TileState, add_tiles, read_events
from rfpsurvey.survey._history._targets import DROPPED, IS_ADDED, target_changes
from rfpsurvey.survey._history._tile_events import History, tile_events
from rfpsurvey.survey._survey import Survey
from rfpsurvey.tiling import Tiling

RESULTS = ("state", "good", "date", "fraction", "positioner", "target")
"""Roles of columns of which a table of observations has at least one; other tables can be lists of tiles."""
CHANGES = {
    TileState.DONE: "tiles observed",
    TileState.PARTLY: "tiles partly observed",
    TileState.BAD: "tiles whose observation was bad",
    TileState.DROPPED: "tiles dropped",
    TileState.PLANNED: "tiles whose records are canceled",
    TileState.ADDED: "tiles added or moved",
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
    if _is_configuration(table):
        table = _visits_of_configuration(table, survey, tile)
    else:
        table = _io.read_table(table) if isinstance(table, str | os.PathLike) else as_table(table)[0]
    table = renamed(table, columns or {})
    roles = roles_of(table)
    named = columns_of_catalog(table, survey.provenance["catalog"].get("columns", ""))
    if "tile" in roles or tile is not None:
        check_others(table, roles, named.get("target"))
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
            table = renamed(table, named)
            changes, n_known = target_changes(table, events, survey)
        else:
            dropped = {*history.states.dropped}
            tiles, n_known, n_ignored = tile_events(table, roles, history, enough, tile)
            states = history.states
            if any(event.state == TileState.ADDED for event in tiles) or (states.added and dropped - {*states.dropped}):
                names = ["tile", "ra", "dec", "position_angle", "pass"]
                first = Tiling(QTable({**survey.tiles[names], "state": np.full(len(survey.tiles), TileState.DROPPED)}))
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
        state = {1: "dropped", IS_ADDED: "added"}.get(int(row[DROPPED]), "changed")
        found.setdefault(f"targets {state}", []).append(str(row["target_id"]))
    return found


def _present_survey(survey: Survey, folder: Path) -> Survey:
    """Return the survey in a folder, which may have been planned again after ``survey`` was read."""
    request = read_request(folder)
    is_present = survey.provenance.get("events") == request.get("events")
    is_present &= str(request.get("tiles")).startswith(f"{len(survey.tiles)} ")
    return survey if is_present and {*TABLES} <= {*read_index(folder)} else Survey.read(folder)


def _is_configuration(table: object) -> bool:
    """Return whether the table of observations is the path of a plan of another program."""
    return isinstance(table, str | os.PathLike) and native_format(_io.to_path(table)) is not None


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
    row_of = {name: row for row, name in enumerate(np.asarray(used["positioner"]).astype(str).tolist())}
    on_target, ids = np.asarray(used["on_target"]) == 1, np.asarray(used["target_id"]).astype(str).tolist()
    reasons, n_same, n_science = [], 0, 0
    for name, target, row in zip(
        np.asarray(visits["positioner"]).astype(str).tolist(),
        np.asarray(visits["target_id"]).astype(str).tolist(),
        visits["target_row"].tolist(),
        strict=True,
    ):
        found = row_of.get(name)
        same = found is not None and (row < 0 or ids[found] == target)
        n_same, n_science = n_same + (same and row >= 0), n_science + (row >= 0)
        reasons.append(
            "no target in the file"
            if found is None
            else "another target in the file"
            if not same
            else ""
            if on_target[found]
            else "not on target"
        )
    if n_science and not n_same:
        raise InputError(
            f"{path} must be the file of tile {tile}, got a file in which no fiber has its target of the survey"
        )
    if not on_target.any():
        warn(f"no fiber of {path} was on target; therefore, all visits of tile {tile} are recorded as failed")
    others = len({*row_of} - {*np.asarray(visits["positioner"]).astype(str).tolist()})
    if others:
        warn(f"{number_of(others, 'fiber')} of {path} with a target have no target in tile {tile}, and are ignored")
    mjd = plan.meta["header"].get("MJD")
    date = "" if mjd is None else Time(float(mjd), format="mjd", scale="utc").isot[:10]
    good = np.array([not one for one in reasons], dtype=bool)
    columns = {"positioner": visits["positioner"], "target": visits["target_id"], "good": good, "reason": reasons}
    return Table({**columns, "date": [date] * len(visits)})
