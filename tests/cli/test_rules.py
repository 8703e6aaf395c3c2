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


@pytest.mark.parametrize("option", [["--rules", "dark_monit"], ["--set", "options.rules=dark_monit"]])
def test_score_prints_the_verdict_on_each_rule(run, real_data, tmp_path, option):
    path = real_data("sdssv_apo_2021/confSummary-998.par.gz")
    report = tmp_path / "report.html"
    code, out, err = run("score", path, *option, "--report", report)
    assert code == 0
    assert "the arms are nominal: score the plan with the instrument as built" in err
    lines = out.splitlines()
    assert lines[0].startswith("sdss_apo, nominal, allocator scored")
    assert any(" constraints not met: " in line for line in lines[1:3])
    assert "fail          sky@BOSS=50: 0 (at least 50)" in lines
    assert "pass          sky@APOGEE=35: 35 (at least 35)" in lines
    assert sum(line.startswith(("pass  ", "fail  ", "not checkable ")) for line in lines) == 16
    text = report.read_text()
    assert "Verdict on each constraint" in text
    assert "not checkable" in text
    assert "contrast h 5.0 APOGEE fiberId" in text


def test_a_plan_reads_the_columns_of_its_rules(run, targets, tmp_path):
    path = tmp_path / "tile.ecsv"
    code, out, _ = run(
        "plan", targets, "--instrument", "sdss_apo", "--center", "95 23", "--rules", "dark_monit", "--output", path
    )
    assert code == 0
    assert "magnitude g 16.0 inf science BOSS allowed: 0 (no g of at most 16)" in out
    table = rs.Tile.read(path).table
    boss = table[(table["fiber_type"] == "BOSS") & (table["kind"] == "science")]
    assert len(boss) > 0
    assert min(boss[band].min() for band in ("g", "r", "i")) > 16


def test_a_survey_follows_rules(run, targets, tmp_path):
    folder = tmp_path / "survey"
    Table({"ra": [95.0, 95.1], "dec": [23.0, 23.0]}).write(tmp_path / "tiles.csv")
    code, out, _ = run(
        "survey", targets, "--instrument", "sdss_apo", "--tiles", tmp_path / "tiles.csv", "--folder", folder,
        "--set", "options.rules=dark_monit",
    )  # fmt: skip
    assert code == 0
    survey = rs.Survey.read(folder)
    for row in survey.rules:
        (line,) = [line.split() for line in out.splitlines() if line.strip().startswith(f"{row['rule']} ")]
        numbers = [str(row[name]) for name in ("pass", "fail", "not checkable")]
        assert line[len(row["rule"].split()) :][:3] == numbers
    assert (
        dict(zip(survey.rules["rule"], survey.rules["not checkable"], strict=True))["contrast h 5.0 APOGEE fiberId"]
        == 2
    )
    catalog = Table.read(targets)
    for rows in survey:
        used = catalog[np.isin(catalog["id"], rows["target_id"])]
        boss = used[(used["fiber_type"] == "BOSS") & (used["kind"] == "science")]
        assert len(boss) > 0
        assert min(boss[band].min() for band in ("g", "r", "i")) > 16


@pytest.mark.parametrize(
    ("instrument", "rules", "message"),
    [
        ("lamost", "dark_monit", "the instrument must have rules of the name 'dark_monit', but lamost has no rules"),
        ("sdss_lco", "dark_mon", "choose one of: bright_time, dark_faint, dark_monit, dark_plane, dark_rm"),
        ("sdss_apo", "bright_time", "that a rule uses, must be columns of the table"),
    ],
)
def test_rules_that_cannot_be_used_get_one_sentence(run, targets, instrument, rules, message):
    code, _, err = run("plan", targets, "--instrument", instrument, "--center", "95 23", "--rules", rules)
    assert code == 2
    assert message in err
    assert len(err.strip().splitlines()) == 1


@pytest.mark.parametrize(
    ("instrument", "rule", "message"),
    [
        ("lamost", "guide_stars gaia_g 12 19 5", "needs cameras, but lamost has none; describe them in the section"),
        (
            "sdss_lco",
            "guide_stars gaia_g 19 12 5",
            "the brightest magnitude of 'gaia_g' must be smaller than the faint",
        ),
        ("sdss_lco", "guide_stars gaia_g 12 19 5 inf gfa7", "unknown camera of sdss_lco 'gfa7'; choose one of: gfa1"),
        ("pfs", "guide_stars gaia_g 12 19 5 inf '' {folder}/nowhere.ecsv", "nowhere.ecsv"),
    ],
)
def test_rules_on_guide_stars_that_cannot_be_used_get_one_sentence(run, targets, instrument, rule, message):
    rule = rule.format(folder=targets.parent)
    code, _, err = run("plan", targets, "--instrument", instrument, "--center", "95 23", "--constraint", rule)
    assert code == 2
    assert message in err
    assert len(err.strip().splitlines()) == 1


def test_a_plan_warns_of_cameras_without_guide_stars(run, targets, tmp_path):
    """The stars of a second file are read; the plan is made, and its verdict is printed."""
    rule = f"guide_stars gaia_g 12 19 40 inf '' {targets}"
    code, out, err = run("plan", targets, "--instrument", "sdss_apo", "--center", "95 23", "--constraint", rule)
    assert code == 0
    assert "warning: guide_stars gaia_g 12.0 19.0 40" in err
    assert "on each camera); gfa1 has" in err
    assert "\nfail          guide_stars gaia_g 12.0 19.0 40" in out
