"""Plots of a tiling with a panel for each pass."""

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import QTable
from matplotlib.collections import PolyCollection

import rfpsurvey as rs


def tiling_of(passes, dec=20):
    n = len(passes)
    return rs.Tiling.from_table(
        QTable({"ra": (350 + 3 * np.arange(n)) % 360 * u.deg, "dec": [dec] * n * u.deg, "pass": passes})
    )


def test_each_pass_has_a_panel_on_the_same_map():
    """Regression: passes were drawn on top of each other in two colors."""
    tiling = tiling_of([1, 1, 3, 3, 3, 7])
    figure = rs.plot.draw_tiling(tiling)
    assert [ax.get_title() for ax in figure.axes] == ["pass 1: 2 tiles", "pass 3: 3 tiles", "pass 7: 1 tile"]
    assert len({(ax.get_xlim(), ax.get_ylim()) for ax in figure.axes}) == 1
    for ax, number in zip(figure.axes, (1, 3, 7), strict=True):
        (fields,) = [c for c in ax.collections if isinstance(c, PolyCollection)]
        middles = [path.vertices[:-1].mean(axis=0)[0] % 360 for path in fields.get_paths()]
        expected = tiling.table["ra"][tiling.table["pass"] == number].value
        assert middles == pytest.approx(expected, abs=1e-3)
        assert ax.xaxis_inverted()


def test_targets_and_the_region_are_in_every_panel():
    region, targets = rs.Region.parse("box 340 20 10 50"), SkyCoord([352, 358] * u.deg, [20, 21] * u.deg)
    figure = rs.plot.draw_tiling(tiling_of([1, 2]), targets=targets, region=region)
    for ax in figure.axes:
        *sides, dots = ax.get_lines()
        assert len(sides) == 4
        assert sorted(dots.get_xdata() % 360) == pytest.approx([352, 358])
        assert ax.get_ylim()[1] > 50  # the whole region is visible
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == ["region", "2 targets"]


def test_one_pass_and_many_passes_are_one_picture():
    for passes in ([1, 1], list(range(9))):
        assert rs.plot.draw_tiling(tiling_of(passes)).axes[0].get_title() == f"{len(passes)} tiles"


def test_the_whole_sky_has_panels():
    tiling = rs.place_tiles(rs.Region.whole_sky(), radius=30 * u.deg, method="spiral", passes=2)
    assert [ax.name for ax in rs.plot.draw_tiling(tiling).axes] == ["aitoff", "aitoff"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"tiling": 5}, "tiling must be a Tiling, got int"),
        ({"region": "sky"}, "region must be a Region, got str"),
        ({"targets": [1]}, "targets must be a SkyCoord"),
    ],
)
def test_bad_input_is_named(options, message):
    with pytest.raises(rs.InputError, match=message):
        rs.plot.draw_tiling(**{"tiling": tiling_of([1, 2]), **options})
