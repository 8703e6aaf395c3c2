"""A survey on disk: a part for each tile, an index of checksums, and a note of what was asked.

Parts are renamed into place when they are whole. A line of the index follows, so that a part without one is not
trusted, and a line that was cut off is no line.
"""

import hashlib
import json
import warnings
from contextlib import suppress
from pathlib import Path

from filelock import FileLock, Timeout

from rfpsurvey._io import to_path, write_bytes
from rfpsurvey.errors import InputError, RfpsurveyWarning

__all__ = ["Folder", "part_name", "read_index"]

REQUEST, INDEX, LOCK = "survey.json", "index.csv", "lock"
HEADER = "file,bytes,sha256\n"


class Folder:
    """The folder of a run, locked as long as the run lasts.

    Parameters
    ----------
    path : str or path-like
        Where it is, or shall be.
    request : dict
        What the run is asked to do: a run is continued by the same request only.
    resume : bool
        Continue what is there?
    """

    def __init__(self, path: object, request: dict, *, resume: bool):
        self.path = to_path(path)
        if self.path.exists() and not self.path.is_dir():
            raise InputError(f"{self.path} is a file; the output of a survey is a folder")
        if not self.path.parent.is_dir():
            raise InputError(f"{self.path}: the folder {self.path.parent} does not exist")
        self._request, self._resume = json.loads(json.dumps(request)), resume
        self._known: dict[str, tuple[int, str]] = {}

    def __enter__(self):
        try:
            self.path.mkdir(exist_ok=True)
            self._lock = FileLock(self.path / LOCK)
            self._lock.acquire(timeout=0)
        except Timeout:
            raise InputError(
                f"{self.path}: another run is at work in this folder; wait for it, or take another"
            ) from None
        except OSError as error:
            raise InputError(f"{self.path} cannot be written: {error.strerror or error}") from error
        try:
            self._open()
        except BaseException:
            self._lock.release()
            raise
        return self

    def __exit__(self, *_):
        self._lock.release()

    def _open(self):
        others = [entry.name for entry in self.path.iterdir() if entry.name != LOCK]
        begun = (self.path / REQUEST).is_file()
        if others and not begun:
            raise InputError(f"{self.path} holds something else ({others[0]}); give a new or empty folder")
        if begun and not self._resume:
            raise InputError(f"{self.path} holds a survey; continue it (--resume, resume=True) or give another folder")
        if begun:
            self._compare(_load(self.path / REQUEST))
            self._known = read_index(self.path)
            for left_over in self.path.rglob(".[0-9]*-*"):  # by a run that was killed
                left_over.unlink()
        else:
            write_bytes(self.path / REQUEST, (json.dumps(self._request, indent=1, sort_keys=True) + "\n").encode())
        lines = [f"{name},{size},{digest}\n" for name, (size, digest) in self._known.items()]
        write_bytes(self.path / INDEX, "".join([HEADER, *lines]).encode())

    def _compare(self, before: dict):
        """Refuse to continue another survey than the one that was begun."""
        now = dict(self._request)
        if before.pop("software", None) != now.pop("software", None):
            text = f"{self.path} was begun with other versions of the software; its tiles may differ in rounding"
            warnings.warn(text, RfpsurveyWarning, stacklevel=5)
        different = [name for name in sorted({*before, *now}) if before.get(name) != now.get(name)]
        if different:
            name = different[0]
            raise InputError(
                f"{self.path} holds another survey: {', '.join(different)} differ ({name} was "
                f"{_short(before.get(name))}, and is {_short(now.get(name))}); give another folder"
            )

    def part(self, tile: int) -> bytes | None:
        """Return the part of a tile (by row), None if there is none that can be trusted."""
        name = part_name(tile)
        if name not in self._known:
            return None
        size, digest = self._known[name]
        try:
            content = (self.path / name).read_bytes()
        except OSError as error:
            reason = error.strerror or str(error)
        else:
            if (len(content), hashlib.sha256(content).hexdigest()) == (size, digest):
                return content
            reason = "it is not what was written"
        warnings.warn(
            f"{self.path / name} is damaged ({reason}): its tile is planned again", RfpsurveyWarning, stacklevel=4
        )
        return None

    def put_part(self, tile: int, content: bytes) -> None:
        """Write the part of a tile."""
        name = part_name(tile)
        if tile % 1000 == 0 or not (self.path / name).parent.is_dir():
            with suppress(FileExistsError):
                self._try(lambda: (self.path / name).parent.mkdir(parents=True))
        self.put(name, content)

    def put(self, name: str, content: bytes) -> None:
        """Write a file, and then its line of the index."""
        write_bytes(self.path / name, content)
        self._known[name] = len(content), hashlib.sha256(content).hexdigest()
        line = f"{name},{len(content)},{self._known[name][1]}\n"

        def append():
            with (self.path / INDEX).open("a") as file:
                file.write(line)

        self._try(append)

    def _try(self, write):
        try:
            write()
        except FileExistsError:
            raise
        except OSError as error:
            raise InputError(f"{self.path} cannot be written: {error.strerror or error}") from error

    def finish(self) -> None:
        """Sort the index: the same survey has the same index, however it was made."""
        lines = [f"{name},{size},{digest}\n" for name, (size, digest) in sorted(self._known.items())]
        write_bytes(self.path / INDEX, "".join([HEADER, *lines]).encode())


def read_index(path: Path) -> dict[str, tuple[int, str]]:
    """Return size and checksum of each file; lines that were cut off are left out."""
    try:
        text = (path / INDEX).read_text()
    except OSError:
        return {}
    found = {}
    for line in text.splitlines(keepends=True)[1:]:
        fields = line.strip().split(",")
        if line.endswith("\n") and len(fields) == 3 and fields[1].isdigit() and len(fields[2]) == 64:
            found[fields[0]] = int(fields[1]), fields[2]
    return found


def part_name(tile: int) -> str:
    """Return the file of a tile (by row)."""
    return f"tiles/{tile // 1000:03d}/{tile:06d}.fits"


def _load(path: Path) -> dict:
    try:
        return json.loads(path.read_text())
    except (OSError, ValueError) as error:
        raise InputError(f"{path} is damaged ({error}); start the survey again in another folder") from None


def _short(value) -> str:
    text = str(value)
    return text if len(text) <= 60 else text[:57] + "..."
