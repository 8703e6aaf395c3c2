"""Locks of outputs, and folders with an index of checksums."""

import multiprocessing

import pytest

from processes import lock_and_wait
from rfpsurvey import InputError
from rfpsurvey._folder import RequestFolder, check_file, locked, read_index, read_verified


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

        monkeypatch.setattr("rfpsurvey._folder.write_bytes", stop)
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
