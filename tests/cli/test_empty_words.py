"""Empty words of the command line, empty values of plan files, and empty paths are refused."""

import os

import astropy.units as u
import pytest
from astropy.coordinates import SkyCoord

import rfpsurvey as rs
from rfpsurvey._cli.application import COMMANDS

ARGUMENTS = {
    "convert": ["plan.ecsv", ""],
    "diff": ["", "plan"],
    "record": ["", "night.ecsv"],
    "benchmark": ["collisions", "--instrument", ""],
}
BEFORE = ("--center", "--constraint", "--set", "--write-plan", "--overwrite", "--")
EMPTY_OPTIONS = {
    **{(option, ""): f"the word after {option} must not be empty, got ''" for option in BEFORE},
    ("--output", " "): "the word after --output must not be empty, got ' '",
    ("--output=",): "--output must have a value, got ''",
    ("--rng= ",): "--rng must have a value, got ' '",
    ("--set", "center=''"): "center must be text, got ''",
    ("--set", "instrument.name=''"): "instrument.name must be text, got ''",
    ("--set", "catalog.keep=['mag', '']"): "catalog.keep must be a list of text, got ''",
    ("--set", "catalog.path=' '"): "catalog.path must be a path, got ' '",
    ("--constraint", "required ''"): "required must contain ids of targets that are not empty, got ''",
}
FIELD = rs.synthetic_catalog("poisson", SkyCoord("95d +23d"), 0.3 * u.deg, density=30 / u.deg**2, rng=1)


@pytest.mark.parametrize("command", COMMANDS)
def test_empty_arguments_are_refused(refused, tmp_path, monkeypatch, command):
    """Regression: ``rfpsurvey plan "$CATALOG"`` planned random targets if the variable was not set."""
    monkeypatch.chdir(tmp_path)
    assert "must not be empty, got ''" in refused(command, *ARGUMENTS.get(command, [""]))
    assert not os.listdir(tmp_path)


@pytest.mark.parametrize("words", EMPTY_OPTIONS, ids=" ".join)
def test_empty_values_of_options_are_refused(refused, tmp_path, monkeypatch, words):
    monkeypatch.chdir(tmp_path)
    assert EMPTY_OPTIONS[words] in refused("plan", *words)
    assert not os.listdir(tmp_path)


def test_empty_values_of_plan_files_are_refused(refused, tmp_path):
    path = tmp_path / "plan.toml"
    path.write_text("[options]\nrules = ''\n")
    assert refused("plan", path).startswith(f"rfpsurvey: {path}: options.rules must be text, got ''")


@pytest.mark.parametrize(
    "call",
    [
        *(cls.read for cls in (rs.Catalog, rs.Tile, rs.Tiling, rs.Survey, rs.Instrument)),
        *(rs.plans.read_plan, rs.catalog.PartitionedCatalog),
        lambda path: rs.catalog.partition_catalog(FIELD, path),
        lambda path: rs.plan_survey(FIELD, "sdss_apo", FIELD.mean_direction, folder=path),
        lambda path: rs.plan_tile(FIELD, "sdss_apo").write(path),
    ],
)
def test_empty_paths_do_not_stand_for_the_current_folder(tmp_path, monkeypatch, call):
    """Regression: ``plan_survey(folder="")`` wrote the survey to the current folder."""
    monkeypatch.chdir(tmp_path)
    with pytest.raises(rs.InputError, match="a path must not be empty, got ''"):
        call("")
    assert not os.listdir(tmp_path)
