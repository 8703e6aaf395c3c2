"""The plots and the calculator of designs in a real browser, against the surrogate of Python."""

import astropy.units as u
import numpy as np
import pytest

import rfpsurvey as rs

SCATTER = "document.querySelector('[data-view=designs]').view"
CALCULATOR = "document.querySelector('[data-view=calculator]').view"
MM = u.mm


@pytest.fixture(scope="module")
def scan():
    grid = {"central_arm": np.linspace(7, 9, 3) * MM, "ratio": [1, 1.3, 1.6], "pitch": [23, 26, 29] * MM}
    return rs.design.explore_designs(**grid, clearance=2.25 * MM)


@pytest.fixture(scope="module")
def scan_page(visit, scan, tmp_path_factory):
    path = tmp_path_factory.mktemp("designs") / "designs.html"
    rs.write_report(scan, path)
    return visit(path)


def test_the_script_agrees_with_python(scan_page):
    rng, n = np.random.default_rng(1), 3000
    shape = [rng.uniform(low, high, n) for low, high in ((0.2, 0.6), (1, 3), (0.02, 0.3))]
    for values, ends in zip(shape, ((0.2, 0.6), (1, 3), (0.02, 0.3)), strict=True):  # include the limits
        values[:50] = rng.choice(ends, 50)
    pitch = rng.uniform(5, 60, n)
    central, clearance = shape[0] * pitch, shape[2] * pitch / 2
    eccentric = shape[1] * central
    designs = np.transpose([central, eccentric, pitch, clearance]).tolist()
    found = scan_page.evaluate(
        f"(rows) => rows.map(([central_arm, eccentric_arm, pitch, clearance]) =>"
        f"{CALCULATOR}.surrogate.probability({{ central_arm, eccentric_arm, pitch, clearance }}))",
        designs,
    )
    expected = rs.probability.surrogate_probability(central * MM, eccentric * MM, pitch * MM, 2 * clearance * MM)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-6)
    assert (expected == 0).any()
    assert expected.max() > 0.5


def test_sliders_show_the_probability_and_what_changes_it(scan_page):
    start = {"central arm": 8.25, "eccentric arm": 9.0, "pitch": 25.6, "clearance": 2.25}
    for name, value in start.items():
        scan_page.get_by_label(f"{name} in mm, as a number").fill(str(value))
    expected = rs.probability.surrogate_probability(8.25 * MM, [9, 10, 8.25] * MM, 25.6 * MM, 4.5 * MM)
    large = scan_page.locator(".result .large")
    assert float(large.inner_text()) == pytest.approx(expected[0], abs=6e-5)
    row = scan_page.locator("tr", has_text="eccentric arm +1 mm").locator("td")
    assert float(row.inner_text()) == pytest.approx(expected[1] - expected[0], abs=6e-5)
    scan_page.get_by_label("eccentric arm in mm", exact=True).fill("8.25")
    assert float(large.inner_text()) == pytest.approx(expected[2], abs=6e-5)
    assert float(scan_page.get_by_label("eccentric arm in mm, as a number").input_value()) == 8.25
    assert "root mean square 0.0005" in scan_page.locator(".result").inner_text()


def test_a_design_outside_the_range_has_no_value_but_a_reason(scan_page):
    for name, value in {"central arm": 8.25, "eccentric arm": 7.0, "pitch": 25.6}.items():
        scan_page.get_by_label(f"{name} in mm, as a number").fill(str(value))
    text = scan_page.locator(".result").inner_text()
    assert "eccentric over central arm must be from 1 to 3; it is 0.848" in text
    assert scan_page.locator(".result .large").inner_text() == "\N{EN DASH}"
    with pytest.raises(rs.InputError):
        rs.probability.surrogate_probability(8.25 * MM, 7 * MM, 25.6 * MM, 4.5 * MM)


def test_the_range_of_the_script_is_that_of_python(scan_page):
    inside, outside = (5, 10, 25, 2), ((4.9, 10, 25, 2), (15.1, 20, 25, 2), (5, 15.1, 25, 2), (5, 10, 25, 0.2))
    for design in (inside, *outside, (5, 10, 25, 4)):
        arguments = dict(zip(("central_arm", "eccentric_arm", "pitch", "clearance"), design, strict=True))
        problems = scan_page.evaluate(f"(design) => {CALCULATOR}.surrogate.problems(design)", arguments)
        l1, l2, pitch, clearance = np.array(design) * MM
        call = (l1, l2, pitch, 2 * clearance)
        if problems:
            with pytest.raises(rs.InputError, match=problems[0].partition(" must")[0]):
                rs.probability.surrogate_probability(*call)
        else:
            assert rs.probability.surrogate_probability(*call) > 0


def test_a_click_on_a_design_sets_the_calculator(scan_page, scan):
    canvas = scan_page.locator("[data-view=designs] canvas").first
    canvas.scroll_into_view_if_needed()
    box, k = canvas.bounding_box(), int(np.flatnonzero(scan["pareto"])[0])
    x, y = scan_page.evaluate(f"{SCATTER}.plots[0].stage.toScreen(...{SCATTER}.plots[0].points[{k}])")
    scan_page.mouse.click(box["x"] + x, box["y"] + y)
    chosen = scan_page.evaluate(f"{SCATTER}.selected")
    both = [(scan[name][k], scan[name][chosen]) for name in scan.meta["objectives"]]
    assert all(a == b for a, b in both)  # several designs can be at the same place
    row, design = scan[chosen], scan_page.evaluate(f"{CALCULATOR}.design")
    assert design["pitch"] == pytest.approx(row["pitch"].value)
    assert design["eccentric_arm"] == pytest.approx(row["central_arm"].value * row["ratio"])
    if row["method"] == "surrogate":
        assert float(scan_page.locator(".result .large").inner_text()) == pytest.approx(row["loss"], abs=6e-5)


def test_both_plots_show_the_same_range(scan_page):
    scan_page.locator("[data-view=designs] canvas").first.focus()
    scan_page.keyboard.press("+")
    scan_page.keyboard.press("Shift+ArrowLeft")
    ranges = scan_page.evaluate(f"{SCATTER}.plots.map(({{ stage }}) => [stage.x, stage.scale])")
    assert ranges[0] == ranges[1]
    assert ranges[0][1] > 0
    scan_page.keyboard.press("0")
    scan_page.get_by_label("Lower plot").select_option("ratio")
    assert scan_page.evaluate(f"{SCATTER}.plots[1].y") == "ratio"


def test_hostile_names_stay_text(visit, scan, tmp_path):
    other = scan.copy()
    hostile = "</script><script>document.title='run'</script>\"'<img src=x onerror=alert(1)>"
    other["instrument"] = np.where(np.arange(len(other)) == 0, hostile, "")
    rs.write_report(other, tmp_path / "page.html")
    assert "<script>document" not in (tmp_path / "page.html").read_text()
    scan_page = visit(tmp_path / "page.html")
    scan_page.evaluate(f"{SCATTER}.choose(0)")
    assert hostile in scan_page.locator("[data-view=designs] .panel").inner_text()
    assert scan_page.locator(".live img, .live script").count() == 0
    assert scan_page.title() != "run"


@pytest.fixture(scope="module")
def table():
    return rs.design.explore_around("moons")


@pytest.fixture(scope="module")
def page(visit, table, tmp_path_factory):
    path = tmp_path_factory.mktemp("designs") / "page.html"
    rs.write_report(table, path)
    page = visit(path)
    page.wait_for_function(f"{SCATTER}?.plots[0].stage.width > 1")
    return page


def texts_of(page, plot):
    """Return all texts of a plot with their places."""
    return page.evaluate(
        f"(() => {{ const v = {SCATTER}.plots[{plot}], seen = [];"
        "const own = v.stage.canvas.getContext('2d'), keep = own.fillText;"
        "own.fillText = (...text) => seen.push(text); v.stage.paint(); own.fillText = keep; return seen; })()"
    )


@pytest.mark.parametrize("column", ["loss", "coverage", "usable_per_area", "pitch", "loss_error"])
def test_an_axis_has_several_ticks_at_the_places_of_their_values(page, table, column):
    """Regression: the axis of the loss had only one tick."""
    page.evaluate(f"{SCATTER}.plots[0].y = '{column}'; {SCATTER}.update()")
    low, range_ = page.evaluate(f"{SCATTER}.ranges['{column}']")
    ticks = [(float(text), y) for text, x, y in texts_of(page, 0) if x == 4]
    if np.ptp(getattr(table[column], "value", table[column])) > 0:
        assert len(ticks) >= 3
    for value, y in ticks:
        place = page.evaluate(f"{SCATTER}.plots[0].stage.toScreen(0, {(value - low) / range_})[1]")
        assert y == pytest.approx(place - 8, abs=0.5)


def test_the_page_defines_the_columns(page, table):
    """Regression: the page defined none of its quantities."""
    page.evaluate(f"{SCATTER}.plots[0].y = 'loss'; {SCATTER}.update()")
    text = page.locator(".about").inner_text()
    assert "fraction of the assigned fibers that are lost to collisions" in text
    assert "fraction of the focal plane that at least one positioner reaches" in text
    meanings = page.evaluate(f"{SCATTER}.data.meanings")
    assert all(meanings.values())
    whole = page.locator("main").inner_text()
    for name, words in meanings.items():
        assert f"{name.replace('_', ' ')}: {words}." in whole


def test_the_name_of_an_instrument_is_inside_the_plot(page):
    width = page.evaluate(f"{SCATTER}.plots[0].stage.width")
    ((_, x, _),) = [entry for entry in texts_of(page, 0) if entry[0] == "moons"]
    assert 0 < x < width - 20


def test_the_coordinates_under_the_pointer_are_shown(page):
    page.evaluate(f"{SCATTER}.plots[0].y = 'loss'; {SCATTER}.update()")
    canvas = page.locator("canvas").first
    canvas.scroll_into_view_if_needed()
    box, k = canvas.bounding_box(), page.evaluate(f"{SCATTER}.pareto.indexOf(1)")
    x, y = page.evaluate(f"{SCATTER}.plots[0].stage.toScreen(...{SCATTER}.plots[0].points[{k}])")
    page.mouse.move(box["x"] + x, box["y"] + y)
    text = page.locator(".place").first.inner_text()
    expected = [page.evaluate(f"{SCATTER}.columns.{name}[{k}]") for name in ("coverage", "loss")]
    np.testing.assert_allclose([float(part.split()[1]) for part in text.split(", ")], expected, atol=0.005)
