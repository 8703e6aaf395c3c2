"""Results in a notebook: a heading, some numbers, and the first rows of a table, all as text."""

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord

import rfpsurvey as rs

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
