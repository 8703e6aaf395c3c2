from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from matplotlib.collections import EllipseCollection, LineCollection, PathCollection
from matplotlib.colors import to_hex

import rfpsurvey as rs
from rfpsurvey.plot._style import ARM, COLLISION, FADED

CENTER = SkyCoord(95, 23, unit="deg")


@pytest.fixture(scope="module")
def tile(presets):
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


def test_large_planes_have_dots_in_place_of_arms(tile):
    ax = rs.plot.plot_focal_plane(tile)
    assert arms(ax) == 0
    t, found = tile.table, dots(ax)
    assert set(found) == {color.lower() for color in (ARM, COLLISION, FADED)}
    colliding = np.asarray(t["in_collision"])
    target = np.asarray(t["status"] == "assigned")
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


def test_a_part_of_a_large_plane_has_arms(tile):
    ax = rs.plot.plot_focal_plane(tile, region=[[-40, -40], [40, 40]] * u.mm)
    assert arms(ax) > 50
    assert not dots(ax)


def test_arms_can_be_asked_for(tile, presets):
    assert arms(rs.plot.plot_focal_plane(tile, arms=True)) > 1000
    sky = rs.synthetic_catalog("uniform", CENTER, 1.4 * u.deg, n_targets=200, rng=1)
    few = rs.plan_tile(sky, presets["sdss_apo"], CENTER)
    assert arms(rs.plot.plot_focal_plane(few)) > 200
    assert arms(rs.plot.plot_focal_plane(few, arms=False)) == 0


@pytest.mark.parametrize("name", ["lamost", "desi"])
def test_thousands_of_positioners_are_dots(presets, name):
    model = presets[name]
    sky = rs.synthetic_catalog("uniform", CENTER, model.field_radius, n_targets=3000, rng=1)
    ax = rs.plot.plot_focal_plane(rs.plan_tile(sky, model, CENTER, allocator="balanced"))
    assert arms(ax) == 0
    assert len(ax.collections) < 12


def test_targets_are_crosses_where_they_are_projected_to(presets, tile):
    pfs = presets["pfs"]
    coord = SkyCoord([95, 95.3] * u.deg, [23.1, 22.9] * u.deg)
    xy = pfs.projection(CENTER).to_focal_plane(coord)
    ax = rs.plot.plot_focal_plane(tile, targets=xy)
    (crosses,) = [c for c in ax.collections if c.get_label() == "target"]
    np.testing.assert_array_equal(crosses.get_offsets(), xy.value)
    assert "target" in [text.get_text() for text in ax.get_legend().get_texts()]


def test_groups_are_pale_below_dots(tile):
    """Regression: dots could not be seen on a spectrograph of the same color."""
    for thing, opacity in ((tile, 0.4), ("pfs", 1.0)):
        ax = rs.plot.plot_focal_plane(thing, color="spectrograph")
        fills = [c for c in ax.collections if isinstance(c, EllipseCollection) and c.get_zorder() == 0.9]
        assert [c.get_alpha() for c in fills] == [opacity] * 4


@pytest.mark.parametrize("targets", [None, "outcome"])
def test_many_collisions_cover_an_area_that_corresponds_to_their_fraction(presets, targets):
    """If most positioners collide, diamonds have the area of dots; if few collide, the diamonds are larger."""
    lamost = presets["lamost"]
    positioner = replace(lamost.focal_plane.positioner, clearance=7 * u.mm)
    wide = replace(lamost, focal_plane=replace(lamost.focal_plane, positioner=positioner))
    sky = rs.synthetic_catalog("uniform", CENTER, lamost.field_radius, n_targets=8000, rng=1)
    ratio = []
    for model in (lamost, wide):
        tile = rs.plan_tile(sky, model, CENTER, allocator="balanced")
        found = dots(rs.plot.plot_focal_plane(tile, targets=targets))
        diamonds, circles = found[COLLISION.lower()], found[ARM.lower()]
        edge = diamonds.get_linewidths()[0]
        ratio.append((np.sqrt(diamonds.get_sizes()[0]) + edge) ** 2 / (np.pi / 4 * circles.get_sizes()[0]))
    assert 0.6 < tile.summary["collision_rate"] < 0.8
    assert ratio[0] > 1.5
    assert ratio[1] == pytest.approx(1)
