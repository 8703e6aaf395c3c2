"""The labels of numbers state what is counted, and do not contradict each other."""

import numpy as np
import pytest
from astropy.coordinates import SkyCoord

import rfpsurvey as rs
from rfpsurvey.report._tile import _asked
from rfpsurvey.survey import survey_facts
from rfpsurvey.tile import tile_facts

CENTER = SkyCoord(95, 23, unit="deg")


@pytest.fixture(scope="module")
def sky(presets):
    return rs.synthetic_catalog("uniform", CENTER, 0.5 * presets["lamost"].field_radius, n_targets=900, rng=1)


def test_the_collision_rate_of_assigned_arms_comes_first(presets, sky):
    """Regression: with many parked arms, the collision rate was 0.0000 although many targets were lost."""
    tile = rs.plan_tile(sky, presets["lamost"], CENTER, allocator="balanced")
    facts, t = tile_facts(tile), tile.table
    names = [name for name in facts if "rate" in name or "and parked" in name]
    assert names == ["collision rate of assigned arms", "  of assigned and parked arms"]
    lost = np.asarray(t["in_collision"])[np.asarray(t["status"]) == "assigned"].sum()
    assert facts[names[0]] == lost / tile.summary["n_assigned"] > 3 * facts[names[1]] > 0


def test_one_rate_is_shown_if_no_arm_is_parked(presets):
    sky = rs.synthetic_catalog("uniform", CENTER, presets["moons"].field_radius, n_targets=900, rng=1)
    facts = tile_facts(rs.plan_tile(sky, presets["moons"], CENTER, allocator="balanced"))
    assert facts["collision rate of assigned arms"] > 0
    assert "  of assigned and parked arms" not in facts


@pytest.mark.parametrize("folder", [False, True])
def test_a_survey_states_how_many_assigned_arms_collide(presets, sky, tmp_path, folder):
    place = {"folder": tmp_path / "survey"} if folder else {}
    survey = rs.plan_survey(sky, presets["lamost"], CENTER.reshape(1), allocator="balanced", **place)
    if folder:  # the numbers of finished tiles are read from their files
        (tmp_path / "survey" / "tiles.fits").unlink()
        survey = rs.plan_survey(sky, presets["lamost"], CENTER.reshape(1), allocator="balanced", resume=True, **place)
    lost = int(survey.targets["in_collision"].sum())
    assert 0 < lost == survey.tiles["n_colliding_assigned"].sum() == survey.summary["n_colliding_assigned"]
    facts = survey_facts(survey)
    assert facts["  in collision"] == lost
    assert facts["  collision rate of assigned arms"] == pytest.approx(lost / survey.summary["n_assigned"])
    names = list(facts)
    assert names.index("  collision rate of assigned arms") < names.index("  fraction of assigned and parked")


def test_surveys_of_earlier_versions_have_no_rate_of_assigned_arms(presets, sky):
    survey = rs.plan_survey(sky, presets["lamost"], CENTER.reshape(1))
    for name in ("n_colliding_assigned", "collision_rate_assigned"):
        del survey.summary[name]
    del survey.tiles["n_colliding_assigned"]
    assert "  in collision" not in survey_facts(survey)
    axes = rs.plot.plot_quality(survey)
    assert "assigned and parked arms" in axes[3].get_legend().get_texts()[1].get_text()


@pytest.mark.parametrize(("parked", "expected"), [(True, "those that are parked"), (False, "none")])
def test_idle_arms_that_are_no_obstacles_are_not_called_obstacles(presets, sky, parked, expected):
    """Regression: "idle arms are obstacles: yes" stood beside "idle, not as obstacles: 2"."""
    tile = rs.plan_tile(sky, presets["lamost"], CENTER, allocator=rs.AllocationOptions(parked_obstacles=parked))
    asked = _asked(tile)
    assert "idle arms are obstacles" not in asked
    assert asked["idle arms that are obstacles"].startswith(expected)


def test_kinds_without_a_fiber_are_shown_with_0(presets, sky):
    """Regression: the numbers of fibers on standard stars and on sky were not shown if they were 0."""
    kind = np.array(["science", "standard", "sky"])[np.arange(len(sky)) % 3]
    facts = tile_facts(rs.plan_tile(rs.Catalog(sky.coord, kind=kind), presets["lamost"], CENTER))
    assert facts["    to science targets"] > 0
    assert facts["    to standard stars"] == facts["    to sky"] == 0
