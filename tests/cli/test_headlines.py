"""Lines of the output of commands state what their numbers mean, and the first lines state what is wrong."""

from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from astropy.table import QTable

import rfpsurvey as rs
from rfpsurvey.instrument import arm_classes

DEG = u.deg


def stars(center="95 23", radius=1.0):
    ra, dec = map(float, center.split())
    rng = np.random.default_rng(1)
    return QTable({"ra": ra + rng.uniform(-radius, radius, 60), "dec": dec + rng.uniform(-radius, radius, 60)})


@pytest.fixture
def plan_of_two(presets):
    """Return a plan of two positioners, one with a target out of reach."""
    plane = presets["lamost"].focal_plane
    x, y = plane.xy[[0, 100]].T
    return QTable({"positioner": plane.id[[0, 100]], "x": x + [5, 500] * u.mm, "y": y})


def test_a_score_begins_with_what_is_wrong(run, tmp_path, plan_of_two):
    """Regression: targets out of reach and constraints that are not met stood below many other lines."""
    plan_of_two.write(tmp_path / "plan.ecsv")
    page = tmp_path / "page.html"
    words = ["--instrument", "lamost", "--constraint", "science=5", "--report", page]
    code, out, _ = run("score", tmp_path / "plan.ecsv", *words)
    lines = out.splitlines()
    assert (code, lines[0]) == (0, "lamost, nominal, allocator scored")
    assert lines[1] == "1 target out of reach"
    assert lines[2].startswith("1 constraint not met: science targets: ")
    text = page.read_text()
    assert "Score of a plan with the nominal instrument: 2 of 4000 positioners have a target" in text
    assert "1 target out of reach; 1 constraint not met" in text
    assert "targets out of reach" in text
    # no two arms of this plan are close to each other
    assert "the arms of none of these pairs are close" in " ".join(out.split())


def test_many_rows_of_a_constraint_are_one_line(run, tmp_path):
    """Regression: one line for each of 336 modules."""
    page = tmp_path / "page.html"
    words = ["--instrument", "must", "--constraint", "sky=1/module", "--allocator", "nearest", "--report", page]
    code, out, _ = run("plan", *words)
    rows = [line for line in out.splitlines() if line.startswith("fail ")]
    assert (code, len(rows)) == (0, 1)
    assert "sky=1/module: 0 (at least 1); 336 times: module 1, module 2, module 3 and 333 more" in " ".join(out.split())
    assert page.read_text().count("sky=1/module") < 20


def test_strange_tiles_of_a_survey_are_named(run, tmp_path):
    """Regression: a tile whose coordinates are missing, and a tile without targets, were like all other tiles."""
    stars().write(tmp_path / "stars.csv")
    QTable({"tile": [3, 4, 5], "ra": [95, 0, 200] * DEG, "dec": [23, 0, -30] * DEG}).write(tmp_path / "tiles.ecsv")
    words = [tmp_path / "stars.csv", "--instrument", "sdss_apo", "--tiles", tmp_path / "tiles.ecsv"]
    code, out, _ = run("survey", *words)
    lines = [" ".join(line.split()) for line in out.splitlines()]
    assert code == 0
    assert "without targets 4, 5 (2 in all)" in lines
    assert "at ra 0, dec 0 4 (1 in all)" in lines
    assert any(line.startswith("fraction of usable positioners 0.") for line in lines)


def test_all_classes_of_arms_are_listed(run, presets):
    """Regression: only the medians of the lengths were printed."""
    assert "arms                  7.4 + 14.97 mm: 500" in run("instruments", "sdss_apo")[1].splitlines()
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
