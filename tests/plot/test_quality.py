"""The panels of the quality of a tile show the numbers in its tables."""

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import QTable
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

import rfpsurvey as rs

CENTER = SkyCoord(95, 23, unit="deg")
N = 3000


@pytest.fixture(scope="module")
def sky():
    rng = np.random.default_rng(4)
    coord = rs.synthetic_catalog("uniform", CENTER, 2.3 * u.deg, n_targets=N, rng=1).coord
    return rs.Catalog(
        coord,
        kind=rng.choice(["science", "standard"], N, p=[0.9, 0.1]),
        category=rng.choice(["qso", "lrg"], N),
        priority=rng.integers(1, 4, N),
        extra={"g": rng.normal(17, 1, N) * u.mag, "name": rng.choice(["a", "b"], N)},
    )


@pytest.fixture(scope="module")
def tile(presets, sky):
    asked = rs.AllocationOptions("lamost_rule", requirements="instrument", sky_separation=20 * u.arcsec)
    return rs.plan_tile(sky, presets["lamost"], CENTER, allocator=asked)


def bars(ax, label):
    (found,) = [c for c in ax.containers if c.get_label().split(":")[0] == label]
    return found


def words(ax):
    return [text.get_text() for text in ax.get_legend().get_texts()]


def test_bars_are_the_fractions_of_each_class(tile):
    ax, rows = rs.plot.plot_quality(tile)[0], tile.completeness
    observed, lost = np.asarray(rows["n_observed"]), np.asarray(rows["n_assigned"] - rows["n_observed"])
    waiting, rest = rows["n_reachable"] - rows["n_assigned"], rows["n_in_field"] - rows["n_reachable"]
    for number, label in (
        (observed, "observed"),
        (lost, "lost to a collision"),
        (waiting, "in reach not assigned"),
        (rest, "out of reach, or not requested"),
    ):
        widths = [bar.get_width() for bar in bars(ax, label)]
        np.testing.assert_allclose(widths, number / rows["n_in_field"], atol=1e-12)
    assert [text.get_text() for text in ax.texts] == [
        *(f"{r['n_observed']} of {r['n_in_field']}" for r in rows),
        "observed",
    ]
    assert (rows["n_observed"] < rows["n_assigned"]).any()
    labels = [text.get_text() for text in ax.get_yticklabels()]
    assert labels == ["science", "standard", "qso", "lrg", "priority 3", "priority 2", "priority 1"]


def test_fibers_in_each_spectrograph_with_what_is_required(tile):
    ax, t = rs.plot.plot_quality(tile)[1], tile.table
    for kind, minimum in (("sky", 20), ("standard", 5)):
        (found,) = [c for c in ax.containers if c.get_label().startswith(f"{kind}:")]
        rows = t["kind"] == kind
        expected = [((t["spectrograph"] == k) & rows & ~t["in_collision"]).sum() for k in range(16)]
        assert ([bar.get_height() for bar in found], found.get_label()) == (expected, f"{kind}: {rows.sum()}")
        assert minimum in [c.get_segments()[0][0, 1] for c in ax.collections if isinstance(c, LineCollection)]
    colliding = sum(bar.get_height() for c in ax.containers if c.get_label() == "in collision" for bar in c)
    assert colliding == (np.isin(t["kind"], ("sky", "standard")) & t["in_collision"]).sum() > 0
    assert "required per spectrograph" in words(ax)


def test_requirements_on_categories_and_on_the_whole_tile(presets, sky):
    asked = rs.AllocationOptions("lamost_rule", requirements=["qso=30", "standard=12/spectrograph"])
    ax = rs.plot.plot_quality(rs.plan_tile(sky, presets["lamost"], CENTER, allocator=asked))[1]
    assert any(text.startswith("qso: ") and text.endswith("(at least 30 required)") for text in words(ax))
    assert [c.get_segments()[0][0, 1] for c in ax.collections if isinstance(c, LineCollection)] == [12]


def test_a_tile_without_spectrographs_or_requirements(presets, sky):
    plain = rs.plan_tile(rs.Catalog(sky.coord), presets["sdss_apo"], CENTER)
    classes, fibers, histogram, _ = rs.plot.plot_quality(plain)
    assert [text.get_text() for text in classes.get_yticklabels()] == ["science"]
    (science,) = [c for c in fibers.containers if c.get_label() == f"science: {plain.summary['n_assigned']}"]
    assert sum(p.get_height() for p in fibers.patches) == plain.summary["n_assigned"]
    assert len(science) == len(np.unique(plain["spectrograph"])) if "spectrograph" in plain.table.colnames else 1
    assert not histogram.axison


@pytest.mark.parametrize(("column", "label"), [(None, "priority"), ("priority", "priority"), ("g", "g [mag]")])
def test_histogram_of_a_column(tile, column, label):
    ax, found = rs.plot.plot_quality(tile, column=column)[2], tile.outcomes
    science = found["kind"] == "science"
    assigned = science & np.isin(found["outcome"], ("observed", "lost to a collision"))
    assert ax.get_xlabel() == label
    assert words(ax) == [f"available: {science.sum()}", f"assigned: {assigned.sum()}"]
    if label == "priority":
        outlines = [p.get_xy() for p in ax.patches[::2]]
        for outline, rows in zip(outlines, (science, assigned), strict=True):
            assert set(outline[:, 1]) == {0, *{(rows & (found["priority"] == k)).sum() for k in (1, 2, 3)}}


def test_fractions_against_radius(tile):
    ax, found = rs.plot.plot_quality(tile)[3], tile.outcomes
    found = found[found["kind"] == "science"]
    radius = np.hypot(found["x"], found["y"]).value
    edges = radius.max() * np.sqrt(np.arange(13) / 12)
    ring = np.digitize(radius, edges[1:-1], right=True)
    for container, names in zip(
        ax.containers,
        (("observed", "lost to a collision", "in reach not assigned"), ("observed", "lost to a collision")),
        strict=True,
    ):
        x, y = container[0].get_data()
        rows = np.isin(found["outcome"], names)
        np.testing.assert_allclose(y, [rows[ring == k].mean() for k in range(12)])
        assert ((x > edges[:-1]) & (x < edges[1:])).all()
    low, high = (np.array(container[2][0].get_segments())[:, k, 1] for k in (0, 1))
    assert ((low >= 0) & (low <= y) & (y <= high) & (high <= 1)).all()


def test_axes_and_style_can_be_given(tile):
    given = tuple(Figure().subplots(2, 2).ravel())
    assert rs.plot.plot_quality(tile, axes=given, height=0.5) == given
    assert {round(bar.get_height(), 9) for bar in given[0].patches} == {0.5}


def test_many_classes_are_cut(presets, sky):
    many = rs.Catalog(sky.coord, priority=np.arange(N) % 20, category=np.array([f"c{k % 30}" for k in range(N)]))
    tile = rs.plan_tile(many, presets["lamost"], CENTER)
    ax = rs.plot.plot_quality(tile)[0]
    labels = [text.get_text() for text in ax.get_yticklabels()]
    assert len(labels) == 16
    assert "priority 19" in labels
    assert f"{len(tile.completeness) - 16} more classes not shown" in ax.get_xlabel()


def test_what_cannot_be_drawn_is_refused(tile, presets):
    scored = rs.score_tile(tile.table, presets["lamost"])
    for arguments, message in (
        (("lamost", {}), "result must be a Tile or a Survey, got str"),
        ((scored, {}), "the tile must have outcomes of targets, got none"),
        ((tile, {"column": "name"}), "column must be one of the columns of numbers \\(priority, g\\), got 'name'"),
        ((tile, {"column": "mag"}), "got 'mag'"),
        ((tile, {"axes": ()}), "axes must be four Axes, got 0"),
    ):
        with pytest.raises(rs.InputError, match=message):
            rs.plot.plot_quality(arguments[0], **arguments[1])


@pytest.fixture(scope="module")
def survey(presets, sky):
    tiles = QTable({"ra": [94.5, 95.5, 95.0] * u.deg, "dec": [23.0, 23.0, 23.4] * u.deg, "pass": [4, 4, 2]})
    asked = rs.AllocationOptions("lamost_rule", requirements="standard=20")
    return rs.plan_survey(sky, presets["sdss_apo"], tiles, allocator=asked, passes=[4, 2])


def test_the_bars_of_a_survey_are_the_visits_of_each_class_and_pass(survey):
    """The passes are in the order of planning. The number beside a bar is the length of its colored part."""
    ax, after = rs.plot.plot_quality(survey)[0], survey.completeness
    first, last = after[after["pass"] == 4], after[after["pass"] == 2]
    labels = [text.get_text() for text in ax.get_yticklabels()]
    assert labels == ["all", "qso", "lrg", "priority 3", "priority 2", "priority 1"]
    order = [0, 4, 5, 1, 2, 3]
    assert last["category"][order].tolist() == ["all", "qso", "lrg", "all", "all", "all"]
    wanted, one, two = last["n_requested"][order], first["n_observed"][order], last["n_observed"][order]
    for label, expected in (("in pass 4", one), ("in pass 2", two - one), ("not observed", wanted - two)):
        np.testing.assert_allclose([bar.get_width() for bar in bars(ax, label)], expected / wanted, atol=1e-12)
    assert (two > one).all()
    numbers = [f"{n} of {of}" for n, of in zip(two, wanted, strict=True)]
    assert [text.get_text() for text in ax.texts] == [*numbers, "observed"]


def test_the_other_panels_of_a_survey_show_its_own_counts(survey):
    _, outcomes, fibers, tiles = rs.plot.plot_quality(survey)
    counts, s, t = survey.summary["outcomes"], survey.summary, survey.tiles
    assert {int(bar.get_width()) for bar in outcomes.patches} == set(counts.values())
    assert {text.get_text() for text in outcomes.get_yticklabels()} == set(counts)
    for label, name in (("science", "n_science"), ("standard stars", "n_standard")):
        heights = [bar.get_height() for bar in bars(fibers, label)]
        assert heights == [t[name][t["pass"] == k].sum() for k in (2, 4)]
    assert sum(bar.get_height() for bar in fibers.patches) == s["n_fibers"]
    use, rate = tiles.lines
    order = np.argsort(t["round"], kind="stable")
    assert use.get_ydata().tolist() == t["fiber_use"][order].tolist()
    assert rate.get_ydata().tolist() == (t["n_colliding_assigned"] / t["n_assigned"])[order].tolist()
    together = f"all tiles together: {s['collision_rate_assigned']:.3f}"
    assert f"collision rate of assigned arms ({together})" in words(tiles)


def test_a_survey_of_one_pass_and_no_class_is_drawn(presets, sky):
    one = rs.plan_survey(rs.Catalog(sky.coord), presets["sdss_apo"], CENTER.reshape(1))
    axes = rs.plot.plot_quality(one)
    axes[0].figure.draw_without_rendering()
    assert axes[0].get_title(loc="left").endswith("observed on 1 tile")
    assert words(axes[0]) == ["observed", "not observed"]
    with pytest.raises(rs.InputError, match="column must be None for a survey"):
        rs.plot.plot_quality(one, column="priority")


def test_many_classes_and_passes_of_a_survey_share_bars_and_colors(presets, sky):
    many = rs.Catalog(sky.coord, priority=np.arange(N) % 20, category=np.array([f"c{k % 12}" for k in range(N)]))
    tiles = QTable({"ra": np.full(7, 95.0) * u.deg, "dec": np.full(7, 23.0) * u.deg, "pass": np.arange(7)})
    ax = rs.plot.plot_quality(rs.plan_survey(many, presets["sdss_apo"], tiles))[0]
    assert words(ax) == ["in pass 0", "in pass 1", "in pass 2", "in pass 3", "in passes 4 to 6", "not observed"]
    labels = [text.get_text() for text in ax.get_yticklabels()]
    assert (len([label for label in labels if label.startswith("c")]), labels[-1]) == (8, "priority 13")
    assert ax.get_xlabel().endswith("; 17 more classes not shown")
    last = [sum(bar.get_width() for bar in row) for row in zip(*ax.containers, strict=True)]
    np.testing.assert_allclose(last, 1)


@pytest.mark.filterwarnings("ignore:no target of the catalog is 'sky'")
@pytest.mark.parametrize("kind", ["science", "sky"])
def test_a_tile_with_one_target_is_drawn(presets, kind):
    one = rs.Catalog(SkyCoord([95.05] * u.deg, [23.05] * u.deg), kind=[kind])
    asked = rs.AllocationOptions("lamost_rule", requirements=["sky=2"])
    axes = rs.plot.plot_quality(rs.plan_tile(one, presets["moons"], CENTER, allocator=asked))
    axes[0].figure.draw_without_rendering()
    assert "1 of 1" in [text.get_text() for text in axes[0].texts]
    assert len(axes[3].containers[0][0].get_xdata()) == (kind == "science")


def histogram_of(presets, flux):
    near = rs.synthetic_catalog("uniform", CENTER, 1.4 * u.deg, n_targets=len(flux), rng=1)
    catalog = rs.Catalog(near.coord, extra={"flux": flux})
    return rs.plot.plot_quality(rs.plan_tile(catalog, presets["sdss_apo"], CENTER, allocator="balanced"))


def test_values_over_many_decades_have_logarithmic_bins(presets):
    """Every bin of a flux over twelve decades has targets; values that have no logarithm are counted in the label."""
    flux = 10 ** np.random.default_rng(1).uniform(-6, 6, 1000)
    flux[:3] = 0, -1, -1e6
    ax = histogram_of(presets, flux)[2]
    assert (ax.get_xscale(), ax.get_xlabel()) == ("log", "flux; 3 values of 0 or less not shown")
    steps = ax.patches[0].get_xy()[:, 1]
    assert set(np.histogram(np.log10(flux[3:]), 24)[0]) == set(steps[steps > 0])
    assert ((steps > 20) | (steps == 0)).all()


@pytest.mark.parametrize("low", [0, 1e-6, -1])
def test_values_of_similar_size_have_equal_bins(presets, low):
    """Uniform and mostly negative values have bins of equal width, even if the smallest value is close to 0."""
    flux = np.random.default_rng(1).uniform(low, 1, 1000)
    ax = histogram_of(presets, -flux if low < 0 else flux)[2]
    assert (ax.get_xscale(), ax.get_xlabel()) == ("linear", "flux")


def test_the_ring_of_one_target_is_at_the_center_of_the_panel(presets):
    ax = histogram_of(presets, np.ones(1))[3]
    assert 0.3 < ax.lines[0].get_xdata()[0] / ax.get_xlim()[1] < 0.7
