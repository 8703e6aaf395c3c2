"""A survey on disk: a file with the result of each tile, an index with checksums, and the request.

The file of a tile is called its *part*. A part receives its final name when it is complete, and the line of the index
for this part is written afterward. Parts without a line in the index are therefore not used, and incomplete lines of
the index are ignored.
"""

import hashlib
import json
import re
import shutil
from contextlib import contextmanager
from pathlib import Path

from filelock import FileLock, Timeout

from rfpsurvey._checkpoint import check_request, warn_of_software
from rfpsurvey._io import TEMPORARY_PREFIX, to_path, write_bytes
from rfpsurvey._readers import content_of, parse_json
from rfpsurvey.errors import InputError, warn

__all__ = ["JOINT", "TABLES", "Folder", "RequestFolder", "part_name", "read_index", "read_verified"]

REQUEST, INDEX, LOCK = "survey.json", "index.csv", "lock"
TABLES = ("tiles.fits", "completeness.ecsv", "outcomes.fits")
JOINT = "joint.ecsv"
OTHERS = (JOINT, "joint/state.npz")
HEADER = "file,bytes,sha256\n"
MOST_REQUEST = 10_000_000
LINE = re.compile(r"([a-z0-9/]+\.(?:fits|ecsv|npz)),(\d+),([0-9a-f]{64})\n")


class RequestFolder:
    """A folder for the results and the request of a long computation; the folder is locked during the computation.

    Parameters
    ----------
    path : str or path-like
        Path of the folder, which need not exist.
    request : dict
        The input and the options of the computation. An unfinished computation can only be continued with the same
        request.
    resume : bool
        Whether to continue an unfinished computation.
    """

    request_name = REQUEST
    """Name of the file of the request."""
    work, parts = "survey", "tiles"
    """Words for error messages: the kind of work in the folder, and the parts into which the work is divided."""

    def __init__(self, path: object, request: dict, *, resume: bool):
        self.path = to_path(path)
        if self.path.exists() and not self.path.is_dir():
            raise InputError(f"{self.path} is a file; the output of a {self.work} is a folder")
        if not self.path.parent.is_dir():
            raise InputError(f"{self.path}: the folder {self.path.parent} does not exist")
        self._request, self._resume = json.loads(json.dumps(request)), resume

    def __enter__(self):
        with self._told():
            self.path.mkdir(exist_ok=True)
            if not self._begun:
                self._refuse_others()
            self._lock = FileLock(self.path / LOCK)
            try:
                self._lock.acquire(timeout=0)
            except Timeout:
                text = f"{self.path}: another run uses this folder; wait until it ends, or give another folder"
                raise InputError(text) from None
        try:
            self._open()
        except BaseException:
            self._lock.release()
            raise
        return self

    def __exit__(self, *_):
        self._lock.release()

    @property
    def _begun(self) -> bool:
        return (self.path / self.request_name).is_file()

    def _refuse_others(self):
        others = [entry.name for entry in self.path.iterdir() if entry.name != LOCK]
        others = [name for name in others if not name.startswith(TEMPORARY_PREFIX)]
        if others:
            raise InputError(f"{self.path} must be a new or empty folder, got one that contains {others[0]}")

    def _open(self):
        if self._begun and not self._resume:
            raise InputError(
                f"{self.path} holds a {self.work}; continue it (--resume, resume=True) or give another folder"
            )
        if self._begun:
            self._compare(_load(self.path / self.request_name))
            self._read()
        for left_over in list(self.path.rglob(f"{TEMPORARY_PREFIX}*")):  # left by a process that was killed
            if left_over.is_dir():
                shutil.rmtree(left_over, ignore_errors=True)
            else:
                left_over.unlink(missing_ok=True)
        content = (json.dumps(self._request, indent=1, sort_keys=True) + "\n").encode()
        write_bytes(self.path / self.request_name, content, sync=True)

    def _read(self):
        """Read the results of unfinished work from the folder."""

    def _compare(self, before: dict):
        """Raise an error if the request differs from the request of the unfinished work."""
        now = dict(self._request)
        warn_of_software(self.path, before.pop("software", None), now.pop("software", None), self.parts)
        if "method" in before:
            raise InputError(
                f"{self.path} was begun by version 0.1 of rfpsurvey, which recorded other options; give another folder"
            )
        check_request(self.path, before, now, self.work, "folder")

    @contextmanager
    def _told(self):
        """Convert errors of the operating system to an InputError."""
        try:
            yield
        except OSError as error:
            raise InputError(f"{self.path} cannot be written: {error.strerror or error}") from error


class Folder(RequestFolder):
    """The folder of a survey, which is locked while the survey is planned.

    Parameters
    ----------
    path : str or path-like
        Path of the folder, which need not exist.
    request : dict
        The request of the survey; a survey can only be continued with the same request.
    n_tiles : int
        Number of tiles.
    resume : bool
        Whether to continue an unfinished survey.
    """

    def __init__(self, path: object, request: dict, n_tiles: int, *, resume: bool):
        super().__init__(path, request, resume=resume)
        self._n = n_tiles
        self._known: dict[str, tuple[int, str]] = {}

    def _open(self):
        super()._open()
        self._write_index(self._known.items())

    def _read(self):
        known, n_strange = _read_index(self.path)
        self._known = {name: entry for name, entry in known.items() if _belongs(name, self._n)}
        if n_strange or len(self._known) < len(known):
            text = f"{self.path / INDEX} is damaged: tiles without a line in this file are planned again"
            warn(text)

    def _write_index(self, entries):
        write_bytes(self.path / INDEX, "".join([HEADER, *(_line(*entry) for entry in entries)]).encode())

    def part(self, tile: int) -> bytes | None:
        """Return the stored result of the tile in row ``tile`` of the tiling, or None if there is no valid result."""
        name = part_name(tile)
        if name not in self._known:
            return None
        try:
            return read_verified(self.path, name, self._known)
        except InputError as error:
            self.distrust(tile, str(error))
            return None

    def distrust(self, tile: int, reason: str) -> None:
        """Issue a warning that the stored result of a tile is not used, and that the tile is planned again."""
        text = f"the tile in row {tile} of the tiling is planned again: {reason}"
        warn(text)

    def put_part(self, tile: int, content: bytes) -> None:
        """Write the result of a tile to the file of this tile."""
        self.put_file(part_name(tile), content)

    def file(self, name: str) -> bytes | None:
        """Return the content of a file, or None if there is no valid file; a damaged file causes a warning."""
        if name not in self._known:
            return None
        try:
            return read_verified(self.path, name, self._known)
        except InputError as error:
            warn(str(error))
            return None

    def put_file(self, name: str, content: bytes) -> None:
        """Write a file of the survey; if its parent folder does not exist, make this folder."""
        with self._told():
            (self.path / name).parent.mkdir(parents=True, exist_ok=True)
        self.put(name, content)

    def put(self, name: str, content: bytes) -> None:
        """Write a file, and then the line of the index for this file."""
        write_bytes(self.path / name, content)
        self._known[name] = len(content), hashlib.sha256(content).hexdigest()
        with self._told(), (self.path / INDEX).open("a") as file:
            file.write(_line(name, self._known[name]))

    def finish(self) -> None:
        """Sort the lines of the index, so that the index does not depend on the order in which tiles were planned."""
        self._write_index(sorted(self._known.items()))


def read_verified(path: Path, name: str, known: dict[str, tuple[int, str]]) -> bytes:
    """Return the content of a file of a survey; raise an error if it does not match its checksum in the index."""
    try:
        content = (path / name).read_bytes()
    except FileNotFoundError:
        raise InputError(f"{path / name} is missing") from None
    except OSError as error:
        raise InputError(f"{path / name} is damaged ({error.strerror or error})") from None
    if (len(content), hashlib.sha256(content).hexdigest()) != known.get(name):
        raise InputError(f"{path / name} is damaged (its checksum differs from the checksum recorded in the index)")
    return content


def read_index(path: Path) -> dict[str, tuple[int, str]]:
    """Return the size and the checksum of each file in the index; incomplete lines are omitted."""
    return _read_index(path)[0]


def _read_index(path: Path):
    """Return the entries of the index, and the number of invalid lines among all lines except the last one."""
    try:
        text = (path / INDEX).read_text(encoding="ascii", errors="replace")
    except OSError:
        return {}, 0
    lines = text.splitlines(keepends=True)[1:]
    found = [LINE.fullmatch(line) for line in lines]
    known = {match[1]: (int(match[2]), match[3]) for match in found if match}
    return known, sum(match is None for match in found[:-1])


def _line(name: str, entry: tuple[int, str]) -> str:
    """Return the line of the index for a file."""
    return f"{name},{entry[0]},{entry[1]}\n"


def _belongs(name: str, n_tiles: int) -> bool:
    """Return whether a survey with ``n_tiles`` tiles has a file with this name."""
    stem = Path(name).stem
    return name in (*TABLES, *OTHERS) or (stem.isdigit() and int(stem) < n_tiles and name == part_name(int(stem)))


def part_name(tile: int) -> str:
    """Return the name of the file for the tile in row ``tile`` of the tiling."""
    return f"tiles/{tile // 1000:03d}/{tile:06d}.fits"


def _load(path: Path) -> dict:
    try:
        content = content_of(path, most=MOST_REQUEST)
        return parse_json(content.decode("utf-8", "backslashreplace"), "the request")
    except InputError as error:
        raise InputError(f"{path} is damaged ({error}); start again in another folder") from None
