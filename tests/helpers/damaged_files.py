"""Ways to damage valid files, and checks of the outcome of reading them.

For any damage, a reader must return all rows or raise an InputError. It must not raise other errors, issue warnings of
other packages, or return fewer rows without a warning.
"""

import bz2
import gzip
import io
import lzma
import os
import re
import shutil
import warnings
import zipfile
import zlib
from functools import cache
from pathlib import Path

import numpy as np

import rfpsurvey as rs
from valid_files import Sample

NUMBER = re.compile(rb"\d+(?:\.\d+)?(?:[eE][+-]?\d+)?")
HUGE = (
    *(b"999999999", b"-1", b"0", b"1e400", b"99999999999999999999", b"2147483648", b"NaN", b"1000000"),
    *(b"9" * 400, b"-" + b"9" * 400, b"7" * 5000, b"0." + b"3" * 400, b"inf", b"-inf", b"1e308", b"5e-324", b"1e-400"),
    *(b"9223372036854775807", b"-9223372036854775808", b"18446744073709551616", b"true", b"''"),
)
TOKENS = (
    b'"',
    b"\0",
    b"\n",
    b"\r",
    b",",
    b"#",
    b"\xff",
    b"\xe9",
    b"<",
    b">",
    b"&",
    b"'",
    b"[",
    b"]",
    b"{",
    b"=",
    b"END",
    b"\xff\xfe",
    b"\xc3\x28",
    b"\xef\xbb\xbf",
    b"[" * 3000,
    b"{a=" * 3000,
    b"a." * 3000,
    b"<a>" * 3000,
)


def _some(rng, n, most=64):
    begin = int(rng.integers(n + 1))
    return begin, min(begin + 1 + int(rng.integers(most)), n)


def flip(rng, b):
    b = bytearray(b)
    for _ in range(1 + int(rng.integers(8)) if b else 0):
        b[int(rng.integers(len(b)))] ^= 1 << int(rng.integers(8))
    return bytes(b)


def truncate(rng, b):
    return b[: int(rng.integers(len(b) + 1))]


def cut_the_end(rng, b):
    return b[: -1 - int(rng.integers(min(len(b), 100)))] if b else b


def remove(rng, b):
    begin, end = _some(rng, len(b))
    return b[:begin] + b[end:]


def duplicate(rng, b):
    begin, end = _some(rng, len(b), 4096)
    return b[:end] + b[begin:]


def insert(rng, b):
    where = int(rng.integers(len(b) + 1))
    return b[:where] + TOKENS[int(rng.integers(len(TOKENS)))] * (1 + int(rng.integers(2))) + b[where:]


def insert_noise(rng, b):
    where = int(rng.integers(len(b) + 1))
    return b[:where] + rng.bytes(1 + int(rng.integers(40))) + b[where:]


def blank(rng, b):
    begin, end = _some(rng, len(b), 3000)
    return b[:begin] + (b"\0" if rng.integers(2) else b" ") * (end - begin) + b[end:]


def _lines(rng, b, change):
    lines = b.split(b"\n")
    change(lines, *(int(rng.integers(len(lines))) for _ in range(2)))
    return b"\n".join(lines)


def swap_lines(rng, b):
    def change(lines, one, other):
        lines[one], lines[other] = lines[other], lines[one]

    return _lines(rng, b, change)


def drop_line(rng, b):
    return _lines(rng, b, lambda lines, one, _: lines.pop(one))


def double_line(rng, b):
    return _lines(rng, b, lambda lines, one, other: lines.insert(other, lines[one]))


def change_number(rng, b):
    found = list(NUMBER.finditer(b))
    if not found:
        return b
    match = found[int(rng.integers(len(found)))]
    other = HUGE[int(rng.integers(len(HUGE)))] if rng.integers(2) else str(int(rng.integers(1000))).encode()
    return b[: match.start()] + other + b[match.end() :]


def change_card(rng, b):
    """Change a card of a FITS header; change a number in other files."""
    cards = [k for k in range(0, min(len(b), 40_000), 80) if b[k + 8 : k + 10] == b"= "]
    if not cards:
        return change_number(rng, b)
    k = cards[int(rng.integers(len(cards)))]
    values = (*HUGE, b"'", b"'X'", b"T", b"", b"'999999999D'", b"'1PD(999999999)'", b"'(9999,9999)'", b"1", b"12")
    return b[: k + 10] + values[int(rng.integers(len(values)))].rjust(20).ljust(70)[:70] + b[k + 80 :]


def change_word(rng, b):
    found = list(re.finditer(rb"[A-Za-z_]{3,}", b))
    if not found:
        return b
    one, other = (found[int(rng.integers(len(found)))] for _ in range(2))
    return b[: one.start()] + other[0] + b[one.end() :]


def encode(rng, b):
    try:
        return b.decode("utf-8").encode(("utf-16", "utf-32", "utf-16-le", "utf-8-sig", "cp037")[int(rng.integers(5))])
    except UnicodeError:
        return b[::-1]


def compress(rng, b):
    return (gzip.compress, bz2.compress, lzma.compress, lambda b: gzip.compress(gzip.compress(b)))[
        int(rng.integers(4))
    ](b)


def change_archive(rng, b):
    """Change a member of a NumPy archive."""
    try:
        with zipfile.ZipFile(io.BytesIO(b)) as archive:
            members = {name: archive.read(name) for name in archive.namelist()}
        name = sorted(members)[int(rng.integers(len(members)))]
        values = np.lib.format.read_array(io.BytesIO(members[name]))
    except Exception:  # the archive is already damaged
        return b
    kind = ("huge", "objects", "type", "shape", "text", "bomb", "no member", "other member", "not finite")[
        int(rng.integers(9))
    ]
    changed = io.BytesIO()
    if kind == "huge":
        shape = (int(rng.choice([2**31, 2**40, 2**62])), *values.shape[1:])
        np.lib.format.write_array_header_1_0(changed, {"descr": "<f8", "fortran_order": False, "shape": shape})
    elif kind == "objects":
        np.save(changed, np.array([{"a": 1}, None], dtype=object), allow_pickle=True)
    elif kind == "type":
        types = ("f4", "i1", "c16", "S3", "M8[s]", "?", "u8", [("a", "f8"), ("b", "i4")])
        np.save(changed, np.zeros(values.shape, types[int(rng.integers(len(types)))]))
    elif kind == "shape":
        np.save(
            changed,
            (values[:-1], values[None], np.zeros(()), values[..., None], np.zeros((0,)))[int(rng.integers(5))]
            if values.ndim
            else values[None],
        )
    elif kind == "not finite" and values.size:
        other = (np.nan, np.inf, -1, 2**62, 255, 0)[int(rng.integers(6))]
        values = values.astype(float if not np.isfinite(other) else np.int64)
        values.flat[int(rng.integers(values.size))] = other
        np.save(changed, values)
    elif kind == "text":
        changed.write(b"not an array")
    members[name] = changed.getvalue()
    if kind == "no member":
        del members[name]
    elif kind == "other member":
        members["other.npy"] = members.pop(name)
    found = io.BytesIO()
    with zipfile.ZipFile(found, "w") as archive:
        for one, content in members.items():
            archive.writestr(one, content)
    return _bomb(name) if kind == "bomb" else found.getvalue()


@cache
def _bomb(name: str, n: int = 3 * 2**30) -> bytes:
    """Return an archive of a few MB with an array of n bytes, all of them zero.

    All blocks of zeros have the same compressed form, so that only one of them is compressed. The checksum of the array
    is wrong, but a reader compares it only after it has decompressed all bytes.
    """
    packer, header, found = zlib.compressobj(1, wbits=-zlib.MAX_WBITS), io.BytesIO(), io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "|u1", "fortran_order": False, "shape": (n,)})
    parts = [packer.compress(block) + packer.flush(zlib.Z_FULL_FLUSH) for block in (header.getvalue(), bytes(1 << 24))]
    with zipfile.ZipFile(found, "w") as archive:
        archive.writestr(name, parts[0] + parts[1] * (n >> 24) + packer.flush())
        info = archive.getinfo(name)
        info.compress_type, info.file_size = zipfile.ZIP_DEFLATED, len(header.getvalue()) + n
    return found.getvalue()


def replace_file(rng, path: Path) -> str:
    """Replace a file by something else that has its name, and return a description."""
    kinds = (
        "nothing",
        "folder",
        "loop of links",
        "link to nothing",
        "pipe",
        "link to /dev/zero",
        "empty",
        "link to a folder",
    )
    kind = kinds[int(rng.integers(len(kinds)))]
    path.unlink()
    if kind == "folder":
        path.mkdir()
    elif kind == "loop of links":
        path.symlink_to(path.name)
    elif kind == "link to nothing":
        path.symlink_to("no-such-file")
    elif kind == "pipe":
        os.mkfifo(path)
    elif kind == "link to /dev/zero":
        path.symlink_to("/dev/zero")
    elif kind == "link to a folder":
        path.symlink_to("/")
    elif kind == "empty":
        path.touch()
    return kind


MUTATORS = (
    flip,
    flip,
    truncate,
    cut_the_end,
    remove,
    duplicate,
    insert,
    insert,
    insert_noise,
    blank,
    swap_lines,
    drop_line,
    double_line,
    change_number,
    change_number,
    change_card,
    change_card,
    change_word,
    encode,
    compress,
)


def damage(rng: np.random.Generator, sample: Sample, folder: Path) -> tuple[Path, str]:
    """Write a damaged copy into a folder, and return its path and a description of the damage."""
    path = folder / sample.path.name
    if sample.pieces:
        shutil.copytree(sample.path, path)
        piece = path / sample.pieces[int(rng.integers(len(sample.pieces)))]
    else:
        piece = path
        shutil.copy(sample.path, path)
    if rng.integers(12) == 0:
        return path, f"{piece.name}: {replace_file(rng, piece)}"
    before = piece.read_bytes()
    inside = piece.suffix == ".gz" and rng.integers(2)
    after = gzip.decompress(before) if inside else before
    done = []
    for _ in range(1 if rng.integers(3) else 2):
        archive = after.startswith(b"PK") and rng.integers(2)
        mutator = change_archive if archive else MUTATORS[int(rng.integers(len(MUTATORS)))]
        after = mutator(rng, after)
        done.append(mutator.__name__)
    piece.write_bytes(gzip.compress(after, mtime=0) if inside else after)
    if sample.pieces and rng.integers(4):
        sample.repair(path)
    return path, f"{piece.name}: {', '.join(done)}"


def outcome(sample: Sample, path: Path) -> tuple[str, str]:
    """Read a damaged file, and return the outcome as a word and a detail."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            n = sample.read(path)
        except rs.InputError as error:
            cause = error
            while cause is not None:
                if isinstance(cause, MemoryError):
                    return "too large", str(error)
                cause = cause.__cause__
            text = str(error)
            if "\n" in text or len(text) > 1000 + 3 * len(str(path)):
                return "long sentence", text[:300]
            return "refused", text
        except Exception as error:
            return "traceback", f"{type(error).__name__}: {error}"
    strange = [w for w in caught if not issubclass(w.category, rs.RfpsurveyWarning)]
    if strange:
        return "foreign warning", f"{strange[0].category.__name__}: {strange[0].message}"
    try:
        expected = sample.count(path)
    except Exception as error:
        return "row loss", f"{n} rows were read, and cannot be counted otherwise: {type(error).__name__}: {error}"
    told = any("rows" in str(w.message) or "tables" in str(w.message) for w in caught)
    # if the stated number of rows includes padding of FITS, the additional rows are zeros, and no rows are lost
    if expected is not None and (n < expected or (n > expected and sample.format != "survey")) and not told:
        return "row loss", f"{n} rows of {expected}"
    return "read", ""


FINE = ("read", "refused")
