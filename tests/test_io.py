"""Files are written completely or not at all, are safe from other users, and are not replaced by default; locks."""

import io
import multiprocessing
import os
import stat
from concurrent.futures import ThreadPoolExecutor

import astropy.units as u
import numpy as np
import pytest
from astropy.io import fits
from astropy.table import QTable

import rfpsurvey as rs
from processes import lock_and_wait
from rfpsurvey._common import io as _io
from rfpsurvey._common.folder import RequestFolder, check_file, locked, read_index, read_verified
from rfpsurvey._common.read_tables import read_table
from rfpsurvey.errors import InputError

N_THREADS, N_WRITES = 6, 60


def table(k):
    return QTable({"a": np.full(2000, k), "b": np.arange(2000.0) * u.deg}, meta={"k": k})


@pytest.mark.few(1)
@pytest.mark.parametrize("name", ["tile.fits", "tile.ecsv", "tile.ecsv.gz"])
def test_threads_that_write_to_one_path_leave_one_whole_file(tmp_path, name):
    """Regression: names of temporary files depended only on the process, so that threads wrote into the same file."""
    path = tmp_path / name
    with ThreadPoolExecutor(N_THREADS) as pool:
        list(pool.map(lambda k: _io.write_table(table(k), path, overwrite=True), range(N_WRITES)))
    found = read_table(path)
    assert found.meta["k"] in range(N_WRITES)
    assert (found["a"] == found.meta["k"]).all()
    assert os.listdir(tmp_path) == [name]


def no_link(*_):
    raise OSError("the file system has no hard links")


@pytest.mark.parametrize("has_links", [True, False])
def test_of_threads_that_must_not_overwrite_one_writes(tmp_path, monkeypatch, has_links):
    """On file systems without hard links, the last thread replaced the file of the first thread."""
    if not has_links:
        monkeypatch.setattr(os, "link", no_link)

    def write(k):
        try:
            _io.write_table(table(k), tmp_path / "tile.fits")
        except rs.InputError as error:
            return str(error)
        return k

    with ThreadPoolExecutor(N_THREADS) as pool:
        said = list(pool.map(write, range(N_WRITES)))
    (winner,) = (one for one in said if isinstance(one, int))
    assert read_table(tmp_path / "tile.fits").meta["k"] == winner
    assert all("exists; to replace it, use overwrite=True" in one for one in said if one != winner)


def test_a_file_that_appears_meanwhile_is_not_overwritten(tmp_path):
    path = tmp_path / "page.npz"

    def write():
        with _io.writing_to(path, (".npz",)) as temporary:
            temporary.write_text("new")
            path.write_text("of somebody else")

    with pytest.raises(rs.InputError, match="exists"):
        write()
    assert path.read_text() == "of somebody else"


def test_disks_without_hard_links_do(tmp_path, monkeypatch):
    def refuse(*_):
        raise PermissionError

    monkeypatch.setattr(os, "link", refuse)
    _io.write_table(table(1), tmp_path / "tile.fits")
    assert os.listdir(tmp_path) == ["tile.fits"]


def test_links_under_names_that_could_be_guessed_are_not_followed(tmp_path):
    """Regression: a link with the predictable name of the temporary file redirected the output."""
    victim = tmp_path / "victim"
    victim.write_text("mine")
    for name in (f".{os.getpid()}-tile.ecsv", "tile.ecsv"):
        (tmp_path / name).symlink_to(victim)
    _io.write_table(table(1), tmp_path / "tile.ecsv", overwrite=True)
    assert victim.read_text() == "mine"
    assert not (tmp_path / "tile.ecsv").is_symlink()


def test_temporary_names_are_random_and_closed_to_others(tmp_path):
    names = set()
    for _ in range(20):
        with _io.writing_to(tmp_path / "a.npz", (".npz",), overwrite=True) as temporary:
            assert stat.S_IMODE(temporary.parent.stat().st_mode) == 0o700
            names.add(temporary.parent.name)
            temporary.write_text("x")
    assert len(names) == 20
    # the umask determines who may read the file
    plain = tmp_path / "plain"
    plain.write_text("x")
    assert (tmp_path / "a.npz").stat().st_mode == plain.stat().st_mode
    assert sorted(os.listdir(tmp_path)) == ["a.npz", "plain"]


def test_parts_of_surveys_are_valid_fits_files():
    columns = {"id": np.arange(3), "name": np.array(["a", "bc", "d"]), "flag": np.ones(3, dtype=bool)}
    content = _io.fits_bytes(columns, {"TILE": "t1", "RA": 1.5, "NREACH": (7, "in reach"), "TUNIT1": "deg"})
    with fits.open(io.BytesIO(content)) as units:
        units.verify("exception")
        header, table = units[1].header, units[1].data
        assert (header["TILE"], header["RA"], header["NREACH"], header["TUNIT1"]) == ("t1", 1.5, 7, "deg")
        assert (header.comments["NREACH"], table["id"].tolist()) == ("in reach", [0, 1, 2])
        assert table["name"].tolist() == ["a", "bc", "d"]
        assert table["flag"].all()
    assert len(content) % 2880 == 0


class Work(RequestFolder):
    request_name, work, parts = "work.json", "work", "parts"


def test_a_locked_output_is_refused_in_other_processes(tmp_path):
    context = multiprocessing.get_context("spawn")
    begun, end = context.Event(), context.Event()
    process = context.Process(target=lock_and_wait, args=(tmp_path / "a.fits", begun, end))
    process.start()
    try:
        assert begun.wait(60)
        with locked(tmp_path / "b.fits"):
            pass
        with pytest.raises(InputError, match=r"a\.fits: another run uses this file; wait until it ends, or give"):
            locked(tmp_path / "a.fits").__enter__()
    finally:
        end.set()
        process.join()
    with locked(tmp_path / "a.fits"), pytest.raises(InputError, match="another run"):
        locked(tmp_path / "a.fits").__enter__()
    assert list(tmp_path.iterdir()) == []


class StopError(Exception):
    pass


@pytest.mark.parametrize("n_written", [0, 1])
def test_a_run_that_ends_while_a_file_is_replaced_leaves_a_valid_file(tmp_path, monkeypatch, n_written):
    """A checkpoint counted as damaged if the run ended between the renaming of the new file and its line."""
    with Work(tmp_path / "work", {}, resume=False) as folder:
        folder.put("state.npz", b"old")

        def stop(path, content):
            if n_written:
                path.write_bytes(content)
            raise StopError

        monkeypatch.setattr("rfpsurvey._common.folder.write_bytes", stop)
        with pytest.raises(StopError):
            folder.put("state.npz", b"new")
        monkeypatch.undo()
    for _ in range(2):
        with Work(tmp_path / "work", {}, resume=True) as folder:
            content = read_verified(folder.path, "state.npz", folder._known)
            assert content == (b"new" if n_written else b"old")
    with Work(tmp_path / "work", {}, resume=True) as folder:
        folder.put("state.npz", b"last")
        with folder.writing("block-0001.npz") as temporary:
            temporary.write_bytes(b"block")
        folder.finish()
    known = read_index(tmp_path / "work")
    assert {name: len(entries) for name, entries in known.items()} == {"block-0001.npz": 1, "state.npz": 1}
    check_file(tmp_path / "work", "block-0001.npz", known)
    (tmp_path / "work" / "block-0001.npz").write_bytes(b"black")
    with pytest.raises(InputError, match=r"block-0001\.npz is damaged"):
        check_file(tmp_path / "work", "block-0001.npz", known)


def test_a_file_that_was_not_written_completely_has_no_line(tmp_path):
    with Work(tmp_path / "work", {}, resume=False) as folder:
        writing = folder.writing("block.npz")
        writing.__enter__().write_bytes(b"half")
        assert not writing.__exit__(StopError, StopError(), None)
        assert read_index(folder.path) == {}
        assert not (folder.path / "block.npz").exists()
