"""Maps of tilings and surveys, and plots of a tiling with a panel for each pass."""

import astropy.units as u
import matplotlib
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import QTable
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import to_hex

import rfpsurvey as rs
from rfpsurvey.plot._classes import STATE_COLORS
from rfpsurvey.plot._sky_map import outlines_of_whole_sky

CENTER = SkyCoord(359.5 * u.deg, 20 * u.deg)


@pytest.fixture(scope="module")
def survey(small):
    sky = rs.synthetic_catalog("poisson", CENTER, 2 * u.deg, density=200 / u.deg**2, rng=3)
    sky = rs.Catalog(sky.coord, priority=np.arange(len(sky)) % 2)
    tiles = SkyCoord([359.0, 0.2, 359.5] * u.deg, [20, 20, 20.5] * u.deg)
    return rs.plan_survey(sky, small, QTable({"ra": tiles.ra, "dec": tiles.dec, "pass": [1, 1, 2]}))


def test_fields_are_drawn_where_they_are_on_either_side_of_the_origin(survey):
    ax = rs.plot.plot_tiling(survey)
    (circles,) = [c for c in ax.collections if isinstance(c, PolyCollection)]
    (edges,) = [c for c in ax.collections if isinstance(c, LineCollection)]
    corners = np.array([path.vertices for path in circles.get_paths()])[:, :-1]
    rims = np.array(edges.get_segments())
    assert np.ptp(rims[..., 0]) < 10
    radius = survey.provenance["parameters"]["radius_deg"] * u.deg
    for k, center in enumerate(SkyCoord(survey.tiles["ra"], survey.tiles["dec"])):
        # the outline is that of the field, and the fill is smaller for later passes
        for points, size in ((rims[k], 1), (corners[k], 0.75 if survey.tiles["pass"][k] == 2 else 1)):
            rim = SkyCoord(points[:, 0] * u.deg, points[:, 1] * u.deg)
            assert np.abs(rim.separation(center) - size * radius).max() < 1e-6 * u.deg
    assert np.array_equal(circles.get_array(), survey.tiles["completeness"])
    assert ax.xaxis_inverted()
    ax.figure.draw_without_rendering()
    assert {t.get_text() for t in ax.get_xticklabels()} <= {f"{x:g}" for x in np.arange(0, 360, 0.25)}


def outlines(ax):
    (drawn,) = [c for c in ax.collections if isinstance(c, PolyCollection)]
    return [path.vertices[:-1] for path in drawn.get_paths()], drawn.get_array()


@pytest.mark.parametrize("method", ["spiral", "max_density"])
def test_targets_can_be_drawn_on_a_map_of_the_whole_sky(method):
    """The map raised an error of matplotlib, because its limits cannot be set."""
    z, lon = np.random.default_rng(1).uniform((-1, 0), (1, 360), (300, 2)).T
    sky = SkyCoord(lon * u.deg, np.rad2deg(np.arcsin(z)) * u.deg)
    tiling = rs.place_tiles(sky, radius=25 * u.deg, fibers=30, method=method)
    for axes in ([rs.plot.plot_tiling(tiling, targets=sky)], rs.plot.draw_tiling(tiling, targets=sky).axes):
        shown = [ax for ax in axes if ax.name == "aitoff"]
        assert shown
        assert any(len(line.get_xdata()) == 300 for line in shown[0].lines)


def test_wide_tilings_show_the_whole_sky():
    """The outlines of fields in the center of the map, across its edge, and over a pole are correct."""
    tiling = rs.Tiling.from_table(QTable({"ra": [180, 0.5, 77, 300] * u.deg, "dec": [0, 30, 89, -30] * u.deg}))
    radius = 3 * u.deg
    ax = rs.plot.plot_tiling(tiling, radius=radius, color="tile")
    assert ax.name == "aitoff"
    polygons, tile_of = outlines_of_whole_sky(tiling.coord, 3.0)
    drawn, values = outlines(ax)
    assert np.array_equal(values, tile_of)
    for one, polygon in zip(drawn, polygons, strict=True):
        assert len(one) == len(polygon)
        pixels = (ax.transAffine + ax.transAxes).transform(one)
        np.testing.assert_allclose(pixels, ax.transData.transform(polygon), atol=1e-6)
    assert np.bincount(tile_of.astype(int)).tolist() == [1, 2, 1, 1]  # one field is cut by the edge
    for polygon, k in zip(polygons, tile_of.astype(int), strict=True):
        x, y = polygon.T
        assert np.abs(x).max() <= np.pi
        away = SkyCoord((np.pi - x) * u.rad, y * u.rad).separation(tiling.coord[k])
        cut = (np.abs(x) == np.pi) | (np.abs(y) == np.pi / 2)
        assert np.abs(away - radius)[~cut].max() < 1e-6 * u.deg
        # the part that is cut off is within the field
        assert (away[cut] <= radius + 0.2 * u.deg).all()
    # east is to the left of the center at 180 deg
    assert polygons[-1][:, 0].mean() < 0
    region = matplotlib.figure.Figure().subplots()
    assert rs.plot.plot_tiling(tiling, ax=region) is region


def test_fields_about_a_pole_keep_their_shape():
    tiling = rs.Tiling.from_table(QTable({"ra": [0, 120, 240] * u.deg, "dec": [86, 86, 86] * u.deg}))
    ax = rs.plot.plot_tiling(tiling, radius=3 * u.deg)
    assert ax.name == "rectilinear"
    polygons, _ = outlines(ax)
    middles = np.array([polygon.mean(axis=0) for polygon in polygons])
    assert np.hypot(*middles.T) == pytest.approx([4, 4, 4], abs=0.05)
    for polygon, middle in zip(polygons, middles, strict=True):
        assert np.hypot(*(polygon - middle).T) == pytest.approx(3 * np.ones(len(polygon)), abs=0.05)
    assert ax.get_aspect() == 1


def test_the_scale_fits_the_values(survey):
    tiling = rs.Tiling(survey.tiles["tile", "ra", "dec", "position_angle", "pass"])
    (scale,) = rs.plot.plot_tiling(tiling).child_axes
    assert [t.get_text() for t in scale.get_yticklabels()] == ["1", "2"]
    assert not rs.plot.plot_tiling(rs.Tiling(tiling.table[:2])).child_axes  # a single value requires no color bar


def test_a_tiling_is_colored_by_pass_or_any_column(survey):
    tiling = rs.Tiling(survey.tiles["tile", "ra", "dec", "position_angle", "pass"])
    assert np.array_equal(rs.plot.plot_tiling(tiling).collections[0].get_array(), [1, 1, 2])
    assert rs.plot.plot_tiling(survey, color="n_observed").collections[0].get_array().sum() > 10
    with pytest.raises(rs.InputError, match="color must be a column of numbers"):
        rs.plot.plot_tiling(tiling, color="completeness")
    with pytest.raises(rs.InputError, match="must be a Tiling or a Survey"):
        rs.plot.plot_tiling(CENTER)
    with pytest.raises(rs.InputError, match="at least one tile"):
        rs.plot.plot_tiling(rs.Tiling(tiling.table[:0]))


def test_style_can_be_given_and_one_value_is_neither_dark_nor_pale(survey):
    fields = rs.plot.plot_tiling(survey, color="n_observed", cmap="cividis", clim=(0, 500)).collections[0]
    assert (fields.get_cmap().name, fields.get_clim()) == ("cividis", (0, 500))
    one = rs.plot.plot_tiling(rs.Tiling(survey.tiles["tile", "ra", "dec", "position_angle", "pass"][:2])).collections[0]
    np.testing.assert_allclose(one.norm(one.get_array()), 0.5)
    assert rs.plot.plot_completeness(survey, linewidth=4).get_lines()[0].get_linewidth() == 4


def test_completeness_rises_to_what_the_summary_says(survey):
    ax = rs.plot.plot_completeness(survey)
    lines = {line.get_label(): line.get_xydata() for line in ax.get_lines()}
    curve = lines["all visits"]
    assert (curve[0].tolist(), curve[-1].tolist()) == ([0, 0], [3, survey.summary["completeness"]])
    assert (np.diff(curve[:, 1]) >= 0).all()
    assert lines["fraction of complete targets"][-1, 1] == pytest.approx(survey.summary["completeness_targets"])
    last = survey.completeness[survey.completeness["pass"] == 2]
    for row in last[1:]:
        assert lines[f"priority {row['priority']}"][-1].tolist() == [3, row["completeness"]]
    assert {t.get_text() for t in ax.texts} == {"pass 1", "pass 2"}
    with pytest.raises(rs.InputError, match="must be a Survey"):
        rs.plot.plot_completeness(survey.tiles)


def test_the_curve_follows_the_order_of_observing(small):
    sky = rs.synthetic_catalog("poisson", CENTER, 2 * u.deg, density=200 / u.deg**2, rng=3)
    table = QTable({"ra": [359.0, 359.5] * u.deg, "dec": [20, 21] * u.deg, "pass": [2, 1]})
    survey = rs.plan_survey(sky, small, table)
    curve, observed = rs.plot.plot_completeness(survey).get_lines()[0].get_ydata(), survey.tiles["n_observed"]
    assert observed[0] != observed[1]
    assert curve[1] == observed[1] / len(sky)


def test_twenty_thousand_tiles_are_one_collection():
    rng = np.random.default_rng(1)
    tiling = rs.Tiling.from_table(
        QTable({"ra": rng.uniform(0, 360, 20_000) * u.deg, "dec": rng.uniform(-60, 60, 20_000) * u.deg})
    )
    assert len(rs.plot.plot_tiling(tiling).collections) == 1


def test_tiles_are_colored_by_their_states(survey):
    table = survey.tiles[["tile", "ra", "dec", "position_angle", "pass"]]
    table["state"] = ["done", "", "bad"]
    ax = rs.plot.plot_tiling(rs.Tiling(table), color="state")
    names = [label.get_text() for label in ax.child_axes[-1].get_yticklabels()]
    assert names == ["observed", "bad", "planned"]
    (collection,) = [one for one in ax.collections if isinstance(one, PolyCollection)]
    drawn = {names[int(code)]: to_hex(collection.to_rgba(code)).upper() for code in collection.get_array()}
    assert drawn == {name: STATE_COLORS[name] for name in names}
    table["state"] = ["other"] * len(table)
    with pytest.raises(rs.InputError, match="color must be a column of numbers"):
        rs.plot.plot_tiling(rs.Tiling(table), color="state")


def test_colors_run_from_the_smallest_to_the_largest_value_and_are_opaque(survey):
    """Regression: with limits of 0 and 1, all tiles of a survey had the same color.

    Translucent colors looked like other values.
    """
    fields, values = rs.plot.plot_tiling(survey).collections[0], survey.tiles["completeness"]
    assert fields.get_clim() == (values.min(), values.max())
    assert values.max() < 0.9
    assert (fields.to_rgba(fields.get_array())[:, 3] == 1).all()
    assert fields.get_alpha() is None
    colors = fields.to_rgba(fields.get_array())[:, :3]
    assert np.abs(colors[values.argmax()] - colors[values.argmin()]).max() > 0.5


def test_targets_and_the_border_of_a_region_are_drawn():
    box = rs.Region.box(ra=[350 * u.deg, 10 * u.deg], dec=[10, 20] * u.deg)
    tiling = rs.place_tiles(box, "lamost")
    ax = rs.plot.plot_tiling(tiling, targets=SkyCoord([359, 3, 200] * u.deg, [15, 12, -80] * u.deg), region=box)
    *sides, dots = ax.get_lines()
    np.testing.assert_allclose(np.sort(dots.get_xdata() % 360), [3, 200, 359])
    corners = np.vstack([line.get_xydata() for line in sides])
    assert (corners[:, 0].min() % 360, corners[:, 0].max() % 360) == pytest.approx((350, 10))
    assert np.ptp(corners[:, 0]) == pytest.approx(20)
    assert (corners[:, 1].min(), corners[:, 1].max()) == pytest.approx((10, 20))
    # a distant target does not change the limits
    assert np.ptp(ax.get_ylim()) < 40
    assert [t.get_text() for t in ax.get_legend().get_texts()] == ["region", "3 targets"]
    with pytest.raises(rs.InputError, match="region must be a Region, got str"):
        rs.plot.plot_tiling(tiling, region="sky")
    with pytest.raises(rs.InputError, match="targets must be a SkyCoord, got"):
        rs.plot.plot_tiling(tiling, targets=[1, 2])


@pytest.mark.parametrize(
    "region",
    [
        rs.Region.cap(SkyCoord("1h +20d"), 6 * u.deg),
        rs.Region.polygon(SkyCoord([10, 25, 15] * u.deg, [15, 18, 26] * u.deg)),
        rs.Region.box(ra=[10 * u.deg, 22 * u.deg], dec=[15, 24] * u.deg),
        rs.Region.healpix([0, 1, 2, 3, 8], 16),
    ],
    ids=lambda region: region.kind,
)
@pytest.mark.parametrize("projection", [None, "aitoff"])
def test_borders_divide_inside_from_outside(region, projection):
    tiling = rs.Tiling.from_table(QTable({"ra": [15, 16] * u.deg, "dec": [20, 21] * u.deg}))
    ax = matplotlib.figure.Figure().add_subplot(projection=projection)
    lines = rs.plot.plot_tiling(tiling, region=region, ax=ax).get_lines()
    assert lines
    points = np.vstack([line.get_xydata() for line in lines])[::7]
    ra, dec = (np.pi - points[:, 0], points[:, 1]) if projection else np.deg2rad(points.T)
    border = SkyCoord(ra, dec, unit="rad")
    near = border[:, None].directional_offset_by(np.arange(0, 360, 15) * u.deg, 1.2 * u.deg)
    inside = region.contains(near.ravel()).reshape(near.shape)
    assert (inside.any(axis=1) & ~inside.all(axis=1)).all()


def test_a_wide_region_has_a_low_figure():
    """Regression: for a narrow strip of the sky, 40 % of the height of the figure was empty."""
    strip = rs.place_tiles(rs.Region.box(ra=[100, 150] * u.deg, dec=[20, 26] * u.deg), "lamost")
    figure = rs.plot.plot_tiling(strip).figure
    figure.draw_without_rendering()
    box = figure.get_tightbbox()
    assert box.height > 0.8 * figure.get_figheight()
    assert box.width > 0.9 * figure.get_figwidth()


def test_fields_of_later_passes_have_a_legend_entry(survey):
    """Regression: no part of a plot explained why the sizes of fills differ."""
    labels = [text.get_text() for text in rs.plot.plot_tiling(survey).get_legend().get_texts()]
    assert labels == ["field (the fill is smaller where tiles overlap)"]
    one = rs.Tiling.from_table(QTable({"ra": [15, 16] * u.deg, "dec": [20, 21] * u.deg}))
    assert rs.plot.plot_tiling(one).get_legend() is None


def test_few_fields_are_round(survey):
    """Regression: large circles had visible corners."""
    (edges,) = [c for c in rs.plot.plot_tiling(survey).collections if isinstance(c, LineCollection)]
    assert {len(segment) for segment in edges.get_segments()} == {145}


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
        assert middles == pytest.approx(tiling.table["ra"][tiling.table["pass"] == number].value, abs=1e-3)
        assert ax.xaxis_inverted()


def test_targets_and_the_region_are_in_every_panel():
    region, targets = rs.Region.parse("box 340 20 10 50"), SkyCoord([352, 358] * u.deg, [20, 21] * u.deg)
    figure = rs.plot.draw_tiling(tiling_of([1, 2]), targets=targets, region=region)
    for ax in figure.axes:
        *sides, dots = ax.get_lines()
        assert (len(sides), sorted(dots.get_xdata() % 360)) == (4, pytest.approx([352, 358]))
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
