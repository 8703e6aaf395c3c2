"""The completeness of a tiling equals that of a survey of its tiles."""

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord

import rfpsurvey as rs
from rfpsurvey.instrument import as_instrument
from rfpsurvey.tiling import Fibers

CENTER = SkyCoord("8h +30d")
INSTRUMENTS = ("lamost", "sdss_apo", "moons", "desi")


def clustered(name, per_fiber=0.3, **columns):
    """Return a clustered catalog as wide as two fields, and the instrument."""
    model = as_instrument(name)
    radius, n = model.field_radius, len(model.focal_plane)
    density = per_fiber * n / (np.pi * radius**2)
    options = {"cluster_size": max(n // 10, 20), "cluster_scale": 0.2 * radius, "rng": 3}
    sky = rs.synthetic_catalog("clustered", CENTER, 2 * radius, density=density, **options)
    made = {key: make(len(sky)) for key, make in columns.items()}
    return rs.Catalog(sky.coord, **made), model


def delivered(catalog, model, tiling, **options):
    """Return the completeness of a survey of the tiles in the order of the list."""
    return rs.plan_survey(catalog, model, tiling, order="given", **options).summary["completeness"]


@pytest.mark.few(2)
@pytest.mark.parametrize("name", INSTRUMENTS)
def test_a_survey_delivers_what_the_tiling_says(name):
    catalog, model = clustered(name, 0.5, priority=lambda n: np.arange(n) % 3)
    tiling = rs.place_tiles(catalog, model, passes=2)
    assert tiling.summary["completeness"] < 1
    assert delivered(catalog, model, tiling) == pytest.approx(tiling.summary["completeness"], abs=1e-12)
    assert tiling.summary["completeness_means"].startswith("the allocator repair plans each tile")


@pytest.mark.parametrize("name", INSTRUMENTS)
def test_ideal_fibers_are_an_upper_limit(name):
    catalog, model = clustered(name)
    tiling = rs.place_tiles(catalog, model, fibers=len(model.focal_plane))
    assert delivered(catalog, model, tiling) < tiling.summary["completeness"] - 0.01
    assert tiling.summary["completeness_means"].startswith("an upper limit")


@pytest.mark.few(2)
@pytest.mark.parametrize("method", ["max_density", "mean_shift", "network_flow"])
@pytest.mark.parametrize("allocator", ["balanced", "repair"])
def test_every_method_and_allocator_agree(method, allocator):
    """One allocator uses random numbers; the stream of each tile is that of the survey."""
    catalog, model = clustered("sdss_apo", visits=lambda n: 1 + np.arange(n) % 2)
    tiling = rs.place_tiles(catalog, model, method=method, n_tiles=5, allocator=allocator, rng=7)
    found = delivered(catalog, model, tiling, allocator=allocator, rng=7)
    assert found == pytest.approx(tiling.summary["completeness"], abs=1e-12)


def test_targets_that_collide_may_count():
    catalog, model = clustered("sdss_apo")
    rule = {"n_tiles": 5, "allocator": "lamost_rule"}
    kept = rs.place_tiles(catalog, model, fibers=Fibers(lost_in_collision=False), **rule)
    lost = rs.place_tiles(catalog, model, **rule)
    assert kept.summary["completeness"] > lost.summary["completeness"]
    found = delivered(catalog, model, kept, allocator="lamost_rule", lost_in_collision=False)
    assert found == pytest.approx(kept.summary["completeness"], abs=1e-12)


def test_requirements_take_their_fibers():
    """Standards and blank sky are assigned as in a survey, and are not counted."""
    catalog, model = clustered("moons", 2, kind=lambda n: np.where(np.arange(n) % 10 == 0, "standard", "science"))
    needs = rs.AllocationOptions(requirements=["standard=100", "sky=200"], sky_separation=5 * u.arcsec)
    tiling = rs.place_tiles(catalog, model, n_tiles=4, allocator=needs)
    assert delivered(catalog, model, tiling, allocator=needs) == pytest.approx(
        tiling.summary["completeness"], abs=1e-12
    )
    without = rs.place_tiles(catalog, model, n_tiles=4)
    assert tiling.table["n_new"].sum() < 0.9 * without.table["n_new"].sum()
    assert tiling.summary["n_targets"] == (catalog.kind == "science").sum()


def test_a_goal_is_reached_in_the_survey():
    catalog, model = clustered("lamost")
    tiling = rs.place_tiles(catalog, model, completeness=0.8)
    assert delivered(catalog, model, tiling) >= 0.8
