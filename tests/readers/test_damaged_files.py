"""Damaged files of every format are read with all rows, or are refused with a sentence."""

import warnings

import astropy.units as u
import numpy as np
import pytest
from astropy.table import QTable

import rfpsurvey as rs
from damaged_files import FINE, damage, outcome
from refusals import refusal, written
from valid_files import samples
from valid_inputs import inputs
from valid_plans import plan_samples

N_EACH = 10
SLOW, OF_SLOW = ("DESI", "PFS", "selection folder", "survey folder"), (0, 3, 6)
"""Formats of folders that take ten times as long as other files, and seeds of the damages to these folders."""


@pytest.fixture(scope="module")
def valid(tmp_path_factory):
    folder = tmp_path_factory.mktemp("valid")
    return samples(folder) + inputs(folder)


def test_valid_files_are_read(valid):
    for sample in valid:
        assert outcome(sample, sample.path) == ("read", ""), sample.path.name


@pytest.mark.few(1)
@pytest.mark.parametrize("seed", range(N_EACH))
def test_damaged_files_are_refused_or_read_whole(valid, tmp_path, seed):
    """``python tests/benchmarks/fuzz_readers.py`` tests more files, each in a separate process."""
    for number, sample in enumerate(valid):
        if sample.format in SLOW and seed not in OF_SLOW:
            continue
        folder = tmp_path / str(number)
        folder.mkdir()
        path, done = damage(np.random.default_rng([99, seed, number]), sample, folder)
        what, text = outcome(sample, path)
        assert what in FINE, f"{sample.path.name} ({done}): {what}: {text}"


def moved(content, place):
    """Yield copies of a content with bytes inserted at a place, or without bytes from this place."""
    for inserted, removed in ((b"\r", 0), (b"\0\0", 0), (b"", 2), (b"", 1), (b"7", 0)):
        yield content[:place] + inserted + content[place + removed :]


@pytest.mark.filterwarnings("ignore:.*multiple of 2880 bytes")  # a warning, which is an error in tests, is no refusal
def test_plans_with_inserted_or_lost_bytes_are_refused(tmp_path):
    """Rows behind a byte that was inserted into a FITS file had other numbers, and were read without a message."""
    samples, damaged = [one for one in plan_samples(tmp_path) if one.path.suffix == ".fits"], tmp_path / "damaged.fits"
    assert {one.format for one in samples} == {"fiberassign", "pfsDesign", "tile plan"}
    for sample in samples:
        content = sample.path.read_bytes()
        start = content.find(b"XTENSION") + 2880
        for place in np.random.default_rng(len(content)).integers(start, len(content) - 2880, 4).tolist():
            for part in moved(content, place):
                assert "must be a plan in one of" not in refusal(written(damaged, part), rs.plans.read_plan)
                if sample.format == "tile plan":
                    assert refusal(damaged, rs.Tile.read)


def caught(read, path):
    """Return what a function reads from a file, or None if it refuses the file; and the texts of all warnings."""
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        try:
            return read(path), [str(one.message) for one in found]
        except rs.InputError:
            return None, []


def table_of(**columns):
    n = len(next(iter(columns.values())))
    return QTable({"ra": np.linspace(94, 96, n) * u.deg, "dec": np.linspace(22, 24, n) * u.deg, **columns})


def test_catalogs_in_fits_with_inserted_bytes_are_refused_or_named(tmp_path):
    """Non-zero bytes after the rows of a table were accepted if they were fewer than a row."""
    path, damaged, n = tmp_path / "catalog.fits", tmp_path / "damaged.fits", 100
    table = table_of(priority=np.arange(n) + 0.3)
    table.write(path)
    content = path.read_bytes()
    assert len(content) % 2880 == 0
    for part in moved(content, 2 * 2880 + 100):
        damaged.write_bytes(part)
        with pytest.raises(rs.InputError, match=r"must be zero|must be a multiple|cut off|begin with XTENSION"):
            rs.Tiling.read(damaged)
        catalog, texts = caught(rs.Catalog.read, damaged)
        assert catalog is None or any("multiple of 2880" in text for text in texts)
    damaged.write_bytes(content[: 2880 * 2 + 24 * n])  # only the padding is missing
    with pytest.warns(rs.RfpsurveyWarning, match=r"multiple of 2880 bytes, got 8160; only padding"):
        assert rs.Catalog.read(damaged).priority.tolist() == table["priority"].tolist()
    assert "multiple of 2880 bytes, got 8160: the file is damaged" in refusal(damaged, rs.Tiling.read)


@pytest.mark.parametrize("size", [1, 9, 2879])
def test_catalogs_that_are_larger_than_their_headers_state_are_refused(tmp_path, size):
    """If the padding was longer than the inserted bytes, a warning stated that only padding is missing."""
    path, n = tmp_path / "catalog.fits", 120
    table_of(priority=np.zeros(n)).write(path)
    content, place = path.read_bytes(), 2 * 2880 + 24 * (n - 1) + 16
    path.write_bytes(content[:place] + bytes(size) + content[place:])
    text = f"must have {len(content)} bytes, as its headers state, got {len(content) + size}, which is not"
    assert text in refusal(path)


READERS = {
    "catalog.ecsv": lambda path: rs.Catalog.read(path).priority,
    "tiles.ecsv": lambda path: np.asarray(rs.Tiling.read(path).table["pass"]),
    "own.toml": lambda path: np.array([rs.ObservingConditions.read(path).humidity]),
}


@pytest.mark.parametrize("name", READERS)
def test_text_that_ends_within_a_value_is_refused_or_named(tmp_path, name):
    """A priority of 1061.25 was read as 106 if the file ended there, without a message."""
    path, cut, number = tmp_path / name, tmp_path / f"cut_{name}", np.arange(20)
    if name == "catalog.ecsv":
        table_of(priority=1000 + 1.25 * number).write(path)
    elif name == "tiles.ecsv":
        rs.Tiling.from_table(table_of(**{"pass": 10 + number})).write(path)
    else:
        path.write_text('site = "paranal"\nhour_angle = "1 h"\nhumidity = 0.425\n')
    content, whole = path.read_bytes(), READERS[name](path)
    for removed in range(1, 60 if name.endswith("ecsv") else 6):
        values, texts = caught(READERS[name], written(cut, content[:-removed]))
        same = values is None or np.array_equal(values, whole[: len(values)])
        assert same or any("the last line must end with a line break" in text for text in texts), removed
