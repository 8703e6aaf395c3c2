"""The interactive map of tiles in a real browser, and views of results that lack something, such as targets."""

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import QTable

import rfpsurvey as rs
from pages import Reader
from rfpsurvey.report._views import sky_view

CENTER = SkyCoord(95, 23, unit="deg")
VIEW = "document.querySelector('.view').view"


@pytest.fixture(scope="module")
def survey(small):
    sky = rs.synthetic_catalog("poisson", CENTER, 1 * u.deg, density=60 / u.deg**2, rng=3)
    return rs.plan_survey(sky, small, rs.place_tiles(sky, small, passes=2))


@pytest.fixture(scope="module")
def page(visit, write_view, survey, tmp_path_factory):
    path = tmp_path_factory.mktemp("sky") / "survey.html"
    write_view(survey, path)
    return visit(path)


def test_hovering_shows_the_values_of_a_tile(page, survey):
    page.evaluate(f"{VIEW}.stage.fit()")
    page.locator("canvas").scroll_into_view_if_needed()
    box, row = page.locator("canvas").bounding_box(), survey.tiles[3]
    x, y = page.evaluate(f"{VIEW}.stage.toScreen({VIEW}.x[3], {VIEW}.y[3])")
    page.mouse.move(box["x"] + x, box["y"] + y)
    text = page.locator(".card").inner_text()
    assert f"Tile {row['tile']}" in text
    assert f"{row['ra'].value:.4f}\N{DEGREE SIGN}" in text
    assert f"{row['completeness']:.4f}" in text or row["completeness"] in (0, 1)
    page.mouse.click(box["x"] + x, box["y"] + y)
    assert f"Tile {row['tile']}" in page.locator(".panel").inner_text()
    page.keyboard.press("Escape")


def test_the_slider_shows_the_tiles_of_the_passes(page, survey):
    passes = np.asarray(survey.tiles["pass"])
    slider, only = page.get_by_label("Pass", exact=True), page.get_by_label("Only this pass")
    for value, alone in ((0, False), (1, False), (1, True), (0, True)):
        slider.fill(str(value))
        only.set_checked(alone)
        last = np.unique(passes)[value]
        n = (passes == last).sum() if alone else (passes <= last).sum()
        assert page.locator(".count").inner_text() == f"Shown: {n} of {len(passes)} tiles."
    only.set_checked(False)
    slider.fill("1")


def test_every_tile_has_the_class_of_its_value(page, survey):
    page.get_by_label("Color", exact=True).select_option("n_assigned")
    values, bins, words = (page.evaluate(f"{VIEW}.{name}") for name in ("columns.n_assigned", "bin", "words"))
    assert values == survey.tiles["n_assigned"].tolist()
    for value, k in zip(values, bins, strict=True):
        low, _, high = words[k].partition(" to ")
        assert float(low) - 1e-3 * abs(float(low)) <= value <= float(high or low) * 1.001


@pytest.fixture
def three(visit, write_view, tmp_path):
    """Return the page of three tiles, one of which has no completeness, colored by the completeness."""
    table = QTable({"tile": [1, 2, 3], "ra": [94, 97, 100] * u.deg, "dec": [20, 22, 21] * u.deg, "pass": [1, 1, 1]})
    table["position_angle"] = np.zeros(3) * u.deg
    tiling = rs.Tiling.from_table(table)
    tiling.table["n_observed"], tiling.table["completeness"] = [10, 20, 30], [0.426, np.nan, 0.426]
    write_view(tiling, tmp_path / "tiles.html")
    page = visit(tmp_path / "tiles.html")
    page.get_by_label("Color", exact=True).select_option("completeness")
    return page


def test_a_constant_column_has_one_value_in_the_legend(three):
    """Regression: the legend of a column with one value was a range whose upper end was larger by 1."""
    assert three.evaluate(f"{VIEW}.words") == ["0.426"]


def test_tiles_without_a_value_are_drawn_and_counted(three):
    """Regression: tiles without a value were not drawn, although the page stated that all tiles are shown."""
    assert three.locator(".count").inner_text() == "Shown: 3 of 3 tiles; 1 of them without a value (dashed)."
    assert "no value (1)" in three.locator(".legend").inner_text()
    drawn = three.evaluate(
        f"(() => {{ const v = {VIEW}, seen = [], keep = v.pathOf; v.pathOf = (c, s, k) => seen.push([k, "
        "c.getLineDash().length]); v.stage.paint(); v.pathOf = keep; return seen; })()"
    )
    assert sorted(drawn) == [[0, 0], [1, 2], [2, 0]]


def test_the_map_has_coordinates_a_compass_a_scale_and_a_legend_title(three):
    """Regression: the map had no coordinates, directions or scale, and the legend did not name the column."""
    assert three.locator(".legend li").first.inner_text() == "completeness:"
    texts = three.evaluate(
        f"(() => {{ const v = {VIEW}, seen = [], own = v.stage.canvas.getContext('2d'), keep = own.fillText;"
        "own.fillText = (...text) => seen.push(text); v.stage.paint(); own.fillText = keep; return seen; })()"
    )
    across = {text: x for text, x, _ in texts}
    *lines, (scale, _, _) = texts
    assert {22.0, 97.0} <= {float(text.strip("+\N{DEGREE SIGN}")) for text, _, _ in lines if text not in ("N", "E")}
    assert scale in ("0.5\N{DEGREE SIGN}", "1\N{DEGREE SIGN}")
    assert across["E"] < across["N"]
    for text, x, y in lines:  # each label is at its line
        place = three.evaluate(f"{VIEW}.unproject(...{VIEW}.stage.toWorld({x}, {y}))")
        if text.startswith("+"):
            assert place[1] == pytest.approx(float(text[1:-1]), abs=0.1)
        elif text[0].isdigit():
            assert place[0] == pytest.approx(float(text[:-1]), abs=0.2)


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_adjacent_colors_can_be_told_apart(visit, write_view, survey, tmp_path, scheme):
    """Regression: the darkest colors, of values above 0.6, differed too little."""
    write_view(survey, tmp_path / "survey.html")
    page = visit(tmp_path / "survey.html", scheme=scheme)
    page.evaluate(f"{VIEW}.words = Array(8).fill('')")
    colors = [[int(v) for v in page.evaluate(f"{VIEW}.binColor({k})")[4:-1].split()] for k in range(8)]
    values = lab(np.array(colors) / 255)
    assert np.linalg.norm(np.diff(values, axis=0), axis=1).min() > 15
    assert (np.diff(values[:, 0]) > 3).all()  # on paper, large values are light, too


def lab(rgb):
    """Return colors in CIELAB."""
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    xyz = linear @ np.array([[0.4124, 0.2126, 0.0193], [0.3576, 0.7152, 0.1192], [0.1805, 0.0722, 0.9505]])
    t = xyz / np.array([0.9505, 1.0, 1.089])
    f = np.where(t > (6 / 29) ** 3, np.cbrt(t), t / (3 * (6 / 29) ** 2) + 4 / 29)
    return np.column_stack([116 * f[:, 1] - 16, 500 * (f[:, 0] - f[:, 1]), 200 * (f[:, 1] - f[:, 2])])


@pytest.mark.parametrize("whole", [False, True])
def test_the_coordinates_of_a_point_are_the_inverse_of_the_projection(page, whole):
    rng = np.random.default_rng(2)
    ra, dec = rng.uniform(0, 360, 200), rng.uniform(-89, 89, 200)
    for center in ((10.0, 0.0),) if whole else ((10.0, 0.0), (200.0, 60.0), (0.0, -90.0)):
        found = page.evaluate(
            "([whole, center, places]) => {"
            "const there = projection(whole, ...center), back = inverse(whole, ...center);"
            "return places.map(([ra, dec]) => back(...there(ra, dec))); }",
            [whole, center, np.column_stack([ra, dec]).tolist()],
        )
        found = SkyCoord(*np.transpose(found), unit="deg")
        assert found.separation(SkyCoord(ra, dec, unit="deg")).max() < 1e-6 * u.deg


def test_the_coordinates_under_the_pointer_are_shown(page, survey):
    page.evaluate(f"{VIEW}.stage.fit()")
    box = page.locator("canvas").bounding_box()
    x, y = page.evaluate(f"{VIEW}.stage.toScreen({VIEW}.x[3], {VIEW}.y[3])")
    page.mouse.move(box["x"] + x, box["y"] + y)
    text = page.locator(".place").inner_text().replace("\N{DEGREE SIGN}", "").replace("\N{MINUS SIGN}", "-")
    ra, dec = (float(part.split()[1]) for part in text.split(", "))
    assert ra == pytest.approx(survey.tiles["ra"][3].value, abs=0.05)
    assert dec == pytest.approx(survey.tiles["dec"][3].value, abs=0.05)


def test_tiles_are_found_and_selected_with_keys(page, survey):
    page.get_by_label("Search for a tile").fill(str(survey.tiles["tile"][5]))
    page.keyboard.press("Enter")
    assert page.evaluate(f"{VIEW}.selected") == 5
    page.locator("canvas").focus()
    page.keyboard.press("ArrowUp")
    assert survey.tiles["dec"][page.evaluate(f"{VIEW}.selected")] > survey.tiles["dec"][5]


@pytest.mark.parametrize("whole", [False, True])
def test_the_projection_has_equal_areas_and_keeps_the_edges_of_fields(visit, write_view, tmp_path, whole):
    rng, n = np.random.default_rng(1), 60
    lon = rng.uniform(0, 360, n) if whole else rng.uniform(80, 110, n)
    lat = np.rad2deg(np.arcsin(rng.uniform(-0.95, 0.95, n))) if whole else rng.uniform(5, 40, n)
    table = QTable({"tile": np.arange(n), "ra": lon * u.deg, "dec": lat * u.deg, "pass": np.ones(n, int)})
    table["position_angle"] = np.zeros(n) * u.deg
    write_view(rs.Tiling.from_table(table), tmp_path / "tiles.html")
    page = visit(tmp_path / "tiles.html")
    assert page.evaluate(f"{VIEW}.data.whole") == whole
    rims = page.evaluate(
        f"(() => {{ const v = {VIEW}, c = {{ moveTo() {{}}, lineTo() {{}} }};"
        "return v.x.map((_, k) => { v.pathOf(c, v.stage, k); return v.rims.get(k); }); })()"
    )
    area = 2 * np.pi * (1 - np.cos(np.deg2rad(1.0))) * (180 / np.pi) ** 2  # of a circle with a radius of 1 deg
    polygon = area * 36 * np.sin(np.deg2rad(10)) / (2 * np.pi)  # with 36 corners
    good = 0
    for rim in rims:
        x, y = np.transpose(rim)
        if np.ptp(x) < 20:  # others are at both edges of the map
            assert (abs(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))) / 2) == pytest.approx(polygon, rel=5e-3)
            good += 1
    assert good >= n - 5


def test_the_center_of_the_map_is_the_mean_direction():
    table = QTable({"tile": [0, 1], "ra": [359, 1] * u.deg, "dec": [-10, -10] * u.deg, "pass": [1, 1]})
    data = sky_view(table, 1.0, []).data
    assert data["center"][0] == pytest.approx(0, abs=1e-6)
    assert not data["whole"]
    table["ra"] = [0, 180] * u.deg
    assert sky_view(table, 1.0, []).data["whole"]


SCATTER_STEP = f"{VIEW}.plots[0].step(1, 0), {VIEW}.plots[0].step(1, 0), {VIEW}.plots[0].pick(0.5, 0.5)"


@pytest.fixture(scope="module")
def planned(small):
    sky = rs.synthetic_catalog("uniform", CENTER, 0.5 * u.deg, n_targets=40, rng=1)
    return rs.plan_tile(rs.Catalog(sky.coord, priority=np.arange(40) % 3), small, CENTER)


@pytest.fixture
def opened(visit, write_view, tmp_path):
    """Return a function that opens the page of a result and waits for its view."""

    def open_view(result, **options):
        path = tmp_path / "page.html"
        if isinstance(result, rs.Tile | rs.Tiling):
            write_view(result, path, **options)
        else:
            rs.write_report(result, path, overwrite=True, **options)
        page = visit(path)
        page.wait_for_function(f"({VIEW}.stage ?? {VIEW}.plots[0].stage).width > 1")
        return page

    return open_view


def test_tiles_that_were_scored_or_read_have_no_reasons(opened, planned, small, tmp_path):
    planned.write(tmp_path / "tile.fits")
    for tile in (rs.score_tile(planned.table, small), rs.Tile.read(tmp_path / "tile.fits")):
        page = opened(tile)
        k = page.evaluate(f"{VIEW}.plan.target_id.indexOf('')")
        assert k >= 0
        assert page.evaluate(f"{VIEW}.why({k})") == ["The given plan assigns no target to this positioner."]
        page.evaluate(f"{VIEW}.details.open = true")
        page.wait_for_function(f"{VIEW}.table")
        assert page.locator(".long-table").get_attribute("aria-rowcount") == str(len(tile) + 1)


def test_positions_on_the_focal_plane_have_no_compass(opened, planned, small):
    own = planned.table[planned.table["status"] == "assigned"]
    page = opened(rs.score_tile(QTable({"positioner": own["id"], "x": own["tip_x"], "y": own["tip_y"]}), small))
    assert page.evaluate(f"{VIEW}.compass()") is None


def test_one_positioner_one_tile_and_one_design_are_shown(opened):
    robot = rs.Positioner(8.25 * u.mm, 8.25 * u.mm, 2.25 * u.mm)
    one = rs.Instrument("one", rs.FocalPlane([[0, 0]] * u.mm, robot), plate_scale=200 * u.mm / u.deg)
    for result in (rs.plan_tile(SkyCoord([CENTER]), one, CENTER), rs.place_tiles(SkyCoord([CENTER]), one)):
        page = opened(result)
        page.locator("canvas").focus()
        page.keyboard.press("ArrowRight")
        assert page.evaluate(f"{VIEW}.selected") == 0
    page = opened(rs.design.explore_designs(central_arm=8 * u.mm, ratio=0.5, pitch=25 * u.mm, clearance=2 * u.mm))
    page.evaluate(f"{VIEW}.choose(0)")
    assert "Outside the range of the surrogate" in page.locator(".result").inner_text()


def test_designs_without_a_loss_are_shown(opened):
    grid = {"central_arm": [2, 8] * u.mm, "ratio": [1.0, 1.5], "pitch": 25 * u.mm, "clearance": 2 * u.mm}
    with pytest.warns(rs.RfpsurveyWarning, match="2 of 4 designs have no values"):
        table = rs.design.explore_designs(**grid, loss=rs.design.LossOptions("independent", "surrogate"))
    assert np.isnan(np.ma.filled(table["loss"], np.nan)).any()
    page = opened(table)
    page.evaluate(SCATTER_STEP)
    assert page.evaluate(f"{VIEW}.rows.length") == 4


def test_the_comparison_of_allocators_contains_their_plans(opened, small):
    sky = rs.synthetic_catalog("uniform", CENTER, 0.5 * u.deg, n_targets=60, rng=1)
    names = ["lamost_rule", "nearest", "repair"]
    table, tiles = rs.compare_allocators(sky, small, CENTER, allocators=names, return_tiles=True)
    assert list(tiles) == names
    assert [tile.summary["n_colliding"] for tile in tiles.values()] == table["colliding"].tolist()
    page = opened(table, plans=tiles)
    assert page.evaluate(f"{VIEW}.plans.map((plan) => plan.name)") == names
    page.get_by_label("Compared with").select_option("repair")
    one, other = (np.ma.filled(tiles[name].table["target_id"], -1) for name in ("lamost_rule", "repair"))
    different = page.evaluate(f"{VIEW}.id.filter((_, k) => {VIEW}.change(k) !== 'same').length")
    assert different == np.sum(one != other)


def test_the_command_writes_the_plans_of_all_allocators(run, tmp_path):
    options = ["--instrument", "moons", "--allocator", "lamost_rule", "--allocator", "repair"]
    code, _, err = run("compare-allocators", *options, "--report", tmp_path / "page.html")
    assert (code, err) == (0, "")
    text = Reader((tmp_path / "page.html").read_text()).text("script")[0]
    assert '"name":"lamost_rule"' in text
    assert '"name":"repair"' in text


def test_colliding_pairs_of_the_view_are_those_of_the_tile(opened, presets):
    """Rounded coordinates of the page differ from those of the tile by less than a micrometer."""
    apo = presets["sdss_apo"]
    sky = rs.synthetic_catalog("poisson", CENTER, apo.field_radius, density=apo.target_density, rng=1)
    tile = rs.plan_tile(sky, apo, CENTER, allocator="lamost_rule")
    page = opened(tile)
    for name in ("x", "y", "plan.tip_x", "plan.tip_y", "plan.elbow_x", "plan.elbow_y", "plan.arm_x", "plan.arm_y"):
        shown = np.array(page.evaluate(f"{VIEW}.{name}.map((v) => Number.isNaN(v) ? null : v)"), dtype=float)
        np.testing.assert_allclose(shown, tile.table[name.removeprefix("plan.")].to_value(u.mm), atol=1.01e-3, rtol=0)
    states = page.evaluate(f"{VIEW}.plan.state")
    assert [state == "collision" for state in states] == tile.table["in_collision"].tolist()
