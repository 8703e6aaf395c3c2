"""The edges of figures cut off no part of a plot."""

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import QTable
from statuses import status_table

import flat
import rfpsurvey as rs
from rfpsurvey.plot import draw_instruments, draw_survey

CENTER = SkyCoord(95, 23, unit="deg")
ROBOT = rs.Positioner(8.25 * u.mm, 8.25 * u.mm, 2.25 * u.mm)


@pytest.fixture(scope="module")
def results(presets, small):
    """Return the results that the functions plot."""
    sky = rs.synthetic_catalog("poisson", CENTER, 1.2 * u.deg, density=150 / u.deg**2, rng=3)
    sky = rs.Catalog(sky.coord, priority=np.arange(len(sky)) % 2)
    many = rs.Catalog(
        sky.coord,
        priority=np.arange(len(sky)) % 19,
        category=np.array([f"A_CATEGORY_WHOSE_NAME_HAS_40_CHARACTERS_{k % 23}" for k in range(len(sky))]),
    )
    instruments = QTable(
        {
            "instrument": ["a_long_name_of_one", "a_long_name_of_one", "short"],
            "allocator": ["lamost_rule", "optimal", "network_flow"],
            "positioners": [500] * 3,
            "assigned": [400, 400, 480],
            "usable": [300, 400, 470],
            "loss": [0.3, 0, 0.123],
            "probability": [0.34, 0, 0.01],
            "low": [0.3, 0, 0.005],
            "high": [0.41, 0, 0.02],
            "reach_0": [0, 0, 0.1],
            "reach_1": [0.2, 0.2, 0.3],
            "reach_2": [0.2, 0.2, 0.3],
            "reach_3": [0.6, 0.6, 0.3],
        }
    )
    allocators = QTable(
        {
            "allocator": ["balanced", "optimal"],
            "science": [820, 860],
            "usable": [640, 860],
            "missing": [12, 0],
            "seconds": [0.0012, 14] * u.s,
        },
        meta={"blind_science": 905, "instrument": "mine"},
    )
    scan = QTable({"ratio": [1.0, 2, 3], "pitch": [25, 26, 27] * u.mm, "value": [0.1, 0.4, 0.2]})
    scan["closed_form"] = [0.05, 0.2, 0.3]
    speed = QTable(
        {
            "method": ["exact", "sampled"],
            "n_points": [0, 5],
            "time": [0.04, 0.03] * u.ms,
            "misclassified": [0, 0.02],
            "n_colliding_true": [577, 577],
            "max_error": np.array([1e-15, 1.2]) * u.mm,
        },
        meta={"instrument": "lamost"},
    )
    accuracy = QTable(
        {
            "method": ["closed_form", "quadrature", "quadrature"],
            "estimand": ["independent"] * 3,
            "effort": [0, 64, 128],
            "time": [1, 2, 4] * u.ms,
            "error": [0.1, 0.01, 0.005],
            "error_error": [0, 0.001, 0.0006],
            "truth_error": [2e-4] * 3,
        },
        meta={"instrument": "mine"},
    )
    return {
        "tile": rs.plan_tile(sky, presets["sdss_apo"], CENTER, position_angle=123.456 * u.deg, allocator="lamost_rule"),
        "tile with classes": rs.plan_tile(many, presets["sdss_apo"], CENTER, allocator="lamost_rule"),
        "targets": sky,
        "survey": rs.plan_survey(sky, small, rs.place_tiles(sky, small, passes=2), allocator="lamost_rule"),
        "selection": rs.selection_probabilities(
            sky, small, rs.place_tiles(sky, small, passes=2), 16, allocator="nearest"
        ),
        "estimate": flat.collision_probability(presets["sdss_apo"], method="quadrature", max_iterations=32),
        "status": status_table(),
        "instruments": instruments,
        "allocators": allocators,
        "scan": scan,
        "speed": speed,
        "accuracy": accuracy,
        "designs": rs.design.explore_designs(
            central_arm=8 * u.mm, ratio=[1, 1.5], pitch=[24, 26] * u.mm, clearance=2.25 * u.mm
        ),
        "more designs": rs.design.explore_designs(
            central_arm=8.25 * u.mm,
            ratio=[1.0, 2.0],
            pitch=[22.0, 32.0] * u.mm,
            clearance=2.25 * u.mm,
            n_designs=64,
            rng=1,
        ),
        "strip": rs.place_tiles(rs.Region.box(ra=[100, 150] * u.deg, dec=[20, 26] * u.deg), "lamost", passes=2),
        "tower": rs.place_tiles(rs.Region.box(ra=[100, 106] * u.deg, dec=[10, 60] * u.deg), "lamost"),
        "pole": rs.place_tiles(rs.Region.cap(SkyCoord("0h +85d"), 6 * u.deg), "lamost"),
        "sky": rs.place_tiles(rs.Region.parse("sky"), method="spiral", radius=12 * u.deg),
    }


PLOTS = {
    "focal plane of a tile": lambda r: rs.plot.plot_focal_plane(r["tile"]),
    "focal plane with x to the right": lambda r: rs.plot.plot_focal_plane(r["tile"], orientation="focal plane"),
    "part of a tile": lambda r: rs.plot.plot_focal_plane(r["tile"], region=[[0, -50], [200, 0]] * u.mm),
    "dots": lambda r: rs.plot.plot_focal_plane(r["tile"], arms=False),
    "all targets": lambda r: rs.plot.plot_focal_plane(r["tile"], targets="outcome"),
    "many classes": lambda r: rs.plot.plot_focal_plane(r["tile with classes"], targets="priority"),
    "targets on the sky": lambda r: rs.plot.plot_targets(r["tile with classes"], color="category"),
    "targets of a survey": lambda r: rs.plot.plot_targets(r["survey"], r["targets"]),
    "quality": lambda r: rs.plot.plot_quality(r["tile"])[0],
    "quality of many classes": lambda r: rs.plot.plot_quality(r["tile with classes"])[0],
    "quality of a survey": lambda r: rs.plot.plot_quality(r["survey"])[0],
    "instrument": lambda r: rs.plot.plot_focal_plane("lamost"),
    "fiber types": lambda r: rs.plot.plot_focal_plane("sdss_apo", color="fiber_type"),
    "spectrographs": lambda r: rs.plot.plot_focal_plane("lamost", color="spectrograph"),
    "coverage": lambda r: rs.plot.plot_coverage("sdss_apo"),
    "map of an estimate": lambda r: rs.plot.plot_collision_map(r["estimate"], "sdss_apo"),
    "map of a tile": lambda r: rs.plot.plot_collision_map(r["tile"]),
    "tiles of a survey": lambda r: rs.plot.plot_tiling(
        r["survey"], region=rs.Region.cap(CENTER, 1 * u.deg), targets=CENTER
    ),
    "strip of tiles": lambda r: rs.plot.plot_tiling(r["strip"]),
    "tower of tiles": lambda r: rs.plot.plot_tiling(r["tower"]),
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


# the same functions with other options or results
VARIANTS = {
    "focal plane with x to the right",
    "part of a tile",
    "quality of many classes",
    "fiber types",
    "map of a tile",
    "tower of tiles",
    "tiles about a pole",
}


@pytest.mark.few(6)
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.exhaustive if name in VARIANTS else ()) for name in PLOTS]
)
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
    used = {name for draw in PLOTS.values() for name in draw.__code__.co_names}
    assert public <= used


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
