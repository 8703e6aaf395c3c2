"""The command ``survey``, as a user types it."""

import subprocess
import sys

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import QTable

import rfpsurvey as rs

CENTER = SkyCoord(95 * u.deg, 23 * u.deg)


def run(*words, code=0):
    done = subprocess.run([sys.executable, "-m", "rfpsurvey", *map(str, words)], capture_output=True, text=True)
    assert done.returncode == code, done.stderr
    return done


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("survey")
    sky = rs.synthetic_catalog("poisson", CENTER, 0.8 * u.deg, density=2000 / u.deg**2, rng=3)
    sky = rs.Catalog(sky.coord, visits=np.arange(len(sky)) % 3)
    sky.write(folder / "stars.fits")
    tiles = QTable({"RACEN": [94.8, 95.2, 95.0] * u.deg, "DECCEN": [23, 23, 23.2] * u.deg, "PASS": [0, 0, 1]})
    tiles.write(folder / "tiles.ecsv")
    return folder, sky, rs.Tiling.from_table(tiles)


def test_what_is_printed_is_what_the_library_says(files, tmp_path):
    folder, sky, tiling = files
    picture = tmp_path / "plan.png"
    words = ("survey", folder / "stars.fits", "--tiles", folder / "tiles.ecsv", "--instrument", "moons", "--workers", 2)
    done = run(*words, "--folder", tmp_path / "plan", "--plot", picture)
    expected = rs.plan_survey(sky, tiling, "moons").summary
    lines = {line[:34].strip(): line[34:].split() for line in done.stdout.splitlines()}
    assert lines["visits wanted"] == [str(sky.visits.sum())]
    assert lines["observed"] == [str(expected["n_visits_observed"])]
    assert lines["targets on no tile"] == [str(expected["outcomes"]["on no tile"])]
    assert "3 of 3 tiles" in done.stderr
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert rs.Survey.read(tmp_path / "plan").summary["n_assigned"] == expected["n_assigned"]
    again = run(*words, "--folder", tmp_path / "plan", code=2)
    assert "holds a survey; continue it" in again.stderr
    run(*words, "--folder", tmp_path / "plan", "--resume")
    one = run(*words, "--pass", 1, "--visits", 1, "--kept", "--allocator", "repair")
    assert "tiles                                        1" in one.stdout


def test_a_folder_of_partitions(files, tmp_path):
    folder, sky, _ = files
    rs.partition_catalog(sky, tmp_path / "parts")
    done = run("survey", tmp_path / "parts", "--tiles", folder / "tiles.ecsv", "--instrument", "moons")
    assert f"{sky.visits.sum():>12}" in done.stdout
    assert "needs --tiles" in run("survey", tmp_path / "parts", code=2).stderr


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--allocator", "best"], "unknown allocator 'best'"),
        (["--order", "random"], "unknown order 'random'"),
        (["--pass", "7"], "passes must be different passes of the tiling (0, 1)"),
        (["--resume"], "resume needs the folder"),
        (["--folder", "nowhere/plan"], "the folder nowhere does not exist"),
        (["--plot", "plan.txt"], "must end in"),
        (["--scheduler", "nobody"], "no scheduler answers"),
        (["--require", "stars=5"], ""),
    ],
)
def test_wrong_words(files, words, sentence):
    folder, _, _ = files
    known = ("survey", folder / "stars.fits", "--tiles", folder / "tiles.ecsv", "--instrument", "moons")
    done = run(*known, *words, code=0 if not sentence else 2)
    assert sentence in done.stderr
    assert "Traceback" not in done.stderr


def test_bad_tiles(files, tmp_path):
    folder, _, _ = files
    for table, sentence in (
        (QTable({"ra": [] * u.deg, "dec": [] * u.deg}), "at least one tile"),
        (QTable({"ra": [1, 1] * u.deg, "dec": [2, 2] * u.deg}), "tiles 0 and 1 are the same"),
        (QTable({"x": [1]}), "no column for ra and dec"),
    ):
        table.write(tmp_path / "tiles.ecsv", overwrite=True)
        done = run("survey", folder / "stars.fits", "--tiles", tmp_path / "tiles.ecsv", code=2)
        assert sentence in done.stderr
