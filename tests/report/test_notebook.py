"""Views in notebooks: frames without access to the notebook."""

import re
from html import unescape

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord

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
    assert tag == "iframe"
    assert attributes["sandbox"] == "allow-scripts"
    assert attributes["srcdoc"] == views[name].page
    assert html.count("<") == 2  # everything else is escaped
    page = Reader(views[name].page)
    assert [a for a in page.all("meta") if a.get("http-equiv") == "Content-Security-Policy"]
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
    other = {"other": rs.plan_tile(sky, presets["moons"], CENTER)}
    tiling = rs.place_tiles(sky, "moons")
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
