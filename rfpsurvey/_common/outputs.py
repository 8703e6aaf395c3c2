"""Check the paths of outputs before they are computed, and text that files cannot contain."""

import os
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from astropy.table import Table

from rfpsurvey._common.read_documents import is_present
from rfpsurvey._common.read_tables import ZIPPED, has_ending, to_path
from rfpsurvey.errors import InputError, check_switch

WRITABLE = (".fits", ".ecsv")


def check_output(
    path: str | os.PathLike, endings: tuple[str, ...], *, overwrite: bool = False, gzipped: bool = False
) -> Path:
    """Return the path of an output file; raise an error if its ending is not valid or the file cannot be written.

    The file name of a table may end in ``.gz``. The names of other files may end in ``.gz`` only if ``gzipped`` is
    True.
    """
    path = to_path(path)
    zipped = path.suffix.lower() in ZIPPED
    if not has_ending(path, endings) or (
        zipped and (path.suffix.lower() != ".gz" or not (gzipped or endings is WRITABLE))
    ):
        raise InputError(f"{path}: the name of this output file must end in {' or '.join(endings)}")
    check_parent(path)
    if path.is_dir():
        raise InputError(f"{path} is a folder; an output must be a file")
    if path.exists() and not path.is_file():
        raise InputError(f"{path} is a pipe or a device; an output must be a file")
    if not check_switch(overwrite, "overwrite") and is_present(path):
        raise InputError(f"{path} exists; to replace it, use overwrite=True (or --overwrite)")
    return path


def check_parent(path: Path) -> None:
    """Raise an error if a file or folder cannot be made, because its name is not valid or its folder is read-only."""
    try:
        path.lstat()
    except FileNotFoundError:
        pass
    except (OSError, ValueError) as error:  # the name is too long or contains a null character, or a parent is a file
        raise InputError(f"{path} cannot be written: {getattr(error, 'strerror', None) or error}") from None
    if not path.parent.is_dir():
        raise InputError(f"{path}: the folder {path.parent} does not exist")
    if not os.access(path.parent, os.W_OK | os.X_OK):
        raise InputError(f"{path}: the folder {path.parent} cannot be written to")


def check_separate(outputs: Iterable, inputs: Iterable = ()) -> None:
    """Raise an error if an output is also an input, or if two outputs are the same file; None stands for no file."""
    used = {_identity(Path(path)): "an input" for path in inputs if path is not None}
    for path in outputs:
        if path is None:
            continue
        key = _identity(Path(path))
        if key in used:
            raise InputError(f"{path} must be a new file, got the name of {used[key]}; give another name")
        used[key] = "another output"


def _identity(path: Path) -> object:
    """Return a value that is equal for two paths of the same file."""
    try:
        status = path.stat()
    except (OSError, ValueError):
        return os.path.realpath(path.parent), path.name
    return status.st_dev, status.st_ino


def check_new_folder(path: str | os.PathLike) -> Path:
    """Return the path of a folder; raise an error if it exists or cannot be made."""
    path = to_path(path)
    check_parent(path)
    if is_present(path):
        raise InputError(f"{path} exists; give the name of a new folder")
    return path


def check_text(values: object, name: str) -> None:
    """Raise an error for text with control characters or line separators, which tables in files cannot contain."""
    values = np.asarray(values, dtype=str)
    if values.size == 0 or values.dtype.itemsize == 0:
        return
    codes = np.ascontiguousarray(values).view(np.uint32).reshape(values.size, -1)
    strange = (codes < 0x20) | ((codes >= 0x7F) & (codes < 0xA0)) | ((codes >= 0xD800) & (codes < 0xE000))
    strange |= (codes == 0x2028) | (codes == 0x2029)
    strange &= np.arange(codes.shape[1]) < np.char.str_len(values).reshape(-1, 1)  # zeros follow shorter text
    if (rows := strange.any(axis=1)).any():
        text = str(values.flat[np.argmax(rows)])
        raise InputError(f"{name} must be valid Unicode text without line breaks and control characters, got {text!a}")


def check_texts(table: Table, what: object) -> None:
    """Raise an error if a column of a table contains text with control characters or line separators."""
    for column in table.itercols():
        if column.dtype.kind == "U":
            check_text(np.ma.filled(column, ""), f"{what}: the column {column.info.name!r}")
