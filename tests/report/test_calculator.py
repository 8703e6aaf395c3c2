"""The scatter plots and the calculator of designs in a real browser, against the surrogate of Python."""

import astropy.units as u
import numpy as np
import pytest

import rfpsurvey as rs

SCATTER = "document.querySelector('[data-view=designs]').view"
VIEW = "document.querySelector('[data-view=calculator]').view"
MM = u.mm


@pytest.fixture(scope="module")
def table():
    grid = {"central_arm": np.linspace(7, 9, 3) * MM, "ratio": [1, 1.3, 1.6], "pitch": [23, 26, 29] * MM}
    return rs.design.explore_designs(**grid, clearance=2.25 * MM)


@pytest.fixture(scope="module")
def page(visit, table, tmp_path_factory):
    path = tmp_path_factory.mktemp("designs") / "designs.html"
    rs.write_report(table, path)
    return visit(path)


def test_the_script_agrees_with_python(page):
    rng = np.random.default_rng(1)
    n = 3000
    shape = [rng.uniform(low, high, n) for low, high in ((0.2, 0.6), (1, 3), (0.02, 0.3))]
    for values, ends in zip(shape, ((0.2, 0.6), (1, 3), (0.02, 0.3)), strict=True):  # include the limits
        values[:50] = rng.choice(ends, 50)
    pitch = rng.uniform(5, 60, n)
    central, clearance = shape[0] * pitch, shape[2] * pitch / 2
    eccentric = shape[1] * central
    designs = np.transpose([central, eccentric, pitch, clearance]).tolist()
    found = page.evaluate(
        f"(rows) => rows.map(([central_arm, eccentric_arm, pitch, clearance]) =>"
        f"{VIEW}.surrogate.probability({{ central_arm, eccentric_arm, pitch, clearance }}))",
        designs,
    )
    expected = rs.probability.surrogate_probability(central * MM, eccentric * MM, pitch * MM, 2 * clearance * MM)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-6)
    assert (expected == 0).any()
    assert expected.max() > 0.5


def test_sliders_show_the_probability_and_what_changes_it(page):
    start = {"central arm": 8.25, "eccentric arm": 9.0, "pitch": 25.6, "clearance": 2.25}
    for name, value in start.items():
        page.get_by_label(f"{name} in mm, as a number").fill(str(value))
    expected = rs.probability.surrogate_probability(8.25 * MM, [9, 10, 8.25] * MM, 25.6 * MM, 4.5 * MM)
    large = page.locator(".result .large")
    assert float(large.inner_text()) == pytest.approx(expected[0], abs=6e-5)
    row = page.locator("tr", has_text="eccentric arm +1 mm").locator("td")
    assert float(row.inner_text()) == pytest.approx(expected[1] - expected[0], abs=6e-5)
    page.get_by_label("eccentric arm in mm", exact=True).fill("8.25")
    assert float(large.inner_text()) == pytest.approx(expected[2], abs=6e-5)
    assert float(page.get_by_label("eccentric arm in mm, as a number").input_value()) == 8.25
    assert "root mean square 0.0005" in page.locator(".result").inner_text()


def test_a_design_outside_the_range_has_no_value_but_a_reason(page):
    for name, value in {"central arm": 8.25, "eccentric arm": 7.0, "pitch": 25.6}.items():
        page.get_by_label(f"{name} in mm, as a number").fill(str(value))
    text = page.locator(".result").inner_text()
    assert "eccentric over central arm must be from 1 to 3; it is 0.848" in text
    assert page.locator(".result .large").inner_text() == "\N{EN DASH}"
    with pytest.raises(rs.InputError):
        rs.probability.surrogate_probability(8.25 * MM, 7 * MM, 25.6 * MM, 4.5 * MM)


def test_the_range_of_the_script_is_that_of_python(page):
    inside, outside = (5, 10, 25, 2), ((4.9, 10, 25, 2), (15.1, 20, 25, 2), (5, 15.1, 25, 2), (5, 10, 25, 0.2))
    for design in (inside, *outside, (5, 10, 25, 4)):
        arguments = dict(zip(("central_arm", "eccentric_arm", "pitch", "clearance"), design, strict=True))
        problems = page.evaluate(f"(design) => {VIEW}.surrogate.problems(design)", arguments)
        l1, l2, pitch, clearance = np.array(design) * MM
        call = (l1, l2, pitch, 2 * clearance)
        if problems:
            with pytest.raises(rs.InputError, match=problems[0].partition(" must")[0]):
                rs.probability.surrogate_probability(*call)
        else:
            assert rs.probability.surrogate_probability(*call) > 0


def test_a_click_on_a_design_sets_the_calculator(page, table):
    canvas = page.locator("[data-view=designs] canvas").first
    canvas.scroll_into_view_if_needed()
    box = canvas.bounding_box()
    k = int(np.flatnonzero(table["pareto"])[0])
    x, y = page.evaluate(f"{SCATTER}.plots[0].stage.toScreen(...{SCATTER}.plots[0].points[{k}])")
    page.mouse.click(box["x"] + x, box["y"] + y)
    chosen = page.evaluate(f"{SCATTER}.selected")
    both = [(table[name][k], table[name][chosen]) for name in table.meta["objectives"]]
    assert all(a == b for a, b in both)  # several designs can be at the same place
    row, design = table[chosen], page.evaluate(f"{VIEW}.design")
    assert design["pitch"] == pytest.approx(row["pitch"].value)
    assert design["eccentric_arm"] == pytest.approx(row["central_arm"].value * row["ratio"])
    if row["method"] == "surrogate":
        assert float(page.locator(".result .large").inner_text()) == pytest.approx(row["loss"], abs=6e-5)


def test_both_plots_show_the_same_range(page):
    canvas = page.locator("[data-view=designs] canvas").first
    canvas.focus()
    page.keyboard.press("+")
    page.keyboard.press("Shift+ArrowLeft")
    ranges = page.evaluate(f"{SCATTER}.plots.map(({{ stage }}) => [stage.x, stage.scale])")
    assert ranges[0] == ranges[1]
    assert ranges[0][1] > 0
    page.keyboard.press("0")
    page.get_by_label("Lower plot").select_option("ratio")
    assert page.evaluate(f"{SCATTER}.plots[1].y") == "ratio"


def test_hostile_names_stay_text(visit, table, tmp_path):
    other = table.copy()
    hostile = "</script><script>document.title='run'</script>\"'<img src=x onerror=alert(1)>"
    other["instrument"] = np.where(np.arange(len(other)) == 0, hostile, "")
    rs.write_report(other, tmp_path / "page.html")
    assert "<script>document" not in (tmp_path / "page.html").read_text()
    page = visit(tmp_path / "page.html")
    page.evaluate(f"{SCATTER}.choose(0)")
    assert hostile in page.locator("[data-view=designs] .panel").inner_text()
    assert page.locator(".live img, .live script").count() == 0
    assert page.title() != "run"
