"""Tiles are placed for the targets of the highest priority first."""

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord

import rfpsurvey as rs

GREEDY = ("max_density", "density_gradient", "mean_shift")


def clusters(*groups):
    """Return a catalog of clusters, each given by right ascension (deg), number of targets and priority."""
    rng = np.random.default_rng(1)
    ra = np.concatenate([ra + 0.2 * rng.standard_normal(n) for ra, n, _ in groups])
    priority = np.concatenate([np.full(n, float(p)) for _, n, p in groups])
    return rs.Catalog(SkyCoord(ra, 0.2 * rng.standard_normal(len(ra)), unit="deg"), priority=priority)


@pytest.mark.parametrize("method", GREEDY)
def test_the_first_tile_observes_the_highest_priority(method):
    catalog = clusters((10, 100, 1), (30, 90, 1000), (50, 120, 20))
    tiling = rs.place_tiles(catalog, radius=1 * u.deg, fibers=200, method=method)
    np.testing.assert_allclose(tiling.table["ra"][:3].to_value(u.deg), [30, 50, 10], atol=0.6)
    assert tiling.table["n_new"][:3].tolist() == [90, 120, 100]


@pytest.mark.parametrize("method", GREEDY)
def test_equal_priorities_place_the_tiles_of_a_catalog_without_priorities(method):
    catalog = clusters((10, 100, 5), (11.5, 40, 5), (30, 120, 5))
    plain = rs.Catalog(catalog.coord)
    tables = [rs.place_tiles(one, radius=1 * u.deg, fibers=50, method=method).table for one in (catalog, plain)]
    assert tables[0].pformat() == tables[1].pformat()


def test_other_priorities_decide_between_equal_numbers():
    """Both clusters have 30 targets of the highest priority; only the second also has others."""
    catalog = clusters((10, 30, 9), (30, 30, 9), (30, 50, 2), (50, 200, 1))
    tiling = rs.place_tiles(catalog, radius=1.5 * u.deg, fibers=300, method="max_density")
    np.testing.assert_allclose(tiling.table["ra"].to_value(u.deg), [30, 10, 50], atol=1)
    assert tiling.table["n_new"].tolist() == [80, 30, 200]


def test_many_priorities_observe_every_target():
    rng = np.random.default_rng(4)
    coord = SkyCoord(rng.uniform(0, 6, 500), rng.uniform(-3, 3, 500), unit="deg")
    catalog = rs.Catalog(coord, priority=rng.permutation(500).astype(float))
    tiling = rs.place_tiles(catalog, radius=1 * u.deg, fibers=40, method="max_density")
    assert tiling.summary["completeness"] == 1
    near = tiling.table["ra"][0].to_value(u.deg) - coord.ra.deg, tiling.table["dec"][0].to_value(u.deg) - coord.dec.deg
    assert (np.hypot(*near) < 1.001)[catalog.priority >= 495].any()
