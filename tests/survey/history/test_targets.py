"""Tables that add, drop and change targets: columns of the catalog, and tables that are recorded again."""

from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from astropy.table import MaskedColumn, QTable, Table
from living import CENTER, events, replan

import rfpsurvey as rs


@pytest.fixture
def extended(case, tmp_path):
    """Return a catalog with further columns, and a survey with a rule on magnitudes."""
    extra = QTable({"g": np.full(60, 15.0, dtype=np.float32) * u.mag, "field": np.arange(60, dtype=np.int16)})
    extra["name"], extra["flag"] = [f"s{k}" for k in range(60)], np.arange(60) % 2 == 0
    sky = replace(case[0], extra=extra)
    options = rs.AllocationOptions("nearest", constraints="magnitude g 9 inf science")
    return sky, options, rs.plan_survey(sky, *case[1:], folder=tmp_path / "survey", allocator=options)


def new(**columns):
    """Return a table with two targets in the center of the field."""
    place = {"ra": CENTER.ra.deg + np.array([0.0, 0.01]), "dec": [30.0, 30.0], "priority": [9.0, 9.0]}
    return Table({"target": [5000, 5001], "state": ["added"] * 2, **place, **columns})


def test_added_targets_keep_the_columns_of_rules(case, extended):
    """Regression: a bright added star had a fiber, and the rule that excludes bright stars passed."""
    sky, options, survey = extended
    survey.record(events(tile=11, date="2026-01-03"))
    survey.record(new(g=[3.0, 12.0], field=[-7, 2**60], name=["bright", "a longer name"], flag=[True, False]))
    state = survey.state(sky)
    again = rs.plan_survey(sky, *case[1:], visits=state, folder=survey.folder, resume=True, allocator=options)
    found = {*again.targets["target_id"].tolist()}
    assert 5001 in found
    assert 5000 not in found
    assert again.rules["pass"][0] == len(case[2])
    extra = state.catalog.extra
    assert (extra["g"].unit, extra["g"].dtype) == (u.mag, sky.extra["g"].dtype)
    assert (extra["g"][-2:].value.tolist(), extra["name"][-2:].tolist()) == ([3.0, 12.0], ["bright", "a longer name"])
    assert extra["name"][:2].tolist() == ["s0", "s1"]
    assert (extra["flag"].tolist(), extra["field"][-2]) == ([*(np.arange(60) % 2 == 0).tolist(), True, False], -7)


def test_further_columns_of_known_targets_change(extended):
    sky, _, survey = extended
    survey.record(events(target=[1003, 1004], g=[8.0, np.nan], flag=[True, False]))
    survey.record(Table({"target": [1003, 1005], "name": MaskedColumn(["x", ""], mask=[False, True])}))
    extra = survey.state(sky).catalog.extra
    assert (extra["g"][3:6].value.tolist(), extra["name"][3:6].tolist()) == ([8.0, 15.0, 15.0], ["x", "s4", "s5"])
    assert extra["flag"][3:6].tolist() == [True, False, False]


def test_missing_truth_values_of_a_column_of_numbers_change_nothing(extended):
    """Regression: NaN was recorded as false."""
    sky, _, survey = extended
    before = survey.state(sky).catalog.extra["flag"].tolist()
    survey.record(events(target=sky.id[:3].tolist(), flag=[np.nan, 1.0, 0.0]))
    assert survey.state(sky).catalog.extra["flag"].tolist() == [before[0], True, False, *before[3:]]


def test_targets_of_two_tables_are_added_one_after_the_other(case, survey):
    for number in (5000, 5001):
        survey.record(events(target=number, state="added", ra=120.1, dec=30.0, priority=2, visits=number - 4999))
    state = survey.state(case[0])
    assert (state.catalog.id[-2:].tolist(), state.left[-2:].tolist()) == ([5000, 5001], [1, 2])


def test_columns_that_are_not_recorded_are_named(extended):
    sky, _, survey = extended
    with pytest.raises(rs.InputError, match="must have the column g, which the survey uses, got target"):
        survey.record(new(field=[1, 2]))
    text = "the values of field, flag, name are not recorded for all added targets; rules treat them as missing"
    with pytest.warns(rs.RfpsurveyWarning, match="the values of field, name, flag are not recorded|" + text):
        survey.record(new(g=[300.0, 1200.0] * u.cmag))
    assert survey.state(sky).catalog.extra["g"][-2:].value.tolist() == [3.0, 12.0]
    for wrong, sentence in (
        ({"g": ["a", "b"]}, "g must be numbers"),
        ({"g": [1.0, 2.0] * u.mm}, "g must have the unit mag, got mm"),
        ({"field": [0.5, 1.0]}, "field must be whole numbers, as in the catalog, got 0.5"),
        ({"flag": ["perhaps", "no"]}, "flag must hold booleans or numbers"),
    ):
        with pytest.raises(rs.InputError, match=sentence):
            survey.record(new(**wrong))


def test_a_dropped_target_that_is_added_is_observed_again(case, survey):
    """Regression: the target stayed dropped without a message."""
    place = case[0].coord[3]
    added = events(target=1003, state="added", ra=place.ra.deg, dec=place.dec.deg, priority=2.0)
    survey.record(events(target=1003, state="dropped"))
    assert survey.state(case[0]).dropped[3]
    survey.record(added)
    assert not survey.state(case[0]).dropped[3]
    survey.record(events(target=1003, state="dropped"))
    with pytest.warns(rs.RfpsurveyWarning, match="1 target, such as 1003, were changed after this record"):
        assert survey.record(added)["n_known"] == 1
    assert survey.state(case[0]).dropped[3]
    survey.record(events(target=1003, state="planned"))
    assert survey.record(added)["n_known"] == 1
    assert not survey.state(case[0]).dropped[3]


def test_old_tables_with_dates_do_not_undo_changes_of_targets(case, survey):
    """Regression: an old table of changes to targets undid later changes."""
    first = events(target=[1003, 1004], date="2026-01-03", visits=[5, 6])
    survey.record(first)
    survey.record(events(target=1003, date="2026-01-04", visits=2))
    with pytest.warns(rs.RfpsurveyWarning, match="1 target, such as 1003, were changed after this record"):
        assert survey.record(first)["n_known"] == 2
    assert survey.state(case[0]).requested[3:5].tolist() == [2, 6]
    assert survey.record(events(target=1003, date="2026-01-05", visits=5))["n_events"] == 1
    assert survey.state(case[0]).requested[3] == 5


@pytest.mark.filterwarnings("ignore:no target was observed")
def test_priorities_are_recorded_while_all_tiles_are_dropped(case, survey):
    """Regression: the survey seemed to have no priorities."""
    survey.record(events(tile=survey.tiles["tile"].tolist(), state="dropped"))
    again = replan(case, survey)
    assert again.record(events(target=1003, priority=7.0))["n_events"] == 1
    assert again.state(case[0]).catalog.priority[3] == 7


def test_targets_without_a_priority_have_the_priority_0(case, tmp_path):
    """An added target with a priority above 0 is observed first, also in all realizations of the survey."""
    plain, folder = rs.Catalog(case[0].coord, id=case[0].id), tmp_path / "survey"
    options = rs.AllocationOptions("nearest", subpriority=1)
    survey = rs.plan_survey(plain, *case[1:], folder=folder, allocator=options)
    survey.record(events(tile=11, date="2026-01-03"))
    observed = survey.tile(11)
    place = case[2].coord[1].spherical_offsets_by(0.04 * u.deg, 0.0 * u.deg)  # 8 mm from the central positioner
    with pytest.raises(rs.InputError, match="priority must be a finite number for every new target, got none for 5000"):
        survey.record(new(priority=[np.nan, 2.0]))
    table = events(target=[5000, 5001], state="added", ra=place.ra.deg, dec=place.dec.deg, priority=[-1.0, 2.0])
    survey.record(table)
    with pytest.raises(rs.InputError, match="priority must be a finite number for every new target, got none for 5002"):
        survey.record(events(target=5002, state="added", ra=120.0, dec=30.0))
    state = survey.state()
    assert state.catalog.priority.tolist() == [0.0] * 60 + [-1.0, 2.0]
    survey = survey.replan()
    assert (survey.tile(11) == observed).all()
    first = survey.tile(12)
    assert 5001 in first["target_id"][first["observed"]].tolist()
    assert first["priority"].tolist() == [2.0 if name == 5001 else 0.0 for name in first["target_id"].tolist()]
    status = {row["priority"]: row["n_targets"] for row in survey.status()}
    assert status == {"all": 62, "2": 1, "0": 60, "-1": 1}
    assert len(rs.survey.verify_survey(folder)) == 0
    assert survey.select(8).n_observed[-1] == 8
    with pytest.raises(rs.InputError, match="priority must be a finite number for every new target, got none for 5002"):
        survey.record(events(target=5002, state="added", ra=120.0, dec=30.0))
