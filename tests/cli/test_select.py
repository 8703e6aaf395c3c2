"""The command ``select``, called with its options."""

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
    return folder, sky, rs.Tiling.from_table(tiles)


def words_of(folder, *others):
    return ("select", folder / "stars.fits", "--tiles", folder / "tiles.ecsv", "--instrument", "moons", *others)


def test_what_is_printed_and_written_is_what_the_library_returns(run, files, tmp_path):
    folder, sky, tiles = files
    output = tmp_path / "selection.fits"
    words = words_of(folder, "--n-realizations", 40, "--allocator", "lamost_rule", "--workers", 2, "--rng", 5)
    code, out, err = run(*words, "--output", output, "--folder", tmp_path / "work")
    assert code == 0, err
    expected = rs.selection_probabilities(sky, "moons", tiles, 40, allocator="lamost_rule", rng=5)
    lines = {line[:34].strip(): line[34:].split() for line in out.splitlines()}
    assert lines["targets never observed"] == [str(expected.summary["n_never_observed"])]
    assert lines["visits observed, all realizations"] == [str(expected.summary["n_observed"])]
    assert lines["mean selection probability"] == [f"{expected.summary['mean_probability']:.4f}"]
    assert "123 of 123 plans of tiles" in err
    assert f"wrote {output}" in out
    for path in (output, tmp_path / "work"):
        found = rs.SelectionProbabilities.read(path)
        np.testing.assert_array_equal(found.bits, expected.bits)
        assert found.summary == expected.summary


def test_a_plot_and_a_report_are_written(run, files, tmp_path):
    folder, _, _ = files
    words = words_of(folder, "--n-realizations", 4, "--allocator", "nearest", "--output", tmp_path / "selection.fits")
    code, out, err = run(*words, "--plot", tmp_path / "plot.png", "--report", tmp_path / "page.html")
    assert code == 0, err
    for name in ("plot.png", "page.html"):
        assert f"wrote {tmp_path / name}" in out
    summary = rs.SelectionProbabilities.read(tmp_path / "selection.fits").summary
    page = Reader((tmp_path / "page.html").read_text())
    assert page.facts()["targets never observed"] == str(summary["n_never_observed"])
    assert "selection.fits contains all rows" in " ".join(page.text("caption"))


def test_visits_and_passes(run, files, tmp_path):
    folder, _, _ = files
    words = words_of(
        folder, "--n-realizations", 2, "--visits", 2, "--set", "tiles.passes=[1]", "--set", "lost_in_collision=false"
    )
    code, _, err = run(*words, "--output", tmp_path / "selection.fits")
    assert code == 0, err
    found = rs.SelectionProbabilities.read(tmp_path / "selection.fits")
    assert (found.requested == 2).all()
    assert found.summary["n_tiles"] == 1
    assert found.provenance["parameters"]["lost_in_collision"] is False


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--output", "selection.csv"), "selection.csv: the name of this output file must end in .fits"),
        (("--report", "page.txt"), "page.txt: the name of this output file must end in .html or .htm"),
        (("--plot", "plot.txt"), "plot.txt: the name of this output file must end in .png or .pdf or .svg"),
        (("--resume",), "the folder of the computation to resume must be given with --folder"),
        (("--visits", 300), "--visits must be whole numbers from 0 to 255"),
        (("--allocator", "nearer"), "unknown allocator 'nearer'"),
    ],
)
def test_refusals_are_one_sentence(run, files, words, message):
    code, _, err = run(*words_of(files[0], "--n-realizations", 2, *words))
    assert code == 2
    assert message in err
    assert "Traceback" not in err


def test_existing_files_are_kept(run, files, tmp_path):
    output = tmp_path / "selection.fits"
    output.write_text("mine")
    code, _, err = run(*words_of(files[0], "--n-realizations", 2, "--output", output))
    assert code == 2
    assert "exists; to replace it, use --overwrite" in err
    assert output.read_text() == "mine"
