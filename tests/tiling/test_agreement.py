"""The completeness of a tiling, and the targets of its tiles, are those of a survey of its tiles."""

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord

import rfpsurvey as rs
from rfpsurvey._instruments.instrument import as_instrument
from rfpsurvey._survey.tiling.problem import TilingState
from rfpsurvey.tiling import Fibers

CENTER = SkyCoord("8h +30d")


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


@pytest.mark.parametrize("name", ["lamost", "sdss_apo"])
def test_a_survey_delivers_what_the_tiling_says(name):
    catalog, model = clustered(name, 0.5, priority=lambda n: np.arange(n) % 3)
    tiling = rs.place_tiles(catalog, model, passes=2)
    assert tiling.summary["completeness"] < 1
    assert delivered(catalog, model, tiling) == pytest.approx(tiling.summary["completeness"], abs=1e-12)
    assert tiling.summary["completeness_means"].startswith("the allocator repair plans each tile")


@pytest.mark.parametrize("name", ["moons", "desi"])
def test_ideal_fibers_are_an_upper_limit(name):
    catalog, model = clustered(name)
    tiling = rs.place_tiles(catalog, model, fibers=len(model.focal_plane))
    assert delivered(catalog, model, tiling) < tiling.summary["completeness"] - 0.01
    assert tiling.summary["completeness_means"].startswith("an upper limit")


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
    found = delivered(catalog, model, tiling, allocator=needs)
    assert found == pytest.approx(tiling.summary["completeness"], abs=1e-12)
    without = rs.place_tiles(catalog, model, n_tiles=4)
    assert tiling.table["n_new"].sum() < 0.9 * without.table["n_new"].sum()
    assert tiling.summary["n_targets"] == (catalog.kind == "science").sum()


def test_a_goal_is_reached_in_the_survey():
    catalog, model = clustered("lamost")
    tiling = rs.place_tiles(catalog, model, completeness=0.8)
    assert delivered(catalog, model, tiling) >= 0.8


def observed_by_tiling(monkeypatch, catalog, *args, **options):
    """Return the rows of the targets that each tile observes, and the tiling."""
    found, observe = [], TilingState.observe

    def record(state, *rest, **more):
        found.append(np.sort(state.problem.index.order[observe(state, *rest, **more)]).tolist())

    with monkeypatch.context() as patch:
        patch.setattr(TilingState, "observe", record)
        tiling = rs.place_tiles(catalog, *args, **options)
    return found, tiling


def observed_by_survey(catalog, *args, **options):
    """Return the rows of the science targets that each tile observes, and the survey."""
    survey = rs.plan_survey(catalog, *args, order="given", **options)
    found = []
    for visits in survey:
        rows = np.asarray(visits["target_row"][visits["observed"] & (visits["target_row"] >= 0)])
        found.append(np.sort(rows if catalog.kind is None else rows[catalog.kind[rows] == "science"]).tolist())
    return found, survey


@pytest.mark.parametrize("factor", [0.6, 1.3])
def test_positioners_observe_the_field_of_the_instrument_for_every_radius_of_the_tiles(factor, monkeypatch):
    """Regression: with a smaller radius, tiles observed only the targets in this radius, unlike in a survey."""
    catalog, instrument = clustered("moons", kind=lambda n: np.where(np.arange(n) % 9 == 0, "standard", "science"))
    tiles = CENTER.spherical_offsets_by(*np.random.default_rng(3).uniform(-0.2, 0.2, (2, 4)) * u.deg)
    expected, _ = observed_by_survey(catalog, instrument, tiles, allocator="lamost_rule")
    radius = factor * instrument.field_radius
    found, _ = observed_by_tiling(
        monkeypatch, catalog, instrument, method="given", centers=tiles, allocator="lamost_rule", radius=radius
    )
    assert found == expected
    for method in ("max_density", "network_flow"):
        tiling = rs.place_tiles(catalog, instrument, method=method, n_tiles=3, allocator="lamost_rule", radius=radius)
        with pytest.warns(rs.RfpsurveyWarning, match="the tiles were placed for"):
            _, survey = observed_by_survey(catalog, instrument, tiling, allocator="lamost_rule")
        assert tiling.table["n_new"].tolist() == survey.tiles["n_observed"].tolist()


def test_centers_without_a_table_are_the_centers_of_a_survey():
    """Regression: the centers were converted to unit vectors and back, which changed the last digits."""
    centers = CENTER.spherical_offsets_by(*np.random.default_rng(1).uniform(-3, 3, (2, 50)) * u.deg)
    tiling = rs.place_tiles(rs.Region.cap(CENTER, 3 * u.deg), radius=2 * u.deg, method="given", centers=centers)
    assert tiling.table["ra"].value.tolist() == centers.ra.deg.tolist()
    assert tiling.table["dec"].value.tolist() == centers.dec.deg.tolist()
