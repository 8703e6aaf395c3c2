"""Numbers of requested visits: those of the catalog and of records, also if other numbers of visits were made."""

from dataclasses import replace

import numpy as np
import pytest
from living import differences, events, replan

import rfpsurvey as rs
from rfpsurvey.survey import survey_status


def test_requested_visits_do_not_become_the_observed_ones(case, survey):
    """Regression: the requested number of visits became the observed number if it was smaller."""
    survey.record(events(tile=survey.tiles["tile"].tolist(), date="2026-01-03"))
    state = survey.state(case[0])
    twice = case[0].id[state.observed >= 2]
    once = case[0].id[(state.observed == 1) & (state.left > 0)]
    assert len(twice) > 0
    assert len(once) > 0
    survey.record(events(target=twice[:1].tolist(), visits=0))
    survey.record(events(target=twice[1:].tolist(), visits=1))
    survey.record(events(target=once.tolist(), state="dropped"))
    again = replan(case, survey)
    for other in (replan(case, survey, folder=None, resume=False), replan(case, survey)):  # the last one is read
        assert differences(again, other) == []
    state = again.state(case[0])
    few, rows = np.isin(case[0].id, twice[1:]), np.isin(case[0].id, once)
    for table in (state.table, again.outcomes):
        assert (table["requested"][few] == 1).all()
        assert (table["observed"][few] >= 2).all()
        assert table["requested"][case[0].id == twice[0]] == 0
        assert (table["requested"][rows] == 1).all()  # of a dropped target, only the visits that were made
    assert not state.left[few | rows].any()
    assert {*again.outcome_names[few | np.isin(case[0].id, twice)]} == {"observed"}
    summary, status = again.summary, survey_status(again, state)
    surplus = int(np.maximum(state.observed.astype(int) - state.requested, 0).sum())
    assert surplus > 0
    assert summary["n_visits_made"] == again.tiles["n_observed"].sum() == summary["n_visits_observed"] + surplus
    assert summary["n_visits_requested"] == state.requested.sum() == status["n_requested"][0]
    assert summary["n_visits_observed"] == status["n_observed"][0]
    assert summary["n_complete"] == status["n_complete"][0] <= summary["n_targets"]
    assert again.completeness["completeness"].max() <= 1
    assert again.tiles["completeness"].max() <= 1


@pytest.mark.filterwarnings("ignore:required targets never observed")
@pytest.mark.parametrize("constraint", [False, True])
def test_at_least_one_visit_of_required_targets_remains(case, tmp_path, constraint):
    """Regression: no visit of a required target with 0 visits remained, although its plan requested one."""
    rows = np.arange(0, 60, 5)
    sky = replace(case[0], visits=np.where(np.isin(np.arange(60), rows), 0, case[0].visits))
    names = sky.id[rows].tolist()
    required = {"constraints": [f"required {' '.join(map(str, names))}"]} if constraint else {"required": names}
    case, options = (sky, *case[1:]), rs.AllocationOptions("nearest", **required)
    survey = rs.plan_survey(*case, folder=tmp_path / "survey", allocator=options)
    assert survey.state(sky).requested[rows].tolist() == survey.outcomes["requested"][rows].tolist() == [1] * len(rows)
    survey.record(events(tile=11, date="2026-01-03"))
    survey.record(events(target=names[:1], state="dropped"))
    state = survey.state(sky)
    assert state.requested[rows].tolist() == [0] + [1] * (len(rows) - 1)
    assert (state.left[rows] == state.requested[rows] - state.observed[rows]).all()
    again = rs.plan_survey(*case, folder=survey.folder, resume=True, allocator=options, visits=state)
    assert (again.outcomes["requested"] == state.requested).all()
