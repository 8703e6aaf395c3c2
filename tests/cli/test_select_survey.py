"""The command ``select`` for the folder of a survey with recorded observations."""

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import QTable

import rfpsurvey as rs


@pytest.fixture
def plan(run, tmp_path):
    """Return the folder of a survey of which one tile was observed."""
    sky = rs.synthetic_catalog("poisson", SkyCoord(95 * u.deg, 23 * u.deg), 1.5 * u.deg, density=60 / u.deg**2, rng=3)
    rs.Catalog(sky.coord, priority=np.arange(len(sky)) % 2).write(tmp_path / "stars.fits")
    QTable({"ra": [94.6, 95.4] * u.deg, "dec": [23, 23] * u.deg}).write(tmp_path / "tiles.ecsv")
    (tmp_path / "night.csv").write_text("tile,date\n1,2026-01-03\n")
    command = ("survey", tmp_path / "stars.fits", "--tiles", tmp_path / "tiles.ecsv", "--instrument", "sdss_apo")
    folder = tmp_path / "plan"
    for words in (
        (*command, "--allocator", "nearest", "--folder", folder, "--visits", "2", "--set", "options.subpriority=1"),
        ("record", folder, tmp_path / "night.csv"),
        ("survey", folder, "--replan"),
    ):
        code, _, err = run(*words)
        assert code == 0, err
    return folder


def test_the_folder_of_a_survey_gives_all_options_and_events(run, plan, tmp_path):
    # regression: the seed of a survey with random subpriorities was refused
    code, _, err = run("select", plan, "--n-realizations", "3", "--output", tmp_path / "selection.fits")
    assert code == 0, err
    assert "warning" not in err
    found = rs.SelectionProbabilities.read(tmp_path / "selection.fits")
    sky = rs.Catalog.read(tmp_path / "stars.fits")
    tiles = rs.Tiling.read(tmp_path / "tiles.ecsv")
    state = rs.survey.SurveyState.read(plan, sky, visits=2)
    same = rs.selection_probabilities(state, "sdss_apo", tiles, 3, allocator="nearest")
    np.testing.assert_array_equal(found.bits, same.bits)
    assert set(found.requested.tolist()) == {2}
    assert found.provenance["events"]["n_files"] == 1


def test_other_options_than_those_of_the_survey_are_refused(run, plan):
    code, _, err = run("select", plan, "--n-realizations", "3", "--allocator", "repair")
    assert code == 2
    assert "--allocator must be 'nearest', as for the survey, got 'repair'" in err


@pytest.mark.parametrize(
    "words", [("--constraint", "magnitude vt_mag 9 inf science"), ("--epoch", "2026.5")], ids=["rule", "epoch"]
)
@pytest.mark.parametrize("recorded", [False, True])
def test_surveys_with_rules_or_an_epoch_have_a_status_and_probabilities(run, tmp_path, words, recorded):
    """Regression: both commands read another catalog than the command survey, and refused it."""
    (tmp_path / "tiles.csv").write_text("ra,dec\n94.2,23\n95.6,23\n")
    (tmp_path / "night.csv").write_text("tile,date,state\n0,2026-01-03,done\n")
    folder, given = tmp_path / "plan", ("--instrument", "sdss_apo", "--tiles", tmp_path / "tiles.csv", *words)
    given = (*given, "--allocator", "nearest", "--set", "options.subpriority=1", "--folder", folder)
    commands = [("survey", "example:anticenter", *given)]
    commands += [("record", folder, tmp_path / "night.csv")] if recorded else []
    commands += [("status", folder), ("select", folder, "--n-realizations", "2", "--output", tmp_path / "out.fits")]
    for command in commands:
        code, _, err = run(*command)
        assert code == 0, err


def test_columns_of_rules_are_kept_in_probabilities_of_a_catalog(run, tmp_path):
    """Regression: the column of a rule was missing if the catalog was given instead of the folder of a survey."""
    (tmp_path / "tiles.csv").write_text("ra,dec\n94.2,23\n")
    command = ("select", "example:anticenter", "--instrument", "sdss_apo", "--tiles", tmp_path / "tiles.csv")
    rule = ("--constraint", "magnitude vt_mag 9 inf science", "--allocator", "nearest", "--n-realizations", "2")
    code, _, err = run(*command, *rule, "--output", tmp_path / "out.fits")
    assert code == 0, err
