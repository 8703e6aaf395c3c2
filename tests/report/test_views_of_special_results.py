"""Interactive views of results that lack something: no plan in memory, no targets, one positioner, missing values."""

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import QTable

import rfpsurvey as rs
from pages import Reader

CENTER = SkyCoord(95, 23, unit="deg")
VIEW = "document.querySelector('.view').view"
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
    table = QTable({"positioner": own["id"], "x": own["tip_x"], "y": own["tip_y"]})
    page = opened(rs.score_tile(table, small))
    assert page.evaluate(f"{VIEW}.compass()") is None


def test_one_positioner_one_tile_and_one_design_are_shown(opened):
    robot = rs.Positioner(8.25 * u.mm, 8.25 * u.mm, 2.25 * u.mm)
    one = rs.Instrument("one", rs.FocalPlane([[0, 0]] * u.mm, robot), plate_scale=200 * u.mm / u.deg)
    for result in (rs.plan_tile(SkyCoord([CENTER]), one, CENTER), rs.place_tiles(SkyCoord([CENTER]), one)):
        page = opened(result)
        page.locator("canvas").focus()
        page.keyboard.press("ArrowRight")
        assert page.evaluate(f"{VIEW}.selected") == 0
    table = rs.design.explore_designs(central_arm=8 * u.mm, ratio=0.5, pitch=25 * u.mm, clearance=2 * u.mm)
    page = opened(table)
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
