"""Read NumPy archives whose arrays have known types and shapes, and use no more memory than the size of the file."""

import zipfile
from typing import BinaryIO

import numpy as np

from rfpsurvey._readers._limits import reading
from rfpsurvey.errors import InputError


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
        found = {}
        for key, (dtype, shape) in expected.items():
            name = key.removesuffix("?")
            if name in stored:
                found[name] = _read_array(archive, stored[name], np.dtype(dtype), shape, f"{what}: array {name!r}")
            elif name == key:
                raise InputError(f"{what}: the archive must contain the array {name!r}, got none")
    return found


def _read_array(archive, info, dtype: np.dtype, shape: tuple, what: str) -> np.ndarray:
    if info.compress_type != zipfile.ZIP_STORED:
        raise InputError(f"{what} must not be compressed, got a compressed array")
    with archive.open(info) as member:
        if np.lib.format.read_magic(member) != (1, 0):
            raise InputError(f"{what} must have version 1.0 of the format of NumPy, got another version")
        own, _, stored = np.lib.format.read_array_header_1_0(member)
        fits = len(own) == len(shape) and all(n in (None, m) for n, m in zip(shape, own, strict=True))
        if not fits or stored != dtype:
            text = f"the shape {shape} and the type {dtype}".replace("None", "n")
            raise InputError(f"{what} must have {text}, got {own} and {stored}")
        size = member.tell() + dtype.itemsize * int(np.prod(own, dtype=object))
        if size != info.file_size:
            raise InputError(f"{what} must have {info.file_size} bytes in all, got the shape {own}")
    with archive.open(info) as member:
        return np.lib.format.read_array(member, allow_pickle=False)
