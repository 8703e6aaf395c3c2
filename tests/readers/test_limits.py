"""Small files that took minutes, or more memory than available. Each is refused in a short time."""

import bz2
import gzip
import lzma
import os
import subprocess
import sys
from pathlib import Path

import pytest
from astropy.io.fits import Header

import rfpsurvey as rs
from refusals import refusal, written
from rfpsurvey._common import read_documents as _limits

MOST_BYTES, MOST_SECONDS = 2 * 2**30, 10

CHILD = """
import resource, sys, time
from pathlib import Path
import rfpsurvey as rs
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
for path in sorted(Path(sys.argv[1]).iterdir()):
    start = time.process_time()
    try:
        text = repr((rs.Instrument if path.suffix == ".toml" else rs.Catalog).read(path))
    except rs.InputError as error:
        text = str(error).replace(str(path), "")
    grown = 1024 * (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
    print(path.name, time.process_time() - start, grown, text, sep="\\t", flush=True)
"""


def fits(*cards):
    primary = Header([("SIMPLE", True), ("BITPIX", 8), ("NAXIS", 0)])
    structure = [("XTENSION", "BINTABLE"), ("BITPIX", 8), ("NAXIS", 2), *cards, ("PCOUNT", 0), ("GCOUNT", 1)]
    return (primary.tostring() + Header(structure).tostring()).encode()


VOTABLE = """<?xml version="1.0"?><VOTABLE version="1.4"><RESOURCE><TABLE{}><FIELD name="ra" datatype="{}"{}/>
<DATA><TABLEDATA><TR><TD>1</TD></TR></TABLEDATA></DATA></TABLE></RESOURCE></VOTABLE>"""
ECSV, INTEGERS = "# %ECSV 1.0\n# ---\n# datatype:\n", "# - {name: a, datatype: int64}\n"
ALIASES = "".join(f"#   a{k}: &a{k} [{','.join([f'*a{k - 1}'] * 10)}]\n" for k in range(1, 12))
ENTITIES = "".join(f'<!ENTITY a{k} "{f"&a{k - 1};" * 10}">' for k in range(1, 12))
SHAPE = "# - {name: b, datatype: string, subtype: 'float64[1000,1000,1000]'}\n"
ZEROS = ("NAXIS1", 8), ("NAXIS2", 36_000_000), ("TFIELDS", 1), ("TFORM1", "D")
BOMBS = {
    "newlines.csv.gz": lambda: gzip.compress(b"id,ra,dec\n1,2,3\n" + b"\n" * 70_000_000, 1),
    "newlines.csv.bz2": lambda: bz2.compress(b"id,ra,dec\n1,2,3\n" + b"\n" * 70_000_000),
    "newlines.ecsv.xz": lambda: lzma.compress(b"# %ECSV 1.0\n" + b"\n" * 70_000_000, preset=0),
    "newlines.csv": lambda: b"id,ra,dec\n1,2,3\n" + b"\n" * 20_000_000,
    "comments.csv": lambda: b"id,ra,dec\n1,2,3\n" + b"#\n" * 1_100_000,
    "zeros.fits.gz": lambda: gzip.compress(fits(*ZEROS) + bytes(288_000_000), 1),
    "columns.csv": lambda: b",".join(b"a%d" % k for k in range(200_000)) + b"\n",
    "wide.csv": lambda: b"id,ra,dec\n" + b"x" * 2_000_000 + b",1,2\n" + b"a,1,2\n" * 1_000_000,
    "fields.fits": lambda: fits(("NAXIS1", 8), ("NAXIS2", 1), ("TFIELDS", 999999999)) + bytes(2880),
    "rows.fits": lambda: fits(("NAXIS1", 0), ("NAXIS2", 10**10), ("TFIELDS", 1), ("TFORM1", "0A")),
    "cards.fits": lambda: b"SIMPLE  =                    T".ljust(80) + b"COMMENT".ljust(80) * 300_000,
    "keys.toml": lambda: ".".join(["a"] * 50_000) + " = 1",
    "more_keys.toml": lambda: "\n".join(f"a.b{k}.c = 1" for k in range(60_000)),
    "large.toml": lambda: "# comment\n" * 200_000,
    "header.ecsv": lambda: ECSV + INTEGERS * 100_000 + "a\n",
    "laughs.ecsv": lambda: f"{ECSV}{INTEGERS}# meta:\n#   a0: &a0 [x]\n{ALIASES}a\n1\n",
    "shape.ecsv": lambda: f'{ECSV}{INTEGERS}{SHAPE}a b\n1 ""\n',
    "laughs.vot": lambda: f'<?xml version="1.0"?><!DOCTYPE V [<!ENTITY a0 "x">{ENTITIES}]><VOTABLE>&a11;</VOTABLE>',
    "arraysize.vot": lambda: VOTABLE.format("", "char", ' arraysize="100000000"'),
    "nrows.vot": lambda: VOTABLE.format(' nrows="3000000000"', "double", ""),
}


def test_small_files_take_little_time_and_memory(tmp_path):
    """Regression: 3 MB of compressed line breaks took 64 s and 6 GB, many columns 65 s and 11 GB, one key 59 s."""
    for name, make in BOMBS.items():
        written(tmp_path / name, make())
    command = [sys.executable, "-c", CHILD, str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=300)
    reports = [line.split("\t") for line in done.stdout.strip().split("\n")]
    assert [name for name, *_ in reports] == sorted(BOMBS)
    for name, seconds, n_bytes, text in reports:
        assert text.startswith(":"), name
        assert " must " in text, name
        assert float(seconds) < MOST_SECONDS, name
        assert float(n_bytes) < MOST_BYTES, name


def test_the_limits_leave_real_catalogs_alone(tmp_path, monkeypatch):
    """Random coordinates have a compression ratio of three. For small contents, the ratio is not limited."""
    path = written(tmp_path / "a.csv.gz", gzip.compress(b"id,ra,dec\n" + b"1,2,3\n" * 1_000_000))
    assert len(rs.Catalog.read(path)) == 1_000_000
    monkeypatch.setattr(_limits, "FREE", 1_000_000)
    assert "must have at most 1000000 bytes (100 times the size of the file" in refusal(path)


@pytest.mark.parametrize("compress", [gzip.compress, bz2.compress, lzma.compress])
def test_compressed_files_that_are_cut_off(tmp_path, compress):
    content = compress(b"id,ra,dec\n" + b"1,2,3\n" * 1000)
    path = written(tmp_path / "a.csv.gz", content)
    assert len(rs.Catalog.read(path)) == 1000
    for part in (content[:-9], content[: len(content) // 2], content[:20]):
        assert "cannot be read" in refusal(written(path, part))


def test_an_exception_without_a_message_is_named_by_its_type():
    errors = MemoryError(), KeyError("a"), ValueError("a\nb")
    assert [_limits.sentence(error) for error in errors] == ["MemoryError", "KeyError: 'a'", "a"]


@pytest.mark.parametrize("digits", [310, 5000])
def test_integers_of_hundreds_of_digits_in_descriptions_are_refused(tmp_path, digits):
    """Such integers caused an OverflowError or a ValueError of Python."""
    path = tmp_path / "mine.toml"
    for text in (f'name = "a"\n[layout]\nrings = {{ value = {"9" * digits} }}\n', f"site = [{'9' * digits}, 0, 0]\n"):
        for read in (rs.Instrument.read, rs.ObservingConditions.read):
            found = refusal(written(path, text), read)
            assert "integers must be from -1.072e+301" in found or "Exceeds the limit" in found
            assert len(found) < 300


ENDLESS = "a pipe or a device"
NOT_REGULAR = (
    (getattr(os, "mkfifo", None), ENDLESS),
    (lambda path: path.symlink_to("/dev/zero"), ENDLESS),
    (lambda path: path.symlink_to(path.name), "link"),
    (Path.mkdir, "folder"),
)
needs_pipes = pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs named pipes")


@needs_pipes
@pytest.mark.parametrize("read", [rs.Catalog.read, rs.Tiling.read, rs.Instrument.read, rs.ObservingConditions.read])
def test_files_without_an_end_are_refused(tmp_path, read):
    """A named pipe or a device stopped the program, because it has no end."""
    for k, (make, words) in enumerate(NOT_REGULAR):
        make(tmp_path / f"{k}.csv")
        assert words in refusal(tmp_path / f"{k}.csv", read)


@needs_pipes
def test_folders_with_files_without_an_end_are_refused(tmp_path):
    for name in ("positionerTable.csv", "desi-focalplane_2020-01-01.ecsv", "black_dots_mm.csv"):
        folder = tmp_path / name
        folder.mkdir()
        os.mkfifo(folder / name)
        with pytest.raises(rs.InputError, match=ENDLESS):
            rs.Instrument.read(folder)


def test_files_that_must_not_be_read_are_refused(tmp_path, monkeypatch):
    path = written(tmp_path / "a.csv", "ra,dec\n1,2\n")

    def refuse(*_, **__):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "open", refuse)
    for read in (rs.Catalog.read, rs.Instrument.read, rs.ObservingConditions.read):
        assert refusal(path, read) == " cannot be read: Permission denied"
