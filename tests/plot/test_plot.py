"""Plots of the focal plane, with arms, or with dots for thousands of positioners."""

from dataclasses import replace

import astropy.units as u
import matplotlib.pyplot as plt
import numpy as np
import pytest
import shapely
from astropy.coordinates import SkyCoord
from matplotlib.collections import EllipseCollection, LineCollection, PathCollection, PolyCollection
from matplotlib.colors import to_hex
from matplotlib.figure import Figure

import rfpsurvey as rs
from rfpsurvey.plot._axes import ARM, COLLISION, FADED, IDLE, OBSTACLE, PATROL

CENTER = SkyCoord(95, 23, unit="deg")


@pytest.fixture(scope="module")
def tile(presets):
    sky = rs.synthetic_catalog("poisson", CENTER, 1.5 * u.deg, density=100 / u.deg**2, rng=3)
    return rs.plan_tile(sky, presets["sdss_apo"], CENTER, allocator="lamost_rule")


def artists(ax, kind, color):
    def color_of(collection):
        colors = collection.get_facecolor() if kind is PolyCollection else collection.get_edgecolor()
        return to_hex(colors[0]) if len(colors) else None

    return [c for c in ax.collections if type(c) is kind and color_of(c) == color.lower()]


def test_every_arm_is_drawn_once_in_its_color(tile):
    ax, t = rs.plot.plot_focal_plane(tile), tile.table
    for color, rows in ((COLLISION, t["in_collision"]), (ARM, (t["status"] == "assigned") & ~t["in_collision"])):
        central, eccentric = artists(ax, LineCollection, color)
        assert len(central.get_segments()) == len(eccentric.get_segments()) == rows.sum() > 10
        drawn = np.array(eccentric.get_segments())
        np.testing.assert_allclose(drawn[:, 1, 0], t["tip_x"][rows].value)
        np.testing.assert_allclose(drawn[:, 0, 1], t["elbow_y"][rows].value)
    assert ax.get_aspect() == 1
    # the number of artists does not depend on the number of positioners
    assert len(ax.collections) < 20


def test_a_part_shows_the_same_as_the_whole_does_there(tile):
    """Objects outside the axes are not drawn.

    They would make reports large, and legends would contain invisible objects.
    """
    low, high = np.array([40.0, -130.0]), np.array([140.0, 0.0])
    ax = rs.plot.plot_focal_plane(tile, region=[low, high] * u.mm)
    t, seen = tile.table, {}
    for color, rows in ((COLLISION, t["in_collision"]), (ARM, (t["status"] == "assigned") & ~t["in_collision"])):
        whole = np.column_stack([t["tip_x"].value, t["tip_y"].value])[rows]
        drawn = np.array(artists(ax, LineCollection, color)[1].get_segments())[:, 1]
        seen[color] = ((whole > low) & (whole < high)).all(axis=1).sum()
        assert ((drawn > low) & (drawn < high)).all(axis=1).sum() == seen[color]
        assert len(drawn) < len(whole)
    assert min(seen.values()) > 0
    assert rs.plot.plot_focal_plane(tile, region=[[1000, 1000], [1100, 1100]] * u.mm).get_legend() is None


def test_shades_are_half_the_safe_distance_wide(tile):
    body = artists(rs.plot.plot_focal_plane(tile), PolyCollection, COLLISION)[0].get_paths()[0].vertices
    row = np.flatnonzero(tile.table["in_collision"])[0]
    for name in ("elbow", "arm"):
        end = [tile.table[f"{name}_{axis}"][row].value for axis in "xy"]
        assert np.linalg.norm(body - end, axis=1).min() == pytest.approx(4.0782 / 2, abs=1e-4)
    # the capsule of SDSS-V ends 14.7276 mm from the elbow, before the fiber
    t = tile.table[row]
    assert np.hypot(t["arm_x"] - t["elbow_x"], t["arm_y"] - t["elbow_y"]).value == pytest.approx(14.7276)


def test_unassigned_positioners_are_gray_and_obstacles_are_there(tile, presets):
    ax = rs.plot.plot_focal_plane(tile)
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
    assert rs.plot.plot_focal_plane(tile, ax=ax, region=[[-50, -40], [50, 40]] * u.mm, alpha=0.5) is ax
    assert ax.get_xlim() == (50, -50)
    assert ax.get_ylim() == (-40, 40)
    arms = [c for c in artists(ax, LineCollection, COLLISION) if c.get_linewidths()[0] > 2]
    assert [c.get_alpha() for c in arms] == [0.5]


@pytest.mark.parametrize(
    ("thing", "options", "message"),
    [
        ("tile", {}, "unknown instrument 'tile'"),
        (3, {}, "thing must be a Tile, a FocalPlane, an Instrument or the name of an instrument, got int"),
        ("sdss_apo", {"region": [1, 2] * u.mm}, "region must be two finite corners"),
        ("sdss_apo", {"region": [[1, 2], [1, 3]] * u.mm}, "region must be two finite corners"),
        ("sdss_apo", {"color": "status"}, "color must be spectrograph or fiber_type"),
        ("sdss_apo", {"orientation": "up"}, "orientation must be 'sky' or 'focal plane', got 'up'"),
        ("sdss_apo", {"targets": [1, 2] * u.mm}, "targets must have the shape"),
    ],
)
def test_what_cannot_be_drawn_is_refused(thing, options, message):
    with pytest.raises(rs.InputError, match=message):
        rs.plot.plot_focal_plane(thing, **options)


def test_collisions_show_without_color(tile):
    ax = rs.plot.plot_focal_plane(tile)
    for color, hatched in ((COLLISION, True), (ARM, False)):
        (shade,) = artists(ax, PolyCollection, color)
        assert bool(shade.get_hatch()) == hatched
    widths = [artists(ax, LineCollection, color)[1].get_linewidths()[0] for color in (COLLISION, ARM)]
    assert widths[0] > 2 * widths[1]


def test_shades_are_all_points_within_half_the_safe_distance(tile):
    ax, rows = rs.plot.plot_focal_plane(tile), tile.table["in_collision"]
    for path, row in zip(artists(ax, PolyCollection, COLLISION)[0].get_paths(), tile.table[rows], strict=True):
        segment = shapely.LineString([(row[f"{e}_x"].value, row[f"{e}_y"].value) for e in ("elbow", "arm")])
        around = segment.buffer(4.0782 / 2, quad_segs=64)
        assert shapely.Polygon(path.vertices).symmetric_difference(around).area < 0.02 * around.area


def test_only_fiber_tips_are_shaded_where_only_they_collide(small):
    plane = replace(small.focal_plane, positioner=replace(small.focal_plane.positioner, arm_model="fiber_tip"))
    tile = rs.plan_tile(
        rs.synthetic_catalog("uniform", CENTER, 0.5 * u.deg, n_targets=200, rng=1),
        replace(small, focal_plane=plane),
        CENTER,
        allocator="lamost_rule",
    )
    t = tile.table[(tile.table["status"] == "assigned") & ~tile.table["in_collision"]]
    bodies = np.array(
        [p.vertices[:-1] for p in artists(rs.plot.plot_focal_plane(tile), PolyCollection, ARM)[0].get_paths()]
    )
    tips = np.column_stack([t["tip_x"], t["tip_y"]]).value
    np.testing.assert_allclose(np.linalg.norm(bodies - tips[:, None], axis=2), 2.25)


def test_a_focal_plane_without_a_tile_shows_what_cannot_move(small):
    n = len(small.focal_plane)
    stuck = np.full((n, 2), np.nan)
    stuck[5] = 30, 90
    disabled, circles = np.arange(n) == 7, [[12.8, 7.4, 1.5]] * u.mm
    plane = replace(small.focal_plane, stuck=stuck * u.deg, disabled=disabled, obstacles=circles)
    ax = rs.plot.plot_focal_plane(plane, linewidths=3)
    assert ax.get_title() == "37 positioners, 1 obstacle"
    free, not_free = (
        next(c for c in artists(ax, EllipseCollection, color) if c.get_linewidths()[0] == 3) for color in (PATROL, IDLE)
    )
    assert (len(free.get_offsets()), len(not_free.get_offsets())) == (35, 2)
    marks = {c.get_label(): c.get_offsets() for c in ax.collections if isinstance(c, PathCollection)}
    np.testing.assert_array_equal(marks["stuck"], plane.xy.value[[5]])
    np.testing.assert_array_equal(marks["disabled"], plane.xy.value[[7]])
    central, _ = artists(ax, LineCollection, IDLE)
    elbow = plane.xy.value[5] + 8.25 * np.array([np.cos(np.pi / 6), 0.5])
    np.testing.assert_allclose(central.get_segments()[0], [plane.xy.value[5], elbow])
    shade = artists(ax, PolyCollection, IDLE)[0].get_paths()[0].vertices
    assert np.linalg.norm(shade - elbow, axis=1).min() == pytest.approx(2.25)


def test_groups_are_disks_and_words_in_the_legend(presets):
    ax = rs.plot.plot_focal_plane(presets["sdss_apo"], color="fiber_type")
    assert {202, 298} <= {len(c.get_offsets()) for c in ax.collections}
    assert {"fiber type BOSS", "fiber type BOSS+APOGEE"} <= {t.get_text() for t in ax.get_legend().get_texts()}
    ax = rs.plot.plot_focal_plane(presets["lamost"], color="spectrograph")
    assert {t.get_text() for t in ax.texts} >= {str(k) for k in range(16)}
    assert len({to_hex(c.get_facecolor()[0]) for c in ax.collections if isinstance(c, EllipseCollection)}) == 16
    plane = replace(presets["sdss_apo"].focal_plane, spectrograph=np.arange(500))
    with pytest.raises(rs.InputError, match="spectrograph must have at most 24 values"):
        rs.plot.plot_focal_plane(plane, color="spectrograph")


def test_thousands_of_positioners_are_few_artists_and_the_legend_hides_none(presets):
    open_before = plt.get_fignums()  # those of tests that ran before this one
    for ax in (rs.plot.plot_focal_plane(presets["desi"]), rs.plot.plot_coverage(presets["desi"], n_pixels=50)):
        assert len(ax.collections) + len(ax.lines) + len(ax.images) < 20
        ax.figure.draw_without_rendering()
        box, labels = ax.get_legend().get_window_extent(), ax.xaxis.label.get_window_extent()
        assert 0 < box.y0 < box.y1 <= labels.y0
        assert 0 < box.x0 < box.x1 < ax.figure.bbox.x1
    assert plt.get_fignums() == open_before


@pytest.fixture(scope="module")
def large(presets):
    pfs = presets["pfs"]
    sky = rs.synthetic_catalog("uniform", CENTER, pfs.field_radius, n_targets=2000, rng=1)
    return rs.plan_tile(sky, pfs, CENTER, allocator="balanced")


def dots(ax):
    """Return the positions of dots by color."""
    return {to_hex(c.get_facecolor()[0]).lower(): c for c in ax.collections if isinstance(c, PathCollection)}


def arms(ax):
    return sum(len(c.get_segments()) for c in ax.collections if isinstance(c, LineCollection))


def places(table, name):
    return np.column_stack([table[f"{name}x"].value, table[f"{name}y"].value])


def test_large_planes_have_dots_in_place_of_arms(large):
    ax = rs.plot.plot_focal_plane(large)
    assert arms(ax) == 0
    t, found = large.table, dots(ax)
    assert set(found) == {color.lower() for color in (ARM, COLLISION, FADED)}
    colliding, target = np.asarray(t["in_collision"]), np.asarray(t["status"] == "assigned")
    # dots are at targets or, for positioners without a target, at centers
    np.testing.assert_allclose(found[COLLISION.lower()].get_offsets(), places(t, "tip_")[colliding])
    np.testing.assert_allclose(found[ARM.lower()].get_offsets(), places(t, "tip_")[target & ~colliding])
    np.testing.assert_allclose(found[FADED.lower()].get_offsets(), places(t, "")[~target & ~colliding])
    # dots of idle positioners are small; those of collisions are large, on top, and have a different shape
    size, order = (
        [found[c.lower()].__getattribute__(name)() for c in (FADED, ARM, COLLISION)]
        for name in ("get_sizes", "get_zorder")
    )
    assert size[0] < size[1] < size[2]
    assert order[0] < order[1] < order[2]
    shapes = [found[c.lower()].get_paths()[0].vertices for c in (ARM, COLLISION)]
    assert len(shapes[0]) != len(shapes[1])
    words = [text.get_text() for text in ax.get_legend().get_texts()]
    assert words == ["no target", "fiber on a target", "in collision"]


def test_a_part_of_a_large_plane_has_arms(large):
    ax = rs.plot.plot_focal_plane(large, region=[[-40, -40], [40, 40]] * u.mm)
    assert arms(ax) > 50
    assert not dots(ax)


def test_arms_can_be_asked_for(large, presets):
    assert arms(rs.plot.plot_focal_plane(large, arms=True)) > 1000
    sky = rs.synthetic_catalog("uniform", CENTER, 1.4 * u.deg, n_targets=200, rng=1)
    few = rs.plan_tile(sky, presets["sdss_apo"], CENTER)
    assert arms(rs.plot.plot_focal_plane(few)) > 200
    assert arms(rs.plot.plot_focal_plane(few, arms=False)) == 0


def test_targets_are_crosses_where_they_are_projected_to(presets, large):
    xy = presets["pfs"].projection(CENTER).to_focal_plane(SkyCoord([95, 95.3] * u.deg, [23.1, 22.9] * u.deg))
    ax = rs.plot.plot_focal_plane(large, targets=xy)
    (crosses,) = [c for c in ax.collections if c.get_label() == "target"]
    np.testing.assert_array_equal(crosses.get_offsets(), xy.value)
    assert "target" in [text.get_text() for text in ax.get_legend().get_texts()]


def test_groups_are_pale_below_dots(large):
    """Regression: dots could not be seen on a spectrograph of the same color."""
    for thing, opacity in ((large, 0.4), ("pfs", 1.0)):
        ax = rs.plot.plot_focal_plane(thing, color="spectrograph")
        fills = [c for c in ax.collections if isinstance(c, EllipseCollection) and c.get_zorder() == 0.9]
        assert [c.get_alpha() for c in fills] == [opacity] * 4


@pytest.mark.parametrize("targets", [None, "outcome"])
def test_many_collisions_cover_an_area_that_corresponds_to_their_fraction(presets, targets):
    """If most positioners collide, diamonds have the area of dots; if few collide, the diamonds are larger."""
    lamost = presets["lamost"]
    positioner = replace(lamost.focal_plane.positioner, clearance=7 * u.mm)
    wide = replace(lamost, focal_plane=replace(lamost.focal_plane, positioner=positioner))
    sky, ratio = rs.synthetic_catalog("uniform", CENTER, lamost.field_radius, n_targets=8000, rng=1), []
    for model in (lamost, wide):
        large = rs.plan_tile(sky, model, CENTER, allocator="balanced")
        found = dots(rs.plot.plot_focal_plane(large, targets=targets))
        diamonds, circles = found[COLLISION.lower()], found[ARM.lower()]
        edge = diamonds.get_linewidths()[0]
        ratio.append((np.sqrt(diamonds.get_sizes()[0]) + edge) ** 2 / (np.pi / 4 * circles.get_sizes()[0]))
    assert 0.6 < large.summary["collision_rate"] < 0.8
    assert ratio[0] > 1.5
    assert ratio[1] == pytest.approx(1)
