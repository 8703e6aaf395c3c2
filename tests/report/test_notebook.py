"""Views in notebooks, which are frames without access to the notebook, and reports on paper, in a real browser."""

import re
from html import unescape

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import QTable

import rfpsurvey as rs
from pages import Reader

CENTER = SkyCoord(95, 23, unit="deg")
HOSTILE = "</script><script>parent.document.title='run'</script>\"'<img src=x onerror=alert(1)>"


@pytest.fixture(scope="module")
def tile(small):
    sky = rs.synthetic_catalog("uniform", CENTER, 0.5 * u.deg, n_targets=60, rng=1)
    return rs.plan_tile(rs.Catalog(sky.coord, id=[f"{k}{HOSTILE}" for k in range(60)]), small, CENTER)


@pytest.fixture(scope="module")
def views(tile, small):
    survey = rs.plan_survey(SkyCoord([CENTER]), small, SkyCoord([CENTER]))
    return {"tile": tile.show(plans={"again": tile}, height=700), "survey": survey.show()}


@pytest.mark.parametrize("name", ["tile", "survey"])
def test_a_view_is_a_sandboxed_frame(views, name):
    html = views[name]._repr_html_()
    ((tag, attributes, _),) = Reader(html).elements
    assert (tag, attributes["sandbox"], attributes["srcdoc"]) == ("iframe", "allow-scripts", views[name].page)
    assert html.count("<") == 2  # everything else is escaped
    assert [a for a in Reader(views[name].page).all("meta") if a.get("http-equiv") == "Content-Security-Policy"]
    assert f"height: {700 if name == 'tile' else 1000}px" in attributes["style"]


@pytest.fixture
def frame_of(visit, views, tmp_path):
    """Return a function that opens a notebook with a view, and returns the page and the frame of the view."""

    def open_frame(name, **options):
        path, frame = tmp_path / "notebook.html", views[name]._repr_html_()
        path.write_text(f"<!DOCTYPE html><title>notebook</title><link rel=icon href='data:,'><body>{frame}</body>")
        page = visit(path, **options)
        page.frames[1].wait_for_function("document.querySelector('.view')?.view")
        return page, page.frames[1]

    return open_frame


@pytest.mark.parametrize("name", ["tile", "survey"])
def test_a_view_runs_in_its_frame_and_cannot_leave_it(frame_of, name):
    page, inside = frame_of(name)
    assert inside.locator("canvas").first.is_visible()
    assert inside.evaluate("window.origin") == "null"
    if name == "tile":
        view = "document.querySelector('.view').view"
        inside.evaluate(f"{view}.choose({view}.plan.target_id.findIndex(Boolean))")
        assert "onerror" in inside.locator(".panel").inner_text()
    assert page.title() == "notebook"


@pytest.mark.parametrize("width", [450, 1400])
@pytest.mark.parametrize("name", ["tile", "survey"])
def test_the_content_of_a_frame_fits_into_the_frame(frame_of, name, width):
    """Regression: the content was higher than the frame, so that a part of it was hidden below the edge."""
    _, inside = frame_of(name, width=width)
    size = inside.evaluate(
        "(({ scrollHeight, clientHeight, scrollWidth, clientWidth }) => "
        "[scrollHeight - clientHeight, scrollWidth - clientWidth])(document.documentElement)"
    )
    assert max(size) <= 0
    assert inside.locator(".stage").bounding_box()["height"] > (90 if name == "tile" and width == 450 else 200)
    if name == "tile":  # the frame of the tile has a height of 700 pixels only
        assert inside.get_by_text("All assignments", exact=True).is_visible()


def test_what_cannot_be_shown_is_refused(tile, presets, tmp_path):
    sky = rs.synthetic_catalog("uniform", CENTER, 0.2 * u.deg, n_targets=60, rng=1)
    other, tiling = {"other": rs.plan_tile(sky, presets["moons"], CENTER)}, rs.place_tiles(sky, "moons")
    for call, message in (
        (lambda: rs.report.notebook_view(3), "result must be a Tile, a Survey or a Tiling, got int"),
        (lambda: tile.show(height=0), "height"),
        (lambda: tile.show(plans=[tile]), "plans must be a dict of names to tiles"),
        (lambda: tile.show(plans=other), "must have the same positioners, got different ones in the plan 'other'"),
        (
            lambda: rs.write_report(tiling, tmp_path / "page.html", plans=other),
            "plans must be given only for a Tile or a table of compare_allocators",
        ),
    ):
        with pytest.raises(rs.InputError, match=message):
            call()


def test_no_tag_of_a_name_is_in_the_page(views):
    page = views["tile"].page
    assert "<img" not in page
    assert len(re.findall("<script", page)) == 2
    assert "<img" not in unescape(page.replace("&lt;", ""))
    assert np.all([a.get("type") in (None, "application/json") for a in Reader(page).all("script")])


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
    first, others = plans["nearest"], {name: plan for name, plan in plans.items() if name != "nearest"}
    rs.write_report(first, tmp_path / "page.html", plans=others)
    page = printed(visit, tmp_path / "page.html", UPRIGHT)
    for name in others:
        figure = page.locator("figure", has_text=f"The whole focal plane in the plan {name}.")
        assert figure.locator("svg").is_visible()
    table = page.locator("table", has_text="Differences of the plans from the plan nearest.")
    assert table.is_visible()
    own = [np.ma.filled(np.ma.asarray(one.table["target_id"]).astype(str), "") for one in plans.values()]
    for name, target, row in zip(plans, own, table.locator("tbody tr").all_inner_texts(), strict=True):
        words, same = row.split(), target == own[0]
        expected = [target != "", same & (target != ""), ~same & (target != "") & (own[0] != "")]
        expected += [(target == "") & (own[0] != ""), (target != "") & (own[0] == "")]
        assert (words[0], [int(word) for word in words[1:6]]) == (name, [int(rows.sum()) for rows in expected])
        assert int(words[6]) == plans[name].summary["n_colliding"]
