"""Pictures, compared with those in ``baseline`` under the pinned matplotlib of ``tox -e figures``.

After a wanted change, look at the new pictures and keep them:
``tox -e figures -- --mpl-generate-path=tests/figures/baseline``.
"""

import astropy.units as u
import pytest
from astropy.coordinates import SkyCoord
from matplotlib.figure import Figure

import rfpsurvey as rs

CENTER = SkyCoord(95, 23, unit="deg")


def axes():
    """Axes without a layout engine: that of a default figure moves them a little each time it is drawn."""
    return Figure(figsize=(9, 9)).add_subplot()


def tile(instrument, **options):
    sky = rs.synthetic_catalog("uniform", CENTER, 1.4 * u.deg, n_targets=700, rng=1)
    return rs.plan_tile(sky, instrument, CENTER, **options)


@pytest.mark.mpl_image_compare(deterministic=True, savefig_kwargs={"dpi": 36}, tolerance=1)
def test_focal_plane_with_unequal_arms():
    return rs.plot_focal_plane(tile("sdss_apo"), ax=axes()).figure


@pytest.mark.mpl_image_compare(deterministic=True, savefig_kwargs={"dpi": 36}, tolerance=1)
def test_part_of_a_focal_plane_with_equal_arms():
    region = [[-120, -120], [120, 120]] * u.mm
    return rs.plot_focal_plane(tile("lamost", allocator="balanced"), ax=axes(), region=region).figure
