"""Surveys with cadences that are continued: interruptions, changed targets, further tiles, and refusals."""

import shutil
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from astropy.table import Table, vstack
from astropy.time import Time
from cadence_program import plan, scene, with_columns
from living import content, instrument
from naive_cadences import TABLE

import rfpsurvey as rs
from rfpsurvey._survey import run
from rfpsurvey._survey.history.dated import observed_time
from rfpsurvey._survey.work import work
from rfpsurvey.survey import Cadences

pytestmark = pytest.mark.filterwarnings("ignore::rfpsurvey.RfpsurveyWarning")


def text(day):
    return Time(np.floor(day), format="mjd").isot[:10]


@pytest.fixture
def folder(tmp_path):
    """Return the folder of a survey with cadences of which the first four tiles were observed, and their tiling."""
    catalog, tiling = scene(3, n=60, n_tiles=16)
    survey = plan(catalog, tiling, folder=tmp_path / "plan", allocator="repair")
    days = np.asarray(tiling.table["mjd"])
    rows = [(tiling.table["tile"][k], text(days[k]), "done") for k in np.argsort(days)[:4]]
    survey.record(Table(rows=rows, names=["tile", "date", "state"]))
    return tmp_path / "plan", tiling, catalog


@pytest.mark.parametrize(
    ("date", "time"),
    [("2023-02-25", 60000.3), ("2023-02-24", 60000.3), ("2023-02-23", 59998.3), ("2023-02-26", 60001.3), ("", 60000.3)],
)
def test_a_tile_was_observed_as_planned_if_the_date_is_that_of_its_time_or_of_its_night(date, time):
    """MJD 60000 is 2023-02-25."""
    assert observed_time(date, 60000.3) == pytest.approx(time, abs=1e-9)


def test_the_plan_of_the_rest_does_not_depend_on_workers_and_interruptions(folder, monkeypatch):
    path = folder[0]
    shutil.copytree(path, path.parent / "copy")
    with ThreadPoolExecutor(2) as executor:
        survey = rs.survey.continue_survey(path.parent / "copy", executor=executor)
    calls = []

    def fail_later(*arguments):
        calls.append(arguments)
        if len(calls) > 3:
            raise KeyboardInterrupt
        return work(*arguments)

    monkeypatch.setattr(run, "work", fail_later)
    with pytest.raises(KeyboardInterrupt):
        rs.Survey.read(path).replan()
    assert len(rs.survey.verify_survey(path)) == 0
    monkeypatch.setattr(run, "work", work)
    again = rs.Survey.read(path).replan()
    assert again.outcomes["observed"].tolist() == survey.outcomes["observed"].tolist()
    assert again.summary["n_tiles_observed"] == 4
    first, second = content(path), content(path.parent / "copy")
    assert {name for name in first if "tiles/" in name and first[name] != second.get(name)} == set()


def test_targets_with_cadences_are_added_changed_and_dropped(folder):
    """The cadence of added targets is required and checked, because it could not be corrected later."""
    path, _, catalog = folder
    survey = rs.Survey.read(path)
    new = {"target": [99999], "state": ["added"], "ra": [120.0], "dec": [30.0], "priority": [3]}
    with pytest.raises(rs.InputError, match="added targets must have the column cadence, which the survey uses"):
        survey.record(Table(new))
    with pytest.raises(rs.InputError, match="the cadence of a target must be in the table of cadences, got 'other'"):
        survey.record(Table(new | {"cadence": ["other"], "kind_of": [1]}))
    survey.record(Table(new | {"cadence": ["pairs"], "kind_of": [1]}))
    number = len(survey.events())
    free = np.flatnonzero(np.asarray(survey.state().observed)[:-1] == 0)[:3].tolist()
    survey.record(Table({"target": catalog.id[free[:1]], "cadence": ["thrice"]}))
    survey.record(Table({"target": catalog.id[free[1:2]], "state": ["dropped"]}))
    survey.record(Table({"target": catalog.id[free[2:]], "visits": [0]}))
    requested = survey.replan().outcomes["requested"]
    assert requested[[*free, -1]].tolist() == [4, 0, 0, 4]
    survey.undo(number)
    assert survey.replan().outcomes["requested"][-1] == 0


def test_further_tiles_are_planned_unless_they_lie_in_the_past(folder):
    path, tiling, _ = folder
    days = np.asarray(tiling.table["mjd"])
    more = tiling.table[:2].copy()
    more["tile"], more["pass"], more["mjd"] = [900, 901], 2, days.max() + [5, 6]
    many = rs.Tiling(vstack([tiling.table, more]))
    survey = rs.Survey.read(path).replan(tiles=many)
    assert survey.tiles["state"][-2:].tolist() == ["planned", "planned"]
    with pytest.raises(rs.InputError, match="tiles must be those of the first plan, .* other times or another bright"):
        survey.replan(tiles=with_columns(many, mjd=np.asarray(many.table["mjd"]) + 1))
    late = Table({"tile": [901], "date": [text(days.max() + 6)], "state": ["done"], "generation": [2]})
    survey.record(late, allow_future=True)
    assert survey.replan().tiles["state"].tolist().count("past") == 13
    assert rs.Survey.read(path).status().meta["tiles"][1]["past"] == 1


def test_states_with_other_cadences_or_rules_are_refused(folder):
    path, _, catalog = folder
    survey = rs.Survey.read(path)
    state = survey.state(catalog, visits=Cadences(TABLE))
    assert state.observed.tolist() == survey.state().observed.tolist()
    assert repr(state).startswith("<SurveyState of 60 targets: 4 tiles observed")
    for words, given in {
        "visits must be the cadences of the first plan, 5 cadences": {"visits": Cadences(TABLE[::-1])},
        "a survey with cadences must have no rule for visits": {"rule": rs.survey.VisitRule(retries=1)},
        "visits must be the Cadences of the survey in .*, got 2": {"visits": 2},
    }.items():
        with pytest.raises(rs.InputError, match=words):
            survey.state(catalog, **{"visits": Cadences(TABLE)} | given)
    with pytest.raises(rs.InputError, match="tiles must be the Tiling of a survey with cadences, got None"):
        rs.survey.SurveyState.read(path, catalog, visits=Cadences(TABLE))
    plain = rs.plan_survey(catalog, instrument(), survey.tiles[:3], folder=path.parent / "plain", allocator="nearest")
    with pytest.raises(rs.InputError, match="visits must be numbers, as in the survey in .*, got cadences"):
        plain.state(catalog, visits=Cadences(TABLE))


def test_a_joint_plan_with_default_options_of_the_tiles_is_continued(tmp_path):
    """Regression: the plan file of such a plan stated that the allocator must be given in Python."""
    catalog, tiling = scene(3, n=40, n_tiles=6)
    survey = plan(catalog, tiling, folder=tmp_path / "plan", allocator=rs.JointOptions(iterations=1))
    assert survey.replan().summary["n_complete"] == survey.summary["n_complete"]
