"""The tables of the positioners without a target."""

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord

import rfpsurvey as rs
from rfpsurvey.allocation import IDLE_REASONS

CENTER = SkyCoord(95, 23, unit="deg")


@pytest.fixture(scope="module")
def tile(presets):
    apo = presets["sdss_apo"]
    sky = rs.synthetic_catalog("poisson", CENTER, apo.field_radius, density=apo.target_density / 2, rng=1)
    kind = np.where(np.arange(len(sky)) % 7 == 0, "sky", "science")
    return rs.plan_tile(
        rs.Catalog(sky.coord, kind=kind, id=[f"T{k}" for k in range(len(sky))]),
        apo,
        CENTER,
        allocator=rs.AllocationOptions("repair", requirements=["sky=10"]),
    )


def test_every_positioner_without_a_target_has_a_reason(tile):
    idle = tile.table[~np.isin(tile.table["status"], ("assigned", "out_of_reach"))]
    assert tile.idle["id"].tolist() == idle["id"].tolist()
    assert len(set(tile.idle["reason"].tolist())) > 2


def test_free_targets_have_no_positioner_and_are_in_reach(tile):
    free, outcomes = tile.idle_targets, tile.outcomes
    unused = outcomes["target_id"][outcomes["outcome"] == "in reach not assigned"]
    assert len(free) > 0
    assert set(free["target_id"].tolist()) <= set(unused.tolist())
    at = {name: k for k, name in enumerate(outcomes["target_id"].tolist())}
    centers = {row["id"]: (row["x"].to_value(u.mm), row["y"].to_value(u.mm)) for row in tile.table}
    outer = np.max(tile.table.meta["geometry"]["outer_radius_mm"])
    for row in free:
        one = outcomes[at[row["target_id"]]]
        assert (row["x"], row["y"], row["kind"]) == (one["x"], one["y"], one["kind"])
        assert np.hypot(*(np.array([row["x"].value, row["y"].value]) - centers[row["id"]])) <= outer * (1 + 1e-9)


def test_the_numbers_of_a_positioner_are_those_of_its_free_targets(tile):
    known = {*tile.table["id"].astype(str).tolist(), ""}
    obstacles = len(tile.table.meta["geometry"]["obstacles_mm"])
    known |= {f"obstacle-{k}" for k in range(obstacles)}
    for row in tile.idle:
        own = tile.idle_targets[tile.idle_targets["id"] == row["id"]]
        assert (row["n_free"], row["n_possible"]) == (len(own), own["possible"].sum())
        names = {name for text in own["colliding_with"].tolist() for name in text.split()}
        assert set(row["colliding_with"].split()) == names <= known
        reason = IDLE_REASONS.index(row["reason"])
        if reason < 4:
            assert len(own) == 0
        assert (reason == 5, reason == 2) == (bool(own["possible"].any()), row["n_in_reach"] == 0)


def test_tiles_without_a_plan_in_memory_have_no_reasons(tile, tmp_path):
    tile.write(tmp_path / "tile.fits")
    for other in (rs.Tile.read(tmp_path / "tile.fits"), rs.score_tile(tile.table, "sdss_apo")):
        assert other.idle is None
        assert other.idle_targets is None
