"""Each plan of the rest is made beside the present plan, replaces it at once, and leaves the plans before it."""

import os
import shutil
import threading
import time
from types import SimpleNamespace

import pytest
from astropy.io import fits
from living import content, events, part, sha

import rfpsurvey as rs
from rfpsurvey._common.folder import LOCK, locked
from rfpsurvey._survey import generations as _generations
from rfpsurvey._survey.folder import Folder


@pytest.fixture
def recorded(survey):
    """Return a survey in which a tile was observed, and a change of targets that changes the plan of another tile."""
    survey.record(events(tile=11, date="2026-01-03"))
    survey.record(events(target=survey.tile(12)["target_id"][:2].tolist(), state="dropped"))
    return survey


def numbers(folder):
    """Return the generation in the file of each tile."""
    return [fits.getheader(folder / f"tiles/000/{row:06d}.fits", 1)["GENER"] for row in range(6)]


def test_plans_have_generations_and_unchanged_plans_keep_theirs(recorded):
    before = [part(recorded.folder, row) for row in range(6)]
    assert numbers(recorded.folder) == [1] * 6
    again = recorded.replan()
    for row, number in enumerate(numbers(again.folder)):
        assert (number == 1) == (part(again.folder, row) == before[row])
        assert part(again.folder, row) == before[row] or (
            (again.folder / f"events/plans/{sha(before[row])}.fits").read_bytes() == before[row]
        )
    assert numbers(again.folder)[:2] == [1, 2]
    again.record(events(tile=13, date="2026-01-05"))
    third = again.replan()
    assert [generation.number for generation in _generations.read_generations(third.folder)] == [1, 2, 3]
    assert set(numbers(third.folder)) <= {1, 2, 3}
    assert len(rs.survey.verify_survey(third.folder)) == 0


@pytest.mark.parametrize("n", [*range(0, 12, 3), 13, pytest.param(14, marks=pytest.mark.exhaustive)])
def test_the_next_command_completes_an_interrupted_replacement(recorded, tmp_path, monkeypatch, n):
    """The n-th file that is moved interrupts the replacement of the plan; then, the folder is read."""
    expected = rs.Survey.read(shutil.copytree(recorded.folder, tmp_path / "expected")).replan()
    calls, replace, is_interrupted = [], os.replace, False

    def interrupt(*paths):
        if len(calls) == n:
            raise KeyboardInterrupt
        calls.append(paths)
        replace(*paths)

    with monkeypatch.context() as patch:
        patch.setattr(_generations, "os", SimpleNamespace(replace=interrupt))
        try:
            recorded.replan()
        except KeyboardInterrupt:
            is_interrupted = True
    assert (recorded.folder / "ready").is_dir() == is_interrupted == (n < 14)
    again = rs.Survey.read(recorded.folder)
    assert again.tiles["state"].tolist() == expected.tiles["state"].tolist()
    continued = again.replan()
    assert continued.tiles["state"].tolist() == expected.tiles["state"].tolist()
    assert content(recorded.folder) == content(expected.folder)


def test_a_plan_before_the_first_record_is_listed(survey):
    survey.replan()
    assert survey.events()["generation"].tolist() == [2]
    survey.record(events(tile=11, date="2026-01-03"))
    assert survey.events()["number"].tolist() == [0, 1]


def test_changed_options_are_listed_with_the_records(recorded):
    rule = rs.survey.VisitRule(retries=2)
    again = rs.survey.continue_survey(recorded.folder, rule=rule)
    assert again.events()["number"].tolist() == [1, 2, 0]
    row = again.events()[-1]
    assert (row["generation"], row["table"]) == (2, "")
    assert row["note"] == "rule.retries: not given -> 2"


def test_a_plan_does_not_replace_the_plan_of_another_run(recorded, monkeypatch):
    put = Folder.put_part

    def replan_and_put(folder, tile, data):
        if tile == 2 and folder.is_beside:
            monkeypatch.setattr(Folder, "put_part", put)
            shutil.rmtree(recorded.folder / "next")
            rs.Survey.read(recorded.folder).replan()
            (recorded.folder / "next/tiles/000").mkdir(parents=True)
        put(folder, tile, data)

    monkeypatch.setattr(Folder, "put_part", replan_and_put)
    with pytest.raises(rs.InputError, match="must have the plan that was to be replaced, got one of another run"):
        recorded.replan()
    assert rs.Survey.read(recorded.folder).status().meta["generation"] == 2


def test_two_writers_wait_for_each_other(survey, monkeypatch):
    begun, ends = threading.Event(), threading.Event()

    def hold():
        with locked(survey.folder, survey.folder / LOCK):
            begun.set()
            ends.wait(5)

    for is_released in (True, False):
        thread = threading.Thread(target=hold)
        thread.start()
        begun.wait()
        if is_released:
            threading.Timer(0.5, ends.set).start()
            before = time.perf_counter()
            assert survey.record(events(tile=11, date="2026-01-03"))["n_events"] == 1
            assert time.perf_counter() - before > 0.4
        else:
            monkeypatch.setattr("rfpsurvey._survey.history.record.WAIT", 0.2)
            with pytest.raises(rs.InputError, match="another run uses this folder"):
                survey.undo(1)
            ends.set()
        thread.join()
        begun.clear()
        ends.clear()
