"""Commands read one of several tables in a FITS file."""

import astropy.units as u
import pytest
from astropy.coordinates import SkyCoord
from astropy.io import fits

import rfpsurvey as rs

CENTER = SkyCoord(95 * u.deg, 23 * u.deg)


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    """Return a file whose first table has no coordinates, and whose other tables contain targets and tiles."""
    path = tmp_path_factory.mktemp("hdu") / "several.fits"
    targets = rs.synthetic_catalog("poisson", CENTER, 0.15 * u.deg, density=1000 / u.deg**2, rng=1).to_table()
    tiles = rs.Tiling.from_table(targets[:1]["ra", "dec"]).table
    targets.meta = tiles.meta = {}
    hdus = [fits.table_to_hdu(table) for table in (targets["id",], targets, tiles)]
    for hdu, name in zip(hdus, ("EXPOSURES", "TARGETS", "TILES"), strict=True):
        hdu.name = name
    fits.HDUList([fits.PrimaryHDU(), *hdus]).writeto(path)
    return path


@pytest.mark.few(2)
@pytest.mark.parametrize(
    "words",
    [
        ("plan", "{path}", "--instrument", "moons"),
        ("compare", "moons", "--catalog", "{path}", "--allocator", "nearest"),
        ("compare-allocators", "{path}", "--instrument", "moons", "--allocator", "nearest"),
        ("survey", "{path}", "--instrument", "moons", "--tiles", "{path}", "--set", "tiles.hdu=TILES"),
        (
            "select",
            "{path}",
            "--instrument",
            "moons",
            "--n-realizations",
            "2",
            "--tiles",
            "{path}",
            "--set",
            "tiles.hdu=3",
        ),
        (
            "tile",
            "{path}",
            "--instrument",
            "moons",
            "--method",
            "given",
            "--centers",
            "{path}",
            "--set",
            "tiles.hdu=tiles",
        ),
        ("probability", "moons", "--precision", "0.1", "--targets", "{path}"),
    ],
)
def test_the_option_hdu_selects_a_table_of_targets(run, path, words):
    """Only the first table of a FITS file could be read."""
    words = [word.format(path=path) for word in words]
    code, _, err = run(*words)
    assert code == 2
    assert (
        f"{path}: the file has 3 tables, and only the first one was read: 1 (EXPOSURES), 2 (TARGETS), 3 (TILES)" in err
    )
    assert "to read another table, give hdu= or --set catalog.hdu=NAME" in err
    for hdu in ("2", "targets"):
        code, out, err = run(*words, "--set", f"catalog.hdu={hdu}")
        assert code == 0, err
        assert "columns: priority: none, visits: none, id: id, ra: ra, dec: dec\n" in out
        assert "the file has 3 tables" not in err


def test_the_option_hdu_selects_the_table_of_an_assignment(run, path, tmp_path):
    target = rs.plan_tile(rs.Catalog.read(path, hdu=2), "moons").table
    table = target[target["status"] == "assigned"]["id", "tip_x", "tip_y"]
    table.meta = {}
    with fits.open(path) as hdus:
        hdus.append(fits.table_to_hdu(table))
        hdus.writeto(tmp_path / "plan.fits")
    code, _, err = run("score", tmp_path / "plan.fits", "--instrument", "moons")
    assert (code, "give --set catalog.hdu=NAME" in err) == (2, True)
    code, out, _ = run("score", tmp_path / "plan.fits", "--instrument", "moons", "--set", "catalog.hdu=4")
    assert code == 0
    assert str(len(table)) in next(line for line in out.splitlines() if line.startswith("  assigned")).split()


@pytest.mark.parametrize("file", ["{folder}", "example:anticenter"])
def test_the_option_hdu_is_only_for_fits_files(run, tmp_path, file):
    code, _, err = run("plan", file.format(folder=tmp_path), "--set", "catalog.hdu=1")
    assert code == 2
    assert "hdu must be used only with FITS files, got" in err
