import astropy.units as u
import pytest
from astropy.table import QTable

import rfpsurvey as rs


@pytest.fixture
def run(run):
    """Run the command ``tile``."""
    return lambda *words: run("tile", *words)


def test_a_region(run, tmp_path):
    ecsv, png = tmp_path / "tiles.ecsv", tmp_path / "tiles.png"
    code, out, err = run("--region", "box 350 10 -5 5", "--passes", 2, "--output", ecsv, "--plot", png)
    assert (code, err) == (0, "")
    tiling = rs.Tiling.read(ecsv)
    box = rs.Region.box(ra=(350 * u.deg, 10 * u.deg), dec=(-5 * u.deg, 5 * u.deg))
    assert len(tiling) == len(rs.place_tiles(box, "lamost", passes=2))
    assert f"n tiles{len(tiling):>31}" in out
    assert "covering fraction               1.0000" in out
    assert png.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    assert f"wrote {ecsv}" in out


def test_a_catalog(run, tycho, tmp_path):
    path = tmp_path / "tiles.fits"
    options = ["--method", "max_density", "--fibers", 1000, "--completeness", 0.5, "--output", path]
    code, out, err = run(tycho, *options)
    assert (code, err) == (0, "")
    tiling = rs.Tiling.read(path)
    assert tiling.table["completeness"][-1] >= 0.5
    assert tiling.table["n_new"].max() == 1000
    assert "completeness                    0.5" in out
    code, _, err = run(tycho, *options)
    assert code == 2
    assert "exists" in err
    code, _, err = run(tycho, "--fibers", 100, "--n-tiles", 3, "--completeness", 0.5)
    assert code == 0
    assert "warning: 3 tiles reach a completeness of 0.0138" in err


def test_the_embedded_default(run):
    assert run("--instrument", "moons")[0] == 0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--region", "circle 1 2 3"], "unknown kind of region 'circle'"),
        (["--region", "cap 1 2 3", "--method", "sdss"], "needs targets, got a Region"),
        (["--region", "cap 1 2 3", "{good}"], "give a catalog or --region, not both"),
        (["--region", "sky"], "use method='spiral'"),
        (["--method", "best"], "unknown method to place tiles 'best'"),
        (["--passes", "0"], "passes must be a whole number of at least 1"),
        (["--completeness", "95"], "completeness must be a number above 0"),
        (["{folder}/no.fits"], "there is no such file"),
        (["{good}", "--output", "{folder}/x.csv"], "must end in .fits or .ecsv"),
    ],
)
def test_bad_input_is_one_sentence(run, tmp_path, arguments, message):
    QTable({"ra": [10.0] * u.deg, "dec": [20.0] * u.deg}).write(tmp_path / "good.ecsv")
    code, _, err = run(*[a.format(folder=tmp_path, good=tmp_path / "good.ecsv") for a in arguments])
    assert code == 2
    assert message in err
    assert len(err.strip().split("\n")) == 1
