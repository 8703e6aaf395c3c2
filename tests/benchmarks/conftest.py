import astropy.units as u
import pytest
from astropy.coordinates import SkyCoord

import rfpsurvey as rs
from sky_center import CENTER


@pytest.fixture(scope="session")
def lamost():
    return rs.Instrument.preset("lamost")


@pytest.fixture(scope="session")
def stars(lamost):
    """Return 100,000 targets in the field of LAMOST, with computed unit vectors."""
    catalog = rs.synthetic_catalog("uniform", CENTER, lamost.field_radius, n_targets=100_000, rng=1)
    catalog.arrays.vectors  # noqa: B018
    return catalog


@pytest.fixture(scope="session")
def xy(lamost, stars):
    return lamost.projection(CENTER).to_focal_plane(stars)


@pytest.fixture(scope="session")
def tile_table(lamost, stars):
    """Plan a complete tile, which compiles all kernels."""
    return rs.plan_tile(stars, lamost, CENTER, allocator="lamost_rule", epoch=None).table


@pytest.fixture(scope="session", autouse=True)
def _warm(tile_table):
    rs.plan_tile(SkyCoord(95.1, 23.1, unit="deg"), "sdss_apo", CENTER, position_angle=1 * u.deg)
