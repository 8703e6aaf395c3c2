"""The command that plans paths of the arms."""

from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest

import rfpsurvey as rs


@pytest.fixture(scope="module")
def tile(tmp_path_factory):
    """Return a tile without collisions, and its file."""
    path = tmp_path_factory.mktemp("paths") / "tile.fits"
    tile = rs.plan_tile(rs.example_catalog("anticenter"), "sdss_apo", "06h20m +23d", allocator="repair")
    tile.write(path)
    return tile, path


@pytest.mark.parametrize("ending", ["ecsv", "fits", "parquet"])
def test_paths_of_a_tile_are_written_and_proven_again(call, tile, tmp_path, ending):
    tile, path = tile
    out = call("paths {} --output", path, tmp_path / f"paths.{ending}").out
    plane = rs.Instrument.preset("sdss_apo").focal_plane
    paths = rs.collision.Paths.read(tmp_path / f"paths.{ending}", plane)
    n = tile.summary["n_assigned"]
    assert f"{paths.n_arriving} of {n} arms with a target reach it" in out
    assert f"smallest distance of two arms {paths.smallest_distance.value:.3f} mm" in out
    assert f"{len(paths.time)} break points of {len(plane)} arms" in out
    assert paths.n_arriving >= 0.99 * n
    unfold = paths.table[paths.table["motion"] == "unfold"]
    last = {row["positioner"]: row for row in unfold}
    for row in tile.table[tile.table["status"] == "assigned"][::20]:
        for name in ("theta", "phi"):
            difference = (last[row["id"]][name] - row[name]).to_value(u.deg)
            assert abs((difference + 180) % 360 - 180) < 1e-9


def test_the_paths_of_a_plan_of_another_program(call, real_data):
    path = real_data("sdssv_apo_2021/confSummary-998.par.gz")
    out = call(f"paths {{}} --instrument {path.parent}", path).out
    words = out.split()
    assert out.count("arms with a target reach it") == 1
    assert int(words[0]) >= 0.99 * int(words[2]) > 290


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ("--instrument moons", "--instrument must be the instrument of the tile, sdss_apo, got moons"),
        ("--step 0", "--step must be one finite value of at least 0.01 deg and below 90 deg, got 0.0 deg"),
        ("--margin -1", "--margin must be one finite value of at least 0 mm, got -1.0 mm"),
        ("--rng -1", "--rng must be a seed from 0 to 2^128 - 1, a numpy Generator or None, got -1"),
        ("--output paths.txt", "paths.txt"),
    ],
)
def test_bad_input_is_named(refused, tile, words, sentence):
    assert sentence in refused(f"paths {{}} {words}", tile[1])


def test_arms_that_collide_in_the_plan_are_named(refused, tile, tmp_path):
    tile = rs.plan_tile(rs.example_catalog("anticenter"), "sdss_apo", "06h20m +23d", allocator="nearest")
    assert tile.summary["n_colliding"] > 0
    tile.write(tmp_path / "tile.fits")
    sentence = refused("paths", tmp_path / "tile.fits")
    assert sentence.startswith(
        "rfpsurvey: the arms must not collide in the poses of the plan, but the arms of the positioners R"
    )


def test_the_instrument_of_a_tile_must_fit(tile):
    instrument = rs.Instrument.preset("sdss_apo")
    plane = instrument.focal_plane
    changed = replace(instrument, focal_plane=replace(plane, id=np.char.add(plane.id, "x")))
    with pytest.raises(rs.InputError, match="the tile must belong to the 500 positioners of sdss_apo, got other ids"):
        tile[0].paths(changed)


def test_the_report_shows_the_motion(call, refused, tile, tmp_path):
    out = call("paths {} --report {} --output", tile[1], tmp_path / "motion.html", tmp_path / "paths.ecsv").out
    assert out.endswith(f"wrote {tmp_path / 'paths.ecsv'}\nwrote {tmp_path / 'motion.html'}\n")
    text = (tmp_path / "motion.html").read_text()
    assert "MovingFocalPlane" in text
    assert "tile.fits" in text
    assert "motion.html exists; to replace it, use --overwrite" in refused(
        "paths {} --report", tile[1], tmp_path / "motion.html"
    )
    assert "page.txt: the name of this output file must end in .html" in refused("paths {} --report page.txt", tile[1])
