"""The build step that adds the catalog of ``rfpsurvey.example_catalog`` to the wheel; pyproject.toml refers to it.

The ECSV text of a catalog is divided into blocks. Each block is compressed by bzip2 or LZMA, whichever gives the
smaller result, and preceded by its size. The first block describes the others. Each other block is a column of whole
numbers, stored as bytes: all most significant bytes, then all bytes of the next lower significance, and so on.
``rfpsurvey/_sky/catalog_files.py`` restores the text.
"""

import bz2
import gzip
import json
import lzma
from itertools import pairwise
from pathlib import Path

from setuptools.command.build_py import build_py

DATA = Path(__file__).parent
EXAMPLES = {"tycho2_anticenter_r5.ecsv.gz": {"ra": 8, "dec": 8, "pmra": 1, "pmdec": 1, "bt_mag": 3, "vt_mag": 3}}
"""Number of decimals of each column of numbers, for each file; all other columns are whole numbers with hyphens."""


def pack(text: str, decimals: dict[str, int]) -> bytes:
    """Return an ECSV text with commas between its values in packed form."""
    lines = text.splitlines()
    first = next(k for k, line in enumerate(lines) if not line.startswith("#")) + 1
    columns = zip(*(line.split(",") for line in lines[first:]), strict=True)
    integers, described = [], []
    for name, values in zip(lines[first - 1].split(","), columns, strict=True):
        if name in decimals:
            scaled = [round(float(value) * 10 ** decimals[name]) for value in values]
            is_sorted = all(a <= b for a, b in pairwise(scaled))
            integers.append([b - a for a, b in pairwise([0, *scaled])] if is_sorted else scaled)
            described.append([decimals[name], is_sorted])
        else:
            integers += list(zip(*(map(int, value.split("-")) for value in values), strict=True))
            described.append([-len(values[0].split("-")), False])
    low = [min(column) for column in integers]
    width = [((max(column) - least).bit_length() + 7) // 8 for column, least in zip(integers, low, strict=True)]
    header = {"header": "\n".join(lines[:first]), "rows": len(lines) - first, "columns": described}
    blocks = [json.dumps({**header, "low": low, "width": width}).encode()]
    for column, least, size in zip(integers, low, width, strict=True):
        blocks.append(b"".join(bytes((v - least) >> 8 * k & 255 for v in column) for k in reversed(range(size))))
    packed = [min(bz2.compress(block), lzma.compress(block, preset=9), key=len) for block in blocks]
    return b"".join(len(block).to_bytes(4, "big") + block for block in packed)


class BuildWithExamples(build_py):
    """Copy examples from ``data/`` in packed form; their files are smaller than those of gzip by a third."""

    def run(self) -> None:
        """Run the build. An editable installation reads ``data/`` directly."""
        super().run()
        if not self.editable_mode:
            folder = Path(self.build_lib) / "rfpsurvey" / "_sky" / "examples"
            self.mkpath(str(folder))
            for name, decimals in EXAMPLES.items():
                text = gzip.decompress((DATA / name).read_bytes()).decode()
                (folder / name).with_suffix(".packed").write_bytes(pack(text, decimals))
