"""Records keep what a table states; later records add to them, replace them or undo them."""

import csv
from dataclasses import replace

import numpy as np
import pytest
from astropy.time import Time
from living import content, events, instrument, targets, tiling

import rfpsurvey as rs
from rfpsurvey.survey._history._dates import to_date

NIGHT = "2026-01-03"


def failed(survey, tile=11):
    """Return the positioners that failed in the last observation of a tile."""
    (event,) = (event for event in survey.state().attempts if event.tile == str(tile))
    return [*event.failed]


def numbers(survey):
    """Return the numbers of the state of each target, and the states of the tiles."""
    state = survey.state()
    rows = {row: state.states.state_of(row).state for row in range(len(survey))}
    return [state.requested.tolist(), state.observed.tolist(), state.failed.tolist(), state.left.tolist(), rows]


@pytest.fixture
def grouped(tmp_path):
    """Return a survey of an instrument whose positioners are connected to two petals."""
    plane = replace(instrument().focal_plane, groups={"petal": np.array([0, 0, 0, 0, 1, 1, 1])})
    survey = rs.plan_survey(
        targets(), replace(instrument(), focal_plane=plane), tiling(), folder=tmp_path / "survey", allocator="nearest"
    )
    return survey, dict(zip(plane.id.astype(str).tolist(), plane.groups["petal"].tolist(), strict=True))


@pytest.mark.parametrize("column", ["petal", "spectrograph", "PETAL"])
def test_a_spectrograph_that_fails_is_one_row(grouped, column):
    survey, petal_of = grouped
    survey.record(events(tile=11, date=NIGHT, reason=["", "no light"], **{column: ["", "1"]}))
    visited = survey.tile(11)["positioner"].astype(str).tolist()
    assert failed(survey) == sorted(name for name in visited if petal_of[name] == 1)
    survey.record(events(tile=11, date=NIGHT, good=True, **{column: "1"}))
    assert failed(survey) == []


def test_the_number_of_a_spectrograph_with_a_target_is_not_a_failed_spectrograph(grouped):
    survey, _ = grouped
    name = str(survey.tile(11)["positioner"][0])
    survey.record(events(tile=11, date=NIGHT, positioner=["", name], petal=["", "1"]))
    assert failed(survey) == [name]


def test_spectrographs_must_be_those_of_the_instrument(grouped, planned):
    with pytest.raises(rs.InputError, match="spectrograph must be a petal of the instrument, got '7'"):
        grouped[0].record(events(tile=11, date=NIGHT, petal=["", "7"]))
    with pytest.raises(rs.InputError, match=r"instrument \(none\), got the column 'petal'"):
        rs.Survey.read(planned).record(events(tile=11, date=NIGHT, petal=["", "1"]))


def test_a_second_list_of_failures_joins_or_replaces_the_first(survey):
    names = survey.tile(11)["positioner"].astype(str)[:4].tolist()
    survey.record(events(tile=11, date=NIGHT, positioner=["", *names[:2]]))
    survey.record(events(tile=11, date=NIGHT, positioner=names[2:3]))
    assert failed(survey) == sorted(names[:3])
    second = events(tile=11, date=NIGHT, positioner=names[3:])
    survey.record(second, replaces=True)
    assert failed(survey) == names[3:]
    assert survey.record(second, replaces=True)["n_known"] == 1
    survey.record(events(tile=11, date=NIGHT, positioner=names[:1], replaces=True))
    assert failed(survey) == names[:1]
    assert survey.state().summary["n_tiles_observed"] == 1  # the state remains


def test_a_record_keeps_the_rows_of_its_table(survey, tmp_path, monkeypatch):
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1767484800")
    table = events(TILEID=[12, 11], night=20260103, state=["obsend", "unobs"], comment=["clouds", "wind, snow"])
    table.write(tmp_path / "night.csv")
    with pytest.warns(rs.RfpsurveyWarning, match="columns that are not used: comment"):
        survey.record(tmp_path / "night.csv", note="first night")
    (row,) = survey.events()
    assert row["time"] == "2026-01-04T00:00:00+00:00"
    assert (row["note"], row["dates"], row["n_tiles"]) == ("first night", NIGHT, 1)
    assert row["table"] == str(tmp_path / "night.csv")
    with (survey.folder / "events" / row["rows"]).open(newline="") as file:
        rows = [*csv.reader(file)]
    assert rows == [["TILEID", "night", "state", "comment"], *[list(map(str, row)) for row in table]]


@pytest.mark.parametrize(
    ("value", "date"),
    [
        (61043, "2026-01-03"),
        ("61043.9", "2026-01-03"),
        (Time("2026-01-03T10:00:00"), "2026-01-03"),
        ("2026-01-03T20:00:00-07:00", "2026-01-04"),
        ("2026-01-04T03:00+0900", "2026-01-03"),
        (20260103, "2026-01-03"),
    ],
)
def test_dates(value, date):
    assert to_date(value) == date


def test_a_date_in_the_future_is_refused_unless_it_is_allowed(survey):
    for table in (events(tile=11, date="2901-01-03"), events(target=1001, visits=2, date="2901-01-03")):
        before = content(survey.folder)
        with pytest.raises(rs.InputError, match="date must not be later than tomorrow, got 2901-01-03; to record it"):
            survey.record(table)
        assert content(survey.folder) == before
        assert survey.record(table, allow_future=True)["n_events"] == 1


def test_undone_records_leave_no_trace_in_the_state(survey):
    """A wrong night with observations, failures, dropped tiles and changed targets is undone and restored."""
    name = str(survey.tile(11)["positioner"][0])
    survey.record(events(tile=[11, 12], date=NIGHT, state=["done", "partly"]))
    before, tables = (
        numbers(survey),
        [
            events(tile=[11, 13], date="2026-01-04", state=["bad", "done"])[1:],
            events(tile=11, date=NIGHT, positioner=name),
            events(tile=12, date=NIGHT, state="planned"),
            events(tile=14, state="dropped"),
            events(target=[1001, 1002], state=["dropped", ""], visits=[1, 3], priority=2),
        ],
    )
    states = [before]
    for table in tables:
        survey.record(table)
        states.append(numbers(survey))
        assert states[-1] != states[-2]
    for number in range(len(tables) + 1, 1, -1):
        assert survey.undo(number, dry_run=True)["undone"] == number
        survey.undo(number, note="wrong night")
        assert numbers(survey) == states[number - 2]
    records = survey.events()
    assert records["undone_by"].tolist() == [0, 11, 10, 9, 8, 7, 0, 0, 0, 0, 0]
    for number in range(11, 6, -1):
        assert survey.undo(number)["restored"] == 13 - number
    assert numbers(survey) == states[-1]
    with pytest.raises(rs.InputError, match="record 7 was already undone by record 16; to restore it, undo record 16"):
        survey.undo(7)


def test_added_tiles_and_targets_are_dropped_if_their_record_is_undone(case, survey):
    before = numbers(survey)[1:3]
    survey.record(events(tile=[30, 31], state="added", ra=[120.03, 120.1], dec=30.01))
    survey.record(events(target=[5000, 5001], visits=2, ra=120.1, dec=30.0, priority=2))
    survey.undo(1)
    survey.undo(2)
    survey.record(events(tile=32, state="added", ra=119.9, dec=30.0))
    again = survey.replan()
    assert again.tiles["tile"].tolist()[-3:] == [30, 31, 32]
    assert again.tiles["state"].tolist()[-3:] == ["dropped", "dropped", "planned"]
    assert again.outcomes["requested"].tolist()[-2:] == [0, 0]
    assert numbers(again)[1][:60] == before[0]
    again.record(events(target=5000, state="planned"))
    assert again.state().left.tolist()[-2:] == [2, 0]


def test_a_tile_that_was_undone_after_a_new_plan_is_observed_again(survey):
    survey.record(events(tile=[11, 12], date=NIGHT))
    first, again = survey.tile(11), survey.replan()
    again.undo(1)
    assert again.replan().tiles["state"].tolist()[:2] == ["planned", "planned"]
    again.undo(2)  # the plans with which the tiles were observed are kept
    restored = again.replan()
    assert restored.tiles["state"].tolist()[:2] == ["done", "done"]
    assert (restored.tile(11) == first).all()
    assert len(rs.survey.verify_survey(again.folder)) == 0


DONE = events(tile=11, date=NIGHT)
CANCELED = [DONE, events(tile=11, state="planned")]
DEPENDENT = {
    "record 2 must .* because it lists visits of an observation of tile 11": [
        (DONE, events(tile=11, date=NIGHT, positioner="0")),
        1,
    ],
    "record 3 must .* because it observes tile 11, which would be finished": [
        (DONE, events(tile=11, date=NIGHT, state="bad"), events(tile=11, date="2026-01-04")),
        2,
    ],
    "record 2 must .* because it observes tile 11 at its new position": [
        (events(tile=11, state="added", ra=120.05, dec=30.0), None, events(tile=11, date="2026-01-04")),
        1,
    ],
    "record 3 must .* because it drops tile 11, which would be finished": [
        (*CANCELED, events(tile=11, state="dropped")),
        2,
    ],
    "record 3 must .* because it moves tile 11, which would be observed": [
        (*CANCELED, events(tile=11, state="added", ra=120.05, dec=30.0)),
        2,
    ],
}


@pytest.mark.parametrize("sentence", DEPENDENT)
def test_records_on_which_others_depend_are_not_undone(survey, sentence):
    tables, number = DEPENDENT[sentence]
    for table in tables:
        survey.replan() if table is None else survey.record(table)
    before = content(survey.folder)
    with pytest.raises(rs.InputError, match=sentence):
        survey.undo(number)
    assert content(survey.folder) == before


@pytest.mark.parametrize("number", [0, 2, -1, 1.0, "1", True, None])
def test_wrong_numbers_of_records_are_refused(survey, number):
    survey.record(events(tile=11, date=NIGHT))
    with pytest.raises(rs.InputError, match="the number of the record to undo must be a whole number from 1 to 1, got"):
        survey.undo(number)


def test_repeated_failures_of_a_positioner_are_summed(survey):
    both = sorted({*survey.tile(11)["positioner"].astype(str)} & {*survey.tile(12)["positioner"].astype(str)})
    tile, positioner = [11, 12, 11, 12, 11], ["", "", both[0], both[0], both[1]]
    reason = ["", "", "broken", "not on target", ""]
    survey.record(events(tile=tile, date="2026-01-03", positioner=positioner, reason=reason))
    failures = survey.status().meta["failures"]
    assert failures == [{"positioner": both[0], "n_failed": 2, "reasons": "broken, not on target"}]
