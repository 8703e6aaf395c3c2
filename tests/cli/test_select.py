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
    summary = rs.SelectionProbabilities.read(outputs[0]).summary
    page = Reader(outputs[2].read_text())
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
