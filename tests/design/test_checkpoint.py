"""The file of a scan: simultaneous scans, damaged files, and files that other programs write during the scan."""

import multiprocessing
from concurrent.futures import ThreadPoolExecutor

import astropy.units as u
import numpy as np
import pytest
from astropy.table import QTable

import rfpsurvey as rs
from processes import explore, explore_and_tell
from rfpsurvey._common.io import write_table
from rfpsurvey._common.read_tables import read_table
from rfpsurvey._studies import design_rows as _checkpoint
from rfpsurvey._studies.design_rows import digest_of, to_rows


def test_two_scans_in_one_file_are_refused(tmp_path):
    """Both scans ended without an error, and the file contained only one of them."""
    path, tried = tmp_path / "scan.ecsv", []

    def intrude(done, _):
        if not tried:
            tried.append(done)
            for options in ({}, {"resume": True}, {"overwrite": True}):
                with pytest.raises(rs.InputError, match=r"scan\.ecsv: another run uses this file"):
                    explore(path, rng=1, **options)

    expected = explore(path, progress=intrude)
    assert tried
    assert (QTable.read(path)["pitch"] == expected["pitch"]).all()
    assert [file.name for file in tmp_path.iterdir()] == ["scan.ecsv"]


@pytest.mark.exhaustive
def test_simultaneous_processes_never_write_the_file_in_turns(tmp_path):
    """Of several processes that start together, each one either writes its own scan or is refused."""
    context = multiprocessing.get_context("spawn")
    barrier, found = context.Barrier(2), context.Queue()
    own = [
        context.Process(target=explore_and_tell, args=(tmp_path / "scan.fits", barrier, found, seed)) for seed in (1, 2)
    ]
    for process in own:
        process.start()
    said = dict(found.get(timeout=120) for _ in own)
    for process in own:
        process.join()
    wrote = [seed for seed, text in said.items() if text == "wrote"]
    assert wrote
    assert all("another run uses this file" in text for seed, text in said.items() if seed not in wrote)
    table = read_table(tmp_path / "scan.fits")
    assert table.meta["request"]["seed"] in wrote
    assert table.meta["digest"] == digest_of(to_rows(table))


@pytest.mark.parametrize("ending", ["ecsv", "fits"])
def test_changed_values_are_not_resumed(tmp_path, ending):
    """A changed loss in the file of an unfinished scan became part of the result."""
    path = tmp_path / f"scan.{ending}"
    explore(path)
    for rows, other_rows in (([3], [4]), ([3, 4], [4, 3])):
        table = read_table(path)
        table["loss"][rows] = table["loss"][other_rows]
        copy = tmp_path / f"copy.{ending}"
        write_table(table, copy, overwrite=True)
        with pytest.raises(rs.InputError, match="is damaged: its values differ from the values that the scan wrote"):
            explore(copy, resume=True)


@pytest.mark.few(1)
@pytest.mark.parametrize("ending", ["ecsv", "fits"])
def test_rows_with_undefined_values_are_resumed(tmp_path, ending):
    """Impossible designs have no values; their representation depends on the file format."""
    path = tmp_path / f"scan.{ending}"
    with pytest.warns(rs.RfpsurveyWarning, match="have no values"):
        expected = explore(path, clearance=[1.5, 40] * u.mm)
    before = path.read_bytes()
    with pytest.warns(rs.RfpsurveyWarning, match="have no values"), ThreadPoolExecutor(2) as executor:
        found = explore(path, clearance=[1.5, 40] * u.mm, resume=True, executor=executor)
    assert np.isnan(expected["loss"]).any()
    np.testing.assert_array_equal(found["loss"], expected["loss"])
    assert path.read_bytes() == before


def test_a_file_that_appears_during_the_scan_is_not_replaced(tmp_path, monkeypatch):
    monkeypatch.setattr(_checkpoint, "EVERY", 1e9)
    path = tmp_path / "scan.ecsv"

    def write(*_):
        path.write_text("another result")

    with pytest.raises(rs.InputError, match=r"scan\.ecsv exists; to replace it, use overwrite=True"):
        explore(path, progress=write)
    assert path.read_text() == "another result"
