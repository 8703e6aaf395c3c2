from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from matplotlib.collections import EllipseCollection, LineCollection
from matplotlib.figure import Figure

import flat
import rfpsurvey as rs

CENTER = SkyCoord(10 * u.deg, 20 * u.deg)
ROBOT = rs.Positioner(5 * u.mm, 9 * u.mm, 1 * u.mm)


def words(ax):
    return [t.get_text() for t in ax.get_legend().get_texts()]


def test_pixels_count_the_annuli_around_them():
    plane = rs.FocalPlane.hexagonal(ROBOT, rings=2, pitch=15 * u.mm, disabled=np.arange(19) == 9)
    ax = rs.plot.plot_coverage(plane, region=[[-20, -10], [30, 15]] * u.mm, n_pixels=50, alpha=0.5)
    (image,) = ax.images
    assert tuple(image.get_extent()) == (-20, 30, -10, 15)
    assert (ax.get_xlim(), ax.get_ylim()) == ((30, -20), (-10, 15))
    assert image.get_alpha() == 0.5
    x, y = np.meshgrid(np.arange(-19.5, 30), np.arange(-9.5, 15))
    distance = np.hypot(*(np.stack([x, y])[..., None] - plane.xy.value[np.arange(19) != 9].T[:, None, None]))
    counts = ((distance >= 4) & (distance <= 14)).sum(axis=-1)
    assert len(np.unique(counts)) > 3
    np.testing.assert_array_equal(image.get_array(), counts)


def test_the_legend_gives_the_parts_of_the_footprint(presets):
    parts, ax = 100 * presets["moons"].focal_plane.coverage(), rs.plot.plot_coverage("moons", n_pixels=20)
    shown = [float(text.split("(")[1].removesuffix(" %)").removeprefix("< ")) for text in words(ax)]
    assert shown == pytest.approx(parts, rel=0.05, abs=0.2)
    assert words(ax)[0].startswith("no positioner")
    assert words(ax)[2].startswith("2 positioners (")
    assert ax.get_title().startswith("moons")


def test_many_positioners_are_put_together_and_a_line_has_no_footprint():
    unit = replace(ROBOT, central_arm=14 * u.mm, eccentric_arm=15 * u.mm)
    texts = words(rs.plot.plot_coverage(rs.FocalPlane.hexagonal(unit, rings=3, pitch=15 * u.mm), n_pixels=20))
    assert texts[-1].startswith("6 or more")
    assert sum(float(t.split("(")[1].removesuffix(" %)")) for t in texts if "<" not in t) == pytest.approx(100, abs=0.5)
    two = rs.FocalPlane([[0, 0], [20, 0]] * u.mm, ROBOT)
    ax = rs.plot.plot_coverage(two, n_pixels=100)
    assert words(ax) == ["no positioner", "1 positioner", "2 positioners"]
    assert not ax.get_lines()
    with pytest.raises(rs.InputError, match="n_pixels must be a whole number"):
        rs.plot.plot_coverage(two, n_pixels=0)
    with pytest.raises(rs.InputError, match="must be a name, an Instrument or a FocalPlane"):
        rs.plot.plot_coverage(7)


def disks(ax):
    return [c for c in ax.collections if isinstance(c, EllipseCollection)]


def test_estimates_are_disks_colored_by_probability(small):
    plane = replace(small.focal_plane, disabled=np.arange(37) < 3)
    estimate = flat.collision_probability(plane, method="quadrature", max_iterations=64)
    into = Figure().add_subplot()
    ax = rs.plot.plot_collision_map(estimate, plane, ax=into, cmap="gray")
    assert ax is into
    filled, open_ones = disks(ax)
    np.testing.assert_array_equal(filled.get_array(), estimate.per_positioner[3:])
    np.testing.assert_array_equal(filled.get_offsets(), plane.xy.value[3:])
    low, high = np.nanmin(estimate.per_positioner), np.nanmax(estimate.per_positioner)
    assert filled.get_clim() == pytest.approx((low - 0.15 * (high - low), high))
    assert filled.get_cmap().name == "gray"
    np.testing.assert_array_equal(open_ones.get_offsets(), plane.xy.value[:3])
    assert (words(ax), ax.child_axes[0].get_ylabel()) == (["not counted"], "collision probability")
    # disks of neighbors do not overlap
    assert filled.get_widths()[0] == pytest.approx(0.96 * 25.6)


def test_counts_are_parts_of_the_configurations(small):
    plane, tips = small.focal_plane, np.full((4, 37, 2), np.nan)
    # the first two arms collide in half of the configurations
    tips[:2, :2] = plane.xy.value[:2] + [[[12, 0], [-12, 0]]]
    counts = rs.collision.count_collisions(plane, tips * u.mm, parked_obstacles=False)
    ax = rs.plot.plot_collision_map(counts, small)
    assert disks(ax)[0].get_array().tolist() == [0.5, 0.5] + [0] * 35
    assert ax.child_axes[0].get_ylabel() == "fraction of configurations in collision"
    with pytest.raises(rs.InputError, match="at least one configuration"):
        rs.plot.plot_collision_map(rs.collision.count_collisions(plane, tips[:0] * u.mm), small)


def test_a_report_and_its_tile_give_the_same_map(small):
    long = rs.Positioner(8.25 * u.mm, 16.5 * u.mm, 2.25 * u.mm)
    small = replace(small, focal_plane=replace(small.focal_plane, positioner=long))
    sky = rs.synthetic_catalog("uniform", CENTER, 0.5 * u.deg, n_targets=200, rng=2)
    tile = rs.plan_tile(sky, small, CENTER, allocator="balanced")
    t = tile.table
    tips = np.column_stack([t["tip_x"], t["tip_y"]])
    tips[t["status"] != "assigned"] = np.nan
    report = rs.find_collisions(small.focal_plane, tips)
    assert len(report.pairs) > 1
    for ax in (rs.plot.plot_collision_map(report, small), rs.plot.plot_collision_map(tile)):
        free, colliding = disks(ax)
        np.testing.assert_array_equal(colliding.get_offsets(), small.focal_plane.xy.value[t["in_collision"]])
        assert len(free.get_offsets()) == 37 - t["in_collision"].sum()
        assert colliding.get_hatch()
        assert not free.get_hatch()
        (links,) = [c for c in ax.collections if isinstance(c, LineCollection)]
        np.testing.assert_array_equal(links.get_segments(), small.focal_plane.xy.value[report.pairs])
        assert words(ax) == ["no collision", "in collision", "colliding pair"]
    with pytest.raises(rs.InputError, match="instrument must be None for a Tile, which has its own positioners"):
        rs.plot.plot_collision_map(tile, small)


@pytest.mark.parametrize(
    ("collisions", "plane", "message"),
    [
        (np.zeros(5), "small", "a value for each of the 37 positioners"),
        (np.full(37, 2.0), "small", "must lie from 0 to 1, got 2 to 2"),
        (np.zeros(37), None, "instrument must be given: ndarray"),
        ("text", "small", "collisions must be an Estimate"),
    ],
)
def test_what_is_no_map_is_refused(collisions, plane, message, small):
    with pytest.raises(rs.InputError, match=message):
        rs.plot.plot_collision_map(collisions, small if plane else None)


def test_one_positioner_is_a_map(small):
    one = rs.FocalPlane([[0, 0]] * u.mm, ROBOT)
    assert len(disks(rs.plot.plot_collision_map(np.array([np.nan]), one))) == 2
    (free,) = [c for c in disks(rs.plot.plot_collision_map(np.array([False]), one)) if len(c.get_offsets())]
    assert len(free.get_offsets()) == 1


def test_maps_of_large_instruments_have_contrast(presets):
    """Regression: with colors that began at 0, all of DESI had one color, and reach 1 and reach 2 looked alike."""
    desi = presets["desi"]
    estimate = flat.collision_probability(desi, method="quadrature", max_iterations=32)
    filled = disks(rs.plot.plot_collision_map(estimate, desi))[0]
    light = filled.to_rgba([np.nanmin(estimate.per_positioner), np.nanmax(estimate.per_positioner)])[:, :3].sum(axis=1)
    assert light[0] - light[1] > 1.7
    (image,) = rs.plot.plot_coverage(desi).images
    none, one, two = image.to_rgba(np.arange(3))[:, :3].sum(axis=1)
    assert none - one > 0.7
    assert one - two > 0.7
    # the overlaps, 1.6 mm wide, are visible
    assert max(image.get_array().shape) * 1.6 / 780 > 2


def test_equal_probabilities_have_one_color(small):
    assert disks(rs.plot.plot_collision_map(np.full(37, 0.25), small))[0].get_clim() == (0, 0.25)
    assert disks(rs.plot.plot_collision_map(np.zeros(37), small))[0].get_clim() == (0, 1)
