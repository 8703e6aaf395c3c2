"""The interactive focal plane in a real browser."""

import json
from functools import partial

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord

import rfpsurvey as rs
from pages import Reader
from rfpsurvey.allocation import IDLE_REASONS

CENTER = SkyCoord(95, 23, unit="deg")
HOSTILE = "</script><script>document.title='run'</script>\"'<img src=x onerror=alert(1)>&amp;"
VIEW = "document.querySelector('.view').view"


@pytest.fixture(scope="module")
def tiles(presets):
    """Return plans of one tile by two allocators."""
    apo = presets["sdss_apo"]
    sky = rs.synthetic_catalog("poisson", CENTER, apo.field_radius, density=apo.target_density / 2, rng=1)
    n = len(sky)
    catalog = rs.Catalog(sky.coord, id=[f"T{k}" for k in range(n)], category=np.array(["a", "b"])[np.arange(n) % 2])
    plan = partial(rs.plan_tile, catalog, apo, CENTER, position_angle=30 * u.deg)
    return {name: plan(allocator=name) for name in ("repair", "lamost_rule")}


@pytest.fixture(scope="module")
def files(tiles, write_view, tmp_path_factory):
    folder = tmp_path_factory.mktemp("views")
    rs.write_report(tiles["lamost_rule"], folder / "one.html")
    write_view(tiles["repair"], folder / "two.html", plans={"lamost_rule": tiles["lamost_rule"]})
    return folder


@pytest.fixture(scope="module")
def page(visit, files):
    return visit(files / "one.html")


def point_of(page, name, where="tip"):
    """Return the position of the fiber of a positioner on the screen."""
    x, y = page.evaluate(
        f"([name, tip]) => {{ const v = {VIEW}, k = v.row.get(name);"
        "return tip ? v.stage.toScreen(v.plan.tip_x[k], v.plan.tip_y[k]) : v.stage.toScreen(v.x[k], v.y[k]); }",
        [name, where == "tip"],
    )
    box = page.locator("canvas").bounding_box()
    return box["x"] + x, box["y"] + y


def reset(page):
    page.evaluate(f"{VIEW}.filterBox.value = 'all'; {VIEW}.filter(); {VIEW}.choose(-1); {VIEW}.stage.fit()")
    page.locator("canvas").scroll_into_view_if_needed()


def an_assigned(tile, k=40):
    return tile.table[np.flatnonzero(tile.table["status"] == "assigned")[k]]


def test_the_wheel_the_buttons_and_the_keys_zoom(page):
    reset(page)
    scale = lambda: page.evaluate(f"{VIEW}.stage.scale")  # noqa: E731
    whole, box = scale(), page.locator("canvas").bounding_box()
    at = box["x"] + 200, box["y"] + 150
    before = page.evaluate(f"{VIEW}.stage.toWorld(200, 150)")
    page.mouse.move(*at)
    page.keyboard.down("Control")
    page.mouse.wheel(0, -300)
    page.keyboard.up("Control")
    page.wait_for_function(f"{VIEW}.stage.scale > {whole} * 1.2")
    np.testing.assert_allclose(page.evaluate(f"{VIEW}.stage.toWorld(200, 150)"), before, atol=1e-6)
    page.get_by_role("button", name="Show everything").click()
    assert scale() == pytest.approx(whole)
    page.get_by_role("button", name="Zoom in").click()
    assert scale() == pytest.approx(1.6 * whole)
    page.locator("canvas").focus()
    page.keyboard.press("-")
    assert scale() == pytest.approx(whole)
    page.keyboard.press("+")
    page.keyboard.press("0")
    assert scale() == pytest.approx(whole)


def test_the_wheel_alone_scrolls_the_page(page):
    """Regression: the wheel zoomed the plot whenever the mouse was above the plot, so that the page did not scroll."""
    reset(page)
    scale, top = page.evaluate(f"[{VIEW}.stage.scale, scrollY]")
    box = page.locator("canvas").bounding_box()
    page.mouse.move(box["x"] + 200, box["y"] + 150)
    page.mouse.wheel(0, 200)
    page.wait_for_timeout(300)
    assert page.evaluate("scrollY") > top + 100
    assert page.evaluate(f"{VIEW}.stage.scale") == scale


def test_the_coordinates_under_the_pointer_are_shown(page):
    reset(page)
    box = page.locator("canvas").bounding_box()
    page.mouse.move(box["x"] + 200, box["y"] + 150)
    x, y = page.evaluate(f"{VIEW}.stage.toWorld(200, 150)")
    text = page.locator(".place").inner_text().replace("\N{MINUS SIGN}", "-").partition(";")[0]
    found = [float(part.split()[1]) for part in text.removesuffix(" mm").split(", ")]
    np.testing.assert_allclose(found, [x, y], atol=0.5 / page.evaluate(f"{VIEW}.stage.scale"))
    page.mouse.move(0, 0)
    assert page.locator(".place").inner_text() == ""


def test_the_pointer_does_not_draw_the_plot_again(page, tiles):
    reset(page)
    box = page.locator("canvas").bounding_box()
    page.wait_for_timeout(100)
    page.evaluate(
        f"(() => {{ const v = {VIEW}, own = v.paint; v.n_paints = 0; "
        "v.paint = (...all) => { v.n_paints += 1; own.apply(v, all); }; })()"
    )
    pixels = f"{VIEW}.stage.canvas.toDataURL()"
    page.mouse.move(box["x"] + 1, box["y"] + 1)
    plain, seen = page.evaluate(pixels), set()
    for row in (an_assigned(tiles["lamost_rule"], 20), an_assigned(tiles["lamost_rule"], 40)):
        page.mouse.move(*point_of(page, row["id"]))
        page.wait_for_timeout(50)
        assert page.evaluate(f"{VIEW}.id[{VIEW}.stage.hovered]") == row["id"]
        seen.add(page.evaluate(pixels))
    assert len({plain, *seen}) == 3
    page.mouse.move(box["x"] + 1, box["y"] + 1)
    page.wait_for_timeout(50)
    assert page.evaluate(f"{VIEW}.stage.hovered") == -1
    assert page.evaluate(pixels) == plain
    assert page.evaluate(f"{VIEW}.n_paints") == 0


def test_dragging_moves_the_plot(page):
    reset(page)
    page.get_by_role("button", name="Zoom in").click()
    box, before = page.locator("canvas").bounding_box(), page.evaluate(f"{VIEW}.stage.toWorld(300, 300)")
    page.mouse.move(box["x"] + 300, box["y"] + 300)
    page.mouse.down()
    page.mouse.move(box["x"] + 360, box["y"] + 320, steps=5)
    page.mouse.up()
    # the first pixels distinguish a drag from a click
    after, scale = page.evaluate(f"[{VIEW}.stage.toWorld(360, 320), {VIEW}.stage.scale]")
    np.testing.assert_allclose(after, before, atol=13 / scale)
    assert page.evaluate(f"{VIEW}.selected") == -1


def test_two_fingers_zoom(visit, files):
    phone = visit(files / "one.html", width=400, height=850, touch=True)
    phone.locator("canvas").scroll_into_view_if_needed()
    box, whole = phone.locator("canvas").bounding_box(), phone.evaluate(f"{VIEW}.stage.scale")
    session = phone.context.new_cdp_session(phone)
    for kind, half in (("touchStart", 30), ("touchMove", 50), ("touchMove", 80), ("touchMove", 110)):
        middle = box["x"] + 170, box["y"] + 150
        points = [{"x": middle[0] + s * half, "y": middle[1], "id": k} for k, s in enumerate((-1, 1))]
        session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})
    session.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})
    assert phone.evaluate(f"{VIEW}.stage.scale") > 1.5 * whole


def test_hovering_shows_the_values_of_the_tile(page, tiles):
    reset(page)
    row = an_assigned(tiles["lamost_rule"])
    page.evaluate(f"(name) => {VIEW}.find(name)", row["id"])
    page.evaluate(f"{VIEW}.choose(-1)")
    page.mouse.move(*point_of(page, row["id"]))
    text = page.locator(".card").inner_text().replace("\N{MINUS SIGN}", "-")
    assert page.locator(".card").is_visible()
    assert f"Positioner {row['id']}" in text
    assert row["target_id"] in text
    assert f"{row['theta'].value:.2f}\N{DEGREE SIGN}, {row['phi'].value:.2f}\N{DEGREE SIGN}" in text
    assert f"{row['clearance'].value:.3f} mm" in text


def test_a_click_selects_in_the_table_and_back(page, tiles):
    reset(page)
    row, other = an_assigned(tiles["lamost_rule"]), an_assigned(tiles["lamost_rule"], 200)
    page.get_by_text("All assignments", exact=True).click()
    assert page.locator(".long-table").get_attribute("aria-rowcount") == str(len(tiles["lamost_rule"]) + 1)
    page.evaluate(f"(name) => {VIEW}.find(name)", row["id"])
    page.evaluate(f"{VIEW}.choose(-1)")
    page.locator("canvas").scroll_into_view_if_needed()
    page.mouse.click(*point_of(page, row["id"]))
    marked = page.locator("tr[aria-selected=true]")
    assert (marked.count(), marked.locator("td").first.inner_text()) == (1, row["target_id"])
    page.evaluate(f"(name) => {VIEW}.table.mark({VIEW}.row.get(name), true)", other["id"])
    page.get_by_role("button", name=f"Positioner {other['id']}: select", exact=True).click()
    assert page.evaluate(f"{VIEW}.id[{VIEW}.selected]") == other["id"]
    assert f"Positioner {other['id']}" in page.locator(".panel").inner_text()
    page.get_by_text("All assignments", exact=True).click()


def test_targets_and_positioners_are_found_by_their_ids(page, tiles):
    reset(page)
    row = an_assigned(tiles["lamost_rule"])
    for text in (row["id"], row["target_id"]):
        page.get_by_label("Search for a positioner").fill(text)
        page.keyboard.press("Enter")
        assert f"Positioner {row['id']}" in page.locator(".panel").inner_text()
    page.get_by_label("Search for a positioner").fill("nothing has this id")
    page.keyboard.press("Enter")
    assert "no target with the id nothing has this id" in page.locator(".panel").inner_text()


def test_filters_count_the_positioners_of_the_tile(page, tiles):
    reset(page)
    table, idle = tiles["lamost_rule"].table, tiles["lamost_rule"].idle
    expected = {"collision": table["in_collision"].sum(), "idle": (table["status"] == "idle").sum()}
    expected |= {f"reason {k}": (idle["reason"] == text).sum() for k, text in enumerate(IDLE_REASONS)}
    expected |= {f"category {c}": ((table["category"] == c) & (table["status"] == "assigned")).sum() for c in "ab"}
    shown = page.evaluate(f"[...{VIEW}.tests.keys()]")
    for value, number in expected.items():
        assert (value in shown) == (number > 0)
        if number:
            page.evaluate(f"(value) => {{ {VIEW}.filterBox.value = value; {VIEW}.filter(); }}", value)
            assert page.locator(".count").first.text_content() == f"Shown: {number} of 500 positioners."
    assert min(expected["collision"], expected["idle"], expected["category a"]) > 0


WHY = ("disabled", "stuck", "no target in reach", "assigned to", "the arm would collide", "without a collision")


def test_the_reason_of_each_idle_positioner_is_shown(visit, files, tiles):
    page, plan = visit(files / "two.html"), tiles["repair"]
    seen, script = set(), f"(names) => names.map((name) => {VIEW}.why({VIEW}.row.get(name)).join(' '))"
    texts = page.evaluate(script, plan.idle["id"].tolist())
    for row, text in zip(plan.idle, texts, strict=True):
        code, free = IDLE_REASONS.index(row["reason"]), plan.idle_targets[plan.idle_targets["id"] == row["id"]]
        assert WHY[code] in text
        if code == 4:
            for one in free[:8]:
                others = ", ".join(one["colliding_with"].split())
                assert f"Target {one['target_id']}: the arm would collide with {others}." in text
        seen.add(code)
    assert {2, 3, 4} <= seen


def test_the_keyboard_selects_neighbors_and_opens_the_table(page, tiles):
    reset(page)
    page.locator("canvas").focus()
    page.keyboard.press("ArrowRight")
    first, xy = page.evaluate(f"{VIEW}.selected"), page.evaluate(f"[{VIEW}.x, {VIEW}.y]")
    # x increases to the left
    for key, (dx, dy) in {"Right": (-1, 0), "Left": (1, 0), "Up": (0, 1), "Down": (0, -1)}.items():
        before = page.evaluate(f"{VIEW}.selected")
        page.keyboard.press(f"Arrow{key}")
        after = page.evaluate(f"{VIEW}.selected")
        step = [axis[after] - axis[before] for axis in xy]
        assert step[0] * dx + step[1] * dy > 0
    assert first >= 0
    page.keyboard.press("Enter")
    assert page.evaluate("document.activeElement.closest('tr').getAttribute('aria-selected')") == "true"
    page.locator("canvas").focus()
    page.keyboard.press("Escape")
    assert page.evaluate(f"{VIEW}.selected") == -1
    page.get_by_text("All assignments", exact=True).click()


def test_differences_of_two_plans_are_those_of_their_tables(visit, files, tiles):
    page = visit(files / "two.html")
    a, b = (np.ma.filled(tiles[name].table["target_id"], "").tolist() for name in ("repair", "lamost_rule"))
    both = zip(a, b, strict=True)
    kinds = ["same" if x == y else "first" if not y else "second" if not x else "other" for x, y in both]
    assert (page.evaluate(f"{VIEW}.id.map((_, k) => {VIEW}.change(k))"), len(set(kinds))) == (kinds, 4)
    page.get_by_label("Show", exact=True).select_option("changed")
    assert page.locator(".count").first.inner_text().startswith(f"Shown: {500 - kinds.count('same')} of 500")
    page.get_by_label("Compared with").select_option("no other plan")
    assert page.evaluate(f"{VIEW}.compared") is None
    page.get_by_label("Plan", exact=True).select_option("lamost_rule")
    assert page.evaluate(f"{VIEW}.plan.target_id") == b


def test_the_compass_agrees_with_the_projection(page, tiles, presets):
    plane = presets["sdss_apo"].projection(CENTER, 30 * u.deg)
    points = CENTER.directional_offset_by([0, 0, 90] * u.deg, [0, 1, 1] * u.arcmin)
    center, north, east = plane.to_focal_plane(points).to_value(u.mm)
    shown = page.evaluate(f"{VIEW}.compass()")
    for name, point in (("N", north), ("E", east)):
        dx, dy = (point - center) / np.hypot(*(point - center))
        np.testing.assert_allclose(shown[name], [-dx, dy], atol=1e-4)  # x increases to the left


def test_hostile_names_stay_text(visit, write_view, tmp_path, small):
    sky = rs.synthetic_catalog("uniform", CENTER, 0.5 * u.deg, n_targets=60, rng=1)
    names = {"id": [f"{k} {HOSTILE}" for k in range(60)], "category": [f"{k % 2}{HOSTILE}" for k in range(60)]}
    tile = rs.plan_tile(rs.Catalog(sky.coord, **names), small, CENTER)
    write_view(tile, tmp_path / "page.html", plans={HOSTILE: tile})
    text = (tmp_path / "page.html").read_text()
    assert "<script>document" not in text
    assert "<img" not in text
    assert HOSTILE in json.loads(Reader(text).text("script")[0])["plans"][1]["name"]
    page = visit(tmp_path / "page.html")
    page.evaluate(f"{VIEW}.choose({VIEW}.plan.target_id.findIndex(Boolean))")
    page.get_by_text("All assignments", exact=True).click()
    assert HOSTILE in page.locator(".panel").inner_text()
    assert page.locator(".live img, .live script").count() == 0
    assert "run" not in page.title()


def test_figures_replace_the_view_without_scripts_and_on_paper(visit, files):
    assert visit(files / "one.html", scripts=False).locator(".still svg").first.is_visible()
    printed = visit(files / "one.html")
    assert not printed.locator(".still svg").first.is_visible()
    assert printed.locator("canvas").is_visible()
    printed.emulate_media(media="print")
    assert printed.locator(".still svg").first.is_visible()
    assert not printed.locator("canvas").is_visible()


def test_controls_are_large_enough_and_the_page_does_not_scroll_sideways(visit, files):
    page = visit(files / "two.html", width=400)
    page.evaluate(f"{VIEW}.details.open = true")
    page.wait_for_function(f"{VIEW}.table")
    sizes = page.evaluate("""[...document.querySelectorAll('.live :is(button, select, input)')].map((e) =>
        [e.textContent || e.type, e.getBoundingClientRect().width, e.getBoundingClientRect().height])""")
    assert len(sizes) > 40
    assert [entry for entry in sizes if min(entry[1:]) < 32] == []
    assert page.evaluate("document.documentElement.scrollWidth - document.documentElement.clientWidth") <= 0


def test_every_control_has_a_name_and_the_selection_is_announced(page):
    unnamed = page.evaluate("""[...document.querySelectorAll('.live :is(button, select, input, canvas, [role=region])')]
        .filter((e) => !(e.getAttribute('aria-label') || e.labels?.length || e.textContent.trim())).length""")
    assert (unnamed, page.locator(".panel").get_attribute("aria-live")) == (0, "polite")
    assert page.locator("canvas").get_attribute("tabindex") == "0"
