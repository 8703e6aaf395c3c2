"""Rules of observatories in commands: the verdict as a table, and surveys with rules."""

import numpy as np
import pytest
from astropy.table import Table

import rfpsurvey as rs

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
    out = call(words, targets, tiles, folder).out
    survey = rs.Survey.read(folder)
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
    rule = f"guide_stars gaia_g 12 19 40 inf '' {targets}"
    out, err = call(f"{PLAN} sdss_apo --constraint", targets, rule)
    assert "warning: guide_stars gaia_g 12.0 19.0 40" in err
    assert "on each camera); gfa1 has" in err
    assert "\nfail          guide_stars gaia_g 12.0 19.0 40" in out
