"""The command ``survey`` with further passes of a survey that was planned in a folder."""

import tomllib

import astropy.units as u
import numpy as np
import pytest
from astropy.table import QTable
from living import content

import rfpsurvey as rs


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
