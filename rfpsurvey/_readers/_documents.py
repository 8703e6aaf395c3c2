"""Read TOML and JSON documents of limited size and depth, and archives of arrays."""

import json
import re
import zipfile
from pathlib import Path
from typing import BinaryIO

import numpy as np

from rfpsurvey._readers._limits import content_of, reading, sentence, warn_of_open_end
from rfpsurvey.errors import InputError, short

MOST_TOML, MOST_JSON = 2**20, 2**24
MOST_DEPTH, MOST_VALUES = 32, 100_000
# Integers in TOML have 64 bits. Larger integers in other documents can be seeds, but must be representable as floats.
MOST_TOML_INTEGER, MOST_INTEGER = 2**63 - 1, 2**1000
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
    check_size(values, path, most_integer=MOST_TOML_INTEGER)
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


def check_size(
    content: object, what: object, *, most_values: int = MOST_VALUES, most_integer: int = MOST_INTEGER
) -> None:
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
        wide = next((child for child in inner if isinstance(child, int) and abs(child) > most_integer), None)
        if wide is not None:
            raise InputError(
                f"{what}: integers must be from {-most_integer:.4g} to {most_integer:.4g}, got {short(wide)}"
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
