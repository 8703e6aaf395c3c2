"""The state of all targets and tiles that follows from the events of a survey and the plans of the observed tiles."""

import hashlib
import io
import json
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from astropy.table import QTable

from rfpsurvey._common import io as _io
from rfpsurvey._common.descriptions import Column, describe, table_of
from rfpsurvey._common.read_documents import content_of, read_arrays
from rfpsurvey._common.units import MOST_VISITS
from rfpsurvey._field.table import TARGET_ID
from rfpsurvey._sky.arrays import has_role
from rfpsurvey._sky.catalog import Catalog
from rfpsurvey._survey.columns import CARDS, N_LOST
from rfpsurvey._survey.generations import EVENTS
from rfpsurvey._survey.history.events import WORDS, Events, TileEvent, TileState, add_tiles
from rfpsurvey._survey.history.rule import LAST
from rfpsurvey._survey.source import column_of, is_science
from rfpsurvey._survey.tiling.tiling import Tiling
from rfpsurvey._survey.work import LOST_IN_COLLISION, VISITS_COLUMNS
from rfpsurvey.errors import InputError, number_of

STATE = table_of(
    TARGET_ID,
    Column("requested", "number of requested visits"),
    Column("observed", "number of successful visits"),
    Column("failed", "number of failed visits"),
    Column("left", "number of remaining visits"),
    VISITS_COLUMNS["kind"],
    Column("priority", "priority that the rule determines"),
    Column("last", "result of the last visit"),
    Column("last_tile", "tile of the last visit"),
    Column("last_date", "date of the last visit"),
    Column("only_tile", "only tile that may observe the target"),
    Column("until", "last date on which the target is wanted"),
    Column("expired", "number of visits that are no longer requested, because no tile that remains may make them"),
)

ARRAYS = {"made": ("u1", 0), "failed": ("u1", 0), "last": ("i4", -1), "is_good": ("?", False), "flags": ("u1", 0)}
"""For each array of `Replay`, its data type, and the value of targets without visits."""
CHECKPOINT = f"{EVENTS}/state.npz"
NUMBERS = ("n_good", "n_failed")
STORED = {
    "keys": ("S64", (None,)),
    **{name: (kind, (None,)) for name, (kind, _) in ARRAYS.items()},
    "n_flagged": ("i8", (2,)),
    "marked_for": ("S64", (1,)),
    "names": ("S24", (None,)),
    "rows": ("i8", (None,)),
    "counts": ("i8", (None, None)),
    **dict.fromkeys(NUMBERS, ("i8", (None,))),
}
"""For each array of a checkpoint, its data type and its shape."""


class TileStates:
    """The states of all tiles after some events.

    Parameters
    ----------
    events : iterable of TileEvent
        The events, in the order in which they were recorded.
    """

    def __init__(self, events: Iterable[TileEvent]):
        self._attempts: dict[int, dict[tuple, TileEvent]] = {}
        self.dropped: dict[int, str] = {}
        """Rows of dropped tiles, with the date; without a date, the last date that was recorded before."""
        self.added: dict[int, TileEvent] = {}
        # date of each observation; for observations without a date, the last date that was recorded before
        self._order: dict[tuple, str] = {}
        self._latest = ""
        for event in events:
            self.add(event)

    def add(self, event: TileEvent) -> None:
        """Add an event, which is joined with an earlier event of the same observation.

        A dropped tile remains dropped after a report on an earlier observation, or on an observation until this date.
        """
        if event.state == TileState.DROPPED:
            if not event.date or all(attempt.date <= event.date for attempt in self.of(event.row)):
                self.dropped[event.row] = event.date or self._latest
            return
        is_late = event.observation in self._order or "" < event.date <= self.dropped.get(event.row, "")
        if event.state in (TileState.ADDED, TileState.PLANNED) or not is_late:
            self.dropped.pop(event.row, None)
        if event.state == TileState.ADDED:
            self.added[event.row] = event
        elif event.state == TileState.PLANNED:
            for key in self._attempts.pop(event.row, ()):
                del self._order[key]
        else:
            observations = self._attempts.setdefault(event.row, {})
            observations[event.observation] = event.after(observations.get(event.observation))
            self._latest = max(self._latest, event.date)
            self._order.setdefault(event.observation, event.date or self._latest)

    def of(self, row: int) -> list[TileEvent]:
        """Return the observations of a tile, in the order of dates."""
        attempts = self._attempts.get(row, {})
        return [attempts[key] for key in sorted(attempts, key=self._order.get)]

    @property
    def attempts(self) -> list[TileEvent]:
        """All observations, in the order of dates; those of a date, in the order in which they were recorded."""
        return [self._attempts[key[0]][key] for key in sorted(self._order, key=self._order.get)]

    def state_of(self, row: int) -> TileEvent:
        """Return the observation that determines the state of a tile, or an event ``dropped`` or ``planned``."""
        past = self.of(row)
        done = [event for event in past if event.state == TileState.DONE]
        if done:
            return done[-1]
        if row in self.dropped:
            return TileEvent(row, "", TileState.DROPPED)
        return past[-1] if past and past[-1].state == TileState.PARTLY else TileEvent(row, "", TileState.PLANNED)

    def word_of(self, row: int) -> str:
        """Return the state of a tile as a word; a tile is ``bad`` if its last observation failed."""
        last = self.state_of(row).state
        return "bad" if last == TileState.PLANNED and self.of(row) else WORDS[last]

    def rows(self) -> list[int]:
        """Return the rows of the tiles of which anything was recorded, in ascending order."""
        return sorted({*self._attempts, *self.dropped})


class Replay:
    """The visits of all targets that follow from observations.

    Parameters
    ----------
    n_targets : int
        Number of targets.

    Attributes
    ----------
    made, failed : ndarray of uint8, shape (n_targets,)
        Numbers of successful and of failed visits of each target, in the order of rows.
    last : ndarray of int32, shape (n_targets,)
        Index in ``attempts`` of the last visit of each target; -1 if there is none.
    is_good : ndarray of bool, shape (n_targets,)
        Whether the last visit was successful.
    flags : ndarray of uint8, shape (n_targets,)
        Flags of `Bookkeeping`.
    attempts : list of TileEvent
        The observations.
    n_flagged, n_searched : int
        The targets in reach of the first ``n_flagged`` observations are marked in ``flags``, as far as they are among
        the first ``n_searched`` targets.
    marked_for : str
        Digest of the instrument and the options for which they are marked.
    counts : dict
        For each observed tile, its counts by the name of the header card, and the numbers of its successful visits
        (``n_good``) and of its failed visits (``n_failed``).
    """

    def __init__(self, n_targets: int):
        self.made, self.failed, self.last, self.is_good, self.flags = (
            np.full(n_targets, value, dtype=kind) for kind, value in ARRAYS.values()
        )
        self.attempts: list[TileEvent] = []
        self.n_flagged, self.n_searched, self.marked_for = 0, 0, ""
        self.counts: dict[int, dict[str, int]] = {}

    def extend(self, n_targets: int) -> None:
        """Add targets without visits, so that there are ``n_targets`` targets."""
        more = n_targets - len(self.made)
        for name, (_, value) in ARRAYS.items():
            setattr(self, name, np.pad(getattr(self, name), (0, more), constant_values=value))

    def mark_for(self, options: list) -> None:
        """Remove the marks of targets in fields and in reach if they were made for other options.

        ``options`` are the digest of the instrument and the parameters of the survey.
        """
        digest = hashlib.sha256(json.dumps(options, default=str, sort_keys=True).encode()).hexdigest()
        if self.marked_for != digest:
            self.flags &= LOST_IN_COLLISION
            self.n_flagged, self.n_searched, self.marked_for = 0, 0, digest

    def add(self, event: TileEvent, events: Events, ids: np.ndarray) -> None:
        """Add an observation, and the visits of its plan."""
        number = len(self.attempts)
        self.attempts.append(event)
        if event.state != TileState.DONE:  # nothing was observed, or the observation will be continued
            events.plan(event.row, event.plan)  # raises an error if the plan is missing
            return
        visits, cards = events.observed(event)
        _check_ids(event, visits, ids)
        target, good, lost = visits_of(event, visits)
        self.made[target[good]] += self.made[target[good]] < MOST_VISITS
        bad = target[~good & ~lost]
        self.failed[bad] += self.failed[bad] < MOST_VISITS
        self.flags[target[lost]] |= LOST_IN_COLLISION
        self.last[target[~lost]] = number
        self.is_good[target[~lost]] = good[~lost]
        counted = {k: n for k, n in cards.items() if k in CARDS or k.startswith(("MISS", "MORE", "VIOL", "NOTC"))}
        # files of earlier versions do not contain this number
        counted = {N_LOST: int(visits["in_collision"].sum()), **counted}
        self.counts[event.row] = counted | {"n_good": int(good.sum()), "n_failed": len(bad)}

    def write(self, folder: Path) -> None:
        """Write a checkpoint, from which `replay` continues."""
        tiles = self.counts.values()
        names = sorted({name for counts in tiles for name in counts} - {*NUMBERS})
        values = {
            "keys": [_key(event) for event in self.attempts],
            **{name: getattr(self, name) for name in ARRAYS},
            "n_flagged": [self.n_flagged, self.n_searched],
            "marked_for": [self.marked_for],
            "names": names,
            "rows": [*self.counts],
            "counts": np.reshape([counts.get(name, 0) for counts in tiles for name in names], (len(tiles), len(names))),
            **{name: [counts[name] for counts in tiles] for name in NUMBERS},
        }
        content = io.BytesIO()
        np.savez(content, **{name: np.array(values[name], dtype=kind) for name, (kind, _) in STORED.items()})
        body = content.getvalue()
        _io.write_bytes(folder / CHECKPOINT, hashlib.sha256(body).hexdigest().encode() + body)


def replay(events: Events, states: TileStates, ids: np.ndarray) -> Replay:
    """Return the visits that follow from the observations, starting from the checkpoint if it fits to them.

    ``ids`` contains the identifiers of all targets, with which those of the visits are compared.
    """
    attempts, n_targets = states.attempts, len(ids)
    replayed = _read_checkpoint(events.folder, attempts, n_targets) or Replay(n_targets)
    replayed.extend(n_targets)
    for event in attempts[: len(replayed.attempts)]:
        events.plan(event.row, event.plan)  # the checkpoint does not depend on the files, which can be damaged
    for event in attempts[len(replayed.attempts) :]:
        replayed.add(event, events, ids)
    return replayed


def replay_of_plan(survey, events: Events) -> Replay:
    """Return the visits with which a survey was planned; ``events`` are the events with which it was planned."""
    ids = np.asarray(survey.outcomes["target_id"])
    if not events.files:
        return Replay(len(ids))
    return replay(events, TileStates(events.of_tiles(survey.provenance["events"].get("until"))), ids)


def _check_ids(event: TileEvent, visits: np.ndarray, ids: np.ndarray) -> None:
    """Raise an error if the visits of an observed tile are not visits of the targets of the catalog."""
    visits = visits[visits["target_row"] >= 0]
    rows = visits["target_row"]
    if rows.max(initial=-1) >= len(ids) or (ids[rows].astype(visits["target_id"].dtype) != visits["target_id"]).any():
        raise InputError(
            f"the catalog must be that of the survey, got another catalog: tile {event.tile} observed other targets"
        )


def visits_of(event: TileEvent, visits: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the rows of the science targets of an observed tile, and which visits are good and lost to a collision."""
    visits = visits[visits["target_row"] >= 0]
    if "kind" in visits.dtype.names:
        visits = visits[has_role(visits["kind"], "science")]
    observed = visits["observed"].astype(bool)
    good = observed & (event.state == TileState.DONE)
    if event.failed:
        good &= ~np.isin(visits["positioner"], np.array(list(event.failed)).astype(visits["positioner"].dtype))
    return visits["target_row"].astype(np.int64), good, ~observed


def _key(event: TileEvent) -> bytes:
    text = json.dumps([*event[:6], "\0".join(event.failed), *([event.swaps] if event.swaps else [])])
    return hashlib.sha256(text.encode()).hexdigest().encode()


def checkpoint_of(folder: Path) -> bytes:
    """Return the archive in the checkpoint, or raise an error if the checkpoint is missing or damaged."""
    content = content_of(folder / CHECKPOINT, most=2**40)
    if hashlib.sha256(content[64:]).hexdigest().encode() != content[:64]:
        raise InputError(f"{folder / CHECKPOINT} is damaged (its digest differs from its content)")
    return content[64:]


def _read_checkpoint(folder: Path, attempts: list[TileEvent], n_targets: int) -> Replay | None:
    """Return the state in the checkpoint; None if there is none, or if it is not the state after the first attempts."""
    try:
        stored = read_arrays(io.BytesIO(checkpoint_of(folder)), STORED, "the archive")
    except InputError:
        return None
    keys, size = stored["keys"].tolist(), len(stored["made"])
    is_earlier = len(stored["rows"]) and N_LOST.encode() not in stored["names"]  # an earlier version wrote the file
    if is_earlier or size > n_targets or keys != [_key(event) for event in attempts[: len(keys)]]:
        return None
    replayed = Replay(0)
    for name in ARRAYS:
        setattr(replayed, name, stored[name])
    replayed.attempts, (replayed.n_flagged, replayed.n_searched) = attempts[: len(keys)], stored["n_flagged"].tolist()
    replayed.marked_for = stored["marked_for"].tolist()[0].decode()
    names = [*(name.decode() for name in stored["names"].tolist()), *NUMBERS]
    counts = np.column_stack([stored["counts"], *(stored[name] for name in NUMBERS)])
    for row, numbers in zip(stored["rows"].tolist(), counts.tolist(), strict=True):
        replayed.counts[row] = dict(zip(names, numbers, strict=True))
    return replayed


def state_table(state) -> QTable:
    """Return the table of a `SurveyState`; see `SurveyState.table`."""
    replayed, catalog = state.replayed, state.catalog
    table = QTable({"target_id": column_of(catalog, "id")}, copy=False)
    counts = is_science(catalog)
    for name in ("requested", "observed", "failed", "left"):
        table[name] = np.where(counts, getattr(state, name), np.uint8(0))
    for name in ("kind", "priority") if isinstance(catalog, Catalog) else ("kind",):
        if (values := column_of(catalog, name)) is not None:
            table[name] = values
    table["last"] = np.array(LAST)[last_results(replayed)]
    for name in ("tile", "date"):
        values = [getattr(event, name) for event in replayed.attempts]
        table[f"last_{name}"] = np.array([*values, ""])[replayed.last]  # -1 stands for targets without a visit
    if (limits := state.limits) is not None:
        for name, values in {"only_tile": limits.name, "until": limits.until, "expired": limits.expired}.items():
            table[name] = np.zeros(len(table), dtype=values.dtype)  # zeros of text are empty text
            table[name][limits.row] = values
    table.meta["events"] = state.record
    return describe(table, STATE)


def last_results(replayed: Replay) -> np.ndarray:
    """Return the result of the last visit of each target as an index of ``LAST``."""
    return np.where(replayed.last < 0, 0, np.where(replayed.is_good, LAST.index("good"), LAST.index("bad")))


def tiling_after(events: Events, states: TileStates, tiling: Tiling) -> Tiling:
    """Return the tiling of the first plan with the tiles that were added or moved; see `SurveyState.tiling`."""
    files = events.files
    added = [event.row for file in files for event in file.tiles if event.place and event.row >= file.n_tiles]
    first = min(added, default=files[-1].n_tiles if files else 0)
    if len(tiling) < first or (added and len(tiling) > first):
        remedy = "; record further tiles with the state added" if len(tiling) > first else ""
        raise InputError(
            f"tiles must be the {number_of(first, 'tile')} of the first plan, got {number_of(len(tiling), 'tile')}"
            f"{remedy}"
        )
    if states.added:
        tiling = add_tiles(tiling, states.added, TileStates(events.of_tiles()).dropped)
    names = dict(enumerate(np.asarray(tiling.table["tile"]).astype(str).tolist()))
    for event in events.of_tiles():
        if names.get(event.row) != event.tile:
            raise InputError(
                f"tiles must be those of the first plan, got the tile {names.get(event.row)} in row {event.row} "
                f"instead of {event.tile}"
            )
    return tiling
