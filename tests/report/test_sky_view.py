"""The interactive map of tiles in a real browser."""

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import QTable

import rfpsurvey as rs
from rfpsurvey.report._sky_view import sky_view

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
    box = page.locator("canvas").bounding_box()
    row = survey.tiles[3]
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


def test_tiles_are_found_and_selected_with_keys(page, survey):
    page.get_by_label("Search for a tile").fill(str(survey.tiles["tile"][5]))
    page.keyboard.press("Enter")
    assert page.evaluate(f"{VIEW}.selected") == 5
    page.locator("canvas").focus()
    page.keyboard.press("ArrowUp")
    after = page.evaluate(f"{VIEW}.selected")
    assert survey.tiles["dec"][after] > survey.tiles["dec"][5]


@pytest.mark.parametrize("whole", [False, True])
def test_the_projection_has_equal_areas_and_keeps_the_edges_of_fields(visit, write_view, tmp_path, whole):
    rng = np.random.default_rng(1)
    n = 60
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
            found = abs(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))) / 2
            assert found == pytest.approx(polygon, rel=5e-3)
            good += 1
    assert good >= n - 5


def test_the_center_of_the_map_is_the_mean_direction():
    table = QTable({"tile": [0, 1], "ra": [359, 1] * u.deg, "dec": [-10, -10] * u.deg, "pass": [1, 1]})
    data = sky_view(table, 1.0, []).data
    assert data["center"][0] == pytest.approx(0, abs=1e-6)
    assert not data["whole"]
    table["ra"] = [0, 180] * u.deg
    assert sky_view(table, 1.0, []).data["whole"]
