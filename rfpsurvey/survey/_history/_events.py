"""The events of a survey: what was observed, and which tiles and targets were added, dropped or changed.

Each call of ``Survey.record`` appends one file. A file contains a digest of its own content and the digest of the
preceding file, so that missing, changed and truncated files are found. Files are never changed.
"""

import hashlib
import json
import re
from collections.abc import Collection, Iterable
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import NamedTuple

import astropy.units as u
import numpy as np
from astropy.table import QTable, vstack
from astropy.time import Time

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

VERSION = 1
FRAME = '{{"digest": "{}", "events":\n{}\n}}\n'
"""Text of a file of events with its digest and its content, which are JSON in all."""
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
    """What was recorded for a tile."""

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
    stated: dict | None = None
    """Positioners that failed according to the table alone, without earlier records; None if these are ``failed``."""
    good: tuple = ()
    """Positioners that were successful according to the table."""

    @property
    def observation(self) -> tuple:
        """The key of an observation: an event with the same key corrects the earlier event."""
        return self.row, self.date, self.plan

    def includes(self, other: "TileEvent") -> bool:
        """Return whether the table of this event states everything that the table of another event states."""
        if (self.row, self.date, self.place) != (other.row, other.date, other.place):
            return False
        own, its = ((one.state, one.fraction) if one.has_state else () for one in (self, other))
        failed, its_failed = (one.failed if one.stated is None else one.stated for one in (self, other))
        return its in ((), own) and its_failed.items() <= failed.items() and {*other.good} <= {*self.good}


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

    def of_tiles(self, until: str | None = None) -> Iterable[TileEvent]:
        """Yield the events of tiles up to a date."""
        for file in self.files:
            for event in file.tiles:
                if until is None or event.date <= until:
                    yield event

    def first(self, n: int) -> "Events":
        """Return the events of the first n files."""
        return Events(self.folder, self.files[:n])

    def of_plan(self, provenance: dict) -> "Events":
        """Return the events with which a survey with a given provenance was planned."""
        return self.first(provenance.get("events", {"n_files": 0})["n_files"])

    @cached_property
    def target_tables(self) -> list[tuple[int, QTable]]:
        """Tables of added and changed targets, each with the row of the first target that it adds."""
        return [(one.n_targets, self.read_targets(one.targets)) for one in self.files if one.targets]

    def read_targets(self, name: str) -> QTable:
        """Return a table of added and changed targets, or raise an error if its file is missing or damaged."""
        path = self.folder / EVENTS / name
        return QTable(read_fits_bytes(read_named(path, name.partition("-")[2].removesuffix(".fits")), path)[0])

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

    def append(self, tiles: list[TileEvent], targets: QTable | None, **numbers: int) -> None:
        """Write a file with events; ``numbers`` are the numbers in `EventFile`."""
        number, name = len(self.files) + 1, None
        with _io.written(self.folder / EVENTS):
            (self.folder / EVENTS).mkdir(exist_ok=True)
        if targets is not None:
            rows, fixed = targets.as_array(), tuple(_io.table_cards("TARGETS", targets.colnames, {}).items())
            content = _io.fits_bytes({column: rows[column] for column in targets.colnames}, {}, fixed)
            name = f"{number:06d}-{hashlib.sha256(content).hexdigest()}.fits"
            _io.write_bytes(self.folder / EVENTS / name, content, sync=True)
        about = {
            "version": VERSION,
            "previous": self.digest,
            **numbers,
            "targets": name,
            "tiles": [
                event._asdict() | {name: _by_reason(getattr(event, name)) for name in ("failed", "stated")}
                for event in tiles
            ],
        }
        body = json.dumps(about, separators=(",", ":"), sort_keys=True)
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
        file = _read(path / name, parsed)
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


def _read(path: Path, parsed: dict[str, EventFile]) -> EventFile:
    """Return the content of a file of events, which is that in ``parsed`` if the digest is equal."""
    try:
        found = FRAMED.fullmatch(content_of(path, most=MOST_FILE).decode("utf-8", "replace"))
        if not found or found[1] != _digest(found[2]):
            raise InputError("its digest differs from its content")
        if found[1] in parsed:
            return parsed[found[1]]
        about = json.loads(found[2])
        if about["version"] != VERSION:
            raise InputError(f"version {about['version']} of the format is not supported")
        tiles = tuple(
            TileEvent(**one | {"place": tuple(one["place"])})._replace(
                failed=_by_name(one["failed"]), stated=_by_name(one.get("stated"))
            )
            for one in about["tiles"]
        )
        if not all(map(_is_valid, tiles)):
            raise InputError("its events have other types")
        numbers = (about[name] for name in ("n_targets", "n_tiles", "n_applied"))
        file = EventFile(*numbers, tiles, about["targets"], found[1], about["previous"])
        if file.targets and not re.fullmatch(r"\d{6}-[0-9a-f]{64}\.fits", file.targets):
            raise InputError(f"{file.targets!r} is not the name of a table of targets")
    except (InputError, AttributeError, KeyError, TypeError, ValueError, RecursionError) as error:
        raise InputError(f"{path} is damaged ({sentence(error)})") from None
    return file


def _is_valid(event: TileEvent) -> bool:
    """Return whether the values of an event have their types."""
    kinds = (int, str, str, str, int | float, str, dict, tuple, bool, dict | None, list | tuple)
    is_possible = event.state in TileState.ALL and len(event.place) in (0, 4)
    return is_possible and all(map(isinstance, event, kinds)) and event.row >= 0


def _by_reason(failed: dict[str, str] | None) -> dict[str, list[str]] | None:
    """Return the positioners that failed for each reason."""
    if failed is None:
        return None
    found: dict[str, list[str]] = {}
    for name, reason in failed.items():
        found.setdefault(reason, []).append(name)
    return found


def _by_name(failed: dict[str, list[str]] | None) -> dict[str, str] | None:
    """Return the reason for each positioner that failed."""
    if failed is None:
        return None
    return dict(sorted((name, reason) for reason, names in failed.items() for name in names))


def _name(number: int) -> str:
    return f"{EVENTS}/{number:06d}.json"


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def to_date(value: object) -> str:
    """Return a date as text such as 2026-01-03; empty text for missing dates."""
    if value is None or value is np.ma.masked or (isinstance(value, int | np.integer) and value == 0):
        return ""
    if isinstance(value, bytes):
        value = value.decode("utf-8", "replace")
    if isinstance(value, float | np.floating) and value == np.floor(value):
        value = int(value)
    if np.shape(value) == (2,):  # Julian date in two parts, in FITS tables of astropy
        value = Time(*np.asarray(value, dtype=float), format="jd", scale="utc")
    if isinstance(value, Time):
        return value.utc.isot[:10]
    return _date_of(str(value).strip().removesuffix("Z"))


@cache
def _date_of(text: str) -> str:
    if text in ("", "nan", "NaT"):
        return ""
    if re.fullmatch(r"\d{8}", text):
        text = f"{text[:4]}-{text[4:6]}-{text[6:]}"
    try:
        return Time(text, scale="tai").isot[:10]  # without warnings of future leap seconds
    except ValueError:
        raise InputError(f"date must be a date such as 2026-01-03, got {text!r}") from None


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
