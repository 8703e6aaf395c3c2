"""The plots of designs in a real browser."""

import numpy as np
import pytest

import rfpsurvey as rs

VIEW = "document.querySelector('.view').view"


@pytest.fixture(scope="module")
def table():
    return rs.design.explore_around("moons")


@pytest.fixture(scope="module")
def page(visit, table, tmp_path_factory):
    path = tmp_path_factory.mktemp("designs") / "page.html"
    rs.write_report(table, path)
    page = visit(path)
    page.wait_for_function(f"{VIEW}?.plots[0].stage.width > 1")
    return page


def texts_of(page, plot):
    """Return all texts of a plot with their places."""
    return page.evaluate(
        f"(() => {{ const v = {VIEW}.plots[{plot}], seen = [];"
        "const own = v.stage.canvas.getContext('2d'), keep = own.fillText;"
        "own.fillText = (...text) => seen.push(text); v.stage.paint(); own.fillText = keep; return seen; })()"
    )


@pytest.mark.parametrize("column", ["loss", "coverage", "usable_per_area", "pitch", "loss_error"])
def test_an_axis_has_several_ticks_at_the_places_of_their_values(page, table, column):
    """Regression: the axis of the loss had only one tick."""
    page.evaluate(f"{VIEW}.plots[0].y = '{column}'; {VIEW}.update()")
    low, range_ = page.evaluate(f"{VIEW}.ranges['{column}']")
    ticks = [(float(text), y) for text, x, y in texts_of(page, 0) if x == 4]
    if np.ptp(getattr(table[column], "value", table[column])) > 0:
        assert len(ticks) >= 3
    for value, y in ticks:
        place = page.evaluate(f"{VIEW}.plots[0].stage.toScreen(0, {(value - low) / range_})[1]")
        assert y == pytest.approx(place - 8, abs=0.5)


def test_the_page_defines_the_columns(page, table):
    """Regression: the page defined none of its quantities."""
    page.evaluate(f"{VIEW}.plots[0].y = 'loss'; {VIEW}.update()")
    text = page.locator(".about").inner_text()
    assert "fraction of the assigned fibers that are lost to collisions" in text
    assert "fraction of the focal plane that at least one positioner reaches" in text
    meanings = page.evaluate(f"{VIEW}.data.meanings")
    assert all(meanings.values())
    whole = page.locator("main").inner_text()
    for name, words in meanings.items():
        assert f"{name.replace('_', ' ')}: {words}." in whole


def test_the_name_of_an_instrument_is_inside_the_plot(page):
    width = page.evaluate(f"{VIEW}.plots[0].stage.width")
    ((_, x, _),) = [entry for entry in texts_of(page, 0) if entry[0] == "moons"]
    assert 0 < x < width - 20


def test_the_coordinates_under_the_pointer_are_shown(page):
    page.evaluate(f"{VIEW}.plots[0].y = 'loss'; {VIEW}.update()")
    canvas = page.locator("canvas").first
    canvas.scroll_into_view_if_needed()
    box = canvas.bounding_box()
    k = page.evaluate(f"{VIEW}.pareto.indexOf(1)")
    x, y = page.evaluate(f"{VIEW}.plots[0].stage.toScreen(...{VIEW}.plots[0].points[{k}])")
    page.mouse.move(box["x"] + x, box["y"] + y)
    text = page.locator(".place").first.inner_text()
    expected = [page.evaluate(f"{VIEW}.columns.{name}[{k}]") for name in ("coverage", "loss")]
    found = [float(part.split()[1]) for part in text.split(", ")]
    np.testing.assert_allclose(found, expected, atol=0.005)
