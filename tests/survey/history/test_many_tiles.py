"""A survey of 1,000 tiles over two nights: other orders of rows, numbers of workers, and processes that are killed."""

import multiprocessing
import os
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from living import content, events, instrument, targets, tiling

import rfpsurvey as rs
from rfpsurvey.survey import SurveyState
from rfpsurvey.survey._history._event_files import read_events

N_TILES, FAILED = 1000, 0.05
CASE = targets(n=15_000, radius=3.0), instrument(), tiling(n=N_TILES, size=2.0)
NIGHTS = {"2026-01-03": range(200), "2026-01-05": range(200, 500)}
pytestmark = pytest.mark.exhaustive


def plan(folder, state=None, catalog=None, executor=None):
    case = (CASE[0] if catalog is None else catalog, *CASE[1:])
    return rs.plan_survey(*case, folder=folder, resume=True, visits=state, allocator="nearest", executor=executor)


def replan(folder, catalog=None, executor=None):
    return plan(folder, SurveyState.read(folder, CASE[0] if catalog is None else catalog), catalog, executor)


def night(folder, date, rng=None):
    """Record a night, in which visits fail at random; ``rng`` shuffles the rows of each tile of the table."""
    survey, chance = rs.Survey.read(folder), np.random.default_rng(NIGHTS[date].start)
    tiles, positioners = [], []
    for row in NIGHTS[date]:
        name = int(survey.tiles["tile"][row])
        failed = survey.tile(name)["positioner"].astype(str)
        failed = failed[chance.random(len(failed)) < FAILED].tolist()
        tiles += [name] * (1 + len(failed))
        positioners += ["", *failed]
    table = events(tile=tiles, date=date, positioner=positioners, good=[one == "" for one in positioners])
    # the tiles of a night have the order of the table
    survey.record(table if rng is None else table[np.lexsort((rng.random(len(table)), tiles))])


def change(folder, rng=None):
    """Record dropped and new targets."""
    new = events(target=list(range(10**6, 10**6 + 30)), ra=120.1, dec=30.0, priority=2.0, visits=1, state="")
    new["ra"] += np.linspace(0, 0.5, 30)
    old = events(target=list(range(1000, 1050)), state="dropped", ra=np.nan, dec=np.nan, priority=np.nan, visits=-1)
    for table in (new, old[["target", "state"]]):
        rs.Survey.read(folder).record(table if rng is None or table is new else table[rng.permutation(len(table))])


STEPS = [
    (plan,),
    *((night, "2026-01-03"), (replan,), (change,)),
    *((night, "2026-01-05"), (replan,)),
]


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Return the folder of the survey, its content after each step, and the time of each step."""
    folder, contents, seconds = tmp_path_factory.mktemp("whole") / "survey", [], []
    for function, *arguments in STEPS:
        begin = time.perf_counter()
        function(folder, *arguments)
        seconds.append(time.perf_counter() - begin)
        contents.append(content(folder))
    return folder, contents, seconds


def test_sums_of_the_state(whole):
    state = SurveyState.read(whole[0], CASE[0])
    assert state.summary["n_tiles_observed"] == 500
    assert 1000 < state.summary["n_visits_made"] == state.observed.sum()
    assert 50 < state.summary["n_visits_failed"] == state.failed.sum()
    survey = rs.Survey.read(whole[0])
    assert survey.tiles["n_observed"][:500].sum() == state.observed.sum()
    assert len(survey.outcomes) == 15_030


def test_shuffled_events_and_two_workers(whole, tmp_path, rng):
    folder = tmp_path / "survey"
    for function, *arguments in STEPS:
        if function in (plan, replan):
            with ThreadPoolExecutor(2) as executor:
                function(folder, executor=executor)
        else:
            function(folder, *arguments, rng=rng)
    found, expected = content(folder), whole[1][-1]
    # the rows of tables are stored in their order, and the events have a digest
    names = [name for name in expected if not name.startswith("events/") or name.startswith("events/plans/")]
    assert [name for name in names if found[name] != expected[name]] == ["index.csv", "survey.json", "tiles.fits"]
    stated, others = ([file.tiles for file in read_events(one).files] for one in (folder, whole[0]))
    assert stated == others


def test_shuffled_targets(whole, tmp_path, rng):
    """The plans contain the same targets, although their rows differ."""
    folder, order = tmp_path / "survey", rng.permutation(len(CASE[0]))
    for function, *arguments in STEPS:
        more = {"catalog": CASE[0][order]} if function in (plan, replan) else {}
        function(folder, *arguments, **more)
    one, two = rs.Survey.read(whole[0]), rs.Survey.read(folder)
    assert one.summary == two.summary
    for row in range(N_TILES):
        a, b = one._visits(row), two._visits(row)
        assert np.array_equal(a["positioner"], b["positioner"])
        assert np.array_equal(a["target_id"], b["target_id"])
    tables = [survey.outcomes[np.argsort(survey.outcomes["target_id"])] for survey in (one, two)]
    for name in ("target_id", "requested", "observed", "outcome"):
        assert np.array_equal(tables[0][name], tables[1][name]), name


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
def test_killed_at_8_random_moments(whole, tmp_path, rng):
    context = multiprocessing.get_context("fork")
    killed, run = 0, 0
    while killed < 8:
        run += 1
        folder = tmp_path / f"survey-{run}"
        for (function, *arguments), seconds, expected in zip(STEPS, whole[2], whole[1], strict=False):
            for _ in range(rng.integers(0, 8)):
                process = context.Process(target=function, args=(folder, *arguments))
                process.start()
                process.join(rng.uniform(0, seconds))
                killed += process.is_alive()
                process.kill()
                process.join()
            function(folder, *arguments)
            assert content(folder) == expected
