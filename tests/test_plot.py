import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import QTable
from matplotlib.collections import EllipseCollection, LineCollection, PolyCollection
from matplotlib.colors import to_hex
from matplotlib.figure import Figure

import rfpsurvey as rs
from rfpsurvey.plot._style import ARM, COLLISION, IDLE, OBSTACLE

CENTER = SkyCoord(95, 23, unit="deg")


@pytest.fixture(scope="module")
def tile(presets):
    sky = rs.synthetic_catalog("poisson", CENTER, 1.5 * u.deg, density=100 / u.deg**2, rng=3)
    return rs.plan_tile(sky, presets["sdss_apo"], CENTER)


def artists(ax, kind, color):
    def color_of(collection):
        colors = collection.get_facecolor() if kind is PolyCollection else collection.get_edgecolor()
        return to_hex(colors[0]) if len(colors) else None

    return [c for c in ax.collections if type(c) is kind and color_of(c) == color.lower()]


def test_every_arm_is_drawn_once_in_its_color(tile):
    ax = rs.plot_focal_plane(tile)
    t = tile.table
    for color, rows in ((COLLISION, t["in_collision"]), (ARM, (t["status"] == "assigned") & ~t["in_collision"])):
        central, eccentric = artists(ax, LineCollection, color)
        assert len(central.get_segments()) == len(eccentric.get_segments()) == rows.sum() > 10
        drawn = np.array(eccentric.get_segments())
        np.testing.assert_allclose(drawn[:, 1, 0], t["tip_x"][rows].value)
        np.testing.assert_allclose(drawn[:, 0, 1], t["elbow_y"][rows].value)
    assert ax.get_aspect() == 1
    # few artists, however many positioners
    assert len(ax.collections) < 20


def test_shades_are_half_the_safe_distance_wide(tile):
    ax = rs.plot_focal_plane(tile)
    body = artists(ax, PolyCollection, COLLISION)[0].get_paths()[0].vertices
    row = np.flatnonzero(tile.table["in_collision"])[0]
    for name in ("elbow", "arm"):
        end = [tile.table[f"{name}_{axis}"][row].value for axis in "xy"]
        assert np.linalg.norm(body - end, axis=1).min() == pytest.approx(4.0782 / 2, abs=1e-4)
    # the capsule of SDSS-V ends 14.7276 mm from the elbow, short of the fiber
    t = tile.table[row]
    assert np.hypot(t["arm_x"] - t["elbow_x"], t["arm_y"] - t["elbow_y"]).value == pytest.approx(14.7276)


def test_unassigned_positioners_are_gray_and_obstacles_are_there(tile, presets):
    ax = rs.plot_focal_plane(tile)
    gray = artists(ax, EllipseCollection, IDLE)
    assert len(gray[0].get_offsets()) == (tile.table["status"] != "assigned").sum()
    circles = [
        c
        for c in ax.collections
        if isinstance(c, EllipseCollection) and len(c.get_facecolor()) and to_hex(c.get_facecolor()[0]) == OBSTACLE
    ]
    assert len(circles[0].get_offsets()) == 46


def test_axes_region_and_style_can_be_given(tile):
    ax = Figure().add_subplot()
    assert rs.plot_focal_plane(tile, ax=ax, region=[[-50, -40], [50, 40]] * u.mm, alpha=0.5) is ax
    assert ax.get_xlim() == (-50, 50)
    assert ax.get_ylim() == (-40, 40)
    with pytest.raises(rs.InputError, match="tile must be a Tile"):
        rs.plot_focal_plane("tile")
    with pytest.raises(rs.InputError, match="region must be two finite corners"):
        rs.plot_focal_plane(tile, region=[1, 2] * u.mm)


def test_probabilities_are_lines_of_methods():
    table = QTable({
        "method": ["closed_form", "quadrature", "quadrature"], "estimand": ["independent"] * 3, "effort": [0, 64, 128],
        "time": [1, 2, 4] * u.ms, "error": [0.1, 0.01, 0.005],
    }, meta={"instrument": "mine"})  # fmt: skip
    ax = rs.plot_probability_accuracy(table)
    formula, quadrature = ax.get_lines()
    assert formula.get_markerfacecolor() == "none"
    np.testing.assert_array_equal(quadrature.get_xydata(), [[2, 0.01], [4, 0.005]])
    assert [t.get_text() for t in ax.texts] == ["64", "128"]
    assert ax.get_title().startswith("mine")
    assert rs.plot_probability_accuracy(table, ax=ax) is ax
