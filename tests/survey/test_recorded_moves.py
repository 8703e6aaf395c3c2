"""Surveys that were begun with the moves of version 0.3, which recorded no moves, are continued with them."""

import json
import warnings

import astropy.units as u
import pytest
from living import CENTER, differences, events, tiling

import rfpsurvey as rs
from scenes import sdss_like

PLANE = rs.Instrument("small", sdss_like(), plate_scale=200 * u.mm / u.deg)
SKY = rs.synthetic_catalog("uniform", CENTER, 0.6 * u.deg, n_targets=300, rng=1)
MOVES = "was begun with the moves of version 0.3"


def plan(folder, moves="ejection", **options):
    options = {"allocator": rs.AllocationOptions("repair", moves=moves), **options}
    return rs.plan_survey(SKY, PLANE, tiling(), folder=folder, **options)


def test_a_survey_of_version_0_3_is_resumed(tmp_path):
    whole = plan(tmp_path / "whole", "exchange")
    assert differences(plan(tmp_path / "other"), whole)
    request = json.loads((tmp_path / "whole/survey.json").read_text())
    assert request["allocator"] == "repair"
    assert "moves" not in request
    assert "tie_seed" not in request
    (tmp_path / "whole/tiles.fits").unlink()
    (tmp_path / "whole/tiles/000/000003.fits").unlink()
    with pytest.warns(rs.RfpsurveyWarning, match="is planned again"), pytest.warns(rs.RfpsurveyWarning, match=MOVES):
        again = plan(tmp_path / "whole", resume=True)
    assert not differences(again, whole)


def test_the_rest_of_a_survey_of_version_0_3_is_planned_with_its_moves(tmp_path):
    for name in ("first", "second"):
        plan(tmp_path / name, "exchange").record(events(tile=[11, 12], date="2026-01-03", state="done"))
    with pytest.warns(rs.RfpsurveyWarning, match=MOVES):
        found = plan(tmp_path / "first", resume=True, visits=rs.Survey.read(tmp_path / "first").state(SKY))
    with warnings.catch_warnings():
        warnings.filterwarnings("error", message=MOVES)
        state = rs.Survey.read(tmp_path / "second").state(SKY)
        expected = plan(tmp_path / "second", "exchange", resume=True, visits=state)
    assert not differences(found, expected)


def test_other_moves_than_those_of_a_survey_are_refused(tmp_path):
    plan(tmp_path / "survey")
    with pytest.raises(rs.InputError, match="moves"):
        plan(tmp_path / "survey", "exchange", resume=True)
