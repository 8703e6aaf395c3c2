"""The command ``select`` for the folder of a survey with recorded observations."""

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import QTable

import rfpsurvey as rs

CENTER = SkyCoord(95 * u.deg, 23 * u.deg)


@pytest.fixture
def plan(call, tmp_path):
    """Return the folder of a survey of which one tile was observed."""
    sky = rs.synthetic_catalog("poisson", CENTER, 1.5 * u.deg, density=60 / u.deg**2, rng=3)
    rs.Catalog(sky.coord, priority=np.arange(len(sky)) % 2).write(tmp_path / "stars.fits")
    QTable({"ra": [94.6, 95.4] * u.deg, "dec": [23, 23] * u.deg}).write(tmp_path / "tiles.ecsv")
    (tmp_path / "night.csv").write_text("tile,date\n1,2026-01-03\n")
    files, folder = (tmp_path / "stars.fits", tmp_path / "tiles.ecsv"), tmp_path / "plan"
    options = "--instrument sdss_apo --allocator nearest --visits 2 --set options.subpriority=1"
    call(f"survey {{}} --tiles {{}} {options} --folder", *files, folder)
    call("record", folder, tmp_path / "night.csv")
    call("survey {} --replan", folder)
    return folder


def test_the_folder_of_a_survey_gives_all_options_and_events(call, plan, tmp_path):
    # regression: the seed of a survey with random subpriorities was refused
    assert "warning" not in call("select {} --n-realizations 3 --output", plan, tmp_path / "selection.fits").err
    found = rs.SelectionProbabilities.read(tmp_path / "selection.fits")
    state = rs.survey.SurveyState.read(plan, rs.Catalog.read(tmp_path / "stars.fits"), visits=2)
    tiles = rs.Tiling.read(tmp_path / "tiles.ecsv")
    same = rs.selection_probabilities(state, "sdss_apo", tiles, 3, allocator="nearest")
    np.testing.assert_array_equal(found.bits, same.bits)
    assert set(found.requested.tolist()) == {2}
    assert found.provenance["events"]["n_files"] == 1


def test_other_options_than_those_of_the_survey_are_refused(refused, plan):
    message = refused("select {} --n-realizations 3 --allocator repair", plan)
    assert "--allocator must be 'nearest', as for the survey, got 'repair'" in message


RULE, NEAREST = "--constraint 'magnitude vt_mag 9 inf science'", "--instrument sdss_apo --allocator nearest"


@pytest.mark.parametrize("options", [RULE, "--epoch 2026.5"], ids=["rule", "epoch"])
@pytest.mark.parametrize("recorded", [False, True])
def test_surveys_with_rules_or_an_epoch_have_a_status_and_probabilities(call, tmp_path, options, recorded):
    """Regression: both commands read another catalog than the command survey, and refused it."""
    (tmp_path / "tiles.csv").write_text("ra,dec\n94.2,23\n95.6,23\n")
    (tmp_path / "night.csv").write_text("tile,date,state\n0,2026-01-03,done\n")
    folder = tmp_path / "plan"
    words = f"survey example:anticenter --tiles {{}} {NEAREST} {options} --set options.subpriority=1 --folder"
    call(words, tmp_path / "tiles.csv", folder)
    if recorded:
        call("record", folder, tmp_path / "night.csv")
    call("status", folder)
    call("select {} --n-realizations 2 --output", folder, tmp_path / "out.fits")


def test_columns_of_rules_are_kept_in_probabilities_of_a_catalog(call, tmp_path):
    """Regression: the column of a rule was missing if the catalog was given instead of the folder of a survey."""
    (tmp_path / "tiles.csv").write_text("ra,dec\n94.2,23\n")
    words = f"select example:anticenter {NEAREST} {RULE} --n-realizations 2 --tiles {{}} --output"
    call(words, tmp_path / "tiles.csv", tmp_path / "out.fits")
