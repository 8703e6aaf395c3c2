"""Temporary files and folders that are removed even if a signal ends the process."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

_paths: set[Path] = set()


@contextmanager
def temporary(path: Path) -> Iterator[Path]:
    """Remove a file or folder at the end of the context, unless it was renamed; the file need not exist yet."""
    _paths.add(path)
    try:
        yield path
    finally:
        remove(path)
        _paths.discard(path)


def remove_all() -> None:
    """Remove the temporary files and folders of all threads, before a signal ends the process."""
    for path in list(_paths):
        remove(path)


def remove(path: Path) -> None:
    """Remove a file or a folder, if it exists and can be removed."""
    with suppress(OSError):
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)
