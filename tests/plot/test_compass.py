import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import QTable
from matplotlib.patches import FancyArrowPatch

import rfpsurvey as rs
from rfpsurvey.plot._axes import add_compass

CENTER = SkyCoord(95, 23, unit="deg")


def arrows(ax):
    """Return the directions of the arrows on the screen, in pixels, by the letters at their ends."""
    ax.figure.draw_without_rendering()
    found = {}
    for patch in ax.findobj(FancyArrowPatch):
        begin, end = patch.get_path().vertices[[0, -1]]
        begin, end = patch.get_transform().transform([patch._posA_posB[0], patch._posA_posB[1]])
        found[patch.get_gid().removeprefix("compass-")] = (end - begin) / np.linalg.norm(end - begin)
    return found


def on_screen(ax, tile, instrument, angle):
    """Return the direction on the screen from the field center to a point half a degree away at a position angle."""
    plane = instrument.projection(CENTER, tile.provenance["parameters"]["position_angle_deg"] * u.deg)
    places = plane.to_focal_plane(CENTER.directional_offset_by(angle * u.deg, [0, 0.5] * u.deg)).to_value(u.mm)
    begin, end = ax.transData.transform(places)
    return (end - begin) / np.linalg.norm(end - begin)


@pytest.fixture(scope="module")
def sky():
    return rs.synthetic_catalog("uniform", CENTER, 1.4 * u.deg, n_targets=300, rng=1)


@pytest.mark.few(3)
@pytest.mark.parametrize("orientation", ["sky", "focal plane"])
@pytest.mark.parametrize("position_angle", [0, 30, 200])
def test_the_compass_points_where_the_projection_puts_north_and_east(presets, sky, position_angle, orientation):
    apo = presets["sdss_apo"]
    tile = rs.plan_tile(sky, apo, CENTER, position_angle=position_angle * u.deg, allocator="lamost_rule")
    for draw in (rs.plot.plot_focal_plane, rs.plot.plot_collision_map):
        ax = draw(tile, orientation=orientation)
        found = arrows(ax)
        assert set(found) == {"N", "E"}
        np.testing.assert_allclose(found["N"], on_screen(ax, tile, apo, 0), atol=0.01)
        np.testing.assert_allclose(found["E"], on_screen(ax, tile, apo, 90), atol=0.01)
        # on the sky, east is 90 deg counter-clockwise from north
        quarter = np.array([-found["N"][1], found["N"][0]])
        assert found["E"] @ quarter == pytest.approx(1 if orientation == "sky" else -1, abs=0.01)
        letters = {t.get_text(): t for t in ax.texts}
        assert f"PA {position_angle}\N{DEGREE SIGN}" in letters
        box = letters["N"].get_window_extent()
        middle, box = np.array([(box.x0 + box.x1) / 2, (box.y0 + box.y1) / 2]), letters["E"].get_window_extent()
        apart = np.array([(box.x0 + box.x1) / 2, (box.y0 + box.y1) / 2]) - middle
        assert apart @ (found["E"] - found["N"]) > 0.9 * np.linalg.norm(apart) * np.sqrt(2)


@pytest.mark.parametrize("draw", [rs.plot.plot_focal_plane, rs.plot.plot_coverage])
def test_instruments_are_drawn_at_position_angle_zero(presets, draw):
    up, left, right = [0, 1], [-1, 0], [1, 0]
    found = arrows(draw("sdss_apo"))
    np.testing.assert_allclose([found["N"], found["E"]], [up, left], atol=1e-9)
    found = arrows(draw("sdss_apo", orientation="focal plane"))
    np.testing.assert_allclose([found["N"], found["E"]], [up, right], atol=1e-9)


@pytest.mark.parametrize("position_angle", [0, 45, 123.456, 315.25])
def test_the_compass_is_inside_the_axes(presets, sky, position_angle):
    """Regression: the label of an angle with three decimals extended beyond the axes."""
    tile = rs.plan_tile(sky, presets["sdss_apo"], CENTER, position_angle=position_angle * u.deg)
    ax = rs.plot.plot_focal_plane(tile)
    ax.figure.draw_without_rendering()
    frame, boxes = ax.get_window_extent(), {t.get_text(): t.get_window_extent() for t in ax.texts}
    assert set(boxes) == {"N", "E", f"PA {round(position_angle, 1):g}\N{DEGREE SIGN}"}
    for box in boxes.values():
        assert min(box.x0 - frame.x0, box.y0 - frame.y0, frame.x1 - box.x1, frame.y1 - box.y1) > 1
    one, other, label = boxes.values()
    assert not one.overlaps(label)
    assert not other.overlaps(label)


def test_the_compass_hides_as_little_as_it_can(small):
    """Regression: the compass hid arms in a corner with a collision."""
    corners = {(1, 1): [-85, 85], (0, 1): [85, 85], (0, 0): [85, -85], (1, 0): [-85, -85]}
    for free, point in corners.items():
        ax = rs.plot.plot_focal_plane(small, region=[[-100, -100], [100, 100]] * u.mm)
        for artist in [*ax.artists, *ax.texts, *ax.findobj(FancyArrowPatch)]:
            artist.remove()
        add_compass(ax, 0.0, np.array([p for p in corners.values() if p != point]))
        ax.figure.draw_without_rendering()
        (north,) = [t for t in ax.texts if t.get_text() == "N"]
        x, y = ax.transAxes.inverted().transform(north.get_window_extent().get_points().mean(axis=0))
        assert (round(x), round(y)) == free


def test_no_compass_where_the_position_angle_is_unknown(small):
    xy = small.focal_plane.xy[:3] + [3, 0] * u.mm
    tile = rs.score_tile(QTable({"positioner": small.focal_plane.id[:3], "x": xy[:, 0], "y": xy[:, 1]}), small)
    assert "position_angle_deg" not in tile.provenance["parameters"]
    assert not arrows(rs.plot.plot_focal_plane(tile))
