"""Joint plans and further passes of the command ``survey``."""

import shlex
import tomllib

import astropy.units as u
import numpy as np
import pytest
from astropy.table import QTable
from living import content

import rfpsurvey as rs
from scenes import few


@pytest.fixture
def words(tmp_path):
    """Return the words of a command that plans a small survey."""
    few(40).write(tmp_path / "stars.fits")
    QTable({"ra": [94.9, 95.1] * u.deg, "dec": [23, 23] * u.deg}).write(tmp_path / "tiles.ecsv")
    return f"survey '{tmp_path}/stars.fits' --tiles '{tmp_path}/tiles.ecsv' --instrument moons"


def test_the_command_prints_the_gain_and_the_bounds(call, refused, words, tmp_path):
    out, err = call(f"{words} --allocator joint --set joint.iterations=1 --folder", tmp_path / "plan")
    survey = rs.Survey.read(tmp_path / "plan")
    level = survey.summary["joint"]["levels"][0]
    assert f"visits: {level['n_visits_before']} with tiles planned one after the other; " in err
    assert f"at most {survey.joint['bound'][1]} with any plan\nthe search can" in err
    assert "joint plan: for each priority, the number of visits to targets of at least this priority" in out
    assert "lose their targets" not in out
    paths = "--allocator joint --set joint.iterations=1 --constraint 'motion paths'"
    out = " ".join(call(f"{words} {paths}").out.split())
    assert "upper bound, before arms without a path lose their targets:" in out
    message = refused(f"{words} --allocator joint --set joint.fixed={{}}", tmp_path / "nothing")
    assert "nothing does not hold a survey" in message


def test_every_option_reaches_the_library(refused, run, words, monkeypatch):
    seen = {}

    def plan_survey(*_, **options):
        seen.update(options)
        raise rs.InputError("enough")

    def warnings_of(options):
        return run(*shlex.split(f"{words} {options}"))[2]

    monkeypatch.setattr(rs, "plan_survey", plan_survey)
    options = "--set joint.gap=0.1 --set joint.iterations=7 --set joint.time_limit=3 --set joint.fixed=plan"
    refused(f"{words} --allocator joint {options}")
    joint = seen["allocator"]
    assert (joint.gap, joint.iterations, joint.seconds, str(joint.fixed)) == (0.1, 7, 3.0, "plan")
    refused(f"{words} --allocator joint")
    assert seen["allocator"].record == rs.JointOptions().record
    err = warnings_of(options)
    for name in ("gap", "iterations", "time_limit", "fixed"):
        assert f"warning: joint.{name} has no effect without --allocator joint" in err
    err = warnings_of("--allocator optimal --set joint.time_limit=3 --set options.time_limit=5")
    assert "options.time_limit has no effect" not in err
    assert "joint.time_limit has no effect" in err
    assert isinstance(seen["allocator"], rs.AllocationOptions)


@pytest.mark.parametrize("value", ["joint.gap=2", "joint.iterations=-1", "joint.time_limit=-3"])
def test_errors_name_the_option_that_was_typed(refused, words, value):
    assert f"rfpsurvey: {value.partition('=')[0]} must be" in refused(f"{words} --allocator joint --set {value}")


def test_a_plan_file_can_request_a_joint_plan(call, words, tmp_path):
    path = tmp_path / "plan.toml"
    assert call(f"{words} --allocator joint --set joint.iterations=1 --write-plan", path).err == ""
    assert "joint plan: for each priority" in call("survey", path).out


@pytest.fixture
def plan(call, tmp_path):
    """Return a function that plans a survey of two passes in a folder, and returns the folder."""
    rs.synthetic_catalog("poisson", "95 23", 1.5 * u.deg, density=60 / u.deg**2, rng=3).write(tmp_path / "stars.fits")
    tiles = QTable({"ra": [94.6, 95.4, 95, 95] * u.deg, "dec": [23, 23, 22.7, 23.4] * u.deg, "pass": [1, 1, 2, 2]})
    tiles["tile"] = 11 + np.arange(4)
    tiles.write(tmp_path / "tiles.ecsv")
    words = "survey {} --tiles {} --instrument sdss_apo --allocator nearest --set options.subpriority=1 --folder {} "

    def plan(name, options):
        call(words + options, tmp_path / "stars.fits", tmp_path / "tiles.ecsv", tmp_path / name)
        return tmp_path / name

    return plan


PASSES = "--passes 1 --passes 2"


def passes_of(record):
    return tomllib.loads(record)["tiles"]["passes"]


def test_further_passes_are_planned_with_resume(plan):
    once, folder = plan("once", PASSES), plan("plan", "--passes 1")
    plan("plan", f"{PASSES} --resume")
    (ours, expected) = (content(one) for one in (folder, once))
    assert passes_of(ours.pop("plan.toml").decode()) == [1, 2]
    del expected["plan.toml"]  # it contains the name of the folder
    assert ours == expected


def test_further_passes_are_planned_with_the_rest(call, plan, tmp_path):
    """The selection probabilities given what was observed are those of a survey that contained all passes."""
    (tmp_path / "night.csv").write_text("tile,date\n12,2026-01-03\n")
    found = []
    for folder in (plan("once", PASSES), plan("plan", "--passes 1")):
        call("record", folder, tmp_path / "night.csv")
        call(f"survey {{}} --replan {PASSES}", folder)
        assert passes_of((folder / "plan.toml").read_text()) == [1, 2]
        call("select {} --n-realizations 8 --output", folder, f"{folder}.fits")
        table = rs.selection.SelectionProbabilities.read(f"{folder}.fits").table
        tiles = {name: value for name, value in content(folder).items() if name.startswith("tiles/")}
        found.append((tiles, content(folder)["outcomes.fits"], table["BITWEIGHTS"].tolist()))
    assert found[0] == found[1]
