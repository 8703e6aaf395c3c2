"""Rules of observatories in commands, and lines of the output that state what is wrong."""

from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from astropy.table import QTable, Table

import rfpsurvey as rs
from rfpsurvey._instruments.facts import arm_classes

BANDS = ("g", "r", "i", "gaia_g", "h")


@pytest.fixture
def targets(tmp_path, rng):
    """Return the path of a catalog with magnitudes."""
    n = 700
    table = Table({"id": np.arange(n), "ra": rng.uniform(94, 96, n), "dec": rng.uniform(22, 24, n)})
    table["kind"] = rng.choice(["science", "standard", "sky"], n)
    table["fiber_type"] = rng.choice(["BOSS", "APOGEE"], n)
    for band in BANDS:
        table[band] = rng.uniform(14, 20, n)
    table.write(tmp_path / "targets.csv")
    return tmp_path / "targets.csv"


@pytest.mark.parametrize("option", ["--rules dark_monit", "--set options.rules=dark_monit"])
def test_score_prints_the_verdict_on_each_rule(call, real_data, tmp_path, option):
    path, report = real_data("sdssv_apo_2021/confSummary-998.par.gz"), tmp_path / "report.html"
    out, err = call(f"score {{}} {option} --report", path, report)
    assert "the arms are nominal: score the plan with the instrument as built" in err
    lines = out.splitlines()
    assert lines[0].startswith("sdss_apo, nominal, allocator scored")
    assert any(" constraints not met: " in line for line in lines[1:3])
    assert "fail          sky@BOSS=50: 0 (at least 50)" in lines
    assert "pass          sky@APOGEE=35: 35 (at least 35)" in lines
    assert sum(line.startswith(("pass  ", "fail  ", "not checkable ")) for line in lines) == 16
    text = report.read_text()
    for part in ("Verdict on each constraint", "not checkable", "contrast h 5.0 APOGEE fiberId"):
        assert part in text


PLAN = "plan {} --center '95 23' --instrument "


def check_magnitudes(rows):
    """Check that no BOSS fiber on a science target has a target brighter than magnitude 16."""
    boss = rows[(rows["fiber_type"] == "BOSS") & (rows["kind"] == "science")]
    assert len(boss) > 0
    assert min(boss[band].min() for band in ("g", "r", "i")) > 16


def test_a_plan_reads_the_columns_of_its_rules(call, targets, tmp_path):
    path = tmp_path / "tile.ecsv"
    out = call(f"{PLAN} sdss_apo --rules dark_monit --output", targets, path).out
    assert "magnitude g 16.0 inf science BOSS allowed: 0 (no g of at most 16)" in out
    check_magnitudes(rs.Tile.read(path).table)


def test_a_survey_follows_rules(call, targets, tmp_path):
    folder, tiles = tmp_path / "survey", tmp_path / "tiles.csv"
    Table({"ra": [95.0, 95.1], "dec": [23.0, 23.0]}).write(tiles)
    words = "survey {} --instrument sdss_apo --tiles {} --set options.rules=dark_monit --folder"
    out, survey = call(words, targets, tiles, folder).out, rs.Survey.read(folder)
    for row in survey.rules:
        (line,) = [line.split() for line in out.splitlines() if line.strip().startswith(f"{row['rule']} ")]
        numbers = [str(row[name]) for name in ("pass", "fail", "not checkable")]
        assert line[len(row["rule"].split()) :][:3] == numbers
    unchecked = dict(zip(survey.rules["rule"], survey.rules["not checkable"], strict=True))
    assert unchecked["contrast h 5.0 APOGEE fiberId"] == 2
    catalog = Table.read(targets)
    for rows in survey:
        check_magnitudes(catalog[np.isin(catalog["id"], rows["target_id"])])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ("lamost --rules dark_monit", "the instrument must have rules of the name 'dark_monit', but lamost has no"),
        ("sdss_lco --rules dark_mon", "choose one of: bright_time, dark_faint, dark_monit, dark_plane, dark_rm"),
        ("sdss_apo --rules bright_time", "that a rule uses, must be columns of the table"),
        ("lamost --constraint 'guide_stars gaia_g 12 19 5'", "needs cameras, but lamost has none; describe them in"),
        ("sdss_lco --constraint 'guide_stars gaia_g 12 19 5 inf gfa7'", "unknown camera of sdss_lco 'gfa7'; choose"),
        ("pfs --constraint \"guide_stars gaia_g 12 19 5 inf '' nowhere.ecsv\"", "nowhere.ecsv"),
    ],
)
def test_rules_that_cannot_be_used_get_one_sentence(refused, targets, options, message):
    assert message in refused(f"{PLAN} {options}", targets)


def test_a_plan_warns_of_cameras_without_guide_stars(call, targets):
    """The stars of a second file are read; the plan is made, and its verdict is printed."""
    out, err = call(f"{PLAN} sdss_apo --constraint", targets, f"guide_stars gaia_g 12 19 40 inf '' {targets}")
    assert "warning: guide_stars gaia_g 12.0 19.0 40" in err
    assert "on each camera); gfa1 has" in err
    assert "\nfail          guide_stars gaia_g 12.0 19.0 40" in out


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
    lamost, arms = presets["lamost"], np.where(np.arange(4000) < 1000, 8.0, 8.25) * u.mm
    two = replace(lamost, focal_plane=replace(lamost.focal_plane, central_arm=arms))
    assert arm_classes(two) == "8 + 8.25 mm: 1000, 8.25 + 8.25 mm: 3000"
    many = replace(lamost, focal_plane=replace(lamost.focal_plane, central_arm=np.linspace(8, 8.25, 4000) * u.mm))
    assert arm_classes(many) == "8 to 8.25 + 8.25 to 8.25 mm"


def test_designs_around_modules_are_lattices_without_gaps(presets):
    """Regression: the coverage of the lattice, 1.0000, looked like that of the focal plane."""
    with pytest.warns(rs.RfpsurveyWarning, match=r"without the gaps .* positioners of must reach 0\.7.. of its focal"):
        rs.design.explore_around(presets["must"], central_arm=1.8 * u.mm, ratio=1, pitch=6.2 * u.mm)
