"""Pictures, compared with those in ``baseline`` under the pinned matplotlib of ``tox -e figures``.

After a wanted change, look at the new pictures and keep them:
``tox -e figures -- --mpl-generate-path=tests/figures/baseline``.
"""

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import MaskedColumn, QTable
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


@pytest.mark.mpl_image_compare(deterministic=True, savefig_kwargs={"dpi": 36}, tolerance=1)
def test_speed_against_accuracy():
    table = QTable({
        "method": ["exact", "sampled", "sampled", "sweep"],
        "n_points": MaskedColumn([0, 5, 65, 9], mask=[True, False, False, False]),
        "time": [0.04, 0.03, 0.8, 13] * u.ms,
        "misclassified": [0, 0.02, 0, 1.7],
        "max_error": np.array([1e-15, 1.2, 0.07, 4.2]) * u.mm,
    }, meta={"instrument": "lamost", "n_neighbor_pairs": 11769})  # fmt: skip
    figure = Figure(figsize=(9, 9))
    return rs.plot_speed_accuracy(table, axes=tuple(figure.subplots(2, sharex=True)))[0].figure
