"""Tasks of several tiles, and files of tiles that workers write."""

import multiprocessing
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import nullcontext
from typing import NamedTuple

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import QTable

import flat
import rfpsurvey as rs
from rfpsurvey.survey import _run, in_order


class Named(NamedTuple):
    """A job, of which only the name of the tile is needed."""

    tile: int


def jobs(known=()):
    return ((Named(k), k, -k if k in known else None) for k in range(20))


@pytest.mark.parametrize("together", [1, 3, 8, 50])
@pytest.mark.parametrize("pool", [None, 1, 3])
def test_the_results_are_in_order(together, pool):
    known = {0, 4, 5, 6, 19}
    with nullcontext() if pool is None else ThreadPoolExecutor(pool) as executor:
        found = list(in_order(executor, lambda k: 2 * k, jobs(known), 7, together))
    assert found == [(Named(k), -k if k in known else 2 * k, k not in known) for k in range(20)]


@pytest.mark.parametrize("together", [1, 4])
def test_an_error_names_its_tile_and_later_tasks_are_cancelled(together):
    begun = []

    def work(k):
        begun.append(k)
        return 1 // (k - 5)

    with ThreadPoolExecutor(1) as executor, pytest.raises(ZeroDivisionError) as error:
        for _ in in_order(executor, work, jobs(), 8, together):
            pass
    assert error.value.__notes__ == ["while tile 5 was planned"]
    assert 5 in begun
    assert len(begun) < 20


def test_few_jobs_are_made_before_the_first_result_is_awaited():
    made = []

    def count():
        for job in jobs():
            made.append(job)
            yield job

    with ThreadPoolExecutor(1) as executor:
        results = in_order(executor, abs, count(), 8, 4)
        next(results)
        assert len(made) == 8


@pytest.fixture(scope="module")
def case(small):
    """Return the arguments of a survey with a round of 24 tiles, and a round of one tile."""
    lon = np.arange(24) * 3.0
    table = QTable({"ra": [*lon, 0.1] * u.deg, "dec": np.zeros(25) * u.deg})
    coord = SkyCoord(np.random.default_rng(1).uniform(-1, 71, 9000) * u.deg, np.linspace(-1, 1, 9000) * u.deg)
    return rs.Catalog(coord), small, rs.Tiling.from_table(table)


def content(folder):
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize("kind", ["threads", "processes"])
def test_workers_write_the_same_files(case, kind, tmp_path, monkeypatch):
    monkeypatch.setattr(_run, "SHARE", 4)  # six tiles per task
    flat.plan_survey(*case, folder=tmp_path / "alone")
    if kind == "threads":
        executor = ThreadPoolExecutor(2)
    else:
        executor = ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("spawn"))
    paths = []
    monkeypatch.setattr(rs.survey._folder.Folder, "put_file", lambda _, name, __: paths.append(name))
    with executor:
        flat.plan_survey(*case, folder=tmp_path / "workers", executor=executor)
    assert content(tmp_path / "workers") == content(tmp_path / "alone")
    assert paths == []


def test_damaged_files_are_replaced_by_the_first_process(case, tmp_path, monkeypatch):
    flat.plan_survey(*case, folder=tmp_path / "survey")
    before = content(tmp_path / "survey")
    damaged, lost = "tiles/000/000003.fits", "tiles/000/000007.fits"
    (tmp_path / "survey" / damaged).write_bytes(before[damaged][:-1] + b"x")
    index = (tmp_path / "survey/index.csv").read_text().splitlines(keepends=True)
    (tmp_path / "survey/index.csv").write_text("".join(line for line in index if lost not in line))
    (tmp_path / "survey/tiles.fits").unlink()
    record, recorded = rs.survey._folder.Folder.record, []
    monkeypatch.setattr(
        rs.survey._folder.Folder, "record", lambda self, *entry: (recorded.append(entry[0]), record(self, *entry))
    )
    with ThreadPoolExecutor(2) as executor, pytest.warns(rs.RfpsurveyWarning, match="planned again"):
        flat.plan_survey(*case, folder=tmp_path / "survey", executor=executor, resume=True)
    assert content(tmp_path / "survey") == before
    assert recorded == [lost]
