"""Read the packed catalogs that wheels of the package contain; ``data/wheel.py`` writes and describes this format."""

import bz2
import json
import lzma

import numpy as np


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
