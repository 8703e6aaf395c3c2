"""The folder of a survey, with a file for the result of each tile, which is called the *part* of this tile."""

import hashlib
import json
import os
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from astropy.table import QTable

from rfpsurvey._assignment.constraints.text import with_present_texts
from rfpsurvey._assignment.options import AllocationOptions
from rfpsurvey._common.folder import (
    LOCK,
    WAIT,
    RequestFolder,
    check_file,
    checksums_in,
    load_request,
    locked,
    read_verified,
)
from rfpsurvey._common.io import write_table, written
from rfpsurvey._common.read_documents import content_of, is_present
from rfpsurvey._common.read_fits import read_fits_bytes
from rfpsurvey._common.read_tables import read_table
from rfpsurvey._common.temporary import remove
from rfpsurvey._survey import generations as _generations
from rfpsurvey.errors import InputError, warn

TABLES = ("tiles.fits", "completeness.ecsv", "outcomes.fits")
JOINT = "joint.ecsv"
ABOUT = (*TABLES, JOINT, "joint/state.npz")
"""Files that describe the whole survey."""
COLUMNS = {
    "tiles.fits": ("tile", "ra", "dec", "position_angle", "pass", "round", "n_assigned", "completeness"),
    "completeness.ecsv": ("pass", "priority", "n_targets", "n_requested", "n_observed", "n_complete", "completeness"),
    "outcomes.fits": ("target_id", "requested", "observed", "outcome"),
    JOINT: (),
}
"""Columns that the tables must have."""
VISITS = ("target_id", "target_row", "positioner", "ra", "dec", "in_collision", "observed")
KINDS = {"target_row": ("i", "integers"), "in_collision": ("b", "booleans"), "observed": ("b", "booleans")}
"""Columns that the file of each tile must have, and the types of some of them."""
ENTRIES = {"events": dict, "first": dict, "columns": dict, "required_ids": list, "planned": str, "generation": int}
"""Entries of a request that are used without a comparison with those of another request, and their types."""
MOVED = (
    "; the targets must be moved to the same times: if times of tiles determine these, tiles can be added only with an "
    "epoch= (or --epoch) of the first plan"
)


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
    work, parts, again = "survey", "tiles", "it is made again"

    def __init__(self, path: object, request, *, resume: bool):
        super().__init__(path, request.recorded(), resume=resume)
        state, self._n, self._of_first_tiles = request.state, len(request.tiling), request.of_first_tiles
        self._state, self._is_new_state, self._has_more_tiles = state, False, False
        self.home, self._kept, self._former = self.path, {}, {}
        self._request["generation"] = 1
        self._is_own = state is not None and self.home.resolve() == state.folder.resolve()
        if self._is_own and not resume:
            raise InputError(f"{self.path} holds the survey of these events; to plan it again, use resume=True")

    def __enter__(self):
        if self._is_own and self._begun:
            with locked(self.home, self.home / LOCK, wait=WAIT):
                _generations.replace_plan(self.home)
                self._compare(load_request(self.home / self.request_name), dict(self._request))
            if self._is_new_state:  # the present plan remains until the new plan is complete
                self.path, plans = self.home / _generations.NEXT, _generations.read_plans(self.home)
                for name, checksum in checksums_in(self.home).items():
                    number = dict(plans.get(name, ())).get(checksum, self._request["generation"] - 1)
                    self._former[name] = number, checksum
        return super().__enter__()

    def _open(self):
        if not self.is_beside:
            super()._open()
            return
        if self._begun:
            undated = [req | {"planned": ""} for req in (load_request(self.path / self.request_name), self._request)]
            if undated[0] == undated[1]:
                self._read()
            else:
                for entry in self.path.iterdir():  # the plan that was begun has other events or options
                    if entry.name not in (LOCK, self.request_name):
                        remove(entry)
        self._write_request()

    @property
    def is_beside(self) -> bool:
        """Whether the plan is written beside the present plan of the survey, which it will replace."""
        return self.path != self.home

    @property
    def generation(self) -> int:
        """Number of the plan: 1 for the first plan of a survey, 2 for the first plan of the rest."""
        return self._request["generation"]

    def former(self, tile: int) -> tuple[int, str] | None:
        """Return the generation and the checksum of the plan of a tile that the new plan replaces; None for none."""
        return self._former.get(part_name(tile))

    def _compare(self, before: dict, now: dict):
        """Raise an error if the survey differs from that in the folder, except for the recorded events."""
        _check_entries(self.path / self.request_name, before)
        # earlier versions did not write all entries; the entry required, which can be a digest, is compared
        before = {"given": now["given"], "extra": now["extra"], **before, "required_ids": now["required_ids"]}
        before = with_present_texts(before, now)
        # those of the first plan
        now["columns"] = self._request["columns"] = before.setdefault("columns", now["columns"])
        planned, number = before.pop("planned", None), before.pop("generation", 1)
        now = {name: value for name, value in now.items() if name not in ("planned", "generation")}
        self._request |= {"generation": number} | ({} if planned is None else {"planned": planned})
        if not self._is_own:
            if self._state is None and any(self.path.glob(f"{_generations.EVENTS}/*.json")):
                raise InputError(
                    f"{self.path} holds a survey with recorded events; plan the rest with visits=Survey.state(...) "
                    "(or --replan)"
                )
            now |= self._for_tiles_of(before, now)
            n, more = (number_in(str(request.get("tiles"))) for request in (before, now))
            try:
                super()._compare(before, now)
            except InputError as error:
                remedy = f", or tiles of which the first {n} are those of this folder in the same order"
                is_moved = before["given"] == now["given"] and before.get("catalog") != now["catalog"]
                raise InputError(f"{error}{remedy if more > n else ''}{MOVED if is_moved else ''}") from None
            return
        self._state.check_current()
        now["first"]["visits"] = before.get("first", before).get("visits")
        first, now_first = (
            {k: v for k, v in request.items() if k != "visits"} for request in (before.get("first", {}), now["first"])
        )
        if not first:
            first = {name: before.get(name) for name in ("passes", "tiles", "dates") if name in before}
            del now_first["catalog"]  # the state was computed for the catalog of the first plan
        first_of_tiles = self._for_tiles_of(first, now_first)
        now_first |= {name: first_of_tiles[name] for name in ("passes", "tiles", "dates") if name in first_of_tiles}
        self._is_new_state = {**before, "software": None} != {**now, "software": None}
        if self._is_new_state:
            self._request["generation"] = number + 1
        changed = ("catalog", "passes", "tiles", "dates", "visits", "events", "first")
        earlier, same = ({k: v for k, v in request.items() if k not in changed} for request in (before, now))
        for request in (earlier, same):  # the digest changes if positioners break between two nights
            request["instrument"] = str(request.get("instrument")).partition(", digest")[0]
        try:
            super()._compare({**earlier, **first}, {**same, **now_first})
        except InputError as error:
            text = str(error).replace(
                "; give another folder", "; all options except visits must be those of the first plan"
            )
            raise InputError(text + MOVED * (earlier.get("epoch") != same.get("epoch"))) from None

    def _for_tiles_of(self, before: dict, now: dict) -> dict:
        """Return the entries of the request for the tiles in the folder, if it has further tiles; otherwise, {}."""
        tiles = str(before.get("tiles"))
        entries = {} if tiles == now["tiles"] else self._of_first_tiles(tiles)
        self._has_more_tiles = bool(entries)
        return json.loads(json.dumps(entries))

    def _read(self):
        super()._read()
        if self._has_more_tiles and not self._is_new_state:  # the plans remain, but the survey is not finished
            for name in ABOUT:
                self._known.pop(name, None)
            self._write_index((name, entry) for name, entries in self._known.items() for entry in entries)
            for name in ABOUT:
                (self.path / name).unlink(missing_ok=True)

    def _belongs(self, name: str) -> bool:
        stem = Path(name).stem
        return name in ABOUT or (stem.isdigit() and int(stem) < self._n and name == part_name(int(stem)))

    def has_part(self, tile: int, digest: str) -> bool:
        """Return whether the file of a tile has a checksum, which is also that in the index."""
        name = part_name(tile)
        content = verified(self.home / name, digest)
        if content is not None and self.is_beside:
            self._kept[name] = [(len(content), digest)]
            return True
        content = verified(self.path / name, digest)
        return content is not None and self._known.get(name, [None])[-1] == (len(content), digest)

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

    def put_file(self, name: str, content: bytes) -> None:
        """Write a file of the survey; if its parent folder does not exist, make this folder."""
        with written(self.path):
            (self.path / name).parent.mkdir(parents=True, exist_ok=True)
        self.put(name, content)

    def put_table(self, name: str, table: QTable, cards: dict | None, title: str) -> None:
        """Write a table of the survey to a file; ``cards`` and ``title`` are those of `write_table`."""
        with self.writing(name) as temporary:
            write_table(table, temporary, cards=cards, name=title)

    def finish(self) -> None:
        """Write the final index; a plan that was written beside the present plan then replaces it."""
        self._known |= self._kept
        if not self.is_beside:
            super().finish()
            return
        with locked(self.home, self.home / LOCK, wait=WAIT):
            events, today = self._state.present_events(), str(clock().date())
            before = _generations.generations_of(self.home, load_request(self.home / self.request_name))
            if before[-1].number != self.generation - 1:
                raise InputError(f"{self.home} must have the plan that was to be replaced, got one of another run")
            now = _generations.Generation(self.generation, today, len(self._state.events.files))
            recorded = [file for file in events.files if file.n_applied == before[-1].n_files]
            # observations can be reported late
            is_observed = before[-1].date < today or any(event.plan for file in recorded for event in file.tiles)
            used = {(part_name(row), plan) for row, plan in events.plans}
            self._request["planned"] = today
            self._write_request()
            super().finish()
            _generations.add_generation(self.home, self.path, before, now, used, is_observed=is_observed)
            self.release()
            os.rename(self.path, self.home / _generations.READY)
            _generations.replace_plan(self.home)
        self.path = self.home


def read_request(folder: Path) -> dict:
    """Return the request of the survey in a folder, or raise an error if it is damaged; {} if there is none."""
    _generations.settle(folder)
    path = folder / Folder.request_name
    if not is_present(path) and not is_present(folder / _generations.EVENTS):
        return {}
    request = load_request(path)
    _check_entries(path, request)
    return request


def _check_entries(path: Path, request: dict) -> None:
    """Raise an error if entries of a request are missing or have other types; earlier versions wrote fewer entries."""
    needed = {"first": ["events"], "columns": ["given", "extra", "required_ids"]}
    wrong = [name for entry, names in needed.items() if entry in request for name in names if name not in request]
    wrong += [name for name, kind in ENTRIES.items() if not isinstance(request.get(name, kind()), kind)]
    if not wrong:
        about, required = {"n_files": 0, "digest": ""} | request.get("events", {}), request.get("required", [])
        ids = request.get("required_ids", required)
        wrong += [] if isinstance(about["n_files"], int) and isinstance(about["digest"], str) else ["events"]
        # long lists are recorded as digests
        wrong += ["required_ids"] * (isinstance(required, list) and not {*map(str, required)} <= {*map(str, ids)})
    if wrong:
        raise InputError(f"{path} is damaged (its entry {wrong[0]} is missing, or has another type); restore it")


def read_stored_table(folder: Path, name: str, known: dict) -> QTable:
    """Return a table of a survey, or raise an error if its file is missing or damaged; ``known`` is the index."""
    check_file(folder, name, known)
    table = read_table(folder / name)
    _check_columns(folder / name, table.colnames, COLUMNS[name])
    if name == TABLES[0] and not all(isinstance(table.meta.get(entry), dict) for entry in ("summary", "provenance")):
        raise InputError(f"{folder / name} must hold the summary and the provenance of a survey, got none")
    return table


def read_visits(folder: Path, row: int, known: dict, tile: object) -> tuple[np.ndarray, dict]:
    """Return the visits of a tile and the header of its file, or raise an error if the file is missing or damaged.

    ``known`` is the index of the folder, and ``tile`` is the identifier of the tile.
    """
    return parse_visits(read_verified(folder, part_name(row), known), folder / part_name(row), tile)


def parse_visits(content: bytes, path: object, tile: object) -> tuple[np.ndarray, dict]:
    """Return the visits and the header in the file of a tile, or raise an error if it is another file."""
    visits, cards = read_fits_bytes(content, path)
    _check_columns(path, visits.dtype.names, VISITS)
    for name, (kind, words) in KINDS.items():
        if visits.dtype[name].kind != kind:
            raise InputError(f"its column {name} must contain {words}, got the type {visits.dtype[name]}")
    named = cards.get("TILE", tile)
    if str(named).rstrip() != str(tile).rstrip():
        raise InputError(f"{path} must be the file of tile {tile}, got that of tile {named}")
    return visits, cards


def _check_columns(path: Path, names: tuple, needed: tuple) -> None:
    if lacking := [name for name in needed if name not in (names or ())]:
        raise InputError(f"{path} must have the columns of a survey, got a table without {', '.join(lacking)}")


def number_in(tiles: str) -> int:
    """Return the number of tiles in the entry ``tiles`` of a request; 0 for other texts."""
    number = tiles.partition(" ")[0]
    return int(number) if number.isdecimal() else 0


def clock() -> datetime:
    """Return the present time, or the time that the environment variable SOURCE_DATE_EPOCH gives (s since 1970)."""
    seconds = os.environ.get("SOURCE_DATE_EPOCH", "")
    return datetime.fromtimestamp(int(seconds), UTC) if seconds.isdecimal() else datetime.now().astimezone()


def part_name(tile: int) -> str:
    """Return the name of the file for the tile in row ``tile`` of the tiling."""
    return f"tiles/{tile // 1000:03d}/{tile:06d}.fits"


def kept_name(digest: str) -> str:
    """Return the name of the copy of a plan with which a tile was observed, and which the survey later replaced."""
    return f"{_generations.KEPT}/{digest}.fits"


def read_named(path: Path, digest: str) -> bytes:
    """Return the content of a file whose name contains its checksum, or raise an error if it has another one."""
    content = verified(path, digest)
    if content is None:
        raise InputError(f"{path} is missing or damaged (its checksum differs from the checksum in its name)")
    return content


def verified(path: Path, digest: str) -> bytes | None:
    """Return the content of a file, or None if it does not exist or has another checksum."""
    if not is_present(path):
        return None
    content = content_of(path, most=_generations.MOST_FILE)
    return content if hashlib.sha256(content).hexdigest() == digest else None


def with_recorded_moves(options: AllocationOptions, folder: object) -> AllocationOptions:
    """Return the options with which a survey that was begun by version 0.3, which recorded no moves, is continued."""
    if folder is None or not options.method.uses("moves") or options.moves == "exchange":
        return options
    recorded = read_request(Path(folder))
    if "moves" in recorded or recorded.get("allocator") != options.name:
        return options
    warn(f"{folder} was begun with the moves of version 0.3; its tiles are planned with moves='exchange'")
    return replace(options, moves="exchange")
