"""The events of a survey: what was observed, and which tiles and targets were added, dropped or changed.

Each call of ``Survey.record`` or ``Survey.undo`` appends one file. A file contains what the table stated, a digest of
its own content, and the digest of the preceding file, so that missing, changed and truncated files are found. Files are
never changed; `TileStates` joins the statements on an observation.
"""

import re
from collections.abc import Collection, Iterable
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from functools import cache, cached_property
from pathlib import Path
from typing import NamedTuple

import astropy.units as u
import numpy as np
from astropy.table import QTable, vstack
from astropy.time import Time

from rfpsurvey._common.read_fits import read_fits_bytes
from rfpsurvey._survey.folder import kept_name, parse_visits, part_name, read_named, verified
from rfpsurvey._survey.generations import EVENTS
from rfpsurvey._survey.tiling.tiling import Tiling
from rfpsurvey.errors import InputError

MJD = 40_000, 100_000
"""Range of the numbers that are modified Julian dates: the years 1968 to 2132."""


def to_date(value: object) -> str:
    """Return a date as text such as 2026-01-03; empty text for missing dates.

    Dates are text, numbers such as 20260103, times, or modified Julian dates. Times with a time zone are converted to
    UTC.
    """
    if value is None or value is np.ma.masked or (isinstance(value, int | np.integer) and value == 0):
        return ""
    if isinstance(value, bytes):
        value = value.decode("utf-8", "replace")
    if isinstance(value, int | float | np.number) and MJD[0] < value < MJD[1]:
        value = Time(float(value), format="mjd", scale="utc")
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
    if re.fullmatch(r"\d{5}(\.\d*)?", text):
        return to_date(float(text))
    try:
        if re.search(r"\d\d:\d\d.*[+-]\d\d:?\d\d$", text):
            return str(datetime.fromisoformat(text).astimezone(UTC).date())
        return Time(text, scale="tai").isot[:10]  # without warnings of future leap seconds
    except ValueError:
        raise InputError(f"date must be a date such as 2026-01-03, got {text!r}") from None


def check_not_future(dates: list[str]) -> None:
    """Raise an error if a date is later than tomorrow according to the clock, because it is probably not correct."""
    tomorrow = str((datetime.now(UTC) + timedelta(days=1)).date())
    if late := [date for date in dates if date > tomorrow]:
        raise InputError(
            f"date must not be later than tomorrow, got {max(late)}; to record it, use allow_future=True "
            "(or --allow-future)"
        )


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
    made_with: int = -1
    """Number of files of events with which the observed plan was made; -1 if an earlier version did not record it."""
    swaps: dict = {}  # noqa: RUF012
    """For positioners that observed another target than planned: row, identifier and kind of this target."""

    @property
    def observation(self) -> tuple:
        """The key of an observation: an event with the same key corrects the earlier event."""
        return self.row, self.date, self.plan

    def after(self, earlier: "TileEvent | None") -> "TileEvent":
        """Return this event joined with an earlier event of the same observation."""
        if earlier is None:
            return self
        stated = self if self.has_state else earlier
        kept = {} if self.replaces else {k: reason for k, reason in earlier.failed.items() if k not in self.good}
        failed = dict(sorted((kept | self.failed).items()))
        swaps = self.swaps if self.replaces else earlier.swaps | self.swaps
        return self._replace(state=stated.state, fraction=stated.fraction, failed=failed, swaps=swaps)

    def includes(self, other: "TileEvent") -> bool:
        """Return whether the table of this event states everything that the table of another event states."""
        if (self.row, self.date, self.place) != (other.row, other.date, other.place):
            return False
        if not other.swaps.items() <= self.swaps.items():
            return False
        stated, needed = ((event.state, event.fraction) if event.has_state else () for event in (self, other))
        return needed in ((), stated) and other.failed.items() <= self.failed.items() and {*other.good} <= {*self.good}


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
    body: str = ""

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

    def numbered(self) -> Iterable[tuple[int, TileEvent]]:
        """Yield the number of the file and the event for all events of tiles, except those that were undone.

        Tiles that a file added which was undone are dropped, so that later tiles keep their rows.
        """
        for number, file in enumerate(self.files, 1):
            for event in file.tiles:
                if number not in self.undone:
                    yield number, event
                elif event.place and event.row >= file.n_tiles:
                    yield number, event
                    yield number, TileEvent(event.row, event.tile, TileState.DROPPED, "", 0.0)

    def of_tiles(self, until: str | None = None) -> Iterable[TileEvent]:
        """Return the events of tiles up to a date, without those that were undone."""
        return (event for _, event in self.numbered() if until is None or event.date <= until)

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
            table = self.read_targets(file.targets) if file.targets else ()
            if number in self.undone and file.targets:
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
        for name in (part_name(row), kept_name(digest)):
            if (content := verified(self.folder / name, digest)) is not None:
                return content
        raise InputError(
            f"{self.folder / part_name(row)} must be the plan with which the tile in row {row} was observed, got "
            "another or a damaged file, and there is no copy of the plan; restore the file, or record the state "
            "planned for this tile, which cancels its observations"
        )

    def visits(self, event: TileEvent) -> tuple[np.ndarray, dict]:
        """Return the visits of the plan with which a tile was observed, and the header cards of the file."""
        return parse_visits(self.plan(event.row, event.plan), f"the plan of tile {event.tile}", event.tile)

    def observed(self, event: TileEvent) -> tuple[np.ndarray, dict]:
        """Return the visits that a tile made, which are those of `visits` after the swaps, and the header cards."""
        visits, cards = self.visits(event)
        return with_swaps(visits, event.swaps), cards


def with_swaps(visits: np.ndarray, swaps: dict[str, list]) -> np.ndarray:
    """Return the visits of a plan after swaps; a positioner without a planned target has an additional row.

    ``swaps`` contains the row, the identifier and the kind of the observed target of each positioner. The columns
    ``ra``, ``dec`` and those of the catalog are not changed, and are 0 or empty in additional rows.
    """
    if not swaps:
        return visits
    names = visits["positioner"].astype(str).tolist()
    names += [name for name in swaps if name not in names]
    values = [[name, row, target, kind, True, False] for name, (row, target, kind) in swaps.items()]
    columns = ("positioner", "target_row", "target_id", "kind", "observed", "in_collision")
    changed = {name: np.array(part) for name, part in zip(columns, zip(*values, strict=True), strict=True)}
    kinds = [(name, visits.dtype[name]) for name in visits.dtype.names]
    kinds = [(k, np.promote_types(t, changed[k].dtype) if k in changed and t.kind == "U" else t) for k, t in kinds]
    swapped, place = np.zeros(len(names), dtype=kinds), [names.index(name) for name in swaps]
    for name, kind in kinds:
        swapped[name][: len(visits)] = visits[name]
        if name in changed:
            swapped[name][place] = changed[name].astype(kind)
    return swapped


def grouped(pairs: Iterable[tuple]) -> dict:
    """Return a dict from the first item of pairs to a list of the second items."""
    groups: dict = {}
    for key, value in pairs:
        groups.setdefault(key, []).append(value)
    return groups


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
        added_row = table[:1].copy()
        added_row.replace_column("tile", np.array([event.tile if names.dtype.kind == "U" else int(event.tile)]))
        for name, value in values.items():
            added_row[name] = value
        table = vstack([table, added_row], metadata_conflicts="silent")
    table.meta.pop("summary", None)
    table["state"] = np.where(np.isin(np.arange(len(table)), [*dropped]), TileState.DROPPED, "")
    return Tiling(table)
