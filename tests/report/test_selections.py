"""Positions under the pointer, searches by coordinates, selected areas, exports, links and keys, in a real browser."""

import io
from pathlib import Path
from urllib.parse import parse_qs

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import Table
from matplotlib.image import imread

import rfpsurvey as rs

CENTER = SkyCoord(95, 23, unit="deg")
ANGLE = 30 * u.deg
VIEW = "document.querySelector('.view').view"
HOSTILE = "</script><script>document.title='run'</script>\"'<img src=x onerror=alert(1)>&,=1+1"
# the content security policy of pages forbids Page.wait_for_function
READY = f"async () => {{ while (!({VIEW}?.stage.width > 1)) await new Promise(requestAnimationFrame); }}"


@pytest.fixture(scope="module")
def tile(presets):
    apo = presets["sdss_apo"]
    sky = rs.synthetic_catalog("poisson", CENTER, apo.field_radius, density=apo.target_density / 2, rng=1)
    names = [f"T{k} {HOSTILE}" for k in range(len(sky))]
    catalog = rs.Catalog(sky.coord, id=names, priority=np.arange(len(sky)) % 3)
    return rs.plan_tile(catalog, apo, CENTER, position_angle=ANGLE, allocator="nearest")


@pytest.fixture(scope="module")
def survey(small):
    sky = rs.synthetic_catalog("poisson", CENTER, 1 * u.deg, density=60 / u.deg**2, rng=3)
    return rs.plan_survey(sky, small, rs.place_tiles(sky, small, passes=2))


@pytest.fixture(scope="module")
def files(tile, survey, tmp_path_factory):
    folder = tmp_path_factory.mktemp("selections")
    rs.write_report(tile, folder / "tile.html", title="a tile")
    rs.write_report(survey, folder / "survey.html")
    return folder


@pytest.fixture
def opened(visit, files):
    def open_page(name, fragment="", **options):
        page = visit(files / f"{name}.html", **options)
        if fragment:
            page.goto((files / f"{name}.html").as_uri() + fragment)
            page.reload()
        page.evaluate(READY)
        page.locator("canvas").first.scroll_into_view_if_needed()
        return page

    return open_page


def drag(page, corners):
    """Select the area between two corners in world coordinates with the button and the mouse."""
    page.get_by_role("button", name="Select an area").click()
    box = page.locator("canvas").first.bounding_box()
    (ax, ay), (bx, by) = (page.evaluate(f"(p) => {VIEW}.stage.toScreen(...p)", corner) for corner in corners)
    page.mouse.move(box["x"] + ax, box["y"] + ay)
    page.mouse.down()
    page.mouse.move(box["x"] + bx, box["y"] + by, steps=4)
    page.mouse.up()


def saved(page, name):
    """Return the path of the file that a button saves."""
    with page.expect_download() as download:
        page.get_by_role("button", name=name).click()
    return Path(download.value.path()), download.value.suggested_filename


def test_the_sky_position_of_the_pointer_is_that_of_the_projection(opened, tile, presets):
    page = opened("tile")
    points = rs.synthetic_catalog(
        "uniform", CENTER, 0.98 * presets["sdss_apo"].field_radius, n_targets=300, rng=2
    ).coord
    xy = presets["sdss_apo"].projection(CENTER, ANGLE).to_focal_plane(points).to_value(u.mm)
    found = SkyCoord(page.evaluate(f"(xy) => xy.map(([x, y]) => {VIEW}.toSky(x, y))", xy.tolist()), unit="deg")
    assert found.separation(points).max() < 0.3 * u.arcsec
    back = page.evaluate(f"(points) => points.map(([ra, dec]) => {VIEW}.fromSky(ra, dec))", sky_list(found))
    np.testing.assert_allclose(back, xy, atol=1e-6)
    box = page.locator("canvas").bounding_box()
    page.mouse.move(box["x"] + 200, box["y"] + 150)
    ra, dec = page.evaluate(f"{VIEW}.toSky(...{VIEW}.stage.toWorld(200, 150))")
    assert f"; ra {ra:.4f}\N{DEGREE SIGN}, dec {dec:.4f}\N{DEGREE SIGN}" in page.locator(".place").inner_text()


def sky_list(coord):
    return np.transpose([coord.ra.deg, coord.dec.deg]).tolist()


def test_tiles_with_few_targets_have_no_sky_position(visit, write_view, presets, tmp_path):
    sky = rs.synthetic_catalog("uniform", CENTER, 0.5 * u.deg, n_targets=5, rng=1)
    write_view(rs.plan_tile(sky, presets["sdss_apo"], CENTER), tmp_path / "page.html")
    page = visit(tmp_path / "page.html")
    page.evaluate(READY)
    assert page.evaluate(f"{VIEW}.data.sky") is None
    assert page.evaluate(f"{VIEW}.where(1, 2)") == "x 1.00, y 2.00 mm"


@pytest.mark.parametrize("style", ["decimal", "colons", "letters"])
def test_positions_on_the_sky_are_found(opened, tile, survey, style):
    def text(ra, dec):
        place = SkyCoord(ra, dec)
        if style == "decimal":
            return f"{place.ra.deg:.7f}, {place.dec.deg:+.7f}"
        return place.to_string("hmsdms", precision=4, **({"sep": ":"} if style == "colons" else {}))

    page, row = opened("tile"), tile.table[np.flatnonzero(tile.table["status"] == "assigned")[7]]
    page.get_by_label("Search for a positioner").fill(text(row["ra"], row["dec"]))
    page.keyboard.press("Enter")
    xy = np.column_stack([tile.table[name].to_value(u.mm) for name in "xy"])
    tip = [row[name].to_value(u.mm) for name in ("tip_x", "tip_y")]
    distances = np.hypot(*(xy - tip).T)
    assert page.evaluate(f"{VIEW}.selected") == distances.argmin()
    assert f"{distances.min():.2f} mm from the center of this positioner" in page.locator(".panel").inner_text()
    page = opened("survey")
    place = SkyCoord(survey.tiles["ra"][5], survey.tiles["dec"][5]).directional_offset_by(20 * u.deg, 0.001 * u.deg)
    page.get_by_label("Search for a tile").fill(text(place.ra, place.dec))
    page.keyboard.press("Enter")
    apart = SkyCoord(survey.tiles["ra"], survey.tiles["dec"]).separation(place)
    assert page.evaluate(f"{VIEW}.selected") == apart.argmin()
    assert f"at a distance of {apart.min().deg:.3f}\N{DEGREE SIGN}" in page.locator(".panel").inner_text()


def test_what_is_no_position_is_an_id(opened):
    texts = ["1", "1 2 3", "1 91", "1:2:3:4 5", "a 5", "5 a", "", "1 -95"]
    assert opened("tile").evaluate("(texts) => texts.map((text) => coordinates(text))", texts) == [None] * len(texts)


def test_an_area_restricts_the_table_of_a_tile(opened, tile):
    page = opened("tile")
    page.get_by_text("All assignments", exact=True).click()
    corners = [[-100, -60], [150, 90]]
    page.locator("canvas").scroll_into_view_if_needed()
    drag(page, corners)
    x, y = (tile.table[name].to_value(u.mm) for name in "xy")
    (x0, y0, x1, y1) = page.evaluate(f"{VIEW}.stage.area")
    np.testing.assert_allclose([x0, y0, x1, y1], np.ravel(corners), atol=2 / page.evaluate(f"{VIEW}.stage.scale"))
    inside = (x > x0) & (x < x1) & (y > y0) & (y < y1)
    n = int(inside.sum())
    assert 50 < n < 400
    assert page.locator(".count").first.inner_text() == f"Shown: {n} of 500 positioners."
    assert page.locator(".long-table").get_attribute("aria-rowcount") == str(n + 1)
    assert page.evaluate(f"{VIEW}.table.order.map((k) => {VIEW}.id[k])") == tile.table["id"][inside].tolist()
    # the outline moves with the plot
    outline, before = page.locator(".area"), page.locator(".area").bounding_box()
    page.get_by_role("button", name="Zoom in").click()
    page.wait_for_timeout(100)
    assert outline.bounding_box()["width"] == pytest.approx(1.6 * before["width"], abs=0.1)
    page.locator("canvas").focus()
    page.keyboard.press("Escape")
    assert page.locator(".count").first.inner_text() == "Shown: 500 of 500 positioners."
    assert not outline.is_visible()
    # the same with the keyboard: the visible part
    page.keyboard.press("a")
    (ax, ay), (bx, by) = page.evaluate(
        f"[[0, 0], [{VIEW}.stage.width, {VIEW}.stage.height]].map((p) => {VIEW}.stage.toWorld(...p))"
    )
    n = np.count_nonzero((x > min(ax, bx)) & (x < max(ax, bx)) & (y > min(ay, by)) & (y < max(ay, by)))
    assert page.locator(".count").first.inner_text() == f"Shown: {n} of 500 positioners."
    assert n < 500


def test_an_area_restricts_the_tiles_of_a_survey(opened, survey):
    page = opened("survey")
    page.get_by_text("All tiles", exact=True).click()
    page.locator("canvas").scroll_into_view_if_needed()
    drag(page, [[-0.4, -0.3], [0.5, 0.4]])
    assert page.locator(".area").is_visible()
    x, y, (x0, y0, x1, y1) = page.evaluate(f"[{VIEW}.x, {VIEW}.y, {VIEW}.stage.area]")
    rows = [k for k in range(len(survey.tiles)) if x0 < x[k] < x1 and y0 < y[k] < y1]
    assert 0 < len(rows) < len(survey.tiles)
    assert page.evaluate(f"{VIEW}.table.order") == rows
    assert page.locator(".count").first.inner_text() == f"Shown: {len(rows)} of {len(survey.tiles)} tiles."


def test_the_shown_rows_are_saved_as_a_file(opened, tile, survey):
    page = opened("tile")
    page.get_by_label("Show", exact=True).select_option("idle")
    path, name = saved(page, "Save the shown rows")
    idle = tile.table[tile.table["status"] == "idle"]
    found = Table.read(path, format="ascii.csv")
    assert name == "a_tile.csv"
    assert found["id"].astype(str).tolist() == idle["id"].tolist()
    page.get_by_label("Show", exact=True).select_option("assigned")
    found = Table.read(saved(page, "Save the shown rows")[0], format="ascii.csv")
    has = tile.table[tile.table["status"] == "assigned"]
    assert found["target id"].tolist() == has["target_id"].tolist()  # names with commas, quotes and tags
    for column, own in {
        "ra [deg]": "ra",
        "theta [deg]": "theta",
        "clearance [mm]": "clearance",
        "priority": "priority",
    }.items():
        values = np.ma.filled(np.ma.asarray(found[column], dtype=float), np.nan)
        np.testing.assert_allclose(values, np.asarray(has[own], dtype=float), atol=6e-4)
    page = opened("survey")
    found = Table.read(saved(page, "Save the shown rows")[0], format="ascii.csv")
    assert found["n assigned"].tolist() == survey.tiles["n_assigned"].tolist()
    np.testing.assert_allclose(found["dec [deg]"], survey.tiles["dec"].value, atol=6e-5)


def test_the_plot_is_saved_with_its_background_and_its_legend(opened):
    page = opened("tile", scheme="dark")
    path, name = saved(page, "Save the plot")
    image = imread(io.BytesIO(path.read_bytes()))
    width, height, lines = page.evaluate(
        f"[{VIEW}.stage.canvas.width, {VIEW}.stage.canvas.height, {VIEW}.legend.children.length]"
    )
    assert name == "a_tile.png"
    assert image.shape == (height + 20 * lines + 12, width, 4)
    np.testing.assert_allclose(image[0, 0] * 255, [0x10, 0x13, 0x17, 255], atol=1)
    for k in range(lines):  # the row of each entry has its color
        color = page.evaluate(f"(k) => getComputedStyle({VIEW}.legend.children[k].firstChild).backgroundColor", k)
        color = (
            color
            if color != "rgba(0, 0, 0, 0)"
            else page.evaluate(f"(k) => getComputedStyle({VIEW}.legend.children[k].firstChild).borderTopColor", k)
        )
        wanted = [int(v) for v in color[color.index("(") + 1 : -1].split(",")[:3]]
        part = image[height + 20 * k + 4 : height + 20 * k + 24, 5:25, :3] * 255
        assert np.abs(part - wanted).max(axis=2).min() < 60


def test_a_link_restores_the_selection(opened, tile, survey):
    page = opened("tile")
    page.get_by_label("Show", exact=True).select_option("assigned")
    drag(page, [[-100, -60], [150, 90]])
    page.evaluate(f"{VIEW}.choose({VIEW}.row.get('{tile.table['id'][40]}'))")
    page.get_by_role("button", name="Write the selection").click()
    fragment, state = (
        page.evaluate("location.hash"),
        f"[{VIEW}.filterBox.value, {VIEW}.selected, {VIEW}.count.textContent]",
    )
    before = page.evaluate(state)
    assert (before[:2], "500 of" in before[2]) == (["assigned", 40], False)
    assert opened("tile", fragment).evaluate(state) == before
    page = opened("survey")
    page.get_by_label("Color", exact=True).select_option("n_assigned")
    page.get_by_label("Pass", exact=True).fill("0")
    page.get_by_label("Only this pass").check()
    page.evaluate(f"{VIEW}.choose(3)")
    page.get_by_role("button", name="Write the selection").click()
    state = f"[{VIEW}.column, {VIEW}.upTo, {VIEW}.only.checked, {VIEW}.name[{VIEW}.selected], {VIEW}.count.textContent]"
    before, fragment = page.evaluate(state), page.evaluate("location.hash")
    assert opened("survey", fragment).evaluate(state) == before


@pytest.mark.parametrize(
    "fragment", ["#selected=nothing", "#area=1+2+3", "#area=a+b+c+d", "#Show=<img src=x>", "#%", "#x"]
)
def test_a_wrong_link_opens_the_page(opened, fragment):
    page = opened("tile", fragment)
    assert page.evaluate(f"[{VIEW}.selected, {VIEW}.stage.area ?? null]") == [-1, None]
    assert page.locator(".count").first.inner_text() == "Shown: 500 of 500 positioners."


def test_keys_move_in_a_list_and_leave_it(opened, tile):
    page = opened("tile")
    page.get_by_text("All assignments", exact=True).click()
    region = page.get_by_role("region", name="All assignments")
    region.focus()
    names, focus = tile.table["id"].tolist(), "document.activeElement.textContent"
    for key, row in {"ArrowDown": 0, "PageDown": 10, "ArrowUp": 9, "End": 499, "Home": 0}.items():
        page.keyboard.press(key)
        assert page.evaluate(focus) == names[row], key
        assert page.evaluate(f"{VIEW}.id[{VIEW}.selected]") == names[row]
    page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement.closest('.long-table')") is None
    region.focus()
    page.keyboard.press("ArrowDown")
    page.keyboard.press("Escape")
    assert page.evaluate("[document.activeElement.localName, document.activeElement.textContent]") == [
        "summary",
        "All assignments",
    ]


def test_a_tile_links_to_aladin_lite_and_says_what_needs_the_network(opened, survey):
    page = opened("survey")
    page.evaluate(f"{VIEW}.choose(2)")
    link, row = page.locator(".panel a"), survey.tiles[2]
    address, _, query = link.get_attribute("href").partition("?")
    values = parse_qs(query)
    assert address == "https://aladin.cds.unistra.fr/AladinLite/"
    np.testing.assert_allclose(
        [float(v) for v in values["target"][0].split()], [row["ra"].value, row["dec"].value], atol=1e-4
    )
    assert float(values["fov"][0]) == pytest.approx(3 * survey.provenance["parameters"]["radius_deg"], rel=0.01)
    assert link.get_attribute("rel") == "noreferrer"
    assert "The link requires a network; the page itself loads nothing." in page.locator(".panel").inner_text()
