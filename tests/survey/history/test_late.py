"""Reports that arrive after the survey was planned again: the plan of the observation is known, or named."""

import living
import numpy as np
import pytest
from astropy.io import fits
from living import content, events

import rfpsurvey as rs

DAYS = {name: str(np.datetime64(f"2026-01-{name:02d}", "s").astype(int)) for name in (1, 5, 9)}


@pytest.fixture
def replanned(case, survey, monkeypatch):
    """Return a function that plans the survey again on a day of January, and the survey after the first time."""

    def replan(day, survey=survey):
        monkeypatch.setenv("SOURCE_DATE_EPOCH", DAYS[day])
        return living.replan(case, survey)

    survey.record(events(tile=11, date="2026-01-02"))
    survey.record(events(target=survey.tile(12)["target_id"][:2].tolist(), state="dropped"))
    return replan, replan(5)


def changed(survey, again):
    """Return the names of a tile whose plan changed and of a tile whose plan did not change."""
    same = {name: (survey[name] == again.tile(name)["target_id"].tolist()) for name in survey}
    return next(name for name in same if not same[name]), next(name for name in same if same[name])


def targets_of(survey):
    return {name: survey.tile(name)["target_id"].tolist() for name in (12, 13, 14, 15, 16)}


def refuse(survey, table, sentence):
    before = content(survey.folder)
    with pytest.raises(rs.InputError, match=sentence):
        survey.record(table)
    assert content(survey.folder) == before


def plan_id(survey, row):
    return fits.getheader(survey.folder / f"tiles/000/{row:06d}.fits", 1)["PLANID"]


def credited(survey, tile):
    """Return the targets of the plan with which a tile was observed."""
    state = survey.state()
    (event,) = (event for event in state.attempts if event.tile == str(tile))
    return state.events.visits(event)[0]["target_id"].tolist()


def test_an_observation_before_its_plan_changed_is_credited_to_the_plan_before(case, survey, monkeypatch):
    """Regression: a tile that was observed with an earlier plan was credited with the targets of the present plan."""
    before = targets_of(survey)
    survey.record(events(tile=11, date="2026-01-02"))
    survey.record(events(target=before[12][:2], state="dropped"))
    for day in (5, 9):
        monkeypatch.setenv("SOURCE_DATE_EPOCH", DAYS[day])
        again = living.replan(case, survey)
    other, same = changed(before, again)
    again.record(events(tile=[other, same], date="2026-01-04"))
    assert (credited(again, other), credited(again, same)) == (before[other], before[same])
    again.record(events(tile=other, state="planned"))
    again.record(events(tile=other, date="2026-01-05"))
    assert credited(again, other) == again.tile(other)["target_id"].tolist() != before[other]


def test_the_plan_in_a_table_must_be_one_of_the_tile(case, replanned):
    replan, again = replanned
    late = {"tile": 12, "date": "2026-01-04"}
    refuse(again, events(**late, plan="0123456789abcdef"), "must be one of .* got plan '0123456789abcdef'; give")
    refuse(again, events(**late, generation=3), "must be one of .* got generation '3'; give its digest")
    visits, old = again.tile(12), plan_id(again, 1)
    name = str(visits["target_id"][0])
    refuse(again, events(**late, plan=[old, "x"], target=["", name]), "plan must be the same in all")
    again.record(events(tile=12, date="2026-01-06", state="bad"))
    again.record(events(target=visits["target_id"][:1].tolist(), state="dropped"))
    again = replan(9, again)
    assert plan_id(again, 1) != old
    refuse(again, events(tile=12, date="2026-01-06", plan=plan_id(again, 1)), "plan must be that of the recorded")


def test_a_digest_names_the_plan_of_the_recorded_observation(case, survey, replanned):
    """Regression: a correction was refused after another plan with the same targets replaced the recorded plan."""
    replan, again = replanned
    digest, before = plan_id(again, 1), content(again.folder)["tiles/000/000001.fits"]
    again.record(events(tile=12, date="2026-01-06", state="bad"))
    near = case[0].coord.separation(case[2].coord[1]).deg < 0.2
    used = {target for names in targets_of(again).values() for target in names}
    again.record(events(target=[one for one in case[0].id[near].tolist() if one not in used], state="dropped"))
    again = replan(9, again)
    assert plan_id(again, 1) == digest
    assert content(again.folder)["tiles/000/000001.fits"] != before
    assert again.record(events(tile=12, date="2026-01-06", plan=digest))["n_events"] == 1


def test_a_survey_that_is_not_planned_again_keeps_the_dates_of_its_plans(case, survey, replanned):
    replan, again = replanned
    for _ in range(2):
        replan(9, again)
    assert again.record(events(tile=12, date="2026-01-05"))["n_events"] == 1


def test_a_generation_whose_plan_was_not_kept_is_refused(replanned):
    """Regression: the observation was credited to the plan before this generation."""
    replan, again = replanned
    again.record(events(target=again.tile(12)["target_id"][:2].tolist(), state="dropped"))
    again = replan(5, again)
    refuse(again, events(tile=12, date="2026-01-05", generation=2), "must be one of .* got generation '2'; give")


def test_the_plan_of_a_tile_that_is_dropped_in_the_present_plan_is_named(replanned):
    """Regression: the error stated that the tile had no plan, although the targets of the table are those of a plan."""
    replan, again = replanned
    names = again.tile(12)["target_id"].tolist()
    again.record(events(tile=12, state="dropped"))
    again, late = replan(9, again), {"tile": 12, "date": "2026-01-09"}
    refuse(again, events(**late), "must be one of .* got 2026-01-09; give its digest")
    again.record(events(**late, target=["", *map(str, names)], good=True))
    assert credited(again, 12) == names


def test_a_table_with_all_targets_of_an_earlier_plan_is_credited_to_this_plan(case, survey, monkeypatch):
    """A table with all targets of both plans is credited to the plan of its date, and its other targets are errors."""
    before = targets_of(survey)[12]
    survey.record(events(tile=11, date="2026-01-02"))
    survey.record(events(target=before[:2], state="dropped"))
    monkeypatch.setenv("SOURCE_DATE_EPOCH", DAYS[5])
    again = living.replan(case, survey)
    now, row = again.tile(12)["target_id"].tolist(), {"tile": 12, "date": "2026-01-09", "good": True}
    assert not {*before} <= {*now}
    refuse(again, events(**row, target=["", *map(str, {*before, *now})]), "must be a target of tile 12 with")
    again.record(events(**row, target=["", *map(str, before)]))
    assert credited(again, 12) == before
