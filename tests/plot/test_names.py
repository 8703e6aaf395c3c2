"""Abbreviated names in figures."""

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord

import rfpsurvey as rs
from rfpsurvey.plot._classes import MOST, short_names

CENTER = SkyCoord(95, 23, unit="deg")
SETS = {
    "same beginning": [f"bright_emission_line_galaxies_of_program_{k}" for k in range(30)],
    "same end": [f"{k}_bright_emission_line_galaxies_of_program" for k in range(30)],
    "same beginning and end": [f"bright_emission_line_{k}_galaxies_of_a_program" for k in range(30)],
    "short": ["LRG", "ELG", "QSO", ""],
    "mixed": ["LRG", "x" * 22, "x" * 23, "x" * 24],
}


@pytest.mark.parametrize("names", SETS.values(), ids=SETS)
def test_different_names_have_different_short_names(names):
    short = short_names(names)
    assert len(set(short)) == len(set(names))
    assert max(map(len, short)) <= MOST
    assert all(a == b for a, b in zip(names, short, strict=True) if names is SETS["short"])


def test_long_names_of_categories_do_not_shrink_the_axes(presets):
    """Regression: names of 40 characters reduced the axes to a third of the figure, or were cut off."""
    apo = presets["sdss_apo"]
    sky = rs.synthetic_catalog("poisson", CENTER, apo.field_radius, density=300 / u.deg**2, rng=1)
    names = np.array(SETS["same beginning"][:14])[np.arange(len(sky)) % 14]
    tile = rs.plan_tile(rs.Catalog(sky.coord, category=names), apo, CENTER)
    for ax, least in ((rs.plot.plot_quality(tile)[0], 0.3), (rs.plot.plot_focal_plane(tile, targets="category"), 0.75)):
        figure = ax.figure
        figure.canvas.draw()
        assert ax.get_position().width > least
        box = ax.get_legend().get_window_extent()
        assert box.x0 >= 0
        assert box.x1 <= figure.bbox.x1
