"""Records keep what a table states; later records add to them, replace them or undo them."""

import csv
from dataclasses import replace

import numpy as np
import pytest
from astropy.time import Time
from living import content, events, instrument, targets, tiling

import rfpsurvey as rs
from rfpsurvey._survey.history.events import to_date

NIGHT = "2026-01-03"


@pytest.fixture
def grouped(tmp_path):
    """Return a survey of an instrument whose positioners are connected to two petals."""
    plane = replace(instrument().focal_plane, groups={"petal": np.array([0, 0, 0, 0, 1, 1, 1])})
    case = targets(), replace(instrument(), focal_plane=plane), tiling()
    return rs.plan_survey(*case, folder=tmp_path / "survey", allocator="nearest")


def test_the_number_of_a_spectrograph_with_a_target_is_not_a_failed_spectrograph(grouped):
    name = str(grouped.tile(11)["positioner"][0])
    grouped.record(events(tile=11, date=NIGHT, positioner=["", name], petal=["", "1"]))
    assert [[*event.failed] for event in grouped.state().attempts] == [[name]]


def test_spectrographs_must_be_those_of_the_instrument(grouped, planned):
    with pytest.raises(rs.InputError, match="spectrograph must be a petal of the instrument, got '7'"):
        grouped.record(events(tile=11, date=NIGHT, petal=["", "7"]))
    with pytest.raises(rs.InputError, match=r"instrument \(none\), got the column 'petal'"):
        rs.Survey.read(planned).record(events(tile=11, date=NIGHT, petal=["", "1"]))


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
        assert (content(survey.folder), survey.record(table, allow_future=True)["n_events"]) == (before, 1)


def test_undone_records_are_restored_once(survey):
    survey.record(events(tile=[11, 12], date=NIGHT, state=["done", "partly"]))
    for table in (events(tile=12, date=NIGHT, state="planned"), events(tile=14, state="dropped")):
        survey.record(table)
    for number in (3, 2):
        assert survey.undo(number, dry_run=True)["undone"] == number
        survey.undo(number, note="wrong night")
    assert survey.events()["undone_by"].tolist() == [0, 5, 4, 0, 0]
    assert [survey.undo(number)["restored"] for number in (5, 4)] == [2, 3]
    with pytest.raises(rs.InputError, match="record 4 was already undone by record 7; to restore it, undo record 7"):
        survey.undo(4)


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
