"""Recording, planning and checkpoints that are killed at random moments, and repeated."""

import multiprocessing
import os
import shutil
import time

import numpy as np
import pytest
from living import content, differences, events, instrument, targets, tiling

import rfpsurvey as rs
from rfpsurvey.survey import SurveyState

pytestmark = [
    pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork"),
    pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning"),
]
CASE = targets(), instrument(), tiling()


def record(folder, table):
    rs.Survey.read(folder).record(table)


def plan(folder, first=False):
    state = None if first else SurveyState.read(folder, CASE[0])
    rs.plan_survey(*CASE, folder=folder, resume=True, visits=state, allocator="nearest")


STEPS = [
    (plan, True),
    (record, events(tile=[11, 12, 13], date="2026-01-03", state=["done", "bad", "partly"])),
    (plan,),
    (record, events(target=[1001, 2001], state=["dropped", ""], ra=120.1, dec=30.0, priority=2.0)),
    (record, events(tile=30, state="added", ra=120.03, dec=30.01)),
    (plan,),
    (record, events(tile=[30, 12], date="2026-01-05")),
    (record, events(tile=12, date="2026-01-03", state="planned")),
    (plan,),
]


@pytest.mark.filterwarnings("ignore:.*recorded positions")
@pytest.mark.parametrize("n", [6, pytest.param(60, marks=pytest.mark.exhaustive)])
def test_killed_at_random_moments(tmp_path, rng, n):
    """Each command is killed up to four times, and then repeated until it ends; ``n`` processes are killed."""
    context = multiprocessing.get_context("fork")
    expected, seconds = {}, {}
    for k, (function, *arguments) in enumerate(STEPS):
        begin = time.perf_counter()
        function(tmp_path / "whole", *arguments)
        seconds[k], expected[k] = time.perf_counter() - begin, content(tmp_path / "whole")
    assert len(expected[8]) == 33
    killed, run = 0, 0
    while killed < n:
        run += 1
        folder = tmp_path / f"survey-{run}"
        for k, (function, *arguments) in enumerate(STEPS):
            for _ in range(rng.integers(0, 5)):
                process = context.Process(target=function, args=(folder, *arguments))
                process.start()
                process.join(rng.uniform(0, seconds[k]))
                killed += process.is_alive()
                process.kill()
                process.join()
            function(folder, *arguments)
            assert content(folder) == expected[k], k


@pytest.mark.parametrize("n", [2, pytest.param(10, marks=pytest.mark.exhaustive)])
def test_a_plan_is_killed_while_another_process_records(tmp_path, rng, n):
    """The record and the plan are whole, whichever was first, and the rest is planned as from the recorded state."""
    context = multiprocessing.get_context("fork")
    for function, *arguments in STEPS[:2]:
        function(tmp_path / "first", *arguments)
    begin = time.perf_counter()
    plan(shutil.copytree(tmp_path / "first", tmp_path / "timed"))
    seconds = time.perf_counter() - begin
    for number in range(n):
        folder = shutil.copytree(tmp_path / "first", tmp_path / f"survey-{number}")
        table = events(tile=[14, 15], date="2026-01-06", positioner="", state=["done", "bad"])
        processes = [context.Process(target=plan, args=(folder,)), context.Process(target=record, args=(folder, table))]
        for process in processes:
            process.start()
        processes[0].join(rng.uniform(0, 1.2 * seconds))
        processes[0].kill()
        for process in processes:
            process.join()
        assert processes[1].exitcode == 0
        assert len(rs.survey.verify_survey(folder)) == 0
        plan(folder)
        survey = rs.Survey.read(folder)
        again = rs.plan_survey(*CASE, visits=survey.state(CASE[0]), allocator="nearest")
        assert differences(survey, again) == []
        assert survey.tiles["state"].tolist()[:5] == ["done", "planned", "partly", "done", "planned"]
        assert len(rs.survey.verify_survey(folder)) == 0


@pytest.mark.filterwarnings("ignore:.*recorded positions")
def test_repeated_commands_change_nothing(tmp_path):
    """Regression: equal records of targets were appended again."""
    for function, *arguments in STEPS:
        function(tmp_path / "survey", *arguments)
        before = content(tmp_path / "survey")
        if function is record or arguments != [True]:
            function(tmp_path / "survey", *arguments)
        assert content(tmp_path / "survey") == before


def test_equal_changes_of_targets_are_known(tmp_path):
    plan(tmp_path / "survey", True)
    survey = rs.Survey.read(tmp_path / "survey")
    new = events(target=[1001, 7], visits=[2, 3], ra=[np.nan, 120.0], dec=[np.nan, 30.0], priority=[np.nan, 1.0])
    assert survey.record(new)["n_events"] == 2
    assert survey.record(new) == {"n_events": 0, "n_known": 2, "n_ignored": 0, "changes": {}}
    assert survey.record(events(target=[1001, 1002], visits=[2, 2])) == {
        **{"n_events": 1, "n_known": 1, "n_ignored": 0},
        "changes": {"targets changed": ["1002"]},
    }
    assert survey.record(events(target=1001, visits=1))["n_events"] == 1
    assert survey.record(events(target=1001, visits=2))["n_events"] == 1
    assert survey.record(events(target=[1001], category=["a"]))["n_events"] == 1
    assert survey.record(events(target=[1001], category=["longer"]))["n_events"] == 1
    assert survey.record(events(target=[1001], category=["a"]))["n_events"] == 1
    assert survey.record(events(target=[1001], category=["a"]))["n_known"] == 1
    assert survey.state(CASE[0]).catalog.visits[[1, 2, 60]].tolist() == [2, 2, 3]


@pytest.mark.parametrize("table", [events(tile=11, date="2026-01-03"), events(target=1001, visits=2)])
def test_files_that_a_killed_record_left_are_removed(tmp_path, table):
    """Regression: temporary files and tables of targets without events remained."""
    plan(tmp_path / "survey", True)
    survey = rs.Survey.read(tmp_path / "survey")
    survey.record(events(target=1002, visits=2))
    shutil.copytree(tmp_path / "survey", tmp_path / "other")
    for name in ("events/.rfpsurvey-0123456789abcdef", f"events/000002-{'0' * 64}.fits"):
        (survey.folder / name).write_bytes(b"SIMPLE")
    survey.record(table)
    rs.Survey.read(tmp_path / "other").record(table)
    names = [sorted(path.name for path in (tmp_path / one / "events").iterdir()) for one in ("survey", "other")]
    assert names[0] == names[1]
