"""The events of a survey: what was observed, and which tiles and targets were added, dropped or changed.

Each call of ``Survey.record`` or ``Survey.undo`` appends one file. A file contains what the table stated, a digest of
its own content, and the digest of the preceding file, so that missing, changed and truncated files are found. Files are
never changed; `TileStates` joins the statements on an observation.
"""

import csv
import hashlib
import json
import re
from collections.abc import Collection, Iterable
from dataclasses import dataclass
from functools import cached_property
from io import StringIO
from pathlib import Path
from typing import NamedTuple

import astropy.units as u
import numpy as np
from astropy.table import QTable, Table, vstack

from rfpsurvey import _io
from rfpsurvey._readers import content_of, is_present, read_fits_bytes, sentence
from rfpsurvey.errors import InputError, number_of
from rfpsurvey.survey._folder import (
    EVENTS,
    MOST_FILE,
    kept_name,
    parse_visits,
    part_name,
    read_named,
    read_request,
    verified,
)
from rfpsurvey.tiling import Tiling

VERSION = 2
FRAME = '{{"digest": "{}", "events":\n{}\n}}\n'
"""Text of a file of events with its digest and its content, which are JSON in all."""
KINDS = ("targets", "rows")
"""Kinds of tables that belong to a file of events."""
FRAMED = re.compile(r'\{"digest": "([0-9a-f]{64})", "events":\n(.*)\n\}\n', re.DOTALL)


class TileState:
    """States of a tile that events record.

    ``DONE``: the tile was observed. ``PARTLY``: its observation will be continued with the same plan. ``BAD``: the
    observation failed. ``DROPPED``: the tile will not be observed. ``PLANNED``: this cancels what was recorded before.
    ``ADDED``: a new tile, or a new position of a tile.
    """

    DONE, PARTLY, BAD, DROPPED, PLANNED, ADDED = ALL = ("done", "partly", "bad", "dropped", "planned", "added")


WORDS = {TileState.DONE: "observed", TileState.PARTLY: "partly observed", TileState.BAD: "bad"}
WORDS |= {name: name for name in (TileState.DROPPED, TileState.PLANNED)}
"""Words for the states of tiles."""


class TileEvent(NamedTuple):
    """What a table states about a tile."""

    row: int
    """Row of the tile in the tiling; added tiles follow the tiles of the first plan."""
    tile: str
    state: str
    """One of the states of `TileState`."""
    date: str = ""
    """Date of the observation, such as 2026-01-03; empty if no date was given."""
    fraction: float = 1.0
    """Fraction of the requested exposure."""
    plan: str = ""
    """SHA-256 of the file of the tile with which the tile was observed."""
    failed: dict = {}  # noqa: RUF012  (it is never changed)
    """Positioners that failed, with the reason for each of them."""
    place: tuple = ()
    """Right ascension, declination and position angle (deg) and the pass of an added tile."""
    has_state: bool = True
    """Whether the table states the state and the fraction; otherwise, they are those of an earlier record."""
    good: tuple = ()
    """Positioners that were successful according to the table."""
    replaces: bool = False
    """Whether the failed visits of earlier records of the same observation are discarded."""

    @property
    def observation(self) -> tuple:
        """The key of an observation: an event with the same key corrects the earlier event."""
        return self.row, self.date, self.plan

    def after(self, earlier: "TileEvent | None") -> "TileEvent":
        """Return this event joined with an earlier event of the same observation."""
        if earlier is None:
            return self
        state, fraction = (self if self.has_state else earlier)[2:5:2]
        kept = {} if self.replaces else {k: reason for k, reason in earlier.failed.items() if k not in self.good}
        return self._replace(state=state, fraction=fraction, failed=dict(sorted((kept | self.failed).items())))

    def includes(self, other: "TileEvent") -> bool:
        """Return whether the table of this event states everything that the table of another event states."""
        if (self.row, self.date, self.place) != (other.row, other.date, other.place):
            return False
        own, its = ((event.state, event.fraction) if event.has_state else () for event in (self, other))
        return its in ((), own) and other.failed.items() <= self.failed.items() and {*other.good} <= {*self.good}


@dataclass(frozen=True)
class EventFile:
    """The content of one file of events."""

    n_targets: int
    """Number of targets before this file, which is the row of the first target that this file adds."""
    n_tiles: int
    n_applied: int
    """Number of files with whose events the plans were made that were valid when this file was written."""
    tiles: tuple[TileEvent, ...]
    targets: str | None
    """Name of the file with a table of added and changed targets."""
    digest: str
    previous: str
    """Digest of the preceding file."""
    told: dict
    """The name of the table, the time of recording (UTC), the user and the note, as text."""
    rows: str | None = None
    """Name of the file with the rows of a table of observations as the table stated them."""
    undoes: int | None = None
    """Number of the file that this file undoes."""

    @property
    def others(self) -> list[str]:
        """Names of the tables that belong to this file."""
        return [name for name in (self.targets, self.rows) if name]


@dataclass(frozen=True)
class Events:
    """All events of a survey, in the order in which they were recorded.

    Parameters
    ----------
    folder : Path
        The folder of the survey.
    files : tuple of EventFile
        The contents of the files.
    """

    folder: Path
    files: tuple[EventFile, ...] = ()

    @property
    def digest(self) -> str:
        """A digest of all events; empty text if there are none."""
        return self.files[-1].digest if self.files else ""

    @cached_property
    def undone(self) -> dict[int, int]:
        """The files that were undone, with the file that undoes each of them; files are numbered from 1."""
        undone = {}
        for number in range(len(self.files), 0, -1):  # an undo that was undone later has no effect
            if self.files[number - 1].undoes and number not in undone:
                undone.setdefault(self.files[number - 1].undoes, number)
        return undone

    def of_file(self, number: int) -> Iterable[TileEvent]:
        """Yield the events of tiles in a file; if the file was undone, the tiles that it added are dropped."""
        file = self.files[number - 1]
        if number not in self.undone:
            yield from file.tiles
            return
        for event in file.tiles:
            if event.place and event.row >= file.n_tiles:  # later tiles keep their rows
                yield from (event, TileEvent(event.row, event.tile, TileState.DROPPED, "", 0.0))

    def of_tiles(self, until: str | None = None) -> Iterable[TileEvent]:
        """Yield the events of tiles up to a date, without those that were undone."""
        for number in range(1, len(self.files) + 1):
            for event in self.of_file(number):
                if until is None or event.date <= until:
                    yield event

    @property
    def plans(self) -> dict[tuple[int, str], None]:
        """The rows of tiles and the plans with which they were observed, also according to files that were undone."""
        return dict.fromkeys((event.row, event.plan) for file in self.files for event in file.tiles if event.plan)

    def first(self, n: int) -> "Events":
        """Return the events of the first n files."""
        return Events(self.folder, self.files[:n])

    def of_plan(self, provenance: dict) -> "Events":
        """Return the events with which a survey with a given provenance was planned."""
        return self.first(provenance.get("events", {"n_files": 0})["n_files"])

    @cached_property
    def target_tables(self) -> list[tuple[int, QTable]]:
        """Tables of added and changed targets, each with the row of the first target that it adds.

        Of a table that was undone, only the added targets remain, and are dropped, so that later ones keep their rows.
        """
        tables = []
        for number, file in enumerate(self.files, 1):
            table = self.read_targets(file.targets) if file.targets else QTable()
            if number in self.undone and len(table):
                table = table[table["target_row"] >= file.n_targets]
                table["dropped"] = np.ones(len(table), dtype=np.int16)
            if len(table):
                tables.append((file.n_targets, table))
        return tables

    def read_targets(self, name: str) -> QTable:
        """Return a table of added and changed targets, or raise an error if its file is missing or damaged."""
        return QTable(read_fits_bytes(self.read_other(name), self.folder / EVENTS / name)[0])

    def read_other(self, name: str) -> bytes:
        """Return the content of a table in the folder of events, or raise an error if it is missing or damaged."""
        return read_named(self.folder / EVENTS / name, name.partition("-")[2].partition(".")[0])

    def plan(self, row: int, digest: str) -> bytes:
        """Return the plan with which a tile was observed: the content of the file of the tile at that time."""
        content = verified(self.folder / part_name(row), digest)
        content = verified(self.folder / kept_name(digest), digest) if content is None else content
        if content is None:
            raise InputError(
                f"{self.folder / part_name(row)} must be the plan with which the tile in row {row} was observed, got "
                "another or a damaged file, and there is no copy of the plan; restore the file, or record the state "
                "planned for this tile, which cancels its observations"
            )
        return content

    def visits(self, event: TileEvent) -> tuple[np.ndarray, dict]:
        """Return the visits of the plan with which a tile was observed, and the header cards of the file."""
        return parse_visits(self.plan(event.row, event.plan), f"the plan of tile {event.tile}", event.tile)

    def append(
        self, tiles: list[TileEvent], targets: QTable | None, rows: Table | None, undoes: int | None = None, **about
    ) -> None:
        """Write a file with events; ``about`` are the numbers in `EventFile`, and ``told``."""
        number, names = len(self.files) + 1, {}
        with _io.written(self.folder / EVENTS):
            (self.folder / EVENTS).mkdir(exist_ok=True)
        contents = {}
        if targets is not None:
            columns, fixed = targets.as_array(), tuple(_io.table_cards("TARGETS", targets.colnames, {}).items())
            contents["targets"] = "fits", _io.fits_bytes({k: columns[k] for k in targets.colnames}, {}, fixed)
        elif rows is not None:
            lines = StringIO()
            csv.writer(lines, lineterminator="\n").writerows([rows.colnames, *rows.iterrows()])
            contents["rows"] = "csv", lines.getvalue().encode()
        for kind, (ending, content) in contents.items():
            names[kind] = f"{number:06d}-{hashlib.sha256(content).hexdigest()}.{ending}"
            _io.write_bytes(self.folder / EVENTS / names[kind], content, sync=True)
        events = [event._asdict() | {"failed": _by_reason(event.failed)} for event in tiles]
        about |= {"version": VERSION, "previous": self.digest, "undoes": undoes, "tiles": events}
        body = json.dumps(about | {kind: names.get(kind) for kind in KINDS}, separators=(",", ":"), sort_keys=True)
        _io.write_bytes(self.folder / _name(number), FRAME.format(_digest(body), body).encode(), sync=True)


def read_events(folder: Path, known: Events | None = None) -> Events:
    """Return the events of a survey, or raise an error if a file is missing or damaged.

    Files whose digests are those of ``known`` are verified, but not parsed again.
    """
    parsed = {} if known is None else {file.digest: file for file in known.files}
    path = folder / EVENTS
    found = sorted(one.name for one in path.glob("*.json")) if is_present(path) else []
    files, previous = [], ""
    for number, name in enumerate(found, 1):
        if name != Path(_name(number)).name:
            raise InputError(f"{folder / _name(number)} is missing, but {name} exists")
        file = _read(path / name, number, parsed)
        if file.previous != previous:
            raise InputError(f"{path / name} must follow the events before it, got a file for other events")
        files.append(file)
        previous = file.digest
    planned = read_request(folder).get("events", {"n_files": 0})
    n = planned["n_files"]
    if n > len(files):
        raise InputError(
            f"{folder / _name(len(files) + 1)} is missing, although {folder} was planned with {number_of(n, 'file')} "
            "of events; restore it, or use the folder in which the events were recorded"
        )
    if n and files[n - 1].digest != planned["digest"]:
        raise InputError(f"{folder / _name(n)} must be the file with which {folder} was planned, got another file")
    return Events(folder, tuple(files))


def _read(path: Path, number: int, parsed: dict[str, EventFile]) -> EventFile:
    """Return the content of a file of events, which is that in ``parsed`` if the digest is equal."""
    try:
        found = FRAMED.fullmatch(content_of(path, most=MOST_FILE).decode("utf-8", "replace"))
        if not found or found[1] != _digest(found[2]):
            raise InputError("its digest differs from its content")
        if found[1] in parsed:
            return parsed[found[1]]
        about = json.loads(found[2])
        if about["version"] not in (1, VERSION):
            raise InputError(f"version {about['version']} of the format is not supported")
        events = [
            event | {"place": tuple(event["place"]), "failed": _by_name(_stated(event))} for event in about["tiles"]
        ]
        tiles = tuple(TileEvent(**event) for event in events)
        if not all(map(_is_valid, tiles)):
            raise InputError("its events have other types")
        numbers = (about[name] for name in ("n_targets", "n_tiles", "n_applied"))
        told, undoes, rows = about.get("told", {}), about.get("undoes"), about.get("rows")
        if not (isinstance(told, dict) and isinstance(undoes, int | None) and 0 < (undoes or 1) < max(number, 2)):
            raise InputError("its entries have other types")
        file = EventFile(*numbers, tiles, about["targets"], found[1], about["previous"], told, rows, undoes)
        for name in file.others:
            if not re.fullmatch(r"\d{6}-[0-9a-f]{64}\.(fits|csv)", name):
                raise InputError(f"{name!r} is not the name of a table")
    except (InputError, AttributeError, KeyError, TypeError, ValueError, RecursionError) as error:
        raise InputError(f"{path} is damaged ({sentence(error)})") from None
    return file


def _stated(event: dict) -> dict[str, list[str]]:
    """Return the failed positioners that a table stated; files of version 1 also contain those of earlier records."""
    stated = event.pop("stated", None)
    return event["failed"] if stated is None else stated


def _is_valid(event: TileEvent) -> bool:
    """Return whether the values of an event have their types."""
    kinds = (int, str, str, str, int | float, str, dict, tuple, bool, list | tuple, bool)
    is_possible = event.state in TileState.ALL and len(event.place) in (0, 4)
    return is_possible and all(map(isinstance, event, kinds)) and event.row >= 0


def _by_reason(failed: dict[str, str]) -> dict[str, list[str]]:
    """Return the positioners that failed for each reason."""
    found: dict[str, list[str]] = {}
    for name, reason in failed.items():
        found.setdefault(reason, []).append(name)
    return found


def _by_name(failed: dict[str, list[str]]) -> dict[str, str]:
    """Return the reason for each positioner that failed."""
    return dict(sorted((name, reason) for reason, names in failed.items() for name in names))


def _name(number: int) -> str:
    return f"{EVENTS}/{number:06d}.json"


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def places_of(tiles: QTable) -> np.ndarray:
    """Return the right ascension, declination, position angle (deg) and pass of each tile, shape (n, 4)."""
    angles = (tiles[name].to_value(u.deg) for name in ("ra", "dec", "position_angle"))
    return np.column_stack([*angles, tiles["pass"]])


def add_tiles(tiling: Tiling, added: dict[int, TileEvent], dropped: Collection[int]) -> Tiling:
    """Return a tiling with the tiles that events added or moved; ``added`` contains the event of each row.

    Another tile can have the position of a tile in one of the rows ``dropped``.
    """
    table, names = tiling.table.copy(), np.asarray(tiling.table["tile"])
    for row, event in sorted(added.items()):
        ra, dec, angle, number = event.place
        values = {"ra": ra * u.deg, "dec": dec * u.deg, "position_angle": angle * u.deg, "pass": number}
        if row < len(table):
            for name, value in values.items():
                table[name][row] = value
            continue
        one = table[:1].copy()
        one.replace_column("tile", np.array([event.tile if names.dtype.kind == "U" else int(event.tile)]))
        for name, value in values.items():
            one[name] = value
        table = vstack([table, one], metadata_conflicts="silent")
    table.meta.pop("summary", None)
    table["state"] = np.where(np.isin(np.arange(len(table)), [*dropped]), TileState.DROPPED, "")
    return Tiling(table)
