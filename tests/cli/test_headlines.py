"""Lines of the output of commands state what their numbers mean, and the first lines state what is wrong."""

from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from astropy.table import QTable

import rfpsurvey as rs
from rfpsurvey.instrument import arm_classes

DEG = u.deg


@pytest.fixture
def plan_of_two(presets):
    """Return a plan of two positioners, one with a target out of reach."""
    plane = presets["lamost"].focal_plane
    x, y = plane.xy[[0, 100]].T
    return QTable({"positioner": plane.id[[0, 100]], "x": x + [5, 500] * u.mm, "y": y})


def test_a_score_begins_with_what_is_wrong(call, tmp_path, plan_of_two):
    """Regression: targets out of reach and constraints that are not met stood below many other lines."""
    plan_of_two.write(tmp_path / "plan.ecsv")
    page = tmp_path / "page.html"
    called = call("score {} --instrument lamost --constraint science=5 --report", tmp_path / "plan.ecsv", page)
    lines = called.out.splitlines()
    assert lines[:2] == ["lamost, nominal, allocator scored", "1 target out of reach"]
    assert lines[2].startswith("1 constraint not met: science targets: ")
    text = page.read_text()
    assert "Score of a plan with the nominal instrument: 2 of 4000 positioners have a target" in text
    assert "1 target out of reach; 1 constraint not met" in text
    assert "targets out of reach" in text
    # no two arms of this plan are close to each other
    assert "the arms of none of these pairs are close" in called.text


def test_many_rows_of_a_constraint_are_one_line(call, tmp_path):
    """Regression: one line for each of 336 modules."""
    page = tmp_path / "page.html"
    called = call("plan --instrument must --constraint sky=1/module --allocator nearest --report", page)
    assert sum(line.startswith("fail ") for line in called.out.splitlines()) == 1
    assert "sky=1/module: 0 (at least 1); 336 times: module 1, module 2, module 3 and 333 more" in called.text
    assert page.read_text().count("sky=1/module") < 20


def test_strange_tiles_of_a_survey_are_named(call, tmp_path):
    """Regression: a tile whose coordinates are missing, and a tile without targets, were like all other tiles."""
    offsets = np.random.default_rng(1).uniform(-1, 1, (2, 60))
    QTable({"ra": 95 + offsets[0], "dec": 23 + offsets[1]}).write(tmp_path / "stars.csv")
    QTable({"tile": [3, 4, 5], "ra": [95, 0, 200] * DEG, "dec": [23, 0, -30] * DEG}).write(tmp_path / "tiles.ecsv")
    called = call("survey {} --instrument sdss_apo --tiles", tmp_path / "stars.csv", tmp_path / "tiles.ecsv")
    lines = [" ".join(line.split()) for line in called.out.splitlines()]
    assert {"without targets 4, 5 (2 in all)", "at ra 0, dec 0 4 (1 in all)"} <= {*lines}
    assert any(line.startswith("fraction of usable positioners 0.") for line in lines)


def test_all_classes_of_arms_are_listed(call, presets):
    """Regression: only the medians of the lengths were printed."""
    assert "arms                  7.4 + 14.97 mm: 500" in call("instruments sdss_apo").out.splitlines()
    lamost = presets["lamost"]
    arms = np.where(np.arange(4000) < 1000, 8.0, 8.25) * u.mm
    two = replace(lamost, focal_plane=replace(lamost.focal_plane, central_arm=arms))
    assert arm_classes(two) == "8 + 8.25 mm: 1000, 8.25 + 8.25 mm: 3000"
    many = replace(lamost, focal_plane=replace(lamost.focal_plane, central_arm=np.linspace(8, 8.25, 4000) * u.mm))
    assert arm_classes(many) == "8 to 8.25 + 8.25 to 8.25 mm"


def test_designs_around_modules_are_lattices_without_gaps(presets):
    """Regression: the coverage of the lattice, 1.0000, looked like that of the focal plane."""
    with pytest.warns(rs.RfpsurveyWarning, match=r"without the gaps .* positioners of must reach 0\.7.. of its focal"):
        rs.design.explore_around(presets["must"], central_arm=1.8 * u.mm, ratio=1, pitch=6.2 * u.mm)
