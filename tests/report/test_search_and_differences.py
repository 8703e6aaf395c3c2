"""Search, filters, legends, keys and differences of plans on the interactive focal plane, in a real browser."""

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import QTable

import rfpsurvey as rs

CENTER = SkyCoord(95, 23, unit="deg")
VIEW = "document.querySelector('.view').view"


@pytest.fixture(scope="module")
def plans(presets):
    """Return plans of one tile whose positioners and targets have the same ids, with stuck arms and many priorities."""
    apo = presets["sdss_apo"]
    ids = np.asarray(apo.focal_plane.id)
    sky = rs.synthetic_catalog("poisson", CENTER, apo.field_radius, density=apo.target_density, rng=1)
    n = len(sky)
    names = np.array([f"T{k:09d}" for k in range(n)])
    names[: len(ids)] = np.random.default_rng(1).permutation(ids)[:n]
    rows = np.arange(150, 350, 10)
    states = QTable({"id": ids[rows], "state": ["stuck"] * len(rows)})
    states["theta"], states["phi"] = np.full(len(rows), 40.0) * u.deg, np.full(len(rows), 15.0) * u.deg
    model = apo.with_states(states)
    catalog = rs.Catalog(sky.coord, id=names, priority=np.arange(n) % 12)
    return {name: rs.plan_tile(catalog, model, CENTER, allocator=name) for name in ("nearest", "repair")}


@pytest.fixture(scope="module")
def one(visit, write_view, plans, tmp_path_factory):
    path = tmp_path_factory.mktemp("one") / "page.html"
    write_view(plans["nearest"], path)
    return visit(path)


@pytest.fixture(scope="module")
def two(visit, write_view, plans, tmp_path_factory):
    path = tmp_path_factory.mktemp("two") / "page.html"
    write_view(plans["nearest"], path, plans={"repair": plans["repair"]})
    return visit(path)


def targets_of(tile):
    return np.ma.filled(tile.table["target_id"], "").tolist()


def find(page, text):
    page.get_by_label("Search for a positioner").fill(text)
    page.keyboard.press("Enter")
    return page.locator(".panel").inner_text()


def test_every_assigned_target_is_found_although_positioners_have_the_same_ids(one, plans):
    """Regression: the search found only the positioner if a positioner and a target had the same id."""
    ids, targets = np.asarray(plans["nearest"].table["id"]).tolist(), targets_of(plans["nearest"])
    used = [k for k, name in enumerate(targets) if name]
    assert sum(targets[k] in ids for k in used) > 50
    found = one.evaluate(
        f"(names) => names.map((name) => {VIEW}.matches(name).map(([k]) => k))", [targets[k] for k in used]
    )
    for k, rows in zip(used, found, strict=True):
        assert rows == ([ids.index(targets[k])] if targets[k] in ids else []) + [k]


def test_the_search_shows_both_a_positioner_and_a_target_with_the_same_id(one, plans):
    ids, targets = np.asarray(plans["nearest"].table["id"]).tolist(), targets_of(plans["nearest"])
    k = next(k for k, name in enumerate(targets) if name in ids and ids.index(name) != k)
    text = find(one, targets[k])
    assert f"{targets[k]} is the id of a positioner." in text
    assert f"{targets[k]} is the id of a target, to which the positioner {ids[k]} is assigned." in text
    assert f"Positioner {targets[k]}" in text
    assert f"Positioner {ids[k]}" in text
    assert sorted(one.evaluate(f"{VIEW}.found")) == sorted([k, ids.index(targets[k])])
    for row in (k, ids.index(targets[k])):  # both are in the visible part of the plot
        x, y = one.evaluate(f"{VIEW}.stage.toScreen({VIEW}.x[{row}], {VIEW}.y[{row}])")
        width, height = one.evaluate(f"[{VIEW}.stage.width, {VIEW}.stage.height]")
        assert 0 < x < width
        assert 0 < y < height


def test_a_target_of_two_plans_and_a_free_target_are_found(two, plans):
    first, second = (targets_of(plans[name]) for name in ("nearest", "repair"))
    k = next(k for k, name in enumerate(second) if name and name in first and first.index(name) != k)
    text = find(two, second[k])
    ids = plans["nearest"].table["id"]
    for plan, row in (("nearest", first.index(second[k])), ("repair", k)):
        assert f"the positioner {ids[row]} is assigned in the plan {plan}." in text
    free = next(iter(set(plans["repair"].idle_targets["target_id"].tolist()) - {*first, *second}))
    assert f"{free} is the id of a target without a positioner" in find(two, free)
    assert "Targets without a positioner are in the view only if" in find(two, "nothing has this id")


def test_filters_are_in_the_order_of_their_numbers(one):
    """Regression: priorities were sorted as text, so that 10 and 11 preceded 2."""
    shown = one.evaluate(f"[...{VIEW}.tests.keys()]")
    values = [int(name.split()[1]) for name in shown if name.startswith("priority ")]
    assert len(values) == 12
    assert values == sorted(values)


def test_collisions_that_are_not_counted_are_explained(one, plans, tmp_path):
    """Regression: the number of collisions in the legend and in the table exceeded the number in the summary."""
    tile = plans["nearest"]
    n, touched = tile.summary["n_colliding"], int(tile.table["in_collision"].sum())
    assert touched > n > 0
    states = one.evaluate(f"{VIEW}.plan.state")
    assert states.count("collision") == n
    assert states.count("struck") == touched - n
    assert "in collision, not counted" in one.locator(".legend").inner_text()
    rs.write_report(tile, tmp_path / "page.html")
    text = " ".join((tmp_path / "page.html").read_text().split())
    assert f"The table has {touched} rows: the {n} positioners in collision, and {touched - n} " in text


def test_an_arm_with_another_target_has_its_own_color_in_both_plans(two):
    """Regression: in the second plan, all arms had the color of arms that have a target only in the second plan."""
    kinds = two.evaluate(f"{VIEW}.id.map((_, k) => {VIEW}.change(k))")
    dashed = two.evaluate(
        f"(() => {{ const v = {VIEW}, seen = [], keep = v.paintArms;"
        "v.paintArms = (context, stage, rows, plan) => { if (plan === v.compared) seen.push([context.strokeStyle, "
        "context.getLineDash().length, rows]); };"
        "v.stage.paint(); delete v.paintArms; return seen; })()"
    )
    colors = {name: two.evaluate(f"{VIEW}.stage.color('{name}')") for name in ("c-star", "c-arm", "c-other")}
    expected = {"other": colors["c-star"], "first": colors["c-arm"], "second": colors["c-other"]}
    found = {kinds[k]: color for color, dashes, rows in dashed for k in rows if dashes}
    assert found == expected


def test_the_legend_of_differences_explains_dashes_and_collisions(two, plans):
    """Regression: dashed lines had no entry in the legend, and collisions were not drawn."""
    entries = two.evaluate(
        "[...document.querySelectorAll('.legend li')].map((e) => [e.innerText, e.firstChild.className])"
    )
    shapes = {text: shape.removeprefix("mark ") for text, shape in entries}
    assert shapes["arm in the plan repair, if different"] == "dashed"
    assert shapes["in collision in the plan nearest"] == "diamond"
    assert shapes["in collision in the plan repair"] == "open diamond"
    colliding = np.asarray(plans["nearest"].table["in_collision"])
    drawn = two.evaluate(
        f"(() => {{ const v = {VIEW}, all = diamond; let n = 0; diamond = () => {{ n += 1; }};"
        "v.stage.fit(); v.stage.paint(); diamond = all; return n; })()"
    )
    assert drawn == colliding.sum() + plans["repair"].table["in_collision"].sum()


def test_arrow_keys_visit_every_row_of_a_lattice(one):
    """Regression: the keys up and down skipped every second row of a hexagonal lattice."""
    ys = one.evaluate(f"{VIEW}.y")
    one.evaluate(f"{VIEW}.choose({ys.index(min(ys))})")
    one.locator("canvas").focus()
    seen = [min(ys)]
    while True:
        one.keyboard.press("ArrowUp")
        y = one.evaluate(f"{VIEW}.y[{VIEW}.selected]")
        if y == seen[-1]:
            break
        seen.append(y)
    rows = np.unique(np.round(ys, 1))
    assert len(rows) == 27
    np.testing.assert_allclose(seen, rows, atol=1)
