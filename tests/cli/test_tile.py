import astropy.units as u
import pytest
from astropy.table import QTable

import rfpsurvey as rs


@pytest.fixture
def tile(run):
    """Run the command ``tile``."""
    return lambda *words: run("tile", *words)


def values_of(out):
    """Return the printed values by label."""
    return {line[:44].strip(): line[44:].strip() for line in out.splitlines()}


def test_a_region(tile, tmp_path):
    ecsv, png = tmp_path / "tiles.ecsv", tmp_path / "tiles.png"
    code, out, err = tile("--region", "box 350 10 -5 5", "--passes", 2, "--output", ecsv, "--plot", png)
    assert (code, err) == (0, "")
    tiling = rs.Tiling.read(ecsv)
    box = rs.Region.box(ra=(350 * u.deg, 10 * u.deg), dec=(-5 * u.deg, 5 * u.deg))
    assert len(tiling) == len(rs.place_tiles(box, "lamost", passes=2))
    assert values_of(out)["tiles"] == str(len(tiling))
    assert values_of(out)["fraction of the region that fields cover"] == "1.0000"
    assert png.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    assert f"wrote {ecsv}" in out


def test_a_catalog(tile, tycho, tmp_path):
    path = tmp_path / "tiles.fits"
    options = ["--method", "max_density", "--set", "fibers=1000", "--completeness", 0.5, "--output", path]
    code, out, err = tile(tycho, *options)
    assert (code, err) == (0, "")
    tiling = rs.Tiling.read(path)
    assert tiling.table["completeness"][-1] >= 0.5
    assert tiling.table["n_new"].max() == 1000
    assert values_of(out)["completeness"].startswith("0.5")
    assert values_of(out)["definition of the completeness"].startswith("an upper limit")
    code, _, err = tile(tycho, *options)
    assert code == 2
    assert "exists" in err
    code, _, err = tile(tycho, "--set", "fibers=100", "--n-tiles", 3, "--completeness", 0.5)
    assert code == 0
    assert "warning: 3 tiles reach a completeness of 0.0340" in err


def test_the_survey_of_the_tiles_delivers_what_is_printed(run, tile, tycho, tmp_path):
    """Regression: the command printed the completeness for fibers that reach every target."""
    path = tmp_path / "tiles.ecsv"
    options = ["--instrument", "sdss_apo", "--allocator", "repair"]
    near = ["--region", "cap 95 23 2", "--constraint", "sky=20", "--set", "options.sky_separation=10"]
    out = tile(tycho, *options, *near, "--passes", 2, "--output", path)[1]
    assert values_of(out)["definition of the completeness"].startswith("the allocator repair plans each tile")
    region, stars = rs.Region.parse("cap 95 23 2"), rs.Catalog.read(tycho)
    inside = tmp_path / "inside.fits"
    stars[region.contains(stars.coord)].write(inside)
    assert values_of(out)["targets with requested visits"] == str(len(rs.Catalog.read(inside)))
    code, survey, err = run("survey", inside, *options, *near[2:], "--tiles", path, "--set", "order=given")
    assert code == 0, err
    line = next(line for line in survey.splitlines() if line.startswith("completeness"))
    assert line.split()[1] == values_of(out)["completeness"]


def test_centers_of_a_file(tile, tycho, tmp_path):
    tiles, output = tmp_path / "tiles.csv", tmp_path / "out.ecsv"
    tiles.write_text("tile,ra,dec,pass\nb,95,23,1\na,96,24,2\n")
    limits = ["--centers", tiles, "--set", "radius=1.5", "--set", "fibers=400", "--output", output, "--overwrite"]
    assert tile(tycho, "--method", "given", *limits)[0] == 0
    assert rs.Tiling.read(output).table["tile"].tolist() == ["b", "a"]
    assert rs.Tiling.read(output).summary["radius_deg"] == pytest.approx(1.5)
    assert tile(tycho, "--method", "max_density", "--n-tiles", 3, *limits)[0] == 0
    assert set(rs.Tiling.read(output).table["ra"].value.round(6)) <= {95.0, 96.0}
    code, out, err = tile(tycho, "--method", "given", "--set", "tiles.declination=[22, 23.5]", *limits)
    assert (code, "targets are out of reach of centers from 22 to 23.5 deg" in err) == (0, True)
    assert int(values_of(out)["outside the limits of declination"]) > 1000


def test_excluded_regions(tile, tycho):
    counted = [
        int(values_of(tile(tycho, *words)[1])["targets with requested visits"])
        for words in ([], ["--set", "exclude=cap 95 23 2"])
    ]
    stars = rs.Catalog.read(tycho)
    out = rs.Region.parse("cap 95 23 2").contains(stars.coord).sum()
    assert counted == [len(stars), len(stars) - out]


def test_the_embedded_default(tile):
    assert tile("--instrument", "moons")[0] == 0


@pytest.mark.few(4)
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--region", "circle 1 2 3"], "unknown kind of region 'circle'"),
        (["--region", "cap 1 2 3", "--method", "network_flow"], "needs targets, got a Region"),
        (
            ["--region", "cap 100 2 3", "{good}"],
            "--region must contain at least one target, but none of the 1 targets is inside",
        ),
        (["--region", "cap 1 2 3", "--set", "exclude=cup 1 2 3"], "unknown kind of region 'cup'"),
        (["--method", "given"], "'given' needs a list of tiles as centers"),
        (["--centers", "{folder}/no.ecsv"], "there is no such file"),
        (["--set", "tiles.declination=[60, -10]"], "declination must be a lower and an upper limit"),
        (["--set", "radius=0"], "radius must be one finite value above 0"),
        (["--set", "radius=1", "--constraint", "sky=5"], "--allocator must be given if fibers or radius"),
        (["--set", "radius=1", "--set", "options.time_limit=5"], "--allocator must be given if fibers or radius"),
        (["--region", "cap 1 2 3", "--n-tiles", "3"], "--n-tiles applies only to targets"),
        (["--allocator", "magic"], "unknown allocator 'magic'"),
        (["--region", "sky"], "use method='spiral'"),
        (["--method", "best"], "unknown method to place tiles 'best'"),
        (["--passes", "0"], "passes must be a whole number from 1 to 10000"),
        (["--completeness", "95"], "completeness must be a number above 0"),
        (["{folder}/no.fits"], "there is no such file"),
        (["{good}", "--output", "{folder}/x.csv"], "must end in .fits or .ecsv"),
    ],
)
def test_bad_input_is_one_sentence(tile, tmp_path, arguments, message):
    QTable({"ra": [10.0] * u.deg, "dec": [20.0] * u.deg}).write(tmp_path / "good.ecsv")
    code, _, err = tile(*[a.format(folder=tmp_path, good=tmp_path / "good.ecsv") for a in arguments])
    assert code == 2
    assert message in err
    assert len(err.strip().split("\n")) == 1
