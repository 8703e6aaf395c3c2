"""The command ``tile``, called with its options."""

import astropy.units as u
import pytest
from astropy.table import QTable

import rfpsurvey as rs


def values_of(called):
    """Return the printed values by label."""
    return {line[:44].strip(): line[44:].strip() for line in called.out.splitlines()}


def test_a_region(call, tmp_path):
    ecsv, png = tmp_path / "tiles.ecsv", tmp_path / "tiles.png"
    called = call("tile --region 'box 350 10 -5 5' --passes 2 --output {} --plot {}", ecsv, png)
    assert called.err == ""
    tiling, box = rs.Tiling.read(ecsv), rs.Region.box(ra=(350 * u.deg, 10 * u.deg), dec=(-5 * u.deg, 5 * u.deg))
    assert len(tiling) == len(rs.place_tiles(box, "lamost", passes=2))
    assert values_of(called)["tiles"] == str(len(tiling))
    assert values_of(called)["fraction of the region that fields cover"] == "1.0000"
    assert png.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    assert f"wrote {ecsv}" in called.out


def test_a_catalog(call, refused, tycho, tmp_path):
    files = tycho, tmp_path / "tiles.fits"
    words = "tile {} --method max_density --set fibers=1000 --completeness 0.5 --output {}"
    called = call(words, *files)
    assert called.err == ""
    tiling = rs.Tiling.read(files[1])
    assert tiling.table["completeness"][-1] >= 0.5
    assert tiling.table["n_new"].max() == 1000
    assert values_of(called)["completeness"].startswith("0.5")
    assert values_of(called)["definition of the completeness"].startswith("an upper limit")
    assert "exists" in refused(words, *files)
    err = call("tile {} --set fibers=100 --n-tiles 3 --completeness 0.5", tycho).err
    assert "warning: 3 tiles reach a completeness of 0.0340" in err


def test_the_survey_of_the_tiles_delivers_what_is_printed(call, tycho, tmp_path):
    """Regression: the command printed the completeness for fibers that reach every target."""
    path, inside = tmp_path / "tiles.ecsv", tmp_path / "inside.fits"
    options = "--instrument sdss_apo --allocator repair --constraint sky=20 --set options.sky_separation=10"
    values = values_of(call(f"tile {{}} {options} --region 'cap 95 23 2' --passes 2 --output {{}}", tycho, path))
    assert values["definition of the completeness"].startswith("the allocator repair plans each tile")
    region, stars = rs.Region.parse("cap 95 23 2"), rs.Catalog.read(tycho)
    stars[region.contains(stars.coord)].write(inside)
    assert values["targets with requested visits"] == str(len(rs.Catalog.read(inside)))
    survey = call(f"survey {{}} {options} --tiles {{}} --set order=given", inside, path)
    assert survey.lines["completeness"][0] == values["completeness"]


def test_centers_of_a_file(call, tycho, tmp_path):
    tiles, output = tmp_path / "tiles.csv", tmp_path / "out.ecsv"
    tiles.write_text("tile,ra,dec,pass\nb,95,23,1\na,96,24,2\n")
    words = "tile {} --centers {} --output {} --set radius=1.5 --set fibers=400 --overwrite --method "
    call(f"{words} given", tycho, tiles, output)
    assert rs.Tiling.read(output).table["tile"].tolist() == ["b", "a"]
    assert rs.Tiling.read(output).summary["radius_deg"] == pytest.approx(1.5)
    call(f"{words} max_density --n-tiles 3", tycho, tiles, output)
    assert set(rs.Tiling.read(output).table["ra"].value.round(6)) <= {95.0, 96.0}
    called = call(f"{words} given --set 'tiles.declination=[22, 23.5]'", tycho, tiles, output)
    assert "targets are out of reach of centers from 22 to 23.5 deg" in called.err
    assert int(values_of(called)["outside the limits of declination"]) > 1000


def test_excluded_regions(call, tycho):
    counted = [
        int(values_of(call(words, tycho))["targets with requested visits"])
        for words in ("tile {}", "tile {} --set 'exclude=cap 95 23 2'")
    ]
    stars = rs.Catalog.read(tycho)
    assert counted == [len(stars), len(stars) - rs.Region.parse("cap 95 23 2").contains(stars.coord).sum()]


def test_the_embedded_default(call):
    call("tile --instrument moons")


@pytest.mark.few(4)
@pytest.mark.parametrize(
    ("options", "message"),
    [
        ("--region 'circle 1 2 3'", "unknown kind of region 'circle'"),
        ("{} --region 'cap 100 2 3'", "--region must contain at least one target, but none of the 1 targets is inside"),
        ("--region 'cap 1 2 3' --n-tiles 3", "--n-tiles applies only to targets"),
        ("--set 'tiles.declination=[60, -10]'", "declination must be a lower and an upper limit"),
        ("--set radius=1 --constraint sky=5", "--allocator must be given if fibers or radius"),
        ("--set radius=1 --set options.time_limit=5", "--allocator must be given if fibers or radius"),
        ("{} --output x.csv", "must end in .fits or .ecsv"),
    ],
)
def test_bad_input_is_one_sentence(refused, tmp_path, options, message):
    QTable({"ra": [10.0] * u.deg, "dec": [20.0] * u.deg}).write(tmp_path / "good.ecsv")
    assert message in refused(f"tile {options}", *[tmp_path / "good.ecsv"] * options.count("{}"))
