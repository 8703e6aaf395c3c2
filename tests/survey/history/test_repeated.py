"""Tables that are recorded again, that add to earlier tables, or that contradict them."""

import json

import pytest
from living import events

import rfpsurvey as rs
from rfpsurvey.survey._history import _events


def failed(survey, row=0):
    """Return the positioners of a tile that failed, according to the last event."""
    found = [
        one
        for path in sorted((survey.folder / "events").glob("*.json"))
        for one in json.loads(path.read_text())["events"]["tiles"]
    ]
    failed = next(one["failed"] for one in reversed(found) if one["row"] == row)
    return sorted(name for names in failed.values() for name in names)


def test_failures_of_several_tables_add_up(case, survey):
    """A list of finished tiles does not remove failures, and a second file of a night adds its own."""
    names = survey.tile(11)["positioner"].astype(str)[:3].tolist()
    survey.record(events(tile=11, date="2026-01-03", positioner=["", *names[:2]]))
    assert survey.record(events(tile=11, date="2026-01-03"))["n_known"] == 1
    survey.record(events(tile=11, date="2026-01-03", positioner=names[2:]))
    assert failed(survey) == sorted(names)
    survey.record(events(tile=11, date="2026-01-03", positioner=names[:1], good=True))
    assert failed(survey) == sorted(names[1:])
    assert survey.state(case[0]).failed.sum() == 2


def test_an_old_table_does_not_undo_a_correction(case, survey):
    old = events(tile=[11, 12], date="2026-01-03")
    survey.record(old)
    survey.record(events(tile=11, date="2026-01-03", state="bad"))
    with pytest.warns(rs.RfpsurveyWarning, match="tile 11 on 2026-01-03 was corrected after this record"):
        assert survey.record(old) == {"n_events": 0, "n_known": 2, "n_ignored": 0}
    assert survey.state(case[0]).summary["n_tiles_observed"] == 1
    survey.record(events(tile=11, state="planned"))
    assert survey.record(old)["n_events"] == 1
    assert survey.state(case[0]).summary["n_tiles_observed"] == 2


def test_a_bad_tile_is_not_a_failed_visit_of_its_targets(case, survey):
    """Nights with clouds do not use up the retries of a rule."""
    survey.record(events(tile=[11, 12], date="2026-01-03", state=["bad", "done"]))
    state = survey.state(case[0], rule=rs.survey.VisitRule(retries=0))
    assert state.failed.sum() == 0
    assert state.left.sum() == survey.state(case[0]).left.sum()


def test_an_observation_without_a_date_is_not_recorded_after_a_dated_plan(case, survey):
    survey.record(events(tile=11, date="2026-01-03"))
    survey = rs.plan_survey(*case, allocator="nearest", folder=survey.folder, visits=survey.state(case[0]), resume=True)
    with pytest.raises(rs.InputError, match="later than 2026-01-03, .* got no date; record each night before"):
        survey.record(events(tile=12))


def test_columns_without_a_role_are_listed(survey):
    with pytest.warns(rs.RfpsurveyWarning, match="columns that are not used: result; used: tile, date"):
        survey.record(events(tile=11, date="2026-01-03", result="bad"))


def test_a_removed_file_of_an_observed_tile_is_noticed(case, survey):
    survey.record(events(tile=11, date="2026-01-03"))
    plan = {"allocator": "nearest", "folder": survey.folder, "visits": survey.state(case[0]), "resume": True}
    rs.plan_survey(*case, **plan)
    (survey.folder / "tiles/000/000000.fits").unlink()
    with pytest.raises(rs.InputError, match="the plan with which the tile in row 0 was observed"):
        rs.plan_survey(*case, **plan)


def test_visits_of_the_first_plan_that_are_not_given_again_are_noticed(case, tmp_path):
    survey = rs.plan_survey(*case, visits=3, folder=tmp_path / "survey", allocator="nearest")
    with pytest.warns(rs.RfpsurveyWarning, match="the first plan requested 180 visits, but the catalog requests"):
        survey.state(case[0])
    assert survey.state(case[0], visits=3).left.sum() == 180


def test_thousands_of_failures_are_read(case, survey):
    """Regression: files of events with more than 100,000 values were written, but could not be read."""
    name = str(survey.tile(11)["positioner"][0])
    rows = ["", *[name] * 3]
    survey.record(events(tile=11, date="2026-01-03", positioner=rows, reason=["", *["x" * 50_000] * 3]))
    path = survey.folder / "events/000001.json"
    about = json.loads(path.read_text())["events"]
    about["tiles"][0]["failed"] = {"": [f"{name}-{k}" for k in range(120_000)]}
    body = json.dumps(about, separators=(",", ":"), sort_keys=True)
    path.write_text(_events.FRAME.format(_events._digest(body), body))
    assert len(_events.read_events(survey.folder).files[0].tiles[0].failed) == 120_000


@pytest.mark.filterwarnings("ignore:the survey was planned without the option subpriority")
def test_the_instrument_of_realizations_is_that_of_the_survey(case, survey):
    """Regression: another instrument with other positioners caused a KeyError."""
    survey.record(events(tile=11, date="2026-01-03", positioner=["", str(survey.tile(11)["positioner"][0])]))
    with pytest.raises(rs.InputError, match="instrument must be"):
        rs.selection_probabilities(survey.state(case[0]), "sdss_apo", case[2], 2, allocator="nearest")
    assert len(rs.selection_probabilities(survey.state(case[0]), *case[1:], 2, allocator="nearest")) == len(case[0])
