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


MOONS = "--instrument moons"
SEVERAL = "the file has 3 tables, and only the first one was read: 1 (EXPOSURES), 2 (TARGETS), 3 (TILES)"


@pytest.fixture
def errors_of(run):
    """Return a function that runs a command that is refused, and returns its errors, which contain a warning."""

    def errors_of(words, path):
        code, _, err = run(*(path if word == "{}" else word for word in words.split()))
        assert code == 2
        return err

    return errors_of


@pytest.mark.few(2)
@pytest.mark.parametrize(
    "words",
    [
        f"plan {{}} {MOONS}",
        "compare moons --catalog {} --allocator nearest",
        f"compare-allocators {{}} {MOONS} --allocator nearest",
        f"survey {{}} {MOONS} --tiles {{}} --set tiles.hdu=TILES",
        f"select {{}} {MOONS} --n-realizations 2 --tiles {{}} --set tiles.hdu=3",
        f"tile {{}} {MOONS} --method given --centers {{}} --set tiles.hdu=tiles",
        "probability moons --precision 0.1 --targets {}",
    ],
)
def test_the_option_hdu_selects_a_table_of_targets(call, errors_of, path, words):
    """Only the first table of a FITS file could be read."""
    paths = [path] * words.count("{}")
    message = errors_of(words, path)
    assert f"{path}: {SEVERAL}" in message
    assert "to read another table, give hdu= or --set catalog.hdu=NAME" in message
    for hdu in ("2", "targets"):
        out, err = call(f"{words} --set catalog.hdu={hdu}", *paths)
        assert "columns: priority: none, visits: none, id: id, ra: ra, dec: dec\n" in out
        assert "the file has 3 tables" not in err


def test_the_option_hdu_selects_the_table_of_an_assignment(call, errors_of, path, tmp_path):
    target = rs.plan_tile(rs.Catalog.read(path, hdu=2), "moons").table
    table = target[target["status"] == "assigned"]["id", "tip_x", "tip_y"]
    table.meta, plan = {}, tmp_path / "plan.fits"
    with fits.open(path) as hdus:
        hdus.append(fits.table_to_hdu(table))
        hdus.writeto(plan)
    assert "give --set catalog.hdu=NAME" in errors_of(f"score {{}} {MOONS}", plan)
    assert str(len(table)) in call(f"score {{}} {MOONS} --set catalog.hdu=4", plan).lines["assigned"]


@pytest.mark.parametrize("file", ["{}", "example:anticenter"])
def test_the_option_hdu_is_only_for_fits_files(refused, tmp_path, file):
    message = refused(f"plan {file} --set catalog.hdu=1", *[tmp_path] * file.count("{}"))
    assert "hdu must be used only with FITS files, got" in message
