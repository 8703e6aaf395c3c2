"""Search, filters, keys, differences of plans, and the list of all assignments on the interactive focal plane."""

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
    model, catalog = apo.with_states(states), rs.Catalog(sky.coord, id=names, priority=np.arange(n) % 12)
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
    text, ids = find(two, second[k]), plans["nearest"].table["id"]
    for plan, row in (("nearest", first.index(second[k])), ("repair", k)):
        assert f"the positioner {ids[row]} is assigned in the plan {plan}." in text
    free = next(iter(set(plans["repair"].idle_targets["target_id"].tolist()) - {*first, *second}))
    assert f"{free} is the id of a target without a positioner" in find(two, free)
    assert "Targets without a positioner are in the view only if" in find(two, "nothing has this id")


def test_filters_are_in_the_order_of_their_numbers(one):
    """Regression: priorities were sorted as text, so that 10 and 11 preceded 2."""
    shown = one.evaluate(f"[...{VIEW}.tests.keys()]")
    values = [int(name.split()[1]) for name in shown if name.startswith("priority ")]
    assert (len(values), values) == (12, sorted(values))


def test_collisions_that_are_not_counted_are_explained(one, plans, tmp_path):
    """Regression: the number of collisions in the legend and in the table exceeded the number in the summary."""
    tile = plans["nearest"]
    n, touched = tile.summary["n_colliding"], int(tile.table["in_collision"].sum())
    assert touched > n > 0
    states = one.evaluate(f"{VIEW}.plan.state")
    assert (states.count("collision"), states.count("struck")) == (n, touched - n)
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
    assert {kinds[k]: color for color, dashes, rows in dashed for k in rows if dashes} == expected


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


LIMIT = 0.3  # seconds of processor time
FRAME = "requestAnimationFrame"
DRAWN = f"() => new Promise((resolve) => {FRAME}(() => {FRAME}(() => setTimeout(resolve, 50))))"


@pytest.fixture(scope="module")
def long_tile(presets):
    model = presets["lamost"]
    sky = rs.synthetic_catalog("poisson", CENTER, model.field_radius, density=model.target_density, rng=1)
    return rs.plan_tile(rs.Catalog(sky.coord, priority=np.arange(len(sky)) % 3), model, CENTER, allocator="nearest")


@pytest.fixture(scope="module")
def long_page(visit, write_view, long_tile, tmp_path_factory):
    path = tmp_path_factory.mktemp("long") / "page.html"
    write_view(long_tile, path)
    long_page = visit(path)
    long_page.wait_for_function(f"{VIEW}?.stage.width > 1")
    return long_page


def test_4000_rows_open_sort_and_filter_in_300_ms_of_processor_time(long_page, long_tile):
    """Regression: the table contained all rows, so that each of these steps took more than 2 s."""
    session = long_page.context.new_cdp_session(long_page)
    session.send("Performance.enable", {"timeDomain": "threadTicks"})

    def used():
        metrics = session.send("Performance.getMetrics")["metrics"]
        return next(m["value"] for m in metrics if m["name"] == "TaskDuration")

    assert len(long_tile) == 4000
    steps = {
        "open": "document.querySelector('.view details').open = true",
        "sort by a number": "[...document.querySelectorAll('.live thead button')].at(-3).click()",
        "sort by text": "document.querySelectorAll('.live thead button')[1].click()",
        "filter": f"(() => {{ {VIEW}.filterBox.value = 'assigned'; {VIEW}.filter(); }})()",
        "show all": f"(() => {{ {VIEW}.filterBox.value = 'all'; {VIEW}.filter(); }})()",
        "scroll": f"{VIEW}.scroll.scrollTop = 60000",
    }
    seconds = {}
    for name, script in steps.items():
        begin = used()
        long_page.evaluate(script)
        long_page.evaluate(DRAWN)
        seconds[name] = used() - begin
    assert long_page.locator(".long-table").get_attribute("aria-rowcount") == "4001"
    assert long_page.locator(".long-table tbody tr").count() < 80
    assert max(seconds.values()) < LIMIT, seconds


def test_every_row_can_be_reached_in_the_sorted_order(long_page, long_tile):
    long_page.evaluate("document.querySelector('.view details').open = true")
    long_page.wait_for_function(f"{VIEW}.table")
    clearance = long_tile.table["clearance"].to_value(u.mm)
    column = long_page.evaluate(f"{VIEW}.table.columns.findIndex(({{ name }}) => name === 'clearance')")
    long_page.evaluate(f"{VIEW}.table.sorting = [{column}, -1]; {VIEW}.table.sort()")
    expected, seen = np.sort(clearance[np.isfinite(clearance)])[::-1], []
    for _ in range(1000):
        rows = long_page.evaluate(
            "[...document.querySelectorAll('.long-table [aria-rowindex]')].map((row) => "
            f"[+row.getAttribute('aria-rowindex'), row.cells[{column}].textContent])"
        )
        seen += [row for row in rows if row[0] > len(seen) + 1]
        if len(seen) == len(long_tile):
            break
        long_page.evaluate(f"{VIEW}.scroll.scrollTop += {VIEW}.scroll.clientHeight; {VIEW}.table.draw()")
    assert [index for index, _ in seen] == list(range(2, len(long_tile) + 2))
    values = [text.replace("\N{MINUS SIGN}", "-") for _, text in seen]
    shown = [float(text) for text in values if text != "\N{EN DASH}"]
    np.testing.assert_allclose(shown, expected, atol=1e-3)
    assert set(values[len(shown) :]) <= {"\N{EN DASH}"}  # missing values are last


def test_a_selected_row_keeps_the_focus_while_the_table_scrolls_a_little(long_page):
    long_page.evaluate(f"{VIEW}.choose(2000); {VIEW}.enter()")
    assert "select" in long_page.evaluate("document.activeElement.getAttribute('aria-label')")
    long_page.evaluate(f"{VIEW}.scroll.scrollTop += 40")
    long_page.evaluate(DRAWN)
    assert long_page.evaluate("document.activeElement.closest('tr')?.getAttribute('aria-selected')") == "true"


def test_heads_and_numbers_end_at_the_same_place(long_page):
    """Regression: the heads of columns of numbers were aligned on the left, or had another distance from the edge."""
    long_page.evaluate("document.querySelector('.view details').open = true")
    ends = long_page.evaluate("""[...document.querySelectorAll('.long-table thead th.number')].map((head) => {
        const end = (element) => { const range = document.createRange(); range.selectNodeContents(element);
          return Math.max(...[...range.getClientRects()].map((box) => box.right)); };
        const cell = document.querySelector('.long-table [aria-rowindex]').cells[head.cellIndex];
        return [end(head.firstChild), end(cell)];
    })""")
    assert len(ends) > 5
    for head, cell in ends:
        assert head == pytest.approx(cell, abs=1)
