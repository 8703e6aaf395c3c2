"""Joint plans of the command ``survey``."""

import astropy.units as u
import pytest
from astropy.table import QTable

import rfpsurvey as rs
from scenes import few


@pytest.fixture
def words(tmp_path):
    """Return the words of a command that plans a small survey."""
    few(40).write(tmp_path / "stars.fits")
    tiles = QTable({"ra": [94.9, 95.1] * u.deg, "dec": [23, 23] * u.deg})
    tiles.write(tmp_path / "tiles.ecsv")
    files = tmp_path / "stars.fits", "--tiles", tmp_path / "tiles.ecsv"
    return ["survey", *files, "--instrument", "moons"]


def test_the_command_prints_the_gain_and_the_bounds(run, words, tmp_path):
    code, out, err = run(*words, "--allocator", "joint", "--set", "joint.iterations=1", "--folder", tmp_path / "plan")
    assert code == 0, err
    survey = rs.Survey.read(tmp_path / "plan")
    level = survey.summary["joint"]["levels"][0]
    text = f"visits: {level['n_visits_before']} with tiles planned one after the other; "
    assert text in err
    assert f"at most {survey.joint['bound'][1]} with any plan\nthe search can" in err
    assert "joint plan: for each priority, the number of visits to targets of at least this priority" in out
    code, _, err = run(*words, "--allocator", "joint", "--set", f"joint.fixed={tmp_path / 'nothing'}")
    assert code == 2
    assert "nothing does not hold a survey" in err


def test_every_option_reaches_the_library(run, words, monkeypatch):
    seen = {}

    def plan_survey(*_, **options):
        seen.update(options)
        raise rs.InputError("enough")

    monkeypatch.setattr(rs, "plan_survey", plan_survey)
    options = [
        "--set",
        "joint.gap=0.1",
        "--set",
        "joint.iterations=7",
        "--set",
        "joint.time_limit=3",
        "--set",
        "joint.fixed=plan",
    ]
    run(*words, "--allocator", "joint", *options)
    joint = seen["allocator"]
    assert (joint.gap, joint.iterations, joint.seconds, str(joint.fixed)) == (0.1, 7, 3.0, "plan")
    run(*words, "--allocator", "joint")
    assert seen["allocator"].record == rs.JointOptions().record
    _, _, err = run(*words, *options)
    for name in ("gap", "iterations", "time_limit", "fixed"):
        assert f"warning: joint.{name} has no effect without --allocator joint" in err
    _, _, err = run(*words, "--allocator", "optimal", "--set", "joint.time_limit=3", "--set", "options.time_limit=5")
    assert "options.time_limit has no effect" not in err
    assert "joint.time_limit has no effect" in err
    assert isinstance(seen["allocator"], rs.AllocationOptions)


@pytest.mark.parametrize(("key", "value"), [("joint.gap", 2), ("joint.iterations", -1), ("joint.time_limit", -3)])
def test_errors_name_the_option_that_was_typed(run, words, key, value):
    code, _, err = run(*words, "--allocator", "joint", "--set", f"{key}={value}")
    assert code == 2
    assert f"rfpsurvey: {key} must be" in err


def test_a_plan_file_can_request_a_joint_plan(run, words, tmp_path):
    path = tmp_path / "plan.toml"
    code, _, err = run(*words, "--allocator", "joint", "--set", "joint.iterations=1", "--write-plan", path)
    assert (code, err) == (0, "")
    code, out, err = run("survey", path)
    assert code == 0, err
    assert "joint plan: for each priority" in out
