"""Find and read the files of the catalogs that come with the package."""

import bz2
import json
import lzma
import os
from pathlib import Path

import numpy as np
from astropy.table import QTable

from rfpsurvey._common import read_tables
from rfpsurvey.errors import InputError, check_choice


def unpack(packed: bytes) -> str:
    """Convert the bytes of a packed catalog to the text of an ECSV file."""
    blocks, at = [], 0
    while at < len(packed):
        size = int.from_bytes(packed[at : at + 4], "big")
        block = packed[at + 4 : at + 4 + size]
        blocks.append((bz2 if block.startswith(b"BZh") else lzma).decompress(block))
        at += 4 + size
    header = json.loads(blocks[0])
    rows = header["rows"]
    integers = []
    for block, low, width in zip(blocks[1:], header["low"], header["width"], strict=True):
        padded = np.zeros((rows, 8), dtype=np.uint8)
        padded[:, 8 - width :] = np.frombuffer(block, dtype=np.uint8).reshape(width, rows).T
        integers.append(padded.view(">u8").ravel().astype(np.int64) + low)
    columns = []
    for number, is_sorted in header["columns"]:
        if number < 0:
            parts = [integers.pop(0).tolist() for _ in range(-number)]
            columns.append(["-".join(map(str, row)) for row in zip(*parts, strict=True)])
        else:
            values = integers.pop(0)
            values = np.cumsum(values) if is_sorted else values
            columns.append([repr(value / 10**number) for value in values.tolist()])
    lines = map(",".join, zip(*columns, strict=True))
    return "\n".join([header["header"], *lines]) + "\n"


PREFIX = "example:"
EXAMPLES = {"anticenter": "tycho2_anticenter_r5.ecsv"}
# The first folder is in the wheel, where data/wheel.py writes it. The second folder is in the source tree.
_PLACES = ((Path(__file__).parent / "examples", ".packed"), (Path(__file__).parents[2] / "data", ".gz"))


def is_example(path: object) -> bool:
    """Return whether ``path`` is the name of an example catalog, such as "example:anticenter"."""
    return isinstance(path, str | os.PathLike) and os.fspath(path)[: len(PREFIX)] == PREFIX


def path_and_name(path: str | os.PathLike) -> tuple[Path, str]:
    """Return the path of a file or of an example catalog, and the name that results record in their provenance."""
    if not is_example(path):
        path = read_tables.to_path(path)
        return path, path.name
    name = os.fspath(path)
    file = EXAMPLES[check_choice(name.removeprefix(PREFIX), EXAMPLES, "example catalog")]
    paths = [folder / f"{file}{ending}" for folder, ending in _PLACES]
    example = next((path for path in paths if path.exists()), None)
    if example is None:
        raise InputError(f"the installation must contain {paths[0]}, but the file is missing: install rfpsurvey again")
    return example, name


def read_table(path: Path, hdu: int | str | None = None) -> QTable:
    """Read the table of a catalog from a file, which may be a compressed example catalog (``.packed``)."""
    if path.suffix != ".packed":
        return read_tables.read_table(
            path, hdu, "; to read another table, give hdu= or --set catalog.hdu=NAME", padded=False
        )
    if hdu is not None:
        raise InputError(f"hdu must be used only with FITS files, got {hdu!r} for an example catalog")
    return QTable.read(unpack(path.read_bytes()).splitlines(), format="ascii.ecsv")
