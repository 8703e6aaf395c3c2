"""The commands ``select``, also for surveys with recorded observations, and ``potential``."""

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import QTable

import rfpsurvey as rs
from pages import Reader

CENTER = SkyCoord(95 * u.deg, 23 * u.deg)


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("select")
    sky = rs.synthetic_catalog("poisson", CENTER, 0.5 * u.deg, density=4000 / u.deg**2, rng=3)
    sky.write(folder / "stars.fits")
    tiles = QTable({"ra": [94.9, 95.1, 95.0] * u.deg, "dec": [23, 23, 23.1] * u.deg, "pass": [0, 0, 1]})
    tiles.write(folder / "tiles.ecsv")
    return (folder / "stars.fits", folder / "tiles.ecsv"), sky, rs.Tiling.from_table(tiles)


SELECT = "select {} --tiles {} --instrument moons --n-realizations"


def test_what_is_printed_and_written_is_what_the_library_returns(call, files, tmp_path):
    paths, sky, tiles = files
    output, work = tmp_path / "selection.fits", tmp_path / "work"
    options = "--allocator lamost_rule --workers 2 --rng 5 --output {} --folder {}"
    called = call(f"{SELECT} 40 {options}", *paths, output, work)
    expected, lines = rs.selection_probabilities(sky, "moons", tiles, 40, allocator="lamost_rule", rng=5), called.lines
    assert lines["targets never observed"] == [str(expected.summary["n_never_observed"])]
    assert lines["visits observed, all realizations"] == [str(expected.summary["n_observed"])]
    assert lines["mean selection probability"] == [f"{expected.summary['mean_probability']:.4f}"]
    assert "123 of 123 plans of tiles" in called.err
    assert f"wrote {output}" in called.out
    for path in (output, work):
        found = rs.SelectionProbabilities.read(path)
        np.testing.assert_array_equal(found.bits, expected.bits)
        assert found.summary == expected.summary


def test_a_plot_and_a_report_are_written(call, files, tmp_path):
    outputs = [tmp_path / name for name in ("selection.fits", "plot.png", "page.html")]
    out = call(f"{SELECT} 4 --allocator nearest --output {{}} --plot {{}} --report {{}}", *files[0], *outputs).out
    assert all(f"wrote {path}" in out for path in outputs)
    summary, page = rs.SelectionProbabilities.read(outputs[0]).summary, Reader(outputs[2].read_text())
    assert page.facts()["targets never observed"] == str(summary["n_never_observed"])
    assert "selection.fits contains all rows" in " ".join(page.text("caption"))


def test_visits_and_passes(call, files, tmp_path):
    options = "--visits 2 --set tiles.passes=[1] --set lost_in_collision=false --output"
    call(f"{SELECT} 2 {options}", *files[0], tmp_path / "selection.fits")
    found = rs.SelectionProbabilities.read(tmp_path / "selection.fits")
    assert (found.requested == 2).all()
    assert found.summary["n_tiles"] == 1
    assert found.provenance["parameters"]["lost_in_collision"] is False


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ("--output selection.csv", "selection.csv: the name of this output file must end in .fits"),
        ("--report page.txt", "page.txt: the name of this output file must end in .html or .htm"),
        ("--plot plot.txt", "plot.txt: the name of this output file must end in .png or .pdf or .svg"),
        ("--output old.fits", "exists; to replace it, use --overwrite"),
        ("--resume", "the folder of the computation to resume must be given with --folder"),
        ("--visits 300", "--visits must be whole numbers from 0 to 255"),
    ],
)
def test_refusals_are_one_sentence_and_existing_files_are_kept(refused, files, tmp_path, monkeypatch, options, message):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "old.fits").write_text("mine")
    assert message in refused(f"{SELECT} 2 {options}", *files[0])
    assert [path.read_text() for path in tmp_path.iterdir()] == ["mine"]


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
    assert (set(found.requested.tolist()), found.provenance["events"]["n_files"]) == ({2}, 1)


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


@pytest.fixture(scope="module")
def potential_files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("potential")
    points = rs.synthetic_catalog("uniform", CENTER, 0.3 * u.deg, n_targets=1500, rng=3)
    points.write(folder / "points.fits")
    tiles = QTable({"ra": [94.9, 95.1, 95.0] * u.deg, "dec": [23, 23, 23.1] * u.deg, "pass": [0, 0, 1]})
    tiles.write(folder / "tiles.ecsv")
    tiling = rs.Tiling.from_table(tiles)
    survey = rs.plan_survey(points, "moons", tiling, allocator="nearest", folder=folder / "plan")
    return folder, points, tiling, survey


POTENTIAL = "potential {} --instrument moons"


def test_a_plan_file_is_written_and_read(call, potential_files, tmp_path):
    """Regression: ``--write-plan`` ended with an AttributeError, because the command has no options of allocators."""
    folder, plan = potential_files[0], tmp_path / "plan.toml"
    words = (f"{POTENTIAL} --tiles", folder / "points.fits", folder / "tiles.ecsv")
    call(*words, "--write-plan", plan)
    assert call("potential", plan).out.splitlines()[:2] == call(*words).out.splitlines()[:2]


@pytest.mark.parametrize("with_survey", [False, True])
def test_potential_prints_and_writes_what_the_library_returns(call, potential_files, tmp_path, with_survey):
    folder, points, tiles, survey = potential_files
    source = ("--survey", folder / "plan") if with_survey else ("--tiles", folder / "tiles.ecsv")
    output = tmp_path / "potential.fits"
    called = call(f"{POTENTIAL} --workers 2 --output", folder / "points.fits", output, *source)
    expected = rs.selection.potential_assignments(points, "moons", tiles, survey=survey if with_survey else None)
    table = QTable.read(output)
    assert len(table) == len(expected.table)
    for name in ("tile", "positioner", "point"):
        np.testing.assert_array_equal(table[name], expected.table[name])
    for n, number in enumerate(np.bincount(expected.n_tiles())):
        assert called.lines.get(f"points in reach in {n} tile{'s' * (n != 1)}", ["0"]) == [str(number)]
    assert f"wrote {output}: {len(table)} pairs" in called.out


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (f"{POTENTIAL} --output potential.csv", "potential.csv: the name of this output file must end in .fits"),
        (f"{POTENTIAL} --survey nothing", "there is no survey.json"),
        (f"{POTENTIAL} --tiles tiles.ecsv", "tiles.ecsv"),
        ("potential {} --instrument desi --survey {}", "survey must be a plan for desi, got one for moons"),
    ],
)
def test_refusals_of_potential_are_one_sentence(refused, potential_files, tmp_path, monkeypatch, words, message):
    monkeypatch.chdir(tmp_path)
    values = potential_files[0] / "points.fits", potential_files[0] / "plan"
    assert message in refused(words, *values[: words.count("{}")])
