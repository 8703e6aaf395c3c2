"""Reports on paper, in a real browser: no column is cut off, and no plan is missing."""

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import QTable

import rfpsurvey as rs

CENTER = SkyCoord(95, 23, unit="deg")
UPRIGHT, WIDE = 688, 949
"""Widths (pixels) of the text on upright A4 paper and on wide US letter paper with the margins of the style sheet."""


@pytest.fixture(scope="module")
def plans(small):
    sky = rs.synthetic_catalog("poisson", CENTER, 0.5 * u.deg, density=200 / u.deg**2, rng=3)
    return {name: rs.plan_tile(sky, small, CENTER, allocator=name) for name in ("nearest", "repair", "optimal")}


def printed(visit, path, width):
    page = visit(path, width=width)
    page.emulate_media(media="print")
    return page


@pytest.mark.parametrize("n_columns", [8, 21, 60])
def test_every_column_of_a_table_is_on_the_paper(visit, tmp_path, n_columns):
    """Regression: columns beyond the right edge of the paper were not printed."""
    values = {f"a_column_{k}": np.linspace(100, 200, 5) + k for k in range(n_columns)}
    rs.write_report(QTable(values), tmp_path / "page.html")
    check_tables(visit, tmp_path / "page.html", 1)


def test_every_column_of_the_tiles_of_a_survey_is_on_the_paper(visit, small, tmp_path):
    sky = rs.synthetic_catalog("poisson", CENTER, 1 * u.deg, density=60 / u.deg**2, rng=3)
    rs.write_report(rs.plan_survey(sky, small, rs.place_tiles(sky, small, passes=2)), tmp_path / "page.html")
    check_tables(visit, tmp_path / "page.html", 2)


def check_tables(visit, path, n_tables):
    found = 0
    for width in (UPRIGHT, WIDE):
        page = printed(visit, path, width)
        tables = page.evaluate("""[...document.querySelectorAll("main table.rows")].map((table) => {
            const cells = [...table.querySelectorAll("th, td")];
            const most = (value) => Math.max(...cells.map(value));
            return [table.classList.contains("landscape"), most((cell) => cell.getBoundingClientRect().right),
              most((cell) => cell.scrollWidth - cell.clientWidth), parseFloat(getComputedStyle(cells[0]).fontSize)];
        })""")
        for wide, right, hidden, size in tables:
            if wide == (width == WIDE):
                assert right <= width + 1
                assert hidden <= 1
                assert size > 5.3
                found += 1
    assert found == n_tables


def test_every_plan_is_on_the_paper(visit, plans, tmp_path):
    """Regression: only the first of several plans was printed."""
    first = plans["nearest"]
    others = {name: plan for name, plan in plans.items() if name != "nearest"}
    rs.write_report(first, tmp_path / "page.html", plans=others)
    page = printed(visit, tmp_path / "page.html", UPRIGHT)
    for name in others:
        figure = page.locator("figure", has_text=f"The whole focal plane in the plan {name}.")
        assert figure.locator("svg").is_visible()
    table = page.locator("table", has_text="Differences of the plans from the plan nearest.")
    assert table.is_visible()
    own = [np.ma.filled(np.ma.asarray(one.table["target_id"]).astype(str), "") for one in plans.values()]
    for name, target, row in zip(plans, own, table.locator("tbody tr").all_inner_texts(), strict=True):
        words = row.split()
        same = target == own[0]
        expected = [target != "", same & (target != ""), ~same & (target != "") & (own[0] != "")]
        expected += [(target == "") & (own[0] != ""), (target != "") & (own[0] == "")]
        assert words[0] == name
        assert [int(word) for word in words[1:6]] == [int(rows.sum()) for rows in expected]
        assert int(words[6]) == plans[name].summary["n_colliding"]
