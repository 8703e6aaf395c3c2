"""The folder of a survey, with a file for the result of each tile, which is called the *part* of this tile."""

import hashlib
import json
import os
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, date, datetime
from pathlib import Path

from astropy.table import QTable

from rfpsurvey._folder import INDEX, RequestFolder, load_request, read_verified
from rfpsurvey._io import write_bytes, write_table, written
from rfpsurvey._readers import content_of, is_present
from rfpsurvey.allocation import AllocationOptions
from rfpsurvey.constraints import with_present_texts
from rfpsurvey.errors import InputError, warn

TABLES = ("tiles.fits", "completeness.ecsv", "outcomes.fits")
JOINT = "joint.ecsv"
ABOUT = (*TABLES, JOINT, "joint/state.npz")
"""Files that describe the whole survey."""
MOST_FILE = 2**28
EVENTS, PLANS = "events", "events/plans"
"""Folders of recorded events, and of copies of plans with which tiles were observed."""
DATES = f"{EVENTS}/plans.csv"
"""File with the checksum of the former plan of each tile, and the date on which this plan was made."""


class Folder(RequestFolder):
    """The folder of a survey, which is locked while the survey is planned.

    Parameters
    ----------
    path : str or path-like
        Path of the folder, which need not exist.
    request : Request
        The request of the survey. A survey can only be continued with the same request, or with further tiles. Plans of
        tiles that the state of the request does not keep are planned again.
    resume : bool
        Whether to continue an unfinished survey.
    """

    request_name = "survey.json"
    work, parts = "survey", "tiles"

    def __init__(self, path: object, request, *, resume: bool):
        super().__init__(path, request.recorded(), resume=resume)
        state, self._n, self._of_first_tiles = request.state, len(request.tiling), request.of_first_tiles
        self._state, self._is_new_state, self._has_more_tiles = state, False, False
        if state is not None and self.path.resolve() == state.folder.resolve() and not resume:
            raise InputError(f"{self.path} holds the survey of these events; to plan it again, use resume=True")

    def _compare(self, before: dict, now: dict):
        """Raise an error if the survey differs from that in the folder, except for the recorded events."""
        # earlier versions did not write all entries; the entry required, which can be a digest, is compared
        before = {"given": now["given"], "extra": now["extra"], **before, "required_ids": now["required_ids"]}
        before = with_present_texts(before, now)
        # those of the first plan
        now["columns"] = self._request["columns"] = before.setdefault("columns", now["columns"])
        self._planned = before.pop("planned", "")
        if self._state is None or self._state.folder.resolve() != self.path.resolve():
            if self._state is None and any(self.path.glob(f"{EVENTS}/*.json")):
                raise InputError(
                    f"{self.path} holds a survey with recorded events; plan the rest with visits=Survey.state(...) "
                    "(or --replan)"
                )
            now |= self._for_tiles_of(before, now)
            n, more = (number_in(str(one.get("tiles"))) for one in (before, now))
            try:
                super()._compare(before, now)
            except InputError as error:
                remedy = f", or tiles of which the first {n} are those of this folder in the same order"
                raise InputError(f"{error}{remedy if more > n else ''}") from None
            return
        self._state.check_current()
        now["first"]["visits"] = before.get("first", before).get("visits")
        first, now_first = (
            {k: v for k, v in one.items() if k != "visits"} for one in (before.get("first", {}), now["first"])
        )
        if not first:
            first = {name: before.get(name) for name in ("passes", "tiles")}
            del now_first["catalog"]  # the state was computed for the catalog of the first plan
        own_first = self._for_tiles_of(first, now_first)
        now_first |= {name: own_first[name] for name in ("passes", "tiles") if name in own_first}
        self._is_new_state = {**before, "software": None} != {**now, "software": None}
        is_finished = not self._is_new_state and (self.path / TABLES[0]).is_file()
        changed = ("catalog", "passes", "tiles", "visits", "events", "first")
        earlier, same = (
            {name: value for name, value in one.items() if name not in changed} | {"instrument": _instrument_of(one)}
            for one in (before, now)
        )
        try:
            super()._compare({**earlier, **first}, {**same, **now_first})
        except InputError as error:
            text = str(error).replace(
                "; give another folder", "; all options except visits must be those of the first plan"
            )
            raise InputError(text) from None
        self._request["planned"] = self._planned if is_finished else today()

    def _for_tiles_of(self, before: dict, now: dict) -> dict:
        """Return the entries of the request for the tiles in the folder, if it has further tiles; otherwise, {}."""
        tiles = str(before.get("tiles"))
        found = {} if tiles == now["tiles"] else self._of_first_tiles(tiles)
        self._has_more_tiles = bool(found)
        return json.loads(json.dumps(found))

    def _read(self):
        super()._read()
        if self._has_more_tiles and not self._is_new_state:  # the plans remain, but the survey is not finished
            for name in ABOUT:
                self._known.pop(name, None)
            self._write_index((name, entry) for name, entries in self._known.items() for entry in entries)
            for name in ABOUT:
                (self.path / name).unlink(missing_ok=True)
        if not self._is_new_state:
            return
        if not self._known and (self.path / TABLES[0]).is_file():
            warn(f"{self.path / INDEX} is damaged: {self.parts} without a line in this file are planned again")
        dates = plan_dates(self.path)
        for name, entries in self._known.items():
            if dates.get(name, ("",))[0] != entries[-1][1]:
                dates[name] = entries[-1][1], self._planned
        lines = [",".join((name, *entry)) + "\n" for name, entry in sorted(dates.items()) if name not in ABOUT]
        if self._known:
            (self.path / EVENTS).mkdir(exist_ok=True)
            write_bytes(self.path / DATES, "".join(lines).encode(), sync=True)
        # plans that are not kept are removed from the index before the new request is written
        kept = {part_name(row): event for row, event in self._state.kept.items()}
        for event in self._state.events.of_tiles():
            name = part_name(event.row)
            # the index, which can be damaged, does not determine which plans are kept
            if event.plan and (name not in kept or kept[name].plan != event.plan):
                self._copy(name, event.plan)
        stale = [name for name in self._known if name not in kept or self._known[name][-1][1] != kept[name].plan]
        for name in stale:
            del self._known[name]
        self._write_index((name, entries[-1]) for name, entries in self._known.items())
        for name in {*stale, *ABOUT}:  # new files are written faster than files are replaced
            (self.path / name).unlink(missing_ok=True)

    def _copy(self, name: str, digest: str) -> None:
        """Keep a plan with which a tile was observed, because the file of the tile will be replaced."""
        copy = self.path / kept_name(digest)
        if verified(copy, digest) is None and (content := verified(self.path / name, digest)) is not None:
            copy.parent.mkdir(parents=True, exist_ok=True)
            write_bytes(copy, content, sync=True)

    def _belongs(self, name: str) -> bool:
        stem = Path(name).stem
        return name in ABOUT or (stem.isdigit() and int(stem) < self._n and name == part_name(int(stem)))

    def has_part(self, tile: int, digest: str) -> bool:
        """Return whether the file of a tile has a checksum, which is also that in the index."""
        name = part_name(tile)
        known = self._known.get(name, [(0, "")])[-1][1]
        return known == digest and verified(self.path / name, digest) is not None

    def distrust(self, tile: int, reason: str) -> None:
        """Issue a warning that the stored result of a tile is not used, and that the tile is planned again."""
        warn(f"the tile in row {tile} of the tiling is planned again: {reason}")

    def new_path(self, tile: int) -> Path | None:
        """Return the path of the file of a tile, or None if the index already describes this file."""
        name = part_name(tile)
        return None if name in self._known else (self.path / name).absolute()

    def put_part(self, tile: int, part: bytes | tuple[int, str]) -> None:
        """Write the result of a tile to the file of this tile, unless a worker has written the file.

        If a worker has written the file, ``part`` is the size and the checksum of the file.
        """
        if isinstance(part, bytes):
            self.put_file(part_name(tile), part)
        else:
            self.record(part_name(tile), *part)

    def file(self, name: str, complain: Callable[[str], None] = warn) -> bytes | None:
        """Return the content of a file, or None if there is no valid file; ``complain`` is called for damaged files."""
        try:
            return read_verified(self.path, name, self._known) if name in self._known else None
        except InputError as error:
            complain(str(error))
            return None

    def put_file(self, name: str, content: bytes) -> None:
        """Write a file of the survey; if its parent folder does not exist, make this folder."""
        with written(self.path):
            (self.path / name).parent.mkdir(parents=True, exist_ok=True)
        self.put(name, content)

    def put_table(self, name: str, table: QTable, cards: dict | None, title: str) -> None:
        """Write a table of the survey to a file; ``cards`` and ``title`` are those of `write_table`."""
        with self.writing(name) as own:
            write_table(table, own, cards=cards, name=title)


def number_in(tiles: str) -> int:
    """Return the number of tiles in the entry ``tiles`` of a request; 0 for other texts."""
    number = tiles.partition(" ")[0]
    return int(number) if number.isdecimal() else 0


def today() -> str:
    """Return the present date, or the date that the environment variable SOURCE_DATE_EPOCH gives (s since 1970)."""
    seconds = os.environ.get("SOURCE_DATE_EPOCH", "")
    return str(datetime.fromtimestamp(int(seconds), UTC).date() if seconds.isdecimal() else date.today())


def plan_dates(folder: Path) -> dict[str, tuple[str, str]]:
    """Return the checksum and the date of the former plan of each tile by name; the date of the first plan is empty.

    If the present plan of a tile has another checksum, it was made on the date ``planned`` in the request.
    """
    text = content_of(folder / DATES, most=MOST_FILE).decode("ascii", "replace") if is_present(folder / DATES) else ""
    rows = [line.split(",") for line in text.splitlines()]
    return {row[0]: (row[1], row[2]) for row in rows if len(row) == 3}


def part_name(tile: int) -> str:
    """Return the name of the file for the tile in row ``tile`` of the tiling."""
    return f"tiles/{tile // 1000:03d}/{tile:06d}.fits"


def _instrument_of(request: dict) -> str:
    """Return the name of the instrument of a request; its digest changes if positioners break between two nights."""
    return str(request.get("instrument")).partition(", digest")[0]


def kept_name(digest: str) -> str:
    """Return the name of the copy of a plan with which a tile was observed, and which the survey later replaced."""
    return f"{PLANS}/{digest}.fits"


def verified(path: Path, digest: str) -> bytes | None:
    """Return the content of a file, or None if it does not exist or has another checksum."""
    if not is_present(path):
        return None
    content = content_of(path, most=MOST_FILE)
    return content if hashlib.sha256(content).hexdigest() == digest else None


def with_recorded_moves(options: AllocationOptions, folder: object) -> AllocationOptions:
    """Return the options with which a survey that was begun by version 0.3, which recorded no moves, is continued."""
    path = None if folder is None else Path(folder) / Folder.request_name
    if path is None or not is_present(path) or not options.method.uses("moves") or options.moves == "exchange":
        return options
    recorded = load_request(path)
    if "moves" in recorded or recorded.get("allocator") != options.name:
        return options
    warn(f"{folder} was begun with the moves of version 0.3; its tiles are planned with moves='exchange'")
    return replace(options, moves="exchange")
