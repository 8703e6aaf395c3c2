import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from raising import refused

import rfpsurvey as rs
from rfpsurvey.constraints import Motion, as_constraints

CENTER = SkyCoord("06h20m +23d")
NUMBERS = ("n_unfolding_pairs", "n_unfolding_obstacle_collisions", "n_needs_planner")


@pytest.fixture(scope="module")
def sky():
    return rs.example_catalog("anticenter")


def test_the_text_form_contains_the_law_of_time():
    assert as_constraints("motion fold") == (Motion("fold"),)
    (one,) = as_constraints("motion fold same_speed")
    assert (str(one), one.motion_law) == ("motion fold same_speed", "same_speed")
    assert rs.AllocationOptions(constraints=one).record["constraints"] == ["motion fold same_speed"]
    refused("the constraint must have the form 'motion MOTION LAW'", as_constraints, "motion")
    refused("kind of motion 'unfold'", as_constraints, "motion unfold")
    refused("law of time 'slowly'", as_constraints, "motion fold slowly")


def test_plans_with_safe_motion_need_no_path_planner_and_state_it(sky):
    options = rs.AllocationOptions("optimal", constraints="motion fold")
    tile = rs.plan_tile(sky, "sdss_apo", CENTER, allocator=options)
    plain = rs.plan_tile(sky, "sdss_apo", CENTER, allocator="optimal")
    assert [tile.summary[name] for name in NUMBERS] == [0, 0, 0]
    assert not tile.table["needs_planner"].any()
    (row,) = tile.rules
    assert (row["rule"], row["number"], row["verdict"]) == ("motion fold same_duration", 0, "pass")
    assert tile.summary["unmet"] == []
    assert not {*NUMBERS} & {*plain.summary}
    assert "needs_planner" not in plain.table.colnames
    objectives = (np.array([row[1:] for row in one.summary["objectives"]]) for one in (tile, plain))
    (value, bound), (most, _) = (one.T for one in objectives)
    assert (value == bound).all()
    assert tuple(value) <= tuple(most)


def test_idle_positioners_of_a_plan_with_safe_motion_collide_on_the_way_to_free_targets(sky):
    options = rs.AllocationOptions("optimal", constraints="motion fold")
    tile = rs.plan_tile(sky, "sdss_apo", CENTER, allocator=options)
    reasons, counts = np.unique(tile.idle["reason"], return_counts=True)
    assert "a free target in reach was not assigned" not in reasons
    assert counts[reasons == "at every free target in reach the arm would collide"] > 5
    assert not tile.idle["n_possible"].any()


def test_a_score_counts_the_collisions_of_the_motion(sky):
    plain = rs.plan_tile(sky, "sdss_apo", CENTER, allocator="optimal")
    scored = rs.score_tile(plain.table, "sdss_apo", constraints="motion fold")
    assert scored.summary["n_colliding"] == 0
    assert scored.summary["n_needs_planner"] == scored.table["needs_planner"].sum() > 50
    assert scored.summary["n_unmet"] == 1
    assert scored.summary["unmet"] == [
        f"motion fold same_duration: {scored.summary['n_needs_planner']} positioners need a path planner"
    ]
    assert scored.rules["verdict"][0] == "fail"
    safe = rs.plan_tile(sky, "sdss_apo", CENTER, allocator=rs.AllocationOptions("repair", constraints="motion fold"))
    again = rs.score_tile(safe.table, "sdss_apo", constraints="motion fold")
    assert [again.summary[name] for name in NUMBERS] == [0, 0, 0]


def test_rules_of_assignment_only_check_the_motion(sky):
    options = rs.AllocationOptions("lamost_rule", constraints="motion fold")
    with pytest.warns(rs.errors.RfpsurveyWarning, match="except that plans are checked; optimal, repair can honor"):
        tile = rs.plan_tile(sky, "sdss_apo", CENTER, allocator=options)
    plain = rs.plan_tile(sky, "sdss_apo", CENTER, allocator="lamost_rule")
    assert (tile.table["target_id"] == plain.table["target_id"]).all()
    assert tile.summary["n_needs_planner"] >= tile.summary["n_colliding"] > 0


def test_an_instrument_whose_folded_arms_can_touch_is_told_with_the_pairs():
    unit = rs.Positioner(8 * u.mm, 17 * u.mm, 2 * u.mm, phi_range=[0, 150] * u.deg)
    plane = rs.FocalPlane([[0, 0], [25, 0], [80, 0]] * u.mm, unit, id=["a", "b", "c"])
    instrument = rs.Instrument("test", plane, plate_scale=100 * u.mm / u.deg)
    with pytest.warns(rs.errors.RfpsurveyWarning, match=r"1 pair of positioners can touch \(a-b\)"):
        rs.AllocationOptions("optimal", constraints="motion fold").for_instrument(instrument)


@pytest.mark.parametrize("allocator", ["repair", "optimal", "joint"])
def test_surveys_honor_the_motion_and_have_its_columns(sky, allocator, tmp_path):
    options = rs.AllocationOptions("optimal" if allocator == "joint" else allocator, constraints="motion fold")
    if allocator == "joint":
        options = rs.JointOptions(iterations=1, allocator=options)
    tiles = SkyCoord([95, 95.7] * u.deg, [23, 23] * u.deg)
    survey = rs.plan_survey(sky, "sdss_apo", tiles, allocator=options, folder=tmp_path / "s")
    for name in NUMBERS:
        assert (survey.tiles[name].tolist(), survey.summary[name]) == ([0, 0], 0)
    assert (survey.tiles["n_assigned"] > 200).all()
    assert survey.tiles["n_unmet"].tolist() == [0, 0]


def test_surveys_with_rules_of_assignment_count_the_positioners_that_need_a_planner(sky):
    tiles = SkyCoord([95, 95.7] * u.deg, [23, 23] * u.deg)
    rules = rs.AllocationOptions("nearest", constraints="motion fold")
    with (
        pytest.warns(rs.errors.RfpsurveyWarning, match="except that plans are checked"),
        pytest.warns(rs.errors.RfpsurveyWarning, match="2 violations in 2 of 2 tiles"),
    ):
        checked = rs.plan_survey(sky, "sdss_apo", tiles, allocator=rules)
    assert (checked.tiles["n_needs_planner"] >= checked.tiles["n_colliding"]).all()
    assert checked.tiles["n_unmet"].tolist() == [1, 1]
    assert checked.summary["n_needs_planner"] == checked.tiles["n_needs_planner"].sum() > 0
