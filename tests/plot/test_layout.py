"""The edges of figures cut off no part of a plot."""

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from statuses import status_table
from text_tables import text_table

import flat
import rfpsurvey as rs
from rfpsurvey.plot._comparisons import draw_instruments
from rfpsurvey.plot._quality import draw_survey

CENTER = SkyCoord(95, 23, unit="deg")
MM = u.mm
INSTRUMENTS = """
instrument allocator positioners assigned usable loss probability low high reach_0 reach_1 reach_2 reach_3
a_long_name_of_one lamost_rule 500 400 300 0.3 0.34 0.3 0.41 0 0.2 0.2 0.6
a_long_name_of_one optimal 500 400 400 0 0 0 0 0 0.2 0.2 0.6
short network_flow 500 480 470 0.123 0.01 0.005 0.02 0.1 0.3 0.3 0.3
"""
ALLOCATORS = "allocator science usable missing seconds\nbalanced 820 640 12 0.0012\noptimal 860 860 0 14"
SPEED = """
method n_points time misclassified n_colliding_true max_error
exact 0 0.04 0 577 1e-15
sampled 5 0.03 0.02 577 1.2
"""
ACCURACY = """
method estimand effort time error error_error truth_error
closed_form independent 0 1 0.1 0 2e-4
quadrature independent 64 2 0.01 0.001 2e-4
quadrature independent 128 4 0.005 0.0006 2e-4
"""


@pytest.fixture(scope="module")
def results(presets, small):
    """Return the results that the functions plot."""
    sky = rs.synthetic_catalog("poisson", CENTER, 1.2 * u.deg, density=150 / u.deg**2, rng=3)
    sky = rs.Catalog(sky.coord, priority=np.arange(len(sky)) % 2)
    names = np.array([f"A_CATEGORY_WHOSE_NAME_HAS_40_CHARACTERS_{k % 23}" for k in range(len(sky))])
    many = rs.Catalog(sky.coord, priority=np.arange(len(sky)) % 19, category=names)
    apo, two = presets["sdss_apo"], rs.place_tiles(sky, small, passes=2)
    scan = text_table("ratio pitch value closed_form\n1 25 0.1 0.05\n2 26 0.4 0.2\n3 27 0.2 0.3", pitch=MM)
    grid = {"central_arm": 8 * MM, "clearance": 2.25 * MM}
    return {
        "tile": rs.plan_tile(sky, apo, CENTER, position_angle=123.456 * u.deg, allocator="lamost_rule"),
        "tile with classes": rs.plan_tile(many, apo, CENTER, allocator="lamost_rule"),
        "targets": sky,
        "survey": rs.plan_survey(sky, small, two, allocator="lamost_rule"),
        "selection": rs.selection_probabilities(sky, small, two, 16, allocator="nearest"),
        "estimate": flat.collision_probability(apo, method="quadrature", max_iterations=32),
        "status": status_table(),
        "instruments": text_table(INSTRUMENTS),
        "allocators": text_table(ALLOCATORS, {"blind_science": 905, "instrument": "mine"}, seconds=u.s),
        "scan": scan,
        "speed": text_table(SPEED, {"instrument": "lamost"}, time=u.ms, max_error=MM),
        "accuracy": text_table(ACCURACY, {"instrument": "mine"}, time=u.ms),
        "designs": rs.design.explore_designs(**grid, ratio=[1, 1.5], pitch=[24, 26] * MM),
        "more designs": rs.design.explore_designs(
            **{**grid, "central_arm": 8.25 * MM}, ratio=[1.0, 2.0], pitch=[22.0, 32.0] * MM, n_designs=64, rng=1
        ),
        "strip": rs.place_tiles(rs.Region.parse("box 100 150 20 26"), "lamost", passes=2),
        "pole": rs.place_tiles(rs.Region.cap(SkyCoord("0h +85d"), 6 * u.deg), "lamost"),
        "sky": rs.place_tiles(rs.Region.parse("sky"), method="spiral", radius=12 * u.deg),
    }


PLOTS = {
    "focal plane of a tile": lambda r: rs.plot.plot_focal_plane(r["tile"]),
    "dots": lambda r: rs.plot.plot_focal_plane(r["tile"], arms=False),
    "all targets": lambda r: rs.plot.plot_focal_plane(r["tile"], targets="outcome"),
    "many classes": lambda r: rs.plot.plot_focal_plane(r["tile with classes"], targets="priority"),
    "targets on the sky": lambda r: rs.plot.plot_targets(r["tile with classes"], color="category"),
    "targets of a survey": lambda r: rs.plot.plot_targets(r["survey"], r["targets"]),
    "quality": lambda r: rs.plot.plot_quality(r["tile"])[0],
    "quality of a survey": lambda r: rs.plot.plot_quality(r["survey"])[0],
    "instrument": lambda r: rs.plot.plot_focal_plane("lamost"),
    "spectrographs": lambda r: rs.plot.plot_focal_plane("lamost", color="spectrograph"),
    "coverage": lambda r: rs.plot.plot_coverage("sdss_apo"),
    "map of an estimate": lambda r: rs.plot.plot_collision_map(r["estimate"], "sdss_apo"),
    "tiles of a survey": lambda r: rs.plot.plot_tiling(
        r["survey"], region=rs.Region.parse("cap 95 23 1"), targets=CENTER
    ),
    "strip of tiles": lambda r: rs.plot.plot_tiling(r["strip"]),
    "tiles about a pole": lambda r: rs.plot.plot_tiling(r["pole"]),
    "tiles of the whole sky": lambda r: rs.plot.plot_tiling(r["sky"], color="tile"),
    "passes of a tiling": lambda r: rs.plot.draw_tiling(r["strip"], region=rs.Region.parse("box 100 150 20 26")),
    "completeness": lambda r: rs.plot.plot_completeness(r["survey"]),
    "status": lambda r: rs.plot.plot_survey_status(r["status"])[0],
    "selection": lambda r: rs.plot.plot_selection(r["selection"]),
    "survey": lambda r: draw_survey(r["survey"]),
    "instruments": lambda r: rs.plot.plot_instruments(r["instruments"]),
    "comparison": lambda r: draw_instruments(r["instruments"]),
    "allocators": lambda r: rs.plot.plot_allocators(r["allocators"]),
    "few designs": lambda r: rs.plot.plot_designs(r["designs"]),
    "many designs": lambda r: rs.plot.plot_designs(r["more designs"], mark={"one": r["designs"][:1]}),
    "probability": lambda r: rs.plot.plot_probability(r["scan"], values=["value", "closed_form"]),
    "residuals": lambda r: rs.plot.plot_residuals(r["scan"]),
    "speed": lambda r: rs.plot.plot_speed_accuracy(r["speed"])[0],
    "accuracy": lambda r: rs.plot.plot_probability_accuracy(r["accuracy"])[0],
}


@pytest.mark.few(6)
@pytest.mark.parametrize("name", PLOTS)
def test_all_that_is_drawn_is_inside_the_figure(results, name):
    """Regression: the label of the last panel of a comparison, and the right edge of a figure of a survey, were cut
    off.
    """
    figure = PLOTS[name](results).figure
    figure.draw_without_rendering()
    box, (width, height) = figure.get_tightbbox(), figure.get_size_inches()
    assert min(box.x0, box.y0, width - box.x1, height - box.y1) > 0.02


def test_every_public_plot_is_tested_here():
    public = {name for name in rs.plot.__all__ if name.startswith("plot_")}
    assert public <= {name for draw in PLOTS.values() for name in draw.__code__.co_names}


def test_points_at_zero_are_whole(results):
    """Regression: half of the marker of a collision probability of 0 was outside the panel."""
    *_, right = draw_instruments(results["instruments"]).axes
    (points, *_), *_ = (container for container in right.containers)
    right.figure.draw_without_rendering()
    radius = points.get_markersize() / 72 * right.figure.dpi / 2
    x = right.transData.transform(points.get_xydata())[:, 0]
    assert x.min() - radius > right.get_window_extent().x0
    assert x.max() + radius < right.get_window_extent().x1


def test_colors_of_values_can_be_told_from_a_dark_page(results):
    """Regression: dark purple designs and the darkest blue were not visible on the dark page of a report."""
    points = np.vstack([c.get_facecolor() for c in rs.plot.plot_designs(results["designs"]).collections])
    reach = draw_instruments(results["instruments"]).axes[0]
    bars = np.array([patch.get_facecolor() for container in reach.containers[1:] for patch in container])
    for color in (*points, *bars):
        assert contrast(color[:3], np.array([22, 25, 29]) / 255) > 1.8


def contrast(one, other):
    """Return the contrast ratio of two colors (1 to 21) according to the definition for web pages."""
    light, dark = sorted((luminance(one), luminance(other)), reverse=True)
    return (light + 0.05) / (dark + 0.05)


def luminance(color):
    linear = np.where(color <= 0.03928, color / 12.92, ((color + 0.055) / 1.055) ** 2.4)
    return float(linear @ [0.2126, 0.7152, 0.0722])
