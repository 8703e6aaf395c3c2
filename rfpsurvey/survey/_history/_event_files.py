"""The files of recorded events, which are written once, and read as a chain: each file names the file before it."""

import csv
import hashlib
import json
import os
import re
from collections.abc import Sequence
from io import StringIO
from pathlib import Path

from astropy.table import QTable, Table

from rfpsurvey import _io
from rfpsurvey._readers import content_of, is_present, sentence
from rfpsurvey.errors import InputError, number_of
from rfpsurvey.survey._folder import read_request
from rfpsurvey.survey._generations import EVENTS, MOST_FILE
from rfpsurvey.survey._history._events import EventFile, Events, TileEvent, TileState, grouped

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
            event._asdict() | {"failed": grouped((reason, name) for name, reason in event.failed.items())}
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
    kinds = (int, str, str, str, int | float, str, dict, tuple, bool, list | tuple, bool, int)
    is_possible = event.state in TileState.ALL and len(event.place) in (0, 4)
    return is_possible and all(map(isinstance, event, kinds)) and event.row >= 0


def _name(number: int) -> str:
    return f"{EVENTS}/{number:06d}.json"


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()
