"""Recording, planning, checkpoints and selection that are killed, or find a full disk, and are repeated."""

import multiprocessing
import os
import shutil
import signal
import time

import numpy as np
import pytest
from living import content, differences, events, instrument, targets, tiling

import rfpsurvey as rs
from rfpsurvey._survey.selection import run as _folder
from rfpsurvey.survey import SurveyState

resource = pytest.importorskip("resource")

pytestmark = [
    pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork"),
    pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning"),
]
CASE = targets(), instrument(), tiling()
EXHAUSTIVE, FULL = pytest.mark.exhaustive, 28


def record(folder, table):
    rs.Survey.read(folder / "survey").record(table)


def plan(folder, first=False):
    state = None if first else SurveyState.read(folder / "survey", CASE[0])
    allocator = rs.AllocationOptions("nearest", subpriority=1)
    rs.plan_survey(*CASE, folder=folder / "survey", resume=True, visits=state, allocator=allocator)


def select(folder):
    state = SurveyState.read(folder / "survey", CASE[0])
    options = {"folder": folder / "selection", "resume": True, "allocator": "nearest"}
    rs.selection_probabilities(state, *CASE[1:], 8, **options)


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
    (select,),
]


def kill_after(seconds, function, *arguments):
    """Call a function in a process that is killed after some seconds, and return whether it still ran."""
    process = multiprocessing.get_context("fork").Process(target=function, args=arguments)
    process.start()
    process.join(seconds)
    was_alive = process.is_alive()
    process.kill()
    process.join()
    return was_alive


def fill_after(seconds, function, *arguments):
    """Call a function in a process that cannot write after some seconds, and return whether it ended with an error."""

    def call():
        signal.signal(signal.SIGALRM, lambda *_: resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0)))
        signal.setitimer(signal.ITIMER_REAL, max(seconds, 1e-6))
        try:
            function(*arguments)
        except rs.InputError as error:
            os._exit(FULL if "cannot be written" in str(error) else 1)

    process = multiprocessing.get_context("fork").Process(target=call)
    process.start()
    process.join()
    assert process.exitcode in (0, FULL)
    assert not [*arguments[0].rglob(".rfpsurvey*")]
    return process.exitcode == FULL


@pytest.mark.filterwarnings("ignore:.*recorded positions")
@pytest.mark.parametrize(
    ("interrupt", "n"),
    [(kill_after, 6), (fill_after, 2), *(pytest.param(how, 15, marks=EXHAUSTIVE) for how in (kill_after, fill_after))],
)
def test_interrupted_at_random_moments(tmp_path, rng, monkeypatch, interrupt, n):
    """Each command is interrupted up to four times, and then repeated; ``n`` processes are interrupted."""
    monkeypatch.setattr(_folder, "EVERY", 0.0)
    expected, seconds = {}, {}
    (tmp_path / "whole").mkdir()
    for k, (function, *arguments) in enumerate(STEPS):
        begin = time.perf_counter()
        function(tmp_path / "whole", *arguments)
        seconds[k], expected[k] = time.perf_counter() - begin, content(tmp_path / "whole")
    assert len(expected[8]) == 33
    interrupted, run = 0, 0
    while interrupted < n:
        run += 1
        folder = tmp_path / f"run-{run}"
        folder.mkdir()
        for k, (function, *arguments) in enumerate(STEPS):
            for _ in range(rng.integers(0, 5)):
                interrupted += interrupt(rng.uniform(0, seconds[k]), function, folder, *arguments)
            function(folder, *arguments)
            assert content(folder) == expected[k], k


@pytest.mark.parametrize("n", [2, pytest.param(4, marks=EXHAUSTIVE)])
def test_a_plan_is_killed_while_another_process_records(tmp_path, rng, n):
    """The record and the plan are whole, whichever was first, and the rest is planned as from the recorded state."""
    context = multiprocessing.get_context("fork")
    (tmp_path / "first").mkdir()
    for function, *arguments in STEPS[:2]:
        function(tmp_path / "first", *arguments)
    begin = time.perf_counter()
    plan(shutil.copytree(tmp_path / "first", tmp_path / "timed"))
    seconds = time.perf_counter() - begin
    for number in range(n):
        home = shutil.copytree(tmp_path / "first", tmp_path / f"run-{number}")
        folder = home / "survey"
        table = events(tile=[14, 15], date="2026-01-06", positioner="", state=["done", "bad"])
        processes = [context.Process(target=plan, args=(home,)), context.Process(target=record, args=(home, table))]
        for process in processes:
            process.start()
        processes[0].join(rng.uniform(0, 1.2 * seconds))
        processes[0].kill()
        for process in processes:
            process.join()
        assert (processes[1].exitcode, len(rs.survey.verify_survey(folder))) == (0, 0)
        plan(home)
        survey = rs.Survey.read(folder)
        allocator = rs.AllocationOptions("nearest", subpriority=1)
        again = rs.plan_survey(*CASE, visits=survey.state(CASE[0]), allocator=allocator)
        assert differences(survey, again) == []
        assert survey.tiles["state"].tolist()[:5] == ["done", "planned", "partly", "done", "planned"]
        assert len(rs.survey.verify_survey(folder)) == 0


@pytest.mark.filterwarnings("ignore:.*recorded positions")
def test_repeated_commands_change_nothing(tmp_path):
    """Regression: equal records of targets were appended again."""
    for function, *arguments in STEPS:
        function(tmp_path, *arguments)
        before = content(tmp_path)
        if function is record or arguments != [True]:
            function(tmp_path, *arguments)
        assert content(tmp_path) == before


def test_equal_changes_of_targets_are_known(tmp_path):
    plan(tmp_path, True)
    survey = rs.Survey.read(tmp_path / "survey")
    new = events(target=[1001, 7], visits=[2, 3], ra=[np.nan, 120.0], dec=[np.nan, 30.0], priority=[np.nan, 1.0])
    assert survey.record(new)["n_events"] == 2
    assert survey.record(new) == {"n_events": 0, "n_known": 2, "n_ignored": 0, "changes": {}}
    found = survey.record(events(target=[1001, 1002], visits=[2, 2]))
    assert found == {"n_events": 1, "n_known": 1, "n_ignored": 0, "changes": {"targets changed": ["1002"]}}
    for values in ({"visits": 1}, {"visits": 2}, *({"category": [name]} for name in ("a", "longer", "a"))):
        assert survey.record(events(target=[1001], **values))["n_events"] == 1
    assert survey.record(events(target=[1001], category=["a"]))["n_known"] == 1
    assert survey.state(CASE[0]).catalog.visits[[1, 2, 60]].tolist() == [2, 2, 3]


@pytest.mark.parametrize("table", [events(tile=11, date="2026-01-03"), events(target=1001, visits=2)])
def test_files_that_a_killed_record_left_are_removed(tmp_path, table):
    """Regression: temporary files and tables of targets without events remained."""
    plan(tmp_path, True)
    survey = rs.Survey.read(tmp_path / "survey")
    survey.record(events(target=1002, visits=2))
    shutil.copytree(tmp_path / "survey", tmp_path / "other")
    for name in ("events/.rfpsurvey-0123456789abcdef", f"events/000002-{'0' * 64}.fits"):
        (survey.folder / name).write_bytes(b"SIMPLE")
    survey.record(table)
    rs.Survey.read(tmp_path / "other").record(table)
    names = [sorted(path.name for path in (tmp_path / one / "events").iterdir()) for one in ("survey", "other")]
    assert names[0] == names[1]
