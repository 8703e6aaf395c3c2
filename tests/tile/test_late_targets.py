"""Plans with targets that are added to a planned tile."""

from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest

import rfpsurvey as rs

CENTER, N_LATE = "10h +20d", 30


@pytest.fixture(scope="module", params=["sdss_apo", "lamost"])
def case(request, presets):
    """Return an instrument, a catalog, and the tile that is planned without the last targets of the catalog."""
    instrument = presets[request.param]
    n = 2 * len(instrument.focal_plane)
    sky = rs.synthetic_catalog("uniform", CENTER, instrument.field_radius, n_targets=n, rng=1)
    sky = rs.Catalog(sky.coord, id=np.arange(n), priority=np.where(np.arange(n) < n - N_LATE, 1.0, 5.0))
    return instrument, sky, rs.plan_tile(sky[: n - N_LATE], instrument, CENTER, allocator="optimal")


@pytest.mark.parametrize("allocator", ["optimal", "repair"])
def test_fewer_fibers_change(case, allocator):
    instrument, sky, before = case
    usual = rs.plan_tile(sky, instrument, CENTER, allocator=allocator)
    found = rs.plan_tile(sky, instrument, CENTER, allocator=rs.AllocationOptions(allocator, start=before))
    n = [int((np.asarray(t.table["target_id"]) != np.asarray(before.table["target_id"])).sum()) for t in (usual, found)]
    assert n[1] <= n[0] - (instrument.name == "sdss_apo")
    assert (found.summary["search"]["n_changed"], found.summary["n_colliding"]) == (n[1], 0)
    if allocator == "optimal":
        assert found.summary["objectives"] == usual.summary["objectives"]
        assert np.isin(found.table["target_id"], sky.id[-N_LATE:]).sum() > N_LATE / 2


def test_the_same_targets_change_no_fiber(case):
    instrument, sky, before = case
    sky = sky[: len(sky) - N_LATE]
    shuffled = sky[np.random.default_rng(2).permutation(len(sky))]
    for catalog in (sky, shuffled):
        found = rs.plan_tile(catalog, instrument, CENTER, allocator=rs.AllocationOptions("optimal", start=before))
        assert found.summary["search"]["n_changed"] == 0
        assert (found.table["target_id"] == before.table["target_id"]).all()
        np.testing.assert_allclose(found.table["phi"].value, before.table["phi"].value, atol=1e-9)


def test_a_tile_that_was_written_and_read(case, tmp_path):
    instrument, sky, before = case
    before.write(tmp_path / "tile.fits")
    options = rs.AllocationOptions("optimal", start=rs.Tile.read(tmp_path / "tile.fits"))
    found = rs.plan_tile(sky[: len(sky) - N_LATE], instrument, CENTER, allocator=options)
    assert found.summary["search"]["n_changed"] == 0


def test_tiles_that_do_not_fit(case):
    instrument, sky, before = case
    options = rs.AllocationOptions("optimal", start=before)
    with pytest.raises(rs.InputError, match="start must be a tile with the same positioners"):
        rs.plan_tile(sky, "desi", CENTER, allocator=options)
    with pytest.raises(rs.InputError, match="for a survey, start must be the name of an allocator"):
        rs.plan_survey(sky, instrument, sky.coord[:1], allocator=options)
    with pytest.warns(rs.RfpsurveyWarning, match="start has no effect"):
        rs.plan_tile(sky, instrument, CENTER, allocator=rs.AllocationOptions("nearest", start=before))


def real_changes(before, after):
    return int((np.asarray(before.table["target_id"]) != np.asarray(after.table["target_id"])).sum())


@pytest.mark.parametrize("allocator", ["optimal", "repair"])
def test_targets_at_the_same_place(case, allocator):
    """Regression: targets were found by their positions only, and another target with this position was taken."""
    instrument, sky, _ = case
    rows = np.repeat(np.arange(len(instrument.focal_plane)), 2)
    twice = replace(sky[rows], id=np.arange(len(rows)), priority=np.tile([1.0, 2.0], len(rows) // 2))
    before = rs.plan_tile(twice, instrument, CENTER, allocator=allocator)
    order = np.random.default_rng(1).permutation(len(rows))
    found = rs.plan_tile(twice[order], instrument, CENTER, allocator=rs.AllocationOptions(allocator, start=before))
    assert found.summary["search"]["n_changed"] == real_changes(before, found) < (1 if allocator == "optimal" else 20)


def test_targets_that_are_gone_and_broken_positioners(case):
    """Regression: fibers that lost their target, and had none afterwards, were not counted."""
    instrument, sky, before = case
    options = rs.AllocationOptions("optimal", start=before)
    few = rs.plan_tile(sky[:90], instrument, CENTER, allocator=options)
    assert few.summary["search"]["n_changed"] == real_changes(before, few)
    disabled = np.arange(len(instrument.focal_plane)) % 13 == 0
    broken = replace(instrument, focal_plane=replace(instrument.focal_plane, disabled=disabled))
    found = rs.plan_tile(sky[: len(sky) - N_LATE], broken, CENTER, allocator=options)
    assert found.summary["search"]["n_changed"] == real_changes(before, found)


def test_another_time_and_another_field(case):
    """Regression: a tile was not used, without a warning, if the targets had moved by a nanometer."""
    instrument, sky, before = case
    early = sky[: len(sky) - N_LATE]
    options = rs.AllocationOptions("optimal", start=before)
    usual, found = (
        rs.plan_tile(early, instrument, CENTER, allocator=one, position_angle=1e-4 * u.deg)
        for one in ("optimal", options)
    )
    assert found.summary["search"]["n_changed"] == real_changes(before, found) <= min(5, real_changes(before, usual))
    other, words = replace(early, id=10**6 + early.id), "no fiber of the tile in start has a target that it can keep"
    with pytest.warns(rs.RfpsurveyWarning, match=words) as warned:
        rs.plan_tile(other, instrument, CENTER, allocator=options, position_angle=1 * u.deg)
    assert sum("no fiber of the tile in start" in str(one.message) for one in warned) == 1
