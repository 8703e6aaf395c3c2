"""Targets of opportunity: added targets that only one tile, or only the tiles until a date, may observe."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from astropy.table import QTable, Table
from astropy.time import Time

from rfpsurvey._survey.cadences import NEVER
from rfpsurvey._survey.history.event_files import History
from rfpsurvey._survey.history.event_tables import texts_of
from rfpsurvey._survey.history.events import WORDS, TileState, to_date
from rfpsurvey._survey.history.replay import TileStates
from rfpsurvey._survey.history.targets import ID, LIMITS, ROW
from rfpsurvey._survey.tiling.columns import times_of_tiles
from rfpsurvey._survey.tiling.tiling import Tiling
from rfpsurvey.errors import InputError, number_of, warn

ONLY, UNTIL = LIMITS
ONLY_ROW = "only_row"
"""Column of changes of targets with the row of the tile in the column ``ONLY``; -1 for none."""


@dataclass(frozen=True, eq=False)
class Limits:
    """The tiles that may observe targets of opportunity, whose rows in the catalog are ``row``, in ascending order."""

    row: np.ndarray
    tile: np.ndarray
    """Row of the only tile that may observe each target; -1 for all tiles."""
    name: np.ndarray
    until: np.ndarray
    """Last date on which each target is wanted; empty text for no date."""
    days: np.ndarray | None
    """Time of each tile (MJD), or ``NEVER`` for tiles without a time; None if no target has a date."""
    closed: list[int]
    """Rows of the tiles that will not be observed any more."""
    now: str
    """Date of the last recorded observation."""
    expired: np.ndarray | None = None
    """Number of visits of each target that are not requested any more, because no tile that remains may observe it."""

    @cached_property
    def end(self) -> np.ndarray:
        """Time (MJD) before which each target must be observed; no time is before the end of a date before ``now``."""
        days = [Time(date, scale="tai").mjd + 1 if date else np.inf for date in self.until.tolist()]
        return np.where((self.until != "") & (self.until < self.now), -np.inf, days)

    def allows(self, tile: int) -> np.ndarray:
        """Return whether the tile in row ``tile`` may observe each target."""
        return ((self.tile < 0) | (self.tile == tile)) & (self.days is None or self.days[tile] < self.end)

    @property
    def is_over(self) -> np.ndarray:
        """Whether no tile that remains may observe each target."""
        is_closed = np.isin(self.tile, self.closed)
        if self.days is None:
            return is_closed
        first = np.delete(self.days, self.closed).min(initial=NEVER)
        return is_closed | (np.where(self.tile < 0, first, self.days[self.tile]) >= self.end)

    def apply(self, wanted: np.ndarray, made: np.ndarray) -> tuple[np.ndarray, "Limits"]:
        """Return the requested visits of all targets, and the limits with the numbers of expired visits."""
        wanted, asked, made = wanted.copy(), wanted[self.row], made[self.row]
        asked = np.where(self.tile < 0, asked, np.minimum(asked, 1))
        wanted[self.row] = np.where(self.is_over, np.minimum(asked, made), asked)
        return wanted, replace(self, expired=asked - wanted[self.row])


def limits_of(tables: Iterable[QTable], states: TileStates, until: str | None, tiles: object) -> Limits | None:
    """Return the limits in tables of changes up to a date; None if there are none.

    ``tiles`` is the tiling of the survey, or a function that returns it, which is called if a target has a date.
    """
    stated: dict[int, tuple] = {}
    for table in (table for table in tables if ONLY_ROW in table.colnames):
        names = (ROW, ONLY_ROW, ONLY, UNTIL, "date")
        for row, tile, name, last, date in zip(*(np.asarray(table[k]).tolist() for k in names), strict=True):
            if (name or last) and (until is None or date <= until):  # the last of several values remains
                before = stated.get(row, (-1, "", ""))
                stated[row] = *((tile, name) if name else before[:2]), last or before[2]
    if not stated:
        return None
    rows, days = sorted(stated), None
    tile, name, last = (np.array(values) for values in zip(*(stated[row] for row in rows), strict=True))
    if (last != "").any():
        tiling = tiles() if callable(tiles) else tiles
        if tiling is None or (times := times_of_tiles(tiling)) is None:
            raise InputError(
                "until must be given only for targets of a survey whose tiles have times (a column time, mjd or date), "
                "got no times"
            )
        days = times.utc.mjd  # tiles that were added to a survey have no times
        days = np.append(days, np.full(max(1 + max(states.added, default=-1) - len(days), 0), NEVER))
    closed = [row for row in states.rows() if states.state_of(row).state in (TileState.DONE, TileState.DROPPED)]
    now = max((event.date for event in states.attempts), default="")
    return Limits(np.array(rows), tile, name, last, days, closed, now)


def slots_closed_to(state, source, n_tiles: int) -> Callable[[int], np.ndarray]:
    """Return a function of the row of a tile that returns the slots of the targets that this tile may not observe.

    Tiles that were observed keep their plans. ``state`` is the `SurveyState`, or None.
    """
    limits = None if state is None else state.limits
    if limits is None:
        return lambda _: np.empty(0, dtype=np.int64)
    if limits.days is not None and len(limits.days) != n_tiles:
        raise InputError(
            f"tiles must be the {number_of(len(limits.days), 'tile')} of the state, because targets are wanted until a "
            f"date, got {number_of(n_tiles, 'tile')}; give them to Survey.replan"
        )
    row, kept = source.to_slots(np.arange(len(source))), state.kept
    slot = np.flatnonzero(np.isin(row, limits.row))
    place = np.searchsorted(limits.row, row[slot])
    return lambda tile: slot[:0] if tile in kept else slot[~limits.allows(tile)[place]]


def adds_targets(table: Table, roles: dict[str, str]) -> bool:
    """Return whether a table with a column of tiles adds targets for single tiles, instead of stating visits."""
    if not {"target", "state"} <= {*roles} or "positioner" in roles:
        return False
    columns = zip(*(texts_of(table, roles[role]) for role in ("target", "state")), strict=True)
    is_added = [bool(target) and state.lower() == TileState.ADDED for target, state in columns]
    if any(is_added) and not all(is_added):
        raise InputError(
            "a table that adds targets for single tiles must have a target and the state added in each row, got "
            f"another row {is_added.index(False)}"
        )
    return any(is_added)


def with_limits(table: Table, roles: dict[str, str], kinds: Iterable[str]) -> Table:
    """Return a table of targets in which the columns ``LIMITS`` state the tile and the date of each target.

    ``kinds`` are the names of the columns of the catalog, of which ``until`` can be one.
    """
    name = next((name for name in table.colnames if name.lower() == "until"), None)
    if name in kinds:
        warn("the column 'until' is a column of the catalog, and not the last date on which targets are wanted")
        name = None
    if name is None and "tile" not in roles:
        return table
    used, nothing = {name, roles.get("tile")}, [""] * len(table)
    try:
        last = nothing if name is None else [*map(to_date, table[name])]
    except InputError as error:
        raise InputError(str(error).replace("date must", "until must", 1)) from None
    only = texts_of(table, roles["tile"]) if "tile" in roles else nothing
    others = {k: table[k] for k in table.colnames if k not in used}
    return Table({**others, ONLY: np.array(only, dtype=str), UNTIL: np.array(last, dtype=str)}, copy=False)


def check_limits(changes: QTable, history: History, tiles: Callable[[], Tiling], *, has_cadences: bool) -> None:
    """Raise an error unless a tile that remains may observe the targets whose limits change.

    The rows of their tiles, and the default of one visit for targets of a single tile, are added to the changes.
    """
    events, states, ids, rows = history.events, history.states, np.asarray(changes[ID]), np.asarray(changes[ROW])
    given = np.zeros(len(changes), dtype=bool)
    if ONLY in changes.colnames:
        names = np.asarray(changes[ONLY])
        given = (names != "") | (np.asarray(changes[UNTIL]) != "")
        first = events.target_tables[0][0] if events.target_tables else history.n_targets
        kind = np.asarray(changes["kind"]) if "kind" in changes.colnames else np.full(len(changes), "")
        for where, text in (
            (np.full(len(changes), has_cadences), "targets of a survey without cadences"),
            (rows < first, "added targets"),
            (~np.isin(kind, ("", "science")), "science targets"),
        ):
            if (given & where).any():
                raise InputError(f"tile and until must be given only for {text}, got target {ids[given & where][0]}")
        for name in names[names != ""].tolist():
            if (state := states.state_of(history.find_row(name)).state) != TileState.PLANNED:
                raise InputError(
                    f"tile must be a tile that is not yet observed, got tile {name}, which is {WORDS[state]}"
                )
        changes[ONLY_ROW] = np.array([history.row_of.get(name, -1) for name in names.tolist()], dtype=np.int64)
        changes["visits"][(names != "") & (np.asarray(changes["visits"]) < 0)] = 1
    limits = limits_of([*(table for _, table in events.target_tables), changes], states, None, tiles)
    if limits is None:
        return
    begun = [row for row in states.rows() if states.state_of(row).state == TileState.PARTLY]  # they keep their plans
    over = np.isin(rows, limits.row[replace(limits, closed=[*limits.closed, *begun]).is_over]) & given
    if over.any():
        until = limits.until[limits.row == rows[over][0]][0]
        raise InputError(
            "until must be a date before whose end a tile can still observe the target, got "
            f"{until} for target {ids[over][0]}"
            + (f"; the last recorded observation is of {limits.now}" if limits.now else "")
        )
    several = np.isin(rows, limits.row[limits.tile >= 0]) & (np.asarray(changes["visits"]) > 1)
    if several.any():
        n = changes["visits"][several][0]
        raise InputError(
            f"visits must be at most 1 for a target of a single tile, got {n} for target {ids[several][0]}"
        )
