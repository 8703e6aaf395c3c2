"""Tables that are recorded again, that add to earlier tables, or that contradict them."""

import json

import pytest
from living import events, replan

import rfpsurvey as rs
from rfpsurvey._survey.history import event_files as _event_files
from rfpsurvey._survey.history.replay import TileStates


def failed(survey):
    """Return the positioners of a tile that failed, according to all events."""
    return sorted(TileStates(_event_files.read_events(survey.folder).of_tiles()).attempts[-1].failed)


def test_an_observation_without_a_date_is_not_recorded_if_its_plan_changed_after_a_date(case, survey):
    survey.record(events(tile=11, date="2026-01-03"))
    survey.record(events(target=survey.tile(12)["target_id"][:2].tolist(), state="dropped"))
    survey = replan(case, survey)
    choices = r"must be one of [0-9a-f]{16} \(generation 1\), [0-9a-f]{16} \(generation 2 on 2026-01-01\), got no date"
    with pytest.raises(rs.InputError, match=choices):
        survey.record(events(tile=12, state="done"))
    assert survey.record(events(tile=12, state="done", generation=2))["n_events"] == 1


def test_columns_without_a_role_are_listed(survey):
    with pytest.warns(rs.RfpsurveyWarning, match="columns that are not used: result; used: tile, date"):
        survey.record(events(tile=11, date="2026-01-03", result="bad"))


def test_a_removed_file_of_an_observed_tile_is_noticed(case, survey):
    survey.record(events(tile=11, date="2026-01-03"))
    state = survey.state(case[0])
    replan(case, survey, visits=state)
    (survey.folder / "tiles/000/000000.fits").unlink()
    with pytest.raises(rs.InputError, match="the plan with which the tile in row 0 was observed"):
        replan(case, survey, visits=state)


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
    path.write_text(_event_files.FRAME.format(_event_files._digest(body), body))
    assert len(_event_files.read_events(survey.folder).files[0].tiles[0].failed) == 120_000


@pytest.mark.filterwarnings("ignore:the survey was planned without the option subpriority")
def test_the_instrument_of_realizations_is_that_of_the_survey(case, survey):
    """Regression: another instrument with other positioners caused a KeyError."""
    survey.record(events(tile=11, date="2026-01-03", positioner=["", str(survey.tile(11)["positioner"][0])]))
    with pytest.raises(rs.InputError, match="instrument must be"):
        rs.selection_probabilities(survey.state(case[0]), "sdss_apo", case[2], 2, allocator="nearest")
    assert len(rs.selection_probabilities(survey.state(case[0]), *case[1:], 2, allocator="nearest")) == len(case[0])


DATE = "2026-01-03"
DONE, BAD = events(tile=11, date=DATE, state="done"), events(tile=11, date=DATE, state="bad")


def failing(state="", positioner="1", good=False):
    """Return a table with a failed or good visit of a tile and, if a state is given, with the state of the tile."""
    if not state:
        return events(tile=11, date=DATE, positioner=positioner, good=good)
    return events(tile=11, date=DATE, state=[state, ""], positioner=["", positioner], good=[True, good])


HISTORIES = {
    "state corrected": [DONE, BAD],
    "failed visit added": [DONE, failing()],
    "state and failed visit in one table": [DONE, failing("bad")],
    "failed visit, then state": [DONE, failing(), BAD],
    "state, then failed visit": [DONE, BAD, failing()],
    "failed visit removed, then state": [failing("done"), failing(good=True), BAD],
    "bad tile becomes done with a failed visit": [BAD, failing("done")],
    "failed visit removed": [failing("done"), failing(good=True)],
    "good visit becomes failed": [failing("done", good=True), failing()],
    "good visit that changed nothing becomes failed": [DONE, failing(good=True), failing()],
    "only a visit, then state": [failing(), BAD],
    "several failed visits, then state": [failing("done"), failing(positioner="2"), failing("bad", "3")],
    "other fraction": [events(tile=11, date=DATE, fraction=0.5), DONE],
    "repeated after a bad observation": [DONE, BAD, events(tile=11, date="2026-01-05", state="done")],
    "without a date": [events(tile=11, fraction=0.5), events(tile=11, state="bad")],
}


def states_of(survey, sky):
    """Return what is known of tiles and targets after all records."""
    state = survey.state(sky)
    names = ("observed", "failed", "left", "last", "last_tile", "last_date")
    return state.summary, *(state.table[name].tolist() for name in names), state.states.attempts


@pytest.mark.filterwarnings("ignore:the state of tile 11")
@pytest.mark.parametrize("tables", HISTORIES.values(), ids=HISTORIES)
def test_tables_that_were_corrected_are_recorded_again(case, survey, tables):
    """Regression: events were compared after they were merged with earlier ones, and old tables undid corrections."""
    for table in tables:
        assert survey.record(table)["n_events"] == 1
    before = states_of(survey, case[0])
    for table in (*tables, *tables[::-1]):
        assert survey.record(table) == {"n_events": 0, "n_known": 1, "n_ignored": 0, "changes": {}}
        assert states_of(survey, case[0])[:-1] == before[:-1]


def test_a_part_of_an_old_table_is_known_and_new_statements_are_not(case, survey):
    """A list of finished tiles states less than the table of the night."""
    survey.record(failing("done"))
    survey.record(failing("bad", "2"))
    with pytest.warns(rs.RfpsurveyWarning, match="tile 11 on 2026-01-03 was corrected after this record"):
        assert survey.record(DONE)["n_known"] == 1
    assert survey.record(failing("done", "2"))["n_events"] == 1  # no table stated both before
    assert (survey.state(case[0]).summary["n_tiles_observed"], failed(survey)) == (1, ["1", "2"])


def test_old_tables_after_the_survey_was_planned_again_without_dates(case, survey):
    """Regression: an old table without a date became a second observation, with the present plan of the tile."""
    old = events(tile=[11, 11], state=["partly", ""], target=["", str(survey.tile(11)["target_id"][0])])
    survey.record(old)
    survey.record(events(tile=11, state="bad"))
    survey.record(events(target=survey.tile(11)["target_id"][1:3].tolist(), state="dropped"))
    survey = replan(case, survey)
    with pytest.warns(rs.RfpsurveyWarning, match="tile 11 was corrected after this record"):
        assert survey.record(old)["n_known"] == 1
    assert survey.state(case[0]).summary["n_tiles_partly_observed"] == 0


def test_old_tables_of_moved_dropped_and_canceled_tiles(case, survey):
    """Regression: an old table moved a tile back, dropped it, or canceled its later observations."""
    moves = [events(tile=30, state="added", ra=ra, dec=30.0) for ra in (120.0, 120.1)]
    for table in moves:
        survey.record(table)
    with pytest.warns(rs.RfpsurveyWarning, match="tile 30 was corrected after this record"):
        assert survey.record(moves[0])["n_known"] == 1
    assert survey.state(case[0]).tiling(case[2]).table["ra"][-1].value == 120.1
    cancel = events(tile=11, date="2026-01-04", state="planned")
    for table in (DONE, cancel, DONE):
        assert survey.record(table)["n_events"] == 1
    with pytest.warns(rs.RfpsurveyWarning, match="tile 11 on 2026-01-04 was corrected after this record"):
        assert survey.record(cancel)["n_known"] == 1
    assert survey.state(case[0]).summary["n_tiles_observed"] == 1
    drop = events(tile=12, date="2026-01-04", state="dropped")
    survey.record(drop)
    survey.record(events(tile=12, date="2026-01-06", fraction=0.5))
    with pytest.warns(rs.RfpsurveyWarning, match="tile 12 on 2026-01-04 was corrected after this record"):
        assert survey.record(drop)["n_known"] == 1
    assert survey.state(case[0]).summary["n_tiles_dropped"] == 0
    assert survey.record(events(tile=12, state="dropped"))["n_events"] == 1  # without a date, it is a new decision
    assert survey.state(case[0]).summary["n_tiles_dropped"] == 1
