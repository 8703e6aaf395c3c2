"""Tasks of several tiles, and files of tiles that workers write."""

import multiprocessing
import os
import signal
from concurrent.futures import BrokenExecutor, ProcessPoolExecutor, ThreadPoolExecutor

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import QTable
from living import content

import flat
import rfpsurvey as rs
from rfpsurvey._survey import work as _rounds
from rfpsurvey._survey.folder import Folder


@pytest.fixture(scope="module")
def case(small):
    """Return the arguments of a survey with a round of 24 tiles, and a round of one tile."""
    lon = np.arange(24) * 3.0
    table = QTable({"ra": [*lon, 0.1] * u.deg, "dec": np.zeros(25) * u.deg})
    coord = SkyCoord(np.random.default_rng(1).uniform(-1, 71, 9000) * u.deg, np.linspace(-1, 1, 9000) * u.deg)
    return rs.Catalog(coord), small, rs.Tiling.from_table(table)


@pytest.mark.parametrize("kind", ["threads", "processes"])
def test_workers_write_the_same_files(case, kind, tmp_path, monkeypatch):
    monkeypatch.setattr(_rounds, "SHARE", 4)  # six tiles per task
    flat.plan_survey(*case, folder=tmp_path / "alone")
    if kind == "threads":
        executor = ThreadPoolExecutor(2)
    else:
        executor = ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("spawn"))
    paths = []
    monkeypatch.setattr(Folder, "put_file", lambda _, name, __: paths.append(name))
    with executor:
        flat.plan_survey(*case, folder=tmp_path / "workers", executor=executor)
    assert (content(tmp_path / "workers"), paths) == (content(tmp_path / "alone"), [])


def test_damaged_files_are_replaced_by_the_first_process(case, tmp_path, monkeypatch):
    flat.plan_survey(*case, folder=tmp_path / "survey")
    before = content(tmp_path / "survey")
    damaged, lost = "tiles/000/000003.fits", "tiles/000/000007.fits"
    (tmp_path / "survey" / damaged).write_bytes(before[damaged][:-1] + b"x")
    index = (tmp_path / "survey/index.csv").read_text().splitlines(keepends=True)
    (tmp_path / "survey/index.csv").write_text("".join(line for line in index if lost not in line))
    (tmp_path / "survey/tiles.fits").unlink()
    record, recorded = Folder.record, []
    monkeypatch.setattr(Folder, "record", lambda self, *entry: (recorded.append(entry[0]), record(self, *entry)))
    with ThreadPoolExecutor(2) as executor, pytest.warns(rs.RfpsurveyWarning, match="planned again"):
        flat.plan_survey(*case, folder=tmp_path / "survey", executor=executor, resume=True)
    assert (content(tmp_path / "survey"), recorded) == (before, [lost])


def test_a_worker_that_dies_is_told(case, tmp_path):
    flat.plan_survey(*case, folder=tmp_path / "alone")
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=context) as executor:

        def kill(done, _):
            for pid in list(executor._processes):
                os.kill(pid, signal.SIGKILL)

        with pytest.raises(BrokenExecutor, match="a worker process died; the files of finished tiles remain"):
            flat.plan_survey(*case, folder=tmp_path / "survey", executor=executor, progress=kill)
    flat.plan_survey(*case, folder=tmp_path / "survey", resume=True)
    assert content(tmp_path / "survey") == content(tmp_path / "alone")


def test_an_error_names_its_tile(case, monkeypatch):
    def fail(job):
        raise ZeroDivisionError

    monkeypatch.setattr("rfpsurvey._survey.run.work", fail)
    with pytest.raises(ZeroDivisionError) as error:
        flat.plan_survey(*case)
    assert error.value.__notes__[0].startswith("while tile ")
