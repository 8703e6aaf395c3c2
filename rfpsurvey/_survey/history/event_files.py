"""The files of recorded events, and the plans with which tiles can have been observed.

Files are written once, and read as a chain: each file names the file before it.
"""

import csv
import hashlib
import json
import os
import re
from bisect import bisect_right
from collections.abc import Callable, Iterable, Sequence
from functools import cache, cached_property
from io import StringIO
from itertools import accumulate
from pathlib import Path

import numpy as np
from astropy.table import QTable, Table

from rfpsurvey._common import io as _io
from rfpsurvey._common.folder import checksums_in
from rfpsurvey._common.read_documents import content_of, is_present, sentence
from rfpsurvey._common.read_fits import read_fits_bytes
from rfpsurvey._survey.folder import part_name, read_request
from rfpsurvey._survey.generations import EVENTS, MOST_FILE, Generation, generations_of, read_plans
from rfpsurvey._survey.history.events import EventFile, Events, TileEvent, TileState, grouped, places_of
from rfpsurvey._survey.history.replay import TileStates
from rfpsurvey._survey.work import plan_digest
from rfpsurvey.errors import InputError, listed, number_of

VERSION = 2
FRAME = '{{"digest": "{}", "events":\n{}\n}}\n'
"""Text of a file of events with its digest and its content, which are JSON in all."""
COPY = f"{EVENTS}/records.txt"
"""File with the contents of all files of events."""
FRAMED = re.compile(r'\{"digest": "([0-9a-f]{64})", "events":\n(.*)\n\}\n', re.DOTALL)


def append_events(
    history, tiles: list[TileEvent], targets: QTable | None, rows: Table | None, told: dict, undoes: int | None = None
) -> None:
    """Write a file with events after those of a `History`; see `EventFile`."""
    events, content, tables = history.events, None, {"targets": None, "rows": None}
    number, folder = len(events.files) + 1, events.folder
    with _io.written(folder / EVENTS):
        (folder / EVENTS).mkdir(exist_ok=True)
    if targets is not None:
        columns, fixed = targets.as_array(), tuple(_io.table_cards("TARGETS", targets.colnames, {}).items())
        kind, ending = "targets", "fits"
        content = _io.fits_bytes({k: columns[k] for k in targets.colnames}, {}, fixed)
    elif rows is not None:
        lines = StringIO()
        csv.writer(lines, lineterminator="\n").writerows([rows.colnames, *rows.iterrows()])
        kind, ending, content = "rows", "csv", lines.getvalue().encode()
    if content is not None:  # written before the file that names it, so that a killed process leaves no broken chain
        tables[kind] = f"{number:06d}-{hashlib.sha256(content).hexdigest()}.{ending}"
        _io.write_bytes(folder / EVENTS / tables[kind], content, sync=True)
    about = {
        "version": VERSION,
        "previous": events.digest,
        "n_targets": history.n_targets,
        "n_tiles": history.n_tiles_before,
        "n_applied": history.n_applied,
        "told": told,
        "undoes": undoes,
        "tiles": [
            {name: value for name, value in event._asdict().items() if name != "swaps" or value}
            | {"failed": grouped((reason, name) for name, reason in event.failed.items())}
            for event in tiles
        ],
    }
    body = json.dumps(about | tables, separators=(",", ":"), sort_keys=True)
    _io.write_bytes(folder / _name(number), FRAME.format(_digest(body), body).encode(), sync=True)
    write_copy(folder, [*(file.body for file in events.files), body])


def write_copy(folder: Path, bodies: list[str]) -> None:
    """Write the contents of all files of events to one file, because reading a thousand files takes a long time."""
    text = "".join(f"{body}\n" for body in bodies)
    _io.write_bytes(folder / COPY, f"{_digest(text)}\n{text}".encode())


def copied_bodies(folder: Path) -> list[str]:
    """Return the contents of files of events in their copy; an empty list if there is none, or if it is damaged."""
    if not is_present(folder / COPY):
        return []
    digest, _, text = content_of(folder / COPY, most=MOST_FILE).decode("utf-8", "replace").partition("\n")
    return text.splitlines() if digest == _digest(text) else []


def read_events(folder: Path, known: Events | None = None, bodies: Sequence[str] = ()) -> Events:
    """Return the events of a survey, or raise an error if a file is missing or damaged.

    Files whose digests are those of ``known`` are verified, but not parsed again. The first files are not read if
    ``bodies`` contains their contents.
    """
    parsed = {} if known is None else {file.digest: file for file in known.files}
    path = folder / EVENTS
    names = sorted(name for name in os.listdir(path) if name.endswith(".json")) if is_present(path) else []
    if len(bodies) > len(names):
        raise InputError(f"{folder / _name(len(names) + 1)} is missing, although {folder / COPY} has it; restore it")
    files, previous = [], ""
    for number, name in enumerate(names, 1):
        if name != f"{number:06d}.json":
            raise InputError(f"{folder / _name(number)} is missing, but {name} exists")
        file = _read(folder, number, parsed, *bodies[number - 1 : number])
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


def _read(folder: Path, number: int, parsed: dict[str, EventFile], body: str | None = None) -> EventFile:
    """Return the content of a file of events, which is that in ``parsed`` if the digest is equal."""
    try:
        if body is None:
            match = FRAMED.fullmatch(content_of(folder / _name(number), most=MOST_FILE).decode("utf-8", "replace"))
            if not match or match[1] != _digest(match[2]):
                raise InputError("its digest differs from its content")
            body = match[2]
        digest = _digest(body)
        if digest in parsed:
            return parsed[digest]
        about = json.loads(body)
        if about["version"] not in (1, VERSION):
            raise InputError(f"version {about['version']} of the format is not supported")
        tiles = tuple(
            TileEvent(**event | {"place": tuple(event["place"]), "failed": _failed(event)}) for event in about["tiles"]
        )
        if not all(map(_is_valid, tiles)):
            raise InputError("its events have other types")
        numbers = (about[name] for name in ("n_targets", "n_tiles", "n_applied"))
        told, undoes, rows = about.get("told", {}), about.get("undoes"), about.get("rows")
        if not (isinstance(told, dict) and isinstance(undoes, int | None) and 0 < (undoes or 1) < max(number, 2)):
            raise InputError("its entries have other types")
        file = EventFile(*numbers, tiles, about["targets"], digest, about["previous"], told, rows, undoes, body)
        for name in file.others:
            if not re.fullmatch(r"\d{6}-[0-9a-f]{64}\.(fits|csv)", name):
                raise InputError(f"{name!r} is not the name of a table")
    except (InputError, AttributeError, KeyError, TypeError, ValueError, RecursionError) as error:
        raise InputError(f"{folder / _name(number)} is damaged ({sentence(error)})") from None
    return file


def _failed(event: dict) -> dict[str, str]:
    """Return the failed positioners that a table stated, with the reasons; remove the entry ``stated``."""
    stated = event.pop("stated", None)  # in files of version 1, the entry failed also contains earlier records
    by_reason = event["failed"] if stated is None else stated
    return dict(sorted((name, reason) for reason, names in by_reason.items() for name in names))


def _is_valid(event: TileEvent) -> bool:
    """Return whether the values of an event have their types."""
    kinds = (int, str, str, str, int | float, str, dict, tuple, bool, list | tuple, bool, int, dict)
    is_possible = event.state in TileState.ALL and len(event.place) in (0, 4)
    is_possible &= all(map(isinstance, event, kinds)) and event.row >= 0
    return is_possible and all([*map(type, swap)] == [int, str, str] for swap in event.swaps.values())


def _name(number: int) -> str:
    return f"{EVENTS}/{number:06d}.json"


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


class History:
    """What is known about the tiles of a survey before a table is recorded."""

    def __init__(self, survey, folder: Path, events: Events, groups: Callable[[str], dict[str, str]], request=dict):
        self.request = cache(request)
        """Function that returns the `Request` of the rest of the survey."""
        self.survey, self.events, self.states = survey, events, TileStates(events.of_tiles())
        self.groups = groups
        """Function of the name of a column that returns the group of each positioner, such as its petal, as text."""
        self._names, self._places = np.asarray(survey.tiles["tile"]).astype(str).tolist(), places_of(survey.tiles)
        self.row_of = {name: row for row, name in enumerate(self._names)}
        for row, event in self.states.added.items():
            self.row_of.setdefault(event.tile, row)
        self.n_tiles = self.n_tiles_before = max(len(self._names), 1 + max(self.states.added, default=-1))
        added = [n + int((table["target_row"] >= n).sum()) for n, table in events.target_tables]
        self.n_targets = max(len(survey.outcomes), *added, 0)
        self._present_plans, self._plans = checksums_in(folder), read_plans(folder)
        self._used = grouped(events.plans)
        self.generations = generations_of(folder, read_request(folder))
        self.n_applied = len(events.of_plan(survey.provenance).files)
        self.past: dict[int, list[TileEvent]] = {}
        """The events of each tile since the last one that canceled its events."""
        for event in events.of_tiles():
            if event.state == TileState.PLANNED:
                self.past.pop(event.row, None)
            self.past.setdefault(event.row, []).append(event)

    def find_row(self, name: str) -> int:
        """Return the row of a tile, or raise an error if there is no such tile."""
        if name not in self.row_of:
            some = next(iter(self.row_of), "none")
            raise InputError(f"tile must be a tile of the survey, such as {some}, got {name!r}")
        return self.row_of[name]

    def of(self, name: str) -> list[TileEvent]:
        """Return the recorded observations of a tile."""
        return self.states.of(self.row_of[name]) if name in self.row_of else []

    def earlier(self, event: TileEvent) -> TileEvent | None:
        """Return the recorded event of the same observation; None if there is none."""
        return next((past for past in self.states.of(event.row) if past.observation == event.observation), None)

    def _read(self, row: int, plan: str) -> tuple[np.ndarray | None, dict]:
        """Return the visits of a plan and the header of its file; None and {} if it was removed or is damaged."""
        try:
            return read_fits_bytes(self.events.plan(row, plan), part_name(row))
        except InputError:
            return None, {}

    def _is_of(self, row: int, plan: str, targets: set[str]) -> bool:
        """Return whether all targets of a plan, without blank sky, are among the given targets.

        The given targets may include blank sky, whose identifiers are not those of targets of the catalog.
        """
        visits, _ = self._read(row, plan)
        return visits is not None and {*visits["target_id"][visits["target_row"] >= 0].astype(str).tolist()} <= targets

    def plans(self, row: int) -> list[tuple[str, int]]:
        """Return the checksums of the plans of a tile in their order, with the generations that introduced them."""
        plans = list(self._plans.get(part_name(row), ()))
        # an earlier version did not record when plans were made
        plans = [(plan, 0) for plan in self._used.get(row, ()) if plan not in dict(plans)] + plans
        if (present := self._present(row)) and (not plans or plans[-1][0] != present):
            plans.append((present, self.generations[-1].number))
        if row in self.states.added:  # plans for another position are not possible
            plans = [(plan, first) for plan, first in plans if self._is_here(row, plan)]
        return plans

    def _present(self, row: int) -> str | None:
        """Return the checksum of the present plan of a tile; None if there is none."""
        return self._present_plans.get(part_name(row)) if row < len(self._names) else None

    def _is_here(self, row: int, plan: str) -> bool:
        """Return whether a plan was made for the present position of a tile."""
        _, cards = self._read(row, plan)
        return np.array_equal([cards.get(name) for name in ("RA", "DEC", "POSANG")], self.place(row)[:3])

    def choose_plan(self, row: int, name: str, date: str, named: dict[str, str], targets: set[str]) -> tuple[str, int]:
        """Return the checksum of the plan with which a tile was observed, and the number of files of its generation.

        The plan is that of the generation, or that with the digest, in ``named``. Otherwise, it is the last plan that
        was made before the observation, unless the ``targets`` that the table names lack targets of this plan, but not
        those of another plan. A table with further targets is refused later.
        """
        plans, generations = self.plans(row), self.generations
        is_planned = self._present(row) in dict(plans)
        if digest := named.get("plan"):
            recorded = [event.plan for event in self.states.of(row) if date and event.date == date]
            for plan in dict.fromkeys((*recorded, *(plan for plan, _ in reversed(plans)))):
                if digest in (plan, self._digest(row, name, plan)):
                    return plan, self._n_files(dict(plans).get(plan, 0), date)
        if text := named.get("generation"):
            valid = [generation for generation in generations if str(generation.number) == text]
        elif date:
            valid = self._valid_on(date)
        else:
            is_clear = len(dict(plans)) == 1 or not any(self._last_dates)
            valid = generations if is_clear else []
        if not plans:
            raise InputError(f"tile {name} has no plan yet; plan the survey again before its observations are recorded")
        by_date = [plan for plan, first in plans if valid and first <= valid[-1].number]
        if not (is_planned or named or (valid and valid[-1] is not generations[-1])):
            by_date = []  # the tile is dropped in the present plan
        if text and by_date and self._is_replaced(int(text), dict(plans).values()):
            by_date = []  # the plan of this generation may be an older plan, or was not kept
        by_targets = [plan for plan, _ in plans if targets and not named and self._is_of(row, plan, targets)]
        if by_targets and not {*by_date[-1:]} & {*by_targets}:
            return by_targets[-1], self._n_files(dict(plans)[by_targets[-1]], date)
        if digest or not by_date:
            got = f"{'plan' if digest else 'generation'} {(digest or text)!r}" if named else date or "no date"
            raise InputError(
                f"the plan with which tile {name} was observed must be one of {self._listed(row, name)}, got {got}; "
                "give its digest in a column plan, or its generation"
            )
        return by_date[-1], valid[-1].n_files

    def _is_replaced(self, number: int, introduced: Iterable[int]) -> bool:
        """Return whether a plan was replaced on the day of its generation, before an observation was recorded."""
        by_number = {generation.number: generation for generation in self.generations}
        if number in introduced or number + 1 not in introduced or by_number[number].date != by_number[number + 1].date:
            return False
        # the records that were made while this generation was the present plan
        files = [file for file in self.events.files if file.n_applied == by_number[number].n_files]
        return not any(event.plan for file in files for event in file.tiles)

    @cached_property
    def _last_dates(self) -> list[str]:
        """The last date of the observations with which the plan of each generation was made; empty if there are none.

        Dates that were corrected later are not considered.
        """
        stated: dict[tuple, int] = {}
        for number, event in self.events.numbered():
            stated.setdefault(event.observation, number)
        dates = sorted((stated[event.observation], event.date) for event in self.states.attempts)
        latest = [*accumulate((date for _, date in dates), max, initial="")]
        numbers = [number for number, _ in dates]
        return [latest[bisect_right(numbers, generation.n_files)] for generation in self.generations]

    def _valid_on(self, date: str) -> list[Generation]:
        """Return the generations whose plans were made before an observation of a date."""
        return [
            generation
            for generation, last in zip(self.generations, self._last_dates, strict=True)
            if generation.date <= date and (not last or last < date)
        ]

    def _n_files(self, first: int, date: str) -> int:
        """Return the number of files of the last generation until a date, but not before the generation ``first``."""
        later = [generation for generation in self.generations if generation.number >= first]
        valid = [generation for generation in self._valid_on(date) if date and generation in later]
        return (valid[-1:] or later[:1] or self.generations[-1:])[0].n_files

    def _digest(self, row: int, name: str, plan: str) -> str:
        """Return the digest of a plan of a tile in the header of its file; empty text if the plan is missing."""
        visits, _ = self._read(row, plan)
        return "" if visits is None else plan_digest(name, visits["positioner"], visits["target_id"])

    def _listed(self, row: int, name: str) -> str:
        """Return text that lists the plans of a tile."""
        dates = {generation.number: generation.date for generation in self.generations}
        texts = [
            f"{self._digest(row, name, plan)} (generation {first}{on_date(dates.get(first, ''))})"
            for plan, first in dict(self.plans(row)).items()
        ]
        return listed(texts)

    def place(self, row: int) -> np.ndarray:
        """Return the right ascension, declination, position angle (deg) and pass of a tile."""
        return np.array(self.states.added[row].place) if row in self.states.added else self._places[row]


def on_date(date: str) -> str:
    """Return words for a date, or empty text if there is no date."""
    return f" on {date}" if date else ""
