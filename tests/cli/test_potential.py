"""The command ``potential``, called with its options."""

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import QTable

import rfpsurvey as rs

CENTER = SkyCoord(95 * u.deg, 23 * u.deg)


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("potential")
    points = rs.synthetic_catalog("uniform", CENTER, 0.3 * u.deg, n_targets=1500, rng=3)
    points.write(folder / "points.fits")
    tiles = QTable({"ra": [94.9, 95.1, 95.0] * u.deg, "dec": [23, 23, 23.1] * u.deg, "pass": [0, 0, 1]})
    tiles.write(folder / "tiles.ecsv")
    tiling = rs.Tiling.from_table(tiles)
    survey = rs.plan_survey(points, "moons", tiling, allocator="nearest", folder=folder / "plan")
    return folder, points, tiling, survey


POTENTIAL = "potential {} --instrument moons"


def test_a_plan_file_is_written_and_read(call, files, tmp_path):
    """Regression: ``--write-plan`` ended with an AttributeError, because the command has no options of allocators."""
    folder, plan = files[0], tmp_path / "plan.toml"
    words = (f"{POTENTIAL} --tiles", folder / "points.fits", folder / "tiles.ecsv")
    call(*words, "--write-plan", plan)
    assert call("potential", plan).out.splitlines()[:2] == call(*words).out.splitlines()[:2]


@pytest.mark.parametrize("with_survey", [False, True])
def test_what_is_printed_and_written_is_what_the_library_returns(call, files, tmp_path, with_survey):
    folder, points, tiles, survey = files
    source = ("--survey", folder / "plan") if with_survey else ("--tiles", folder / "tiles.ecsv")
    output = tmp_path / "potential.fits"
    called = call(f"{POTENTIAL} --workers 2 --output", folder / "points.fits", output, *source)
    expected = rs.selection.potential_assignments(points, "moons", tiles, survey=survey if with_survey else None)
    table = QTable.read(output)
    assert len(table) == len(expected.table)
    for name in ("tile", "positioner", "point"):
        np.testing.assert_array_equal(table[name], expected.table[name])
    for n, number in enumerate(np.bincount(expected.n_tiles())):
        label = f"points in reach in {n} tile{'s' * (n != 1)}"
        assert called.lines.get(label, ["0"]) == [str(number)]
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
def test_refusals_are_one_sentence(refused, files, tmp_path, monkeypatch, words, message):
    monkeypatch.chdir(tmp_path)
    values = files[0] / "points.fits", files[0] / "plan"
    assert message in refused(words, *values[: words.count("{}")])
