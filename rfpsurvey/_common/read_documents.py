"""Read TOML and JSON documents and archives of arrays, and limit the memory that the content of any file may use."""

import bz2
import gzip
import io
import json
import lzma
import re
import zipfile
import zlib
from collections.abc import Iterator, Sized
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import BinaryIO

import numpy as np

from rfpsurvey.errors import InputError, short, warn

OPENERS = {b"\x1f\x8b": gzip.open, b"BZh": bz2.open, b"\xfd7zXZ\x00": lzma.open}
# Largest ratio of decompressed to compressed size. For tables of real targets, the ratio is less than 10.
MOST_RATIO = 100
# Decompressed contents of at most this many bytes are always allowed.
FREE = 2**26
# In a text column, every row takes as much memory as the longest value. The memory of a column is therefore limited to
# MOST_PADDING times the size of the file or to FREE_TEXT bytes, whichever is larger.
MOST_PADDING, FREE_TEXT = 64, 2**30
MOST_COLUMNS = 10_000
CHUNK = 2**20


def sentence(error: Exception) -> str:
    """Return the first line of the message of an exception.

    The type of the exception precedes the message, unless the exception is a ValueError or an OSError.
    """
    text, kind = str(error).strip().split("\n")[0][:300], type(error).__name__
    if not text:
        return kind
    return text if isinstance(error, ValueError | OSError) else f"{kind}: {text}"


@contextmanager
def reading(what: object, kind: str) -> Iterator[None]:
    """Convert all exceptions of a reader of another package to an InputError that begins with ``what``."""
    try:
        yield
    except InputError:
        raise
    except RecursionError as error:
        raise InputError(f"{what} cannot be read as {kind}: the file is nested too deeply") from error
    except Exception as error:  # the readers can raise any exception
        raise InputError(f"{what} cannot be read as {kind}: {sentence(error)}") from error


def is_present(path: Path) -> bool:
    """Return whether there is a file, a folder or a link with this path, even if it cannot be read."""
    try:
        path.lstat()
    except (FileNotFoundError, NotADirectoryError, ValueError):  # or the path contains a null character
        return False
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror or error}") from error
    return True


def check_is_file(path: Path) -> None:
    """Raise an error if a path is not the path of a regular file; other files, such as pipes, may have no end."""
    try:
        if path.is_file():
            return
        if path.is_dir():
            reason = "this is a folder"
        elif path.exists():
            reason = "this is a pipe or a device; write its content to a file, and give this file"
        else:
            reason = "the target of this link does not exist" if path.is_symlink() else ""
    except OSError as error:
        reason = error.strerror or str(error)
    except ValueError:  # the path contains a null character
        reason = ""
    raise InputError(f"{path}: {reason or 'there is no such file'}")


def entries_of(folder: Path) -> list[Path]:
    """Return the paths of all files and folders in a folder, sorted."""
    try:
        return sorted(folder.iterdir())
    except OSError as error:
        raise InputError(f"{folder} cannot be read: {error.strerror or error}") from error


def open_file(path: Path) -> BinaryIO:
    """Return an open file; raise an error if the path is not the path of a regular file, or cannot be opened.

    All files that users give are opened by this function, or after `check_is_file`.
    """
    check_is_file(path)
    try:
        return path.open("rb")
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror or error}") from error


def head_of(path: Path, n: int) -> bytes:
    """Return the first bytes of a regular file, decompressed if necessary; empty if the file cannot be read."""
    try:
        opener = _opener(path)
        with open_file(path) as file, nullcontext(file) if opener is None else opener(file) as content:
            return content.read(n)
    except (InputError, OSError, EOFError, zlib.error, lzma.LZMAError):
        return b""


def _opener(path: Path):
    with open_file(path) as file:
        head = file.read(6)
    return next((opener for magic, opener in OPENERS.items() if head.startswith(magic)), None)


def content_of(path: Path, most: int | None = None, kind: str = "") -> bytes:
    """Return the decompressed content of a file; raise an error if it has more than ``most`` bytes.

    If ``most`` is None, the size of uncompressed files is not limited, and the decompressed size of compressed files is
    limited by `MOST_RATIO` and `FREE`. ``kind`` is the name of the file format in error messages.
    """
    check_is_file(path)
    try:
        size, opener = path.stat().st_size, _opener(path)
        limit = most if most is not None else None if opener is None else max(FREE, MOST_RATIO * size)
        if opener is None and limit is None:
            return path.read_bytes()
        content = io.BytesIO()
        with (opener or open)(path, "rb") as file:
            while chunk := file.read(CHUNK):
                content.write(chunk)
                if content.tell() > limit and most is not None:
                    raise InputError(f"{path}: the file must have at most {limit} bytes, got more")
                if content.tell() > limit:
                    raise InputError(
                        f"{path}: the decompressed content must have at most {limit} bytes ({MOST_RATIO} times the "
                        f"size of the file, but at least {FREE} bytes), got more"
                    )
        return content.getvalue()
    except (OSError, EOFError, zlib.error, lzma.LZMAError) as error:
        reason = getattr(error, "strerror", None) or sentence(error)
        raise InputError(f"{path} cannot be read{kind and f' as {kind}'}: {reason}") from error


def warn_of_open_end(path: Path, content: bytes) -> None:
    """Issue a warning if the last line of a text has no end, so that its last value may be incomplete."""
    if content and not content.endswith((b"\n", b"\r")):
        warn(f"{path}: the last line must end with a line break, got none; its last value may be cut off")


def open_content(path: Path) -> BinaryIO:
    """Return an open, seekable file: the file itself, or its decompressed content."""
    return io.BytesIO(content_of(path)) if _opener(path) else open_file(path)


def check_width(path: Path, n_rows: int, longest: int, size: int, where: str) -> None:
    """Raise an error if the longest value is so long that the text column would not fit into memory."""
    needed = 4 * n_rows * longest
    if needed > max(FREE_TEXT, MOST_PADDING * size):
        raise InputError(
            f"{path}: the text in {where} must be short enough to fit into memory, got {longest} characters, which "
            f"take {needed / 1e9:.0f} GB in a column of {n_rows} rows"
        )


def check_rows(path: Path, rows: Sized, n_rows: int) -> None:
    """Raise an error if a table does not have as many rows as its file."""
    if len(rows) != n_rows:
        raise InputError(f"{path}: the table must have as many rows as the file ({n_rows}), got {len(rows)} rows")


MOST_TOML, MOST_JSON = 2**20, 2**24
MOST_DEPTH, MOST_VALUES = 32, 100_000
# Seeds have up to 128 bits; all integers must be representable as floats.
MOST_INTEGER = 2**1000
# Matches the beginning of a key that has more than `MOST_DEPTH` parts, which are separated by dots. A match can begin
# only at the start of a word, so that the time of the search is proportional to the length of the text.
LONG_KEY = re.compile(rf"""(?<![\w"'-])(?:[\w"'-]++[ \t]*+\.[ \t]*+){{{MOST_DEPTH}}}""")


def read_toml(path: Path) -> dict:
    """Return the content of a TOML file."""
    import tomllib

    content = content_of(path, most=MOST_TOML, kind="TOML")
    if content[-1:].isdigit():  # a document that ends within another value is not valid
        warn_of_open_end(path, content)
    try:
        text = content.decode("utf-8")
        long = LONG_KEY.search(text)
        if long:
            number = text.count("\n", 0, long.start()) + 1
            raise InputError(f"{path}: a key in line {number} must have at most {MOST_DEPTH} parts, got more")
        values = tomllib.loads(text)
    except RecursionError:
        raise InputError(f"{path}: values must be nested at most {MOST_DEPTH} levels deep, got more") from None
    except InputError:
        raise
    except ValueError as error:  # the text is not UTF-8 or not TOML, or a number has too many digits
        raise InputError(f"{path} cannot be read as TOML: {sentence(error)}") from error
    check_size(values, path)
    return values


def parse_json(text: object, what: object) -> dict:
    """Return the object in a JSON text; ``what`` describes the text in error messages."""
    if not isinstance(text, str):
        raise InputError(f"{what} must be an object in JSON, got {type(text).__name__}")
    if len(text) > MOST_JSON:
        raise InputError(f"{what} must have at most {MOST_JSON} characters, got {len(text)}")
    try:
        content = json.loads(text)
    except RecursionError:
        raise InputError(f"{what} must be nested at most {MOST_DEPTH} levels deep, got more") from None
    except ValueError as error:
        raise InputError(f"{what} must be an object in JSON: {sentence(error)}") from None
    if not isinstance(content, dict):
        raise InputError(f"{what} must be an object in JSON, got {type(content).__name__}")
    check_size(content, what)
    return content


def check_size(content: object, what: object, *, most_values: int = MOST_VALUES) -> None:
    """Raise an error if a document has too many values or nested levels, or an integer that is too large.

    A value that occurs twice counts twice.
    """
    todo, n = [(content, 0)], 0
    while todo:
        value, depth = todo.pop()
        inner = value.values() if isinstance(value, dict) else value if isinstance(value, list | tuple) else ()
        n += len(inner)
        if depth > MOST_DEPTH:
            raise InputError(f"{what}: values must be nested at most {MOST_DEPTH} levels deep, got more")
        if n > most_values:
            raise InputError(f"{what}: there must be at most {most_values} values, got more")
        wide = next((child for child in inner if isinstance(child, int) and abs(child) > MOST_INTEGER), None)
        if wide is not None:
            raise InputError(
                f"{what}: integers must be from {-MOST_INTEGER:.4g} to {MOST_INTEGER:.4g}, got {short(wide)}"
            )
        todo.extend((child, depth + 1) for child in inner if isinstance(child, dict | list | tuple))


def read_arrays(file: BinaryIO, expected: dict[str, tuple[str, tuple]], what: object) -> dict[str, np.ndarray]:
    """Return the arrays of an uncompressed NumPy archive, as `numpy.savez` writes it.

    Parameters
    ----------
    file : file object
        The archive.
    expected : dict
        The type and the shape of each array, by name. A shape can contain None for any length. If a name ends with a
        question mark, the archive may lack this array.
    what : object
        Beginning of error messages.

    Raises
    ------
    InputError
        If the file is not a NumPy archive, or if an array is missing or has another type or shape.
    """
    with reading(what, "npz"), zipfile.ZipFile(file) as archive:
        stored = {info.filename.removesuffix(".npy"): info for info in archive.infolist()}
        arrays = {}
        for key, (dtype, shape) in expected.items():
            name = key.removesuffix("?")
            if name in stored:
                arrays[name] = _read_array(archive, stored[name], np.dtype(dtype), shape, f"{what}: array {name!r}")
            elif name == key:
                raise InputError(f"{what}: the archive must contain the array {name!r}, got none")
    return arrays


def _read_array(archive, info, dtype: np.dtype, shape: tuple, what: str) -> np.ndarray:
    if info.compress_type != zipfile.ZIP_STORED:
        raise InputError(f"{what} must not be compressed, got a compressed array")
    with archive.open(info) as member:
        if np.lib.format.read_magic(member) != (1, 0):
            raise InputError(f"{what} must have version 1.0 of the format of NumPy, got another version")
        stored_shape, _, stored = np.lib.format.read_array_header_1_0(member)
        fits = len(stored_shape) == len(shape) and all(n in (None, m) for n, m in zip(shape, stored_shape, strict=True))
        if not fits or stored != dtype:
            text = f"the shape {shape} and the type {dtype}".replace("None", "n")
            raise InputError(f"{what} must have {text}, got {stored_shape} and {stored}")
        size = member.tell() + dtype.itemsize * int(np.prod(stored_shape, dtype=object))
        if size != info.file_size:
            raise InputError(f"{what} must have {info.file_size} bytes in all, got the shape {stored_shape}")
    with archive.open(info) as member:
        return np.lib.format.read_array(member, allow_pickle=False)
