"""The status of a survey agrees with its plans and its events, which are counted one by one."""

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import QTable, Table

import rfpsurvey as rs
from rfpsurvey.survey import SurveyState, VisitRule, survey_status

CENTER = SkyCoord(95, 23, unit="deg")


TILES = QTable({"ra": [94.7, 95.3, 94.8, 95.2] * u.deg, "dec": [23, 23, 23.1, 23.1] * u.deg, "pass": [1, 1, 2, 2]})


@pytest.fixture(scope="module")
def sky():
    sky = rs.synthetic_catalog("poisson", CENTER, 1 * u.deg, density=400 / u.deg**2, rng=3)
    rng = np.random.default_rng(2)
    kind = np.where(np.arange(len(sky)) % 10 == 0, "sky", "science")
    numbers = {"priority": rng.integers(1, 4, len(sky)), "visits": rng.integers(0, 4, len(sky))}
    return rs.Catalog(sky.coord, **numbers, category=rng.choice(["a", "b"], len(sky)), kind=kind)


@pytest.fixture
def survey(sky, small, tmp_path):
    """Return a survey of four tiles in two passes."""
    options = {"allocator": "lamost_rule", "folder": tmp_path / "plan"}
    return rs.plan_survey(sky, small, TILES, **options)


def record(survey, states, dates=("2026-01-03",) * 4):
    survey.record(Table({"tile": np.arange(len(states)), "date": list(dates[: len(states)]), "state": states}))


def count(sky, survey, closed, done, failed=()):
    """Return the numbers of requested, observed and planned visits of each target, counted one by one."""
    requested = np.where(sky.kind == "science", sky.visits, 0).astype(int)
    observed, planned = np.zeros(len(sky), int), np.zeros(len(sky), int)
    for tile in range(4):
        for visit in survey.tile(tile):
            row = int(visit["target_row"])
            if not visit["observed"]:
                continue
            if tile in done:
                observed[row] += (tile, str(visit["positioner"])) not in failed
            elif tile not in closed:
                planned[row] += 1
    observed = np.minimum(observed, requested)
    return requested, observed, np.minimum(planned, requested - observed)


def check(status, sky, requested, observed, planned):
    parts = status["n_planned"] + status["n_not_assigned"] + status["n_lost"] + status["n_impossible"]
    assert (status["n_left"] == parts).all()
    assert (status["n_left"] == status["n_requested"] - status["n_observed"]).all()
    for row in status:
        rows = np.ones(len(sky), dtype=bool)
        if row["priority"] != "all":
            rows &= sky.priority == int(row["priority"])
        if row["category"] != "all":
            rows &= sky.category == row["category"]
        expected = [one[rows].sum() for one in (requested, observed, planned)]
        assert [row[name] for name in ("n_requested", "n_observed", "n_planned")] == expected
        assert row["n_targets"] == (requested[rows] > 0).sum()
        assert row["n_complete"] == ((requested > 0) & (observed == requested))[rows].sum()


def test_all_visits_are_planned_before_the_first_night(sky, survey):
    status = survey_status(survey, survey.state(sky))
    assert len(status) == 6
    check(status, sky, *count(sky, survey, (), ()))
    assert status["n_planned"][0] == survey.summary["n_visits_observed"]
    assert status.meta["is_planned"]
    outcomes = survey.outcome_names
    left = survey.outcomes["requested"] * (survey.outcomes["observed"] == 0)
    assert status["n_impossible"][0] == left[np.isin(outcomes, ("in no field", "out of reach"))].sum() > 0
    assert status["n_lost"][0] == left[outcomes == "lost to a collision"].sum() > 0


def test_visits_are_counted_from_the_plans_until_the_survey_is_planned_again(sky, survey, small):
    record(survey, ["done", "partly", "dropped"])
    bad = survey.tile(0)["positioner"][:2].tolist()
    survey.record(Table({"tile": [0, 0], "positioner": bad, "date": ["2026-01-03"] * 2}))
    state = survey.state(sky)
    failed = {(0, str(one)) for one in bad}
    status = survey_status(survey, state)
    assert not status.meta["is_planned"]
    check(status, sky, *count(sky, survey, (0, 2), (0,), failed))
    again = rs.plan_survey(sky, small, TILES, allocator="lamost_rule", visits=state, folder=survey.folder, resume=True)
    status = survey_status(again, again.state(sky))
    assert status.meta["is_planned"]
    check(status, sky, *count(sky, again, (0, 2), (0,), failed))
    assert status.meta["tiles"] == [
        {"pass": 1, "observed": 1, "partly observed": 1, "bad": 0, "dropped": 0, "planned": 0},
        {"pass": 2, "observed": 0, "partly observed": 0, "bad": 0, "dropped": 1, "planned": 1},
    ]
    again.record(Table({"tile": [3], "date": ["2026-01-09"], "state": ["bad"]}))
    bad = survey_status(again, again.state(sky)).meta["tiles"][1]
    assert bad == {"pass": 2, "observed": 0, "partly observed": 0, "bad": 1, "dropped": 1, "planned": 0}


def test_progress_is_that_of_the_observed_tiles(sky, survey):
    record(survey, ["done", "done", "bad", "done"], ("2026-01-05", "2026-01-03", "2026-01-03", "2026-01-05"))
    state = survey.state(sky)
    status = survey_status(survey, state)
    progress = status.meta["progress"]
    assert (progress["date"], progress["n_tiles"]) == (["2026-01-03", "2026-01-05"], [1, 3])
    assert progress["n_observed"]["all"][-1] == state.observed.sum() == status["n_observed"][0]
    classes = [values[-1] for name, values in progress["n_observed"].items() if name != "all"]
    assert (sum(classes), status["n_failed"][0]) == (status["n_observed"][0], state.failed.sum())
    earlier = survey_status(survey, survey.state(sky, until="2026-01-04"))
    assert earlier["n_observed"][0] == progress["n_observed"]["all"][0]
    assert earlier["n_planned"][0] > status["n_planned"][0]


def test_visits_that_are_no_longer_requested_are_not_counted_by_class(sky, survey):
    record(survey, ["done"] * 4, ("2026-01-03", "2026-01-04", "2026-01-05", "2026-01-05"))
    made = survey.state(sky).observed
    several = sky.id[(made >= 2) & (sky.kind == "science")]
    assert len(several) > 3
    survey.record(Table({"target": several, "visits": np.ones(len(several), dtype=int)}))
    status = survey_status(survey, survey.state(sky))
    progress = status.meta["progress"]
    assert progress["n_observed"]["all"][-1] == made.sum()
    counted = progress["n_counted"]
    assert [values[-1] for values in counted] == status["n_observed"].tolist()
    assert counted[0][-1] == made.sum() - (made[several] - 1).sum()
    earlier = survey_status(survey, survey.state(sky, until="2026-01-03"))
    assert earlier["n_observed"][0] == counted[0][0]


def test_added_tiles_and_targets_are_part_of_the_status(sky, survey):
    survey.record(Table({"tile": [9], "state": ["added"], "ra": [95.0], "dec": [23.0], "pass": [3]}))
    place = {"state": ["added"], "ra": [95.0], "dec": [23.0]}
    survey.record(Table({"target": [10**6], **place, "priority": [9], "visits": [2]}))
    status = survey_status(survey, survey.state(sky))
    assert (status.meta["tiles"][-1]["pass"], status.meta["tiles"][-1]["planned"]) == (3, 1)
    (row,) = status[status["priority"] == "9"]
    assert (row["n_requested"], row["n_not_assigned"]) == (2, 2)


def test_the_plan_of_a_moved_tile_is_not_counted(sky, survey):
    survey.record(Table({"tile": [3], "state": ["added"], "ra": [95.0], "dec": [23.0], "pass": [2]}))
    status = survey_status(survey, survey.state(sky))
    check(status, sky, *count(sky, survey, (3,), ()))


def test_dropped_targets_require_no_visit(sky, survey):
    survey.record(Table({"target": sky.id[sky.priority == 3], "state": ["dropped"] * int((sky.priority == 3).sum())}))
    status = survey_status(survey, survey.state(sky))
    assert "3" not in status["priority"]


def test_a_rule_determines_the_requested_visits(sky, survey):
    record(survey, ["done"])
    status = survey_status(survey, survey.state(sky, rule=VisitRule(visits=5)))
    assert status["n_requested"][0] == 5 * (sky.kind == "science").sum()
    assert not status.meta["is_planned"]


def test_the_state_must_be_that_of_the_survey(sky, survey, small, tmp_path):
    other = rs.plan_survey(sky, small, TILES, folder=tmp_path / "other")
    for words, given in (
        ("state must be the state of the survey", (survey, other.state(sky))),
        ("state must be a SurveyState", (survey, None)),
        ("survey must be a Survey", (None, other.state(sky))),
    ):
        with pytest.raises(rs.InputError, match=words):
            survey_status(*given)


def test_the_first_plan_follows_a_rule_as_the_state_without_events(sky, small, tmp_path):
    """A rule as the parameter visits gives the plan of a state without events."""
    rule = VisitRule(after_success=3, table=Table({"class": ["a", "b"], "priority": [1.0, 2.0]}))
    first = rs.plan_survey(sky, small, TILES, visits=rule)
    state = SurveyState.read(tmp_path / "none", sky, rule=rule)
    second = rs.plan_survey(state.catalog, small, TILES, visits=state.requested)
    assert (first.targets == second.targets).all()
    assert set(first.outcomes["requested"].tolist()) == {0, 1}
    assert set(first.targets["priority"][first.targets["kind"] == "science"].tolist()) == {1.0, 2.0}


def test_areas_contain_all_requested_visits(sky, survey):
    """Each rectangle contains the visits of the targets between its limits."""
    record(survey, ["done"])
    state = survey.state(sky)
    status = survey_status(survey, state)
    areas = status.meta["areas"]
    assert 4 <= len(areas) <= 20
    for name in ("n_requested", "n_observed", "n_planned"):
        assert sum(area[name] for area in areas) == status[name][0] > 0
    requested = np.where(sky.kind == "science", sky.visits, 0)
    for area in areas:
        (a, b), (c, d) = (map(float, area[one].split(" to ")) for one in ("ra", "dec"))
        inside = (sky.coord.ra.deg >= a) & (sky.coord.ra.deg < b) & (sky.coord.dec.deg >= c) & (sky.coord.dec.deg < d)
        assert area["n_requested"] == requested[inside].sum()
