"""The page of the state of a survey in a real browser: its numbers are those of the tables of the library."""

import shutil

import astropy.units as u
import living
import numpy as np
import pytest

import rfpsurvey as rs
from pages import Reader
from rfpsurvey._survey.history.diff import diff_generations
from rfpsurvey._survey.history.nights import codes_of

VIEW = "document.querySelector('.view').view"
# the content security policy of pages forbids Page.wait_for_function
READY = f"async () => {{ while (!({VIEW}?.stage.width > 1)) await new Promise(requestAnimationFrame); }}"
HOSTILE = "</script><script>document.title='run'</script>\"'<img src=x onerror=alert(1)>"
DATES = "2026-01-03", "2026-01-04", "2026-01-06", "2026-01-09"
STATES = "planned", "observed", "partly observed", "bad", "dropped"


@pytest.fixture(scope="module")
def plans(tmp_path_factory):
    """Return a survey with late reports, corrections and two plans, and a copy of its folder before the second plan."""
    place = tmp_path_factory.mktemp("living")
    sky, unit = living.targets(kinds=True, n=300, radius=0.6), living.instrument()
    plane = rs.FocalPlane.hexagonal(unit.focal_plane.positioner, rings=2, pitch=18 * u.mm)
    instrument = rs.Instrument("small", plane, plate_scale=unit.plate_scale)
    sky = rs.Catalog(sky.coord, id=sky.id, kind=sky.kind, priority=sky.priority, visits=sky.visits, category=sky.id % 2)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SOURCE_DATE_EPOCH", "1767225600")  # 2026-01-01
        survey = rs.plan_survey(sky, instrument, living.tiling(n=10), allocator="nearest", folder=place / "plan")

        def record(**columns):
            survey.record(living.events(**columns))

        first = survey.tile(11)["positioner"].tolist()
        record(tile=[11, 12, 13], date=DATES[0], state=["done", "partly", "bad"])
        record(tile=11, date=DATES[0], positioner=first[:2], reason=["off", ""])
        record(tile=[12, 14], date=DATES[1], state=["done", "dropped"])
        record(target=survey.tile(19)["target_id"].tolist()[:5], state="dropped")
        offsets = np.random.default_rng(1).uniform(-0.2, 0.2, (2, 60))
        added = [20_000 + k for k in range(60)]
        record(target=added, state="added", ra=(120 + offsets[0]).tolist(), dec=(30 + offsets[1]).tolist(), priority=9)
        before = shutil.copytree(survey.folder, place / "before")
        patch.setenv("SOURCE_DATE_EPOCH", "1767571200")  # 2026-01-05
        survey = survey.replan()
        record(tile=[15, 16, 17], date=[DATES[3], DATES[2], DATES[2]], state=["done", "done", "partly"], fraction=0.5)
        record(tile=[14, 18], date=[DATES[2], DATES[0]], state=["planned", "bad"])  # a late report
        record(tile=16, date=DATES[2], positioner=survey.tile(16)["positioner"].tolist()[:1], reason="stuck")
        record(tile=13, date="", state="planned")  # cancels an observation
        record(tile=99, state="added", ra=[120.0], dec=[30.0])
    return rs.Survey.read(survey.folder), before


@pytest.fixture(scope="module")
def page(visit, plans, tmp_path_factory):
    path = tmp_path_factory.mktemp("page") / "page.html"
    rs.write_report(plans[0].state(), path)
    return opened(visit, path)


def opened(visit, path, **options):
    page = visit(path, **options)
    page.evaluate(READY)
    return page


def states_at(survey, night):
    """Return the state of each tile after a night, from the state of the survey at this date."""
    state = survey.state(until=night or "1970-01-01")
    found = {}
    for row, name in enumerate([*map(str, survey.tiles["tile"]), "99"]):
        event = (state.closed | state.begun).get(row, "open")
        word = {"done": "observed", "partly": "partly observed"}
        is_bad = event == "open" and any(attempt.row == row for attempt in state.attempts)
        found[name] = "bad" if is_bad else "planned" if event == "open" else word[event.state] if event else "dropped"
    return found


def test_the_numbers_of_the_page_are_those_of_the_tables(page, plans):
    survey, compared, used = plans[0], 0, set()
    data, state, last = page.evaluate(f"{VIEW}.data"), survey.state(), survey.status()
    names = page.evaluate(f"{VIEW}.name")
    assert data["nights"] == list(DATES)
    for night, date in enumerate(["", *DATES]):
        page.evaluate(f"{VIEW}.setNight({night})")
        shown = page.evaluate(f"{VIEW}.bin.map((code) => {VIEW}.words[code])")
        assert dict(zip(names, shown, strict=True)) == states_at(survey, date)
        compared += len(names)
        status = survey.status(until=date or "1970-01-01")
        for label, requested, seen in data["classes"]:
            column, _, name = label.partition(" ")
            row = 0 if column == "all" else status[column].tolist().index(name)
            assert (requested, seen[night]) == (last["n_requested"][row], status["n_observed"][row])
            compared += 2
        counts = {word: sum(row.get(word, 0) for row in status.meta["tiles"]) for word in STATES}
        assert counts == {word: shown.count(word) for word in STATES}
        compared += len(counts)
    ids = data["positioner"]["id"]
    for k, name in enumerate(names[:-1]):
        codes = [int(code) for code in data["fibers"][k]]
        if survey.tiles["state"][k] == "dropped":
            assert not codes
            continue
        visits = survey.tile(name)
        kind = {
            str(v["positioner"]): 4 if v["in_collision"] else ["science", "standard", "sky"].index(v["kind"]) + 1
            for v in visits
        }
        assert codes == [kind.get(fiber, 0) for fiber in ids]
        targets = dict(zip(visits["positioner"].astype(str), visits["target_id"].astype(str), strict=True))
        assert data["targets"][k] == [targets[fiber] for fiber in ids if fiber in targets]
        compared += len(codes) + len(targets)
        used.update(codes)
    failed = {(names[tile], ids[fiber], reason) for tile, _, fiber, reason in data["failures"]}
    expected = {(e.tile, fiber, why) for e in state.attempts for fiber, why in e.failed.items()}
    assert failed == expected
    assert len(failed) == 3
    assert compared + len(failed) > 300
    assert used == {0, 1, 4}


def test_codes_of_fibers_state_the_first_kind_and_collisions():
    kinds = ["science", "standard", "sky", "science+standard", "sky"]
    visits = np.zeros(5, dtype=[("kind", "U16"), ("in_collision", "?")])
    visits["kind"], visits["in_collision"] = kinds, [False, False, False, False, True]
    assert codes_of(visits).tolist() == [1, 2, 3, 1, 4]
    assert codes_of(visits[["in_collision"]]).tolist() == [1, 1, 1, 1, 4]


def test_changed_fibers_are_the_differences_of_the_two_plans(page, plans):
    """The folder that was copied before the second plan is compared with the present folder."""
    survey, before = plans
    table = rs.survey.diff_surveys(before, survey)
    rows = [tuple(row) for row in table[table["positioner"] != ""].iterrows()]
    assert len(rows) > 10
    assert len({row[-1] for row in rows}) > 1
    assert sorted(tuple(row) for row in diff_generations(survey, survey.state()).iterrows()) == sorted(rows)
    data, names = page.evaluate(f"{VIEW}.data"), page.evaluate(f"{VIEW}.name")
    found = []
    for k in range(len(names)):
        page.evaluate(f"{VIEW}.choose({k})")
        fibers = page.evaluate(
            f"(() => {{ const v = {VIEW}.fibers; return v.id.map((id, i) => "
            "[id, v.former[i], v.targets[i], v.reason(i), v.change(i)]); })()"
        )
        found += [(names[k], *fiber) for fiber in fibers if fiber[-1] != "same"]
    assert sorted(row[:5] for row in found) == sorted(rows)
    kinds = {(True, True): "other", (True, False): "first", (False, True): "second"}
    assert all(kinds[bool(row[2]), bool(row[3])] == row[5] for row in found)
    assert {row[5] for row in found} == {*kinds.values()}
    assert data["plan"] == "changed by generation 2"


def test_a_page_on_another_plan_shows_the_same_differences(visit, plans, tmp_path):
    survey, before = plans
    table = rs.survey.diff_surveys(before, survey)
    rs.write_report(survey.state(), tmp_path / "page.html", changes=table)
    data = opened(visit, tmp_path / "page.html").evaluate(f"{VIEW}.data")
    assert data["plan"] == "that differ from the other plan"
    assert sum(code != "0" for text in data["changes"] for code in text) == (table["positioner"] != "").sum() > 0
    for result, changes in ((survey, table), (survey.state(), survey.tiles)):
        with pytest.raises(rs.InputError, match="changes must be the table of diff_surveys, for the state of a survey"):
            rs.write_report(result, tmp_path / "other.html", changes=changes)


def test_slider_calendar_and_curves_select_a_night(page):
    slider = page.get_by_label("Night", exact=True)
    slider.fill("0")
    assert "0 of 11 tiles observed." in page.locator(".count").first.inner_text()
    assert page.locator(".day[aria-current]").count() == 0
    page.locator(f"button.day[title^='{DATES[1]}']").click()
    assert slider.get_attribute("aria-valuetext") == f"Night 2 of 4: {DATES[1]}"
    assert page.locator(".day[aria-current]").inner_text() == "1"
    assert "1 tile observed" in page.locator(".day[aria-current]").get_attribute("aria-label")
    page.get_by_label("Next night").click()
    assert page.evaluate(f"{VIEW}.night") == 3
    slider.focus()
    page.keyboard.press("ArrowRight")
    assert page.evaluate(f"{VIEW}.night") == 4
    page.locator(".curve").scroll_into_view_if_needed()
    box = page.locator(".curve").bounding_box()
    page.mouse.click(box["x"] + 1, box["y"] + 5)
    assert page.evaluate(f"{VIEW}.night") == 0


def test_a_click_on_a_tile_shows_its_fibers(page, plans):
    page.evaluate(f"{VIEW}.setNight(4); {VIEW}.choose(-1); {VIEW}.stage.fit()")
    assert "3 failed visits of all tiles" in page.locator(".count").nth(2).inner_text()
    page.locator("canvas").first.scroll_into_view_if_needed()
    box = page.locator("canvas").first.bounding_box()
    x, y = page.evaluate(f"{VIEW}.stage.toScreen({VIEW}.x[0], {VIEW}.y[0])")
    page.mouse.click(box["x"] + x, box["y"] + y)
    name = page.evaluate(f"{VIEW}.name[{VIEW}.selected]")
    assert f"Tile {name}" in page.locator(".panel").first.inner_text()
    page.evaluate(f"{VIEW}.choose(0)")
    assert "2 failed visits up to the selected night" in page.locator(".count").nth(2).inner_text()
    page.evaluate(f"{VIEW}.setNight(0)")
    assert "0 failed visits up to the selected night" in page.locator(".count").nth(2).inner_text()
    page.evaluate(f"{VIEW}.setNight(4)")
    fibers = page.locator("canvas").nth(1)
    fibers.focus()
    page.keyboard.press("ArrowRight")
    assert "Positioner" in page.locator(".panel").nth(1).inner_text()
    failed = str(plans[0].tile(11)["positioner"][0])
    page.evaluate(f"{VIEW}.fibers.choose({VIEW}.fibers.id.indexOf({failed!r}))")
    assert f"{DATES[0]}, tile 11: off" in page.locator(".panel").nth(1).inner_text()
    page.locator("canvas").first.focus()
    page.keyboard.press("Enter")
    assert page.locator("details[open] .long-table tbody tr[aria-selected]").count() == 1


def test_the_page_without_scripts_has_the_table_of_the_tiles(plans, tmp_path):
    survey = plans[0]
    rs.write_report(survey.state(), tmp_path / "page.html")
    heads, rows = Reader((tmp_path / "page.html").read_text()).table("The tiles of the survey")
    table = [dict(zip(heads, (cell["text"] for cell in row), strict=True)) for row in rows]
    expected = states_at(survey, DATES[-1])
    assert {row["tile"]: row["state"] for row in table} == expected
    shown = {row["tile"]: (row["observations"], row["n failed"], row["failures"], row["generation"]) for row in table}
    assert shown["11"] == (f"{DATES[0]} observed 1", "2", "1 off, 1 without a reason", "1")
    assert shown["12"][0] == f"{DATES[0]} partly observed 1, {DATES[1]} observed 1"
    assert shown["99"] == ("\N{EN DASH}", "0", "\N{EN DASH}", "\N{EN DASH}")
    status = survey.status()
    _, rows = Reader((tmp_path / "page.html").read_text()).table("Remaining visits that are lost")
    numbers = {row[0]["text"]: [int(cell["text"]) for cell in row[1:]] for row in rows}
    lost = numbers.pop("lost to a collision")
    assert lost[1] == status["n_lost"][0]
    assert sum(n for _, n in numbers.values()) == status["n_impossible"][0] > 0
    assert all(0 <= targets <= visits for targets, visits in [lost, *numbers.values()])


def test_a_tile_can_be_added_at_the_place_of_a_dropped_one(visit, tmp_path):
    """On dates before a tile was dropped, both tiles are planned."""
    survey = rs.plan_survey(living.targets(), living.instrument(), living.tiling(n=3), folder=tmp_path / "plan")
    row = survey.tiles[0]
    place = {"ra": [row["ra"].value], "dec": [row["dec"].value], "pass": row["pass"]}
    survey.record(living.events(tile=[12, 11], state=["done", "dropped"], date=list(DATES[:2])), allow_future=True)
    survey.record(living.events(tile=[21], state="added", **place))
    for until, words in ((None, ["dropped", "observed", "planned", "planned"]), (DATES[0], ["planned", "observed"])):
        rs.write_report(survey.state(until=until), tmp_path / "page.html", overwrite=True)
        page = opened(visit, tmp_path / "page.html")
        assert page.evaluate(f"{VIEW}.name") == ["11", "12", "13", "21"]
        assert page.evaluate(f"{VIEW}.bin.map((code) => {VIEW}.words[code])")[: len(words)] == words


def test_hostile_names_stay_text(visit, tmp_path):
    sky, unit = living.targets(n=60), living.instrument().focal_plane
    ids = [f"{HOSTILE}{k}" for k in range(60)]
    sky = rs.Catalog(sky.coord, id=ids, priority=sky.priority, category=np.where(np.arange(60) % 2, HOSTILE, "all"))
    plane = rs.FocalPlane(unit.xy, unit.positioner, id=[f"{HOSTILE}{k}".replace(" ", "/") for k in range(7)])
    instrument = rs.Instrument(HOSTILE, plane, plate_scale=living.instrument().plate_scale)
    tiles = living.tiling(n=3).table
    tiles.replace_column("tile", [f"{HOSTILE}{k}" for k in range(3)])
    survey = rs.plan_survey(sky, instrument, rs.Tiling(tiles), folder=tmp_path / "plan")
    fibers = survey.tile(tiles["tile"][0])["positioner"][:2].tolist()
    name = tiles["tile"][0]
    survey.record(living.events(tile=name, date=DATES[0], state="done"))
    survey.record(living.events(tile=name, date=DATES[0], positioner=fibers, reason=HOSTILE), note=HOSTILE)
    rs.write_report(survey.state(), tmp_path / "page.html", title=HOSTILE)
    text = (tmp_path / "page.html").read_text()
    assert "<script>document" not in text
    assert "<img" not in text
    page = opened(visit, tmp_path / "page.html")  # the fixture asserts that nothing is requested, and no error
    page.evaluate(f"{VIEW}.choose(0); {VIEW}.fibers.choose(0); {VIEW}.enter(); {VIEW}.fibers.setMode('changes')")
    page.evaluate("for (const part of document.querySelectorAll('details')) part.open = true")
    assert page.title() == HOSTILE
    assert page.locator(".live img, .live script").count() == 0
    shown = page.locator(".live").inner_text()
    assert shown.count(HOSTILE) > 5
    assert HOSTILE in page.locator(".panel").nth(1).inner_text()
    page.evaluate(f"{VIEW}.find({HOSTILE!r})")
    assert f"No tile has the number {HOSTILE}." in page.locator(".panel").first.inner_text()


@pytest.mark.parametrize(("width", "scheme"), [(375, "dark"), (1400, "light")])
def test_the_page_fits_on_screens_and_the_states_have_different_colors(visit, plans, tmp_path, width, scheme):
    rs.write_report(plans[0].state(), tmp_path / "page.html")
    page = opened(visit, tmp_path / "page.html", width=width, scheme=scheme)
    page.evaluate("for (const part of document.querySelectorAll('.live details')) part.open = true")
    page.evaluate("() => new Promise(requestAnimationFrame)")
    assert page.evaluate("document.documentElement.scrollWidth - document.documentElement.clientWidth") <= 0
    colors = page.evaluate(f"{VIEW}.words.map((_, bin) => {VIEW}.binColor(bin))")
    assert len(set(colors)) == len(colors) == 6
    assert all(color.startswith("#") for color in colors)
