"""Outputs of long computations on disk: locks, and folders with a request and an index with checksums.

A file receives its final name when it is complete, and the line of the index for this file is written afterward. New
files without a line in the index are therefore not used, and incomplete lines of the index are ignored. A file that
replaces another one receives its line first; until it is renamed, the line of the replaced file describes the content.
"""

import hashlib
import json
import math
import re
from contextlib import ExitStack, contextmanager, nullcontext, suppress
from pathlib import Path

import numpy as np
from filelock import FileLock, Timeout

from rfpsurvey._common.files import check_parent, suffix_of, to_path
from rfpsurvey._common.io import TEMPORARY_PREFIX, write_bytes, writing_to, written
from rfpsurvey._common.read_documents import content_of, is_present, open_file, parse_json, read_arrays
from rfpsurvey._common.temporary import remove, temporary
from rfpsurvey.errors import InputError, warn

INDEX, LOCK = "index.csv", "lock"
WAIT = 10.0
"""Time in seconds for which a short change of a folder waits until another run releases the folder."""
HEADER = "file,bytes,sha256\n"
MOST_REQUEST, MOST_INDEX = 10_000_000, 2**28
LINE = re.compile(r"([a-z0-9/-]+\.(?:fits|ecsv|npz)),(\d{1,18}),([0-9a-f]{64})\n")


@contextmanager
def locked(path: Path, lock: Path | None = None, *, wait: float = 0.0):
    """Lock an output, and raise an error if another run has locked it for longer than ``wait`` seconds.

    By default, the lock is a hidden file beside the output, which is removed at the end.
    """
    lock_path = path.with_name(f".{path.name}.lock") if lock is None else lock
    guard = FileLock(lock_path)
    try:
        guard.acquire(timeout=wait)
        taken = not lock_path.exists()  # the run that held the lock has just removed its file
    except Timeout:
        taken = True
    except OSError as error:
        raise InputError(f"{path} cannot be written: {error.strerror or error}") from error
    try:
        if taken:
            kind = "file" if lock is None else "folder"
            raise InputError(f"{path}: another run uses this {kind}; wait until it ends, or give another {kind}")
        with temporary(lock_path) if lock is None else nullcontext():
            yield
    finally:
        guard.release()


class RequestFolder:
    """A folder for the results and the request of a long computation.

    The folder is locked during the computation, and an index contains the checksums of its files.

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

    request_name: str
    """Name of the file of the request."""
    work: str
    parts: str
    again: str
    """Words for messages: the kind of work in the folder, its parts, and the consequence of a damaged file."""

    def __init__(self, path: object, request: dict, *, resume: bool):
        self.path = to_path(path)
        check_parent(self.path)
        if is_present(self.path) and not self.path.is_dir():
            raise InputError(f"{self.path} is a file; the output of a {self.work} is a folder")
        # as it will be read from the file, such as lists instead of tuples
        self._request, self._resume = json.loads(json.dumps(request)), resume
        self._known: dict[str, list[tuple[int, str]]] = {}

    def __enter__(self):
        is_new = not self.path.exists()
        with written(self.path):
            self.path.mkdir(exist_ok=True)
            for entry in () if self._begun else self.path.iterdir():
                if entry.name != LOCK and not entry.name.startswith(TEMPORARY_PREFIX):
                    raise InputError(f"{self.path} must be a new or empty folder, got one that contains {entry.name}")
        self._lock = locked(self.path, self.path / LOCK)
        self._lock.__enter__()
        try:
            self._open()
        except BaseException:
            if is_new and not self._begun:  # nothing could be written, for example, because the disk is full
                with suppress(OSError):
                    (self.path / LOCK).unlink()
                    self.path.rmdir()
            self._lock.__exit__(None, None, None)
            raise
        return self

    def __exit__(self, *_):
        self.release()

    def release(self) -> None:
        """Release the lock of the folder."""
        self._lock.__exit__(None, None, None)
        self._lock = nullcontext()

    @property
    def _begun(self) -> bool:
        return (self.path / self.request_name).is_file()

    def _open(self):
        if self._begun and not self._resume:
            raise InputError(
                f"{self.path} holds a {self.work}; continue it with resume=True (or --resume), or give another folder"
            )
        if self._begun:
            self._compare(load_request(self.path / self.request_name), dict(self._request))
            self._read()
        self._write_request()

    def _write_request(self):
        remove_temporary(self.path)
        content = (json.dumps(self._request, indent=1, sort_keys=True) + "\n").encode()
        write_bytes(self.path / self.request_name, content, sync=True)
        self._write_index((name, entry) for name, entries in self._known.items() for entry in entries)

    def _read(self):
        """Read the index of unfinished work."""
        known, n_strange = read_lines(self.path)
        self._known = {name: entries for name, entries in known.items() if self._belongs(name)}
        if n_strange or len(self._known) < len(known):
            text = f"{self.path / INDEX} is damaged: {self.parts} without a line in this file are planned again"
            warn(text)

    def _belongs(self, _name: str) -> bool:
        """Return whether the folder can have a file with this name."""
        return True

    def _compare(self, before: dict, now: dict):
        """Raise an error if the request ``now`` differs from the request of the unfinished work."""
        warn_of_software(self.path, before.pop("software", None), now.pop("software", None), self.parts)
        if "method" in before:
            raise InputError(
                f"{self.path} was begun by version 0.1 of rfpsurvey, which recorded other options; give another folder"
            )
        check_request(self.path, before, now, self.work, "folder")

    def put(self, name: str, content: bytes) -> None:
        """Write a file, and the line of the index for this file."""
        with self._recorded(name, len(content), hashlib.sha256(content).hexdigest()):
            write_bytes(self.path / name, content)

    def record(self, name: str, size: int, checksum: str) -> None:
        """Write the line of the index for a new file, which a worker has written."""
        with self._recorded(name, size, checksum):
            pass

    @contextmanager
    def writing(self, name: str):
        """Provide a temporary path for a file; at the end, rename the file and write its line of the index."""
        path = self.path / name
        with ExitStack() as stack, writing_to(path, (suffix_of(path),), overwrite=True) as new_path:
            try:
                yield new_path
            except InputError as error:
                raise InputError(str(error).replace(str(new_path), str(path))) from error
            stack.enter_context(self._recorded(name, *_entry_of(new_path)))

    @contextmanager
    def _recorded(self, name: str, *entry):
        """Write the line of the index for a file: first if the file replaces another one, otherwise at the end."""
        replaced = name in self._known
        if not replaced:
            yield
        self._known.setdefault(name, []).append(entry)
        with written(self.path), (self.path / INDEX).open("a") as file:
            file.write(_line(name, entry))
        if replaced:
            yield

    def _write_index(self, entries):
        write_bytes(self.path / INDEX, "".join([HEADER, *(_line(*entry) for entry in entries)]).encode())

    def verified(self, name: str) -> Path | None:
        """Return the path of a file, or None if the file is missing or damaged; a damaged file causes a warning."""
        path = self.path / name
        if name not in self._known or not path.exists():
            return None
        try:
            check_file(self.path, name, self._known)
        except InputError as error:
            warn(f"{error}; {self.again}")
            return None
        return path

    def load(self, name: str, **expected: tuple[str, tuple]) -> dict[str, np.ndarray] | None:
        """Return the arrays of a file, or None if the file is missing or damaged.

        ``expected`` contains the type and the shape of each array.
        """
        path = self.verified(f"{name}.npz")
        if path is None:
            return None
        try:
            with open_file(path) as file:
                return read_arrays(file, expected, "the archive")
        except InputError as error:
            warn(f"{path} is damaged ({error}); {self.again}")
            return None

    def finish(self) -> None:
        """Sort the lines of the index, so that the index does not depend on the order in which files were written."""
        self._write_index((name, self._known[name][-1]) for name in sorted(self._known))


def remove_temporary(path: Path) -> None:
    """Remove temporary files in a locked folder, which a process left that was killed."""
    for left_over in list(path.rglob(f"{TEMPORARY_PREFIX}*")):
        remove(left_over)


def _entry_of(path: Path) -> tuple[int, str]:
    """Return the size and the checksum of a file."""
    with open_file(path) as file:
        return path.stat().st_size, hashlib.file_digest(file, "sha256").hexdigest()


def check_file(path: Path, name: str, known: dict[str, list[tuple[int, str]]]) -> None:
    """Raise an error if a file does not match its checksum in the index."""
    with _readable(path / name):
        entry = _entry_of(path / name)
    _check_entry(path / name, entry, known.get(name))


def read_verified(path: Path, name: str, known: dict[str, list[tuple[int, str]]]) -> bytes:
    """Return the content of a file; raise an error if it does not match its checksum in the index."""
    with _readable(path / name), open_file(path / name) as file:
        content = file.read()
    _check_entry(path / name, (len(content), hashlib.sha256(content).hexdigest()), known.get(name))
    return content


@contextmanager
def _readable(path: Path):
    if not is_present(path):
        raise InputError(f"{path} is missing")
    try:
        yield
    except OSError as error:
        raise InputError(f"{path} is damaged ({error.strerror or error})") from None


def _check_entry(path: Path, entry: tuple[int, str], known: list | None):
    if known is None:
        raise InputError(f"{path} is damaged (the index of its folder, {INDEX}, does not contain its checksum)")
    if entry not in known:
        raise InputError(f"{path} is damaged (its checksum differs from the checksum recorded in the index)")


def read_index(path: Path) -> dict[str, list[tuple[int, str]]]:
    """Return the sizes and the checksums that the index of a folder contains for each file.

    Incomplete lines are omitted. A file that was replaced has several sizes and checksums.
    """
    return read_lines(path)[0]


def checksums_in(path: Path) -> dict[str, str]:
    """Return the last checksum that the index of a folder contains for each file."""
    return {name: entries[-1][1] for name, entries in read_index(path).items()}


def read_lines(path: Path) -> tuple[dict[str, list[tuple[int, str]]], int]:
    """Return the entries of the index, and the number of invalid lines among all lines except the last one."""
    if not is_present(path / INDEX):
        return {}, 0
    text = content_of(path / INDEX, most=MOST_INDEX).decode("ascii", "replace")
    lines = text.splitlines(keepends=True)[1:]
    matches = [LINE.fullmatch(line) for line in lines]
    known = {}
    for match in filter(None, matches):
        known.setdefault(match[1], []).append((int(match[2]), match[3]))
    return known, sum(match is None for match in matches[:-1])


def _line(name: str, entry: tuple[int, str]) -> str:
    """Return the line of the index for a file."""
    return f"{name},{entry[0]},{entry[1]}\n"


def load_request(path: Path) -> dict:
    """Return the request in the file of a folder."""
    try:
        content = content_of(path, most=MOST_REQUEST)
        return parse_json(content.decode("utf-8", "backslashreplace"), "the request")
    except InputError as error:
        raise InputError(f"{path} is damaged ({error}); restore it, or start again in another folder") from None


def _agree(first: object, second: object) -> bool:
    """Return whether two values are equal; numbers can differ by rounding errors of other versions of the software."""
    both = isinstance(first, float) and isinstance(second, float)
    return first == second or (both and math.isclose(first, second, rel_tol=1e-11))


def check_request(path: Path, before: dict, now: dict, work: str, place: str) -> None:
    """Raise an error if the present request differs from the request with which the unfinished work began.

    Parameters
    ----------
    path : Path
        File or folder of the unfinished work.
    before, now : dict
        The request of the unfinished work, and the present request. Each request maps names to values that JSON can
        represent.
    work, place : str
        Words for the error message: the kind of work, such as "scan", and the parameter that the user can change to
        begin new work, such as "path".

    Raises
    ------
    InputError
        If the two requests differ.
    """
    if different := [name for name in sorted({*before, *now}) if not _agree(before.get(name), now.get(name))]:
        name = different[0]
        raise InputError(
            f"{path} holds another {work}: {', '.join(different)} {'differs' if len(different) == 1 else 'differ'} "
            f"({name} was {_short(before.get(name))} and is now {_short(now.get(name))}); give another {place}"
        )


def warn_of_software(path: Path, before: object, now: object, parts: str) -> None:
    """Issue a warning if unfinished work was begun with different versions of the software.

    ``before`` and ``now`` contain the versions with which the work was begun, and the present versions. ``parts`` is
    the word for the results in the warning, such as "tiles".
    """
    if before != now:
        warn(
            f"{path} was begun with other versions of the software (rfpsurvey or the packages that it uses); its "
            f"{parts} may differ by rounding errors"
        )


def _short(value: object) -> str:
    text = str(value)
    return text if len(text) <= 60 else text[:57] + "..."
