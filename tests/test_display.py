"""Results in a notebook: a heading, some numbers, and the first rows of a table, all as text."""

import re
from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import QTable

import rfpsurvey as rs
from rfpsurvey._common.small_figures import BLUE, RED, figure_of_tiles
from rfpsurvey._sky.shapes import circle_around

CENTER = SkyCoord("6h20m +23d")


@pytest.fixture(scope="module")
def results():
    sky = rs.synthetic_catalog("uniform", CENTER, 0.2 * u.deg, n_targets=300, rng=1)
    sky = rs.Catalog(sky.coord, id=[f"<b>{k}</b>" for k in range(len(sky))])
    moons, xy = rs.Instrument.preset("moons"), np.random.default_rng(1).uniform(-100, 100, (50, 2)) * u.mm
    plan = rs.allocate(moons.focal_plane, xy, allocator="balanced")
    return {
        "tile": rs.plan_tile(sky, moons, CENTER, allocator="lamost_rule"),
        "survey": rs.plan_survey(sky, moons, CENTER.reshape(1), allocator="lamost_rule"),
        "tiling": rs.place_tiles(sky, moons),
        "allocation": plan,
        "report": rs.find_collisions(moons.focal_plane, plan),
        "estimate": rs.collision_probability(
            moons, method="quadrature", precision=rs.probability.Precision(max_iterations=64)
        ),
    }


@pytest.mark.parametrize("name", ["tile", "survey", "tiling", "allocation", "report", "estimate"])
def test_results_are_shown_as_html(results, name):
    result = results[name]
    html = result._repr_html_()
    assert html.startswith(f"<p>{type(result).__name__}") or type(result).__name__ in html[:60]
    assert html.count("<table") >= 1
    assert "<b>" not in html
    if name == "tile":
        assert "&lt;b&gt;" in html
        assert "<th>n_assigned</th>" in html


def legend_of(html):
    """Return the numbers in the legend of a picture by label, and the numbers of drawn points by color."""
    legend = re.findall(r'<span style="color:(#\w+)">&#9679;</span> (\d+) ([^<]+)', html)
    drawn = {color: path.count("h0") for path, color in re.findall(r'<path d="([^"]*)" stroke="(#\w+)"', html)}
    return {label.strip(): int(number) for _, number, label in legend}, {
        color: drawn.get(color, 0) for color, *_ in legend
    }


def test_pictures_of_tiles_show_the_collisions(results):
    tile = results["tile"]
    numbers, drawn = legend_of(tile._repr_html_())
    colliding = int(tile.summary["n_colliding"])
    assert numbers["in collision"] == colliding > 0
    assert sum(numbers.values()) == len(tile.table)
    assert numbers["assigned"] == np.sum((tile.table["status"] == "assigned") & ~tile.table["in_collision"])
    assert 0 < drawn[RED] <= colliding  # positioners that are close to each other share a point


@pytest.mark.parametrize("name", ["must", "sdss_apo"])
def test_pictures_of_focal_planes_are_small(presets, name):
    plane = presets[name].focal_plane
    disabled = np.arange(len(plane)) % 5 == 0
    html = replace(plane, disabled=disabled)._repr_html_()
    numbers, _ = legend_of(html)
    assert numbers == {"positioners": int((~disabled).sum()), "disabled": int(disabled.sum())}
    assert len(html) < 200_000
    assert legend_of(presets[name]._repr_html_())[0] == {"positioners": len(plane)}


def test_pictures_of_regions_positioners_and_options(presets):
    for region in (rs.Region.cap(CENTER, 3 * u.deg), rs.Region.whole_sky(), rs.Region.parse("box 350 20 -10 30")):
        numbers, drawn = legend_of(region._repr_html_())
        _, radius = circle_around(region)
        fraction = region.area.to_value(u.sr) / (2 * np.pi * (1 - np.cos(radius)))
        assert numbers["points inside"] / 4000 == pytest.approx(fraction, abs=0.01)
        assert drawn[BLUE] > 0
    robot = presets["sdss_apo"].focal_plane.positioner
    assert "7.5697 mm to 22.37 mm" in robot._repr_html_()
    width = re.search(r'r="([\d.]+)" stroke="#\w+" stroke-width="([\d.]+)"', robot._repr_html_())
    middle, wide = map(float, width.groups())
    assert (middle - wide / 2) / (middle + wide / 2) == pytest.approx(
        robot.inner_radius.value / robot.outer_radius.value, abs=0.01
    )
    html = rs.AllocationOptions("optimal", constraints=["magnitude g 10 20"])._repr_html_()
    assert "<th>allocator</th><td>&#x27;optimal&#x27;</td>" in html
    assert "MagnitudeLimits(column=&#x27;g&#x27;" in html


def test_pictures_of_surveys_show_the_states_of_tiles(results, tmp_path):
    assert legend_of(results["survey"]._repr_html_())[0] == {"tiles": 1}
    table = QTable({"ra": [359, 1, 3] * u.deg, "dec": [10, 10, 10] * u.deg, "state": ["done", "<b>", "done"]})
    html = figure_of_tiles(table)
    assert legend_of(html)[0] == {"done": 2, "&lt;b&gt;": 1}
    points = [int(x) for x in re.findall(r"M(\d+) ", html)]
    assert max(points) < 160
    assert points[0] < points[1]  # west is to the right: the tile at 3 deg is left of that at 359 deg
