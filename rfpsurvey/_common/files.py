"""Paths of files: formats of files by their endings, and checks of outputs before they are computed."""

import os
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from astropy.table import Table

from rfpsurvey._common.read_documents import is_present
from rfpsurvey.errors import InputError, check_switch, refusal

FORMATS = {
    ".fits": "fits",
    ".fit": "fits",
    ".ecsv": "ascii.ecsv",
    ".csv": "ascii.csv",
    ".tsv": "ascii.csv",
    ".vot": "votable",
    ".xml": "votable",
    ".votable": "votable",
    ".parquet": "parquet",
}
"""Formats of tables by the ending of their file."""
WRITABLE = (".fits", ".ecsv")
"""Endings of the files of tables that can be written."""
ZIPPED = (".gz", ".bz2", ".xz")
"""Endings of compressed files, which follow the ending that determines the format."""


def to_path(path: object) -> Path:
    """Convert text or a path object to a `pathlib.Path`; refuse empty text, which would name the current folder."""
    if isinstance(path, str) and not path.strip():
        raise InputError(f"a path must not be empty, got {path!r}")
    try:
        return Path(path)
    except TypeError:
        raise refusal("a path must be text or a Path object", path, str) from None


def suffix_of(path: Path) -> str:
    """Return the file extension that determines the format; a final ``.gz``, ``.bz2`` or ``.xz`` is ignored."""
    suffixes = [s.lower() for s in path.suffixes]
    if suffixes and suffixes[-1] in ZIPPED:
        suffixes.pop()
    return suffixes[-1] if suffixes else ""


def has_ending(path: Path, endings: Iterable[str]) -> bool:
    """Return whether a file name has one of some endings, such as ``.csv``; a final ``.gz`` or the like is ignored."""
    name = path.name.lower()
    name = name.removesuffix(path.suffix.lower()) if path.suffix.lower() in ZIPPED else name
    return any(name.endswith(ending) and name != ending for ending in endings)


def is_fits(path: Path) -> bool:
    """Return whether a file is in FITS format, which can contain several tables, but only ASCII text."""
    return FORMATS.get(suffix_of(path)) == "fits"


def is_csv(path: Path) -> bool:
    """Return whether a file is in CSV format, which cannot contain units."""
    return FORMATS.get(suffix_of(path)) == "ascii.csv"


def lacks_units(path: Path) -> bool:
    """Return whether a file has a format whose columns usually have no units: CSV or Parquet."""
    return is_csv(path) or FORMATS.get(suffix_of(path)) == "parquet"


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
