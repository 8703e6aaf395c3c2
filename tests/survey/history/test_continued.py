"""Surveys that are continued after records: no plan with which a tile was observed is lost or confused with another."""

from dataclasses import replace

import numpy as np
import pytest
from astropy.table import QTable
from living import content, differences, events, instrument, replan, targets, tiling

import rfpsurvey as rs


def test_a_state_that_was_read_before_an_event_is_refused(case, survey):
    """Regression: the plan of the tile that was observed in between was replaced, and lost."""
    state = survey.state(case[0])
    survey.record(events(tile=11, date="2026-01-03"))
    before = content(survey.folder)
    with pytest.raises(rs.InputError, match=r"read before the last event was recorded; call Survey\.state again"):
        replan(case, survey, visits=state)
    assert content(survey.folder) == before


def test_a_plan_up_to_a_date_keeps_the_plans_of_later_observations(case, survey):
    """Regression: the plan of a tile that was observed after the date was replaced, and lost."""
    survey.record(events(tile=[11, 12], date=["2026-01-03", "2026-01-05"]))
    whole = survey.state(case[0])
    early = survey.state(case[0], until="2026-01-03")
    assert early.summary["n_tiles_observed"] == 1
    for _ in range(2):
        replan(case, survey, visits=early)
    assert (survey.state(case[0]).observed == whole.observed).all()
    again = replan(case, survey)
    assert again.summary["n_visits_made"] == whole.observed.sum()


def test_the_plan_of_an_observation_that_was_canceled_remains_for_earlier_dates(case, survey):
    survey.record(events(tile=11, date="2026-01-03"))
    early = survey.state(case[0])
    survey.record(events(tile=11, date="2026-01-05", state="planned"))
    replan(case, survey)
    assert (survey.state(case[0], until="2026-01-03").observed == early.observed).all()
    assert not survey.state(case[0]).observed.any()


def test_a_survey_without_events_is_planned_again(case, survey):
    """Regression: the state could not be written to the folder of events, which did not exist."""
    before, again = content(survey.folder / "tiles"), replan(case, survey)
    assert differences(again, rs.plan_survey(*case, visits=survey.state(case[0]), allocator="nearest")) == []
    assert content(survey.folder / "tiles") == before


def test_other_visits_with_the_same_events_make_another_plan(case, survey):
    """Regression: a finished survey was returned with the requested visits of the earlier plan."""
    survey.record(events(tile=11, date="2026-01-03"))
    for number in (1, 2):
        state = survey.state(case[0], visits=number)
        again = replan(case, survey, visits=state)
        assert (again.outcomes["requested"] == state.requested).all()
        assert differences(again, rs.plan_survey(*case, visits=state, allocator="nearest")) == []


def test_a_dropped_tile_needs_a_plan_before_it_is_observed(case, survey):
    """Regression: a KeyError was raised."""
    survey.record(events(tile=13, state="dropped"))
    again = replan(case, survey)
    before = content(survey.folder)
    sentence = r"tile 13 was observed must be one of [0-9a-f]{16} \(generation 1\), got no date"
    for table in (events(tile=13, state="done"), events(tile=13, positioner=1)):
        with pytest.raises(rs.InputError, match=sentence):
            again.record(table)
    assert content(survey.folder) == before
    again.record(events(tile=13, state="planned"))
    with pytest.raises(rs.InputError, match=sentence):
        again.record(events(tile=13, state="done"))
    assert replan(case, again).record(events(tile=13, state="done"))["n_events"] == 1


@pytest.mark.filterwarnings("ignore::rfpsurvey.RfpsurveyWarning")
def test_tiles_without_a_plan_have_no_verdict_and_observed_tiles_are_not_checkable_for_new_rules(case, survey):
    """A rule that the plan of an observed tile did not have, or a dropped tile, never counts as passed."""
    case = replace(case[0], extra=QTable({"mag": np.full(len(case[0]), 15.0)})), *case[1:]
    plans = rs.plan_survey(*case, allocator="nearest", folder=survey.folder.with_name("other"))
    plans.record(events(tile=[11, 13], date="2026-01-03", state=["done", "dropped"]))
    options = rs.AllocationOptions("nearest", constraints="magnitude mag 10 20")
    again = rs.plan_survey(*case, allocator=options, visits=plans.state(case[0]))
    row = again.rules[0]
    assert (row["pass"], row["fail"], row["not checkable"]) == (len(case[2]) - 2, 0, 1)
    assert again.tiles["not_checkable"].tolist()[0] == row["rule"]


def test_a_moved_tile_needs_a_plan_before_it_is_observed(case, survey):
    """Regression: the plan for the former position was recorded as the plan of the observation."""
    row, moved = survey.tiles[2], events(tile=13, state="added", ra=120.05, dec=30.05)
    same = events(tile=13, state="added", ra=row["ra"].value, dec=row["dec"].value)  # in its present place
    assert survey.record(same) == {"n_events": 0, "n_known": 1, "n_ignored": 0, "changes": {}}
    assert survey.record(moved)["n_events"] == 1
    with pytest.raises(rs.InputError, match="tile 13 has no plan yet; plan the survey again"):
        survey.record(events(tile=13, state="done"))
    again = replan(case, survey)
    assert (again.record(moved)["n_known"], again.tiles["ra"][2].value) == (1, 120.05)
    assert again.record(events(tile=13, state="done"))["n_events"] == 1


@pytest.mark.parametrize("angle", [0.0, 370.0, -20.0])
def test_an_added_tile_is_planned_and_observed(case, survey, angle):
    new = events(tile=20, state="added", ra=-240.0, dec=30.05, position_angle=angle)
    survey.record(new)
    assert survey.record(new) == {"n_events": 0, "n_known": 1, "n_ignored": 0, "changes": {}}
    with pytest.raises(rs.InputError, match="tile 20 has no plan yet; plan the survey again"):
        survey.record(events(tile=20, state="done"))
    again = replan(case, survey)
    assert (len(again), again.record(new)["n_known"]) == (7, 1)
    # a survey that was read before it was planned again records the same
    assert survey.record(events(tile=20, date="2026-01-03"))["n_events"] == 1
    assert replan(case, survey).tiles["state"][6] == "done"


def test_a_wrong_date_is_corrected(case, survey):
    """Regression: after a date in the far future, no later observation could be recorded, even if it was canceled."""
    survey.record(events(tile=[11, 12], date=["2062-01-03", "2026-01-04"]), allow_future=True)
    replan(case, survey)
    survey.record(events(tile=11, state="planned"))
    assert survey.record(events(tile=[11, 13], date=["2026-01-03", "2026-01-05"]))["n_events"] == 2
    again = replan(case, survey)
    assert again.tiles["date"].tolist() == ["2026-01-03", "2026-01-04", "2026-01-05", "", "", ""]


def test_a_tile_is_observed_only_once(case, survey):
    """Regression: if an earlier observation was corrected, the visits of the tile were counted twice."""
    survey.record(events(tile=11, date="2026-01-03", state="partly"))
    survey.record(events(tile=11, date="2026-01-04"))
    before = survey.state(case[0]).observed
    with pytest.raises(rs.InputError, match="tile 11 must be observed only once, got .*-03 and on 2026-01-04"):
        survey.record(events(tile=11, date="2026-01-03"))
    assert (survey.state(case[0]).observed == before).all()
    survey.record(events(tile=11, date="2026-01-04", state="bad"))
    survey.record(events(tile=11, date="2026-01-03"))
    assert (survey.state(case[0]).observed == before).all()


def test_the_failures_of_a_corrected_observation_are_those_of_its_plan(case, survey):
    """Regression: targets that failed were looked up in the present plan of the tile."""
    first = survey.tile(11)
    survey.record(events(tile=11, date="2026-01-03", state="bad"))
    survey.record(events(target=first["target_id"][:2].tolist(), state="dropped"))
    second = replan(case, survey)
    only = sorted({*first["target_id"].tolist()} - {*second.tile(11)["target_id"].tolist()})
    assert only
    second.record(events(tile=[11, 11], target=["", str(only[0])], state=["done", ""], date="2026-01-03"))
    state = second.state(case[0])
    assert (state.failed[case[0].id == only[0]], state.observed[case[0].id == only[0]]) == (1, 0)


def test_added_targets_in_observed_fields_have_the_same_outcome_without_checkpoint(case, survey):
    """Regression: targets added after an observation were not marked as inside its field, unlike without checkpoint."""
    survey.record(events(tile=survey.tiles["tile"].tolist(), date="2026-01-03"))
    replan(case, survey)
    new = events(target=[5000 + k for k in range(40)], priority=[1] * 40)
    rng = np.random.default_rng(1)
    new["ra"], new["dec"] = rng.uniform(119.7, 120.3, 40), rng.uniform(29.7, 30.3, 40)
    survey.record(new)
    one = replan(case, survey)
    (survey.folder / "events/state.npz").unlink()
    other = rs.plan_survey(*case, visits=survey.state(case[0]), allocator="nearest")
    assert differences(one, other) == []
    assert "out of reach" in one.outcome_names[-40:]


@pytest.mark.filterwarnings("ignore:required targets never observed")
def test_a_dropped_target_is_not_planned_even_if_it_is_required(case, tmp_path):
    """Regression: at least one visit of each required target was requested, also of dropped targets."""
    options = rs.AllocationOptions("nearest", required=case[0].id.tolist())
    survey = rs.plan_survey(*case, folder=tmp_path / "survey", allocator=options)
    gone = np.unique(survey.targets["target_id"][survey.targets["observed"]])[:5].tolist()
    survey.record(events(target=gone, state="dropped"))
    for folder in (survey.folder, None):
        again = replan(case, survey, folder=folder, resume=folder is not None, allocator=options)
        assert not np.isin(again.targets["target_id"], gone).any()
        assert not again.outcomes["requested"][np.isin(case[0].id, gone)].any()


def test_a_folder_planned_with_the_events_of_another_folder_takes_no_records(case, survey, tmp_path):
    """Regression: the first record in such a folder began a new history without the earlier observations."""
    survey.record(events(tile=11, date="2026-01-03"))
    state = survey.state(case[0])
    copy = rs.plan_survey(*case, folder=tmp_path / "copy", visits=state, allocator="nearest")
    assert differences(copy, replan(case, survey)) == []
    for use in (lambda: copy.record(events(tile=12, date="2026-01-05")), lambda: copy.state(case[0])):
        with pytest.raises(rs.InputError, match=r"000001\.json is missing, although .* was planned with 1 file of"):
            use()


RULES = ["magnitude g 14 inf science", "distribution sky 1 100 5"]


@pytest.mark.filterwarnings("ignore::rfpsurvey.RfpsurveyWarning")
@pytest.mark.parametrize("state", ["done", "partly"])
@pytest.mark.parametrize(
    ("first", "then", "unknown"),
    [
        (RULES, RULES, []),
        (RULES, RULES[::-1], []),
        (RULES[1:], RULES[:1], RULES[:1]),
        (["standard=3"], ["sky=1", "standard=3"], ["sky=1"]),
        (["sky=2"], ["standard=3"], ["standard=3"]),
        ([], [*RULES, "sky=2"], [*RULES, "sky=2"]),
    ],
)
def test_constraints_of_kept_tiles(tmp_path, state, first, then, unknown):
    """Regression: numbers of other constraints were used, or all rules of observed tiles were not checkable."""
    sky = targets(kinds=True)
    sky = replace(sky, extra=QTable({"g": np.full(len(sky), 15.0)}))
    case = sky, instrument(), tiling(n=2)
    options = {"folder": tmp_path / "survey"}
    survey = rs.plan_survey(*case, allocator=rs.AllocationOptions("nearest", constraints=first), **options)
    before = {row["rule"]: row for row in survey.rules} if first else {}
    survey.record(events(tile=11, date="2026-01-03", state=state))
    allocator = rs.AllocationOptions("nearest", constraints=then)
    found = rs.plan_survey(*case, allocator=allocator, visits=survey.state(sky), folder=tmp_path / "other")
    unknown = [str(one) for one in rs.constraints.as_constraints(unknown)]
    assert {row["rule"] for row in found.rules} == {str(one) for one in rs.constraints.as_constraints(then)}
    for row in found.rules:
        assert row["pass"] + row["fail"] + row["not checkable"] == 2
        if row["rule"] in unknown:
            assert row["not checkable"] >= 1
        elif first == then:
            assert row["not checkable"] == before[row["rule"]]["not checkable"]
    assert {*found.tiles["not_checkable"][0].split(", ")} - {""} >= {*unknown} if unknown else True
    assert rs.Survey.read(tmp_path / "other").rules.as_array().tolist() == found.rules.as_array().tolist()
