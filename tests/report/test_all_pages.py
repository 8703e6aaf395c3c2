"""Pages of all kinds of results, whose names are hostile: the first screen, widths, numbers, and what they load."""

import re
import warnings
from dataclasses import replace

import astropy.units as u
import living
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import QTable

import rfpsurvey as rs
from pages import Reader, full

CENTER = SkyCoord(95, 23, unit="deg")
HOSTILE = "<script>alert(1)</script>\"><img src=x onerror=alert(2)>'"
SHORT = "<img src=x>"
KINDS = (
    "tile motion survey status table_of_status tiling allocators instruments select designs estimate benchmark table"
)
WITHOUT_PLOT = ("estimate", "benchmark", "table")
WITHOUT_LAYOUT = ("tiling", "designs", "table")
"""Kinds of results that do not depend on an instrument, or whose instrument is described by a few lengths."""
FIRST = """() => {
  const texts = [], plots = [...document.querySelectorAll("canvas, figure svg")].filter((e) => e.checkVisibility());
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (walker.nextNode()) {
    const range = document.createRange();
    range.selectNodeContents(walker.currentNode);
    const box = range.getBoundingClientRect();
    if (box.height && box.bottom < innerHeight) texts.push(walker.currentNode.textContent.trim());
  }
  return { text: texts.join(" "), plot: Math.min(...plots.map((e) => e.getBoundingClientRect().top)),
    wide: document.documentElement.scrollWidth - document.documentElement.clientWidth,
    open: [...document.querySelectorAll("table.rows:not(.long-table)")].filter((e) => e.checkVisibility())
      .map((e) => e.tBodies[0].rows.length).filter((n) => n > 100) };
}"""
NUMBERS = """() => {
  const seen = {}, walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (walker.nextNode()) {
    const { parentElement: own, textContent } = walker.currentNode;
    if (own.closest("script, style, footer, table.rows, option, svg") || !own.checkVisibility()) continue;
    for (const [text] of textContent.matchAll(/(?<![\\w.:-])\\d{3,}(?![\\w:-])/g)) seen[text] = (seen[text] ?? 0) + 1;
  }
  return seen;
}"""


@pytest.fixture(scope="module")
def results(small, tmp_path_factory):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rs.RfpsurveyWarning)
        return results_of(small, tmp_path_factory)


def results_of(small, tmp_path_factory):
    """Return a result of each kind with the options of its page; names contain HTML where they can."""
    sky = rs.synthetic_catalog("poisson", CENTER, 0.5 * u.deg, density=400 / u.deg**2, rng=3)
    n = len(sky)
    names = {"id": [f"{k}{HOSTILE}" for k in range(n)], "category": np.array([HOSTILE, "b"])[np.arange(n) % 2]}
    kind = np.where(np.arange(n) < 2, "standard", "science")
    catalog = rs.Catalog(sky.coord, priority=np.arange(n) % 3, kind=kind, **names)
    named = rs.Instrument(HOSTILE, small.focal_plane, plate_scale=small.plate_scale)
    options = rs.AllocationOptions("nearest", requirements=["standard=3"])
    tile = rs.plan_tile(catalog, named, CENTER, allocator="nearest")
    found = {"tile": (rs.plan_tile(catalog, named, CENTER, allocator=options), {"plans": {HOSTILE: tile}})}
    found["motion"] = rs.plan_tile(catalog, named, CENTER, allocator="repair"), {}
    found["motion"][1]["paths"] = found["motion"][0].paths(named)
    tiling = rs.place_tiles(sky, named, passes=2)
    tiling.table["tile"] = [f"{k}{SHORT}" for k in range(len(tiling))]
    found["survey"] = rs.plan_survey(catalog, named, tiling, allocator=options), {}
    found["tiling"] = tiling, {}
    found["table_of_status"], found["status"] = of_living(tmp_path_factory.mktemp("all") / "plan")
    plans = {"allocators": ["nearest", "repair"], "options": rs.AllocationOptions(requirements=["standard=3"])}
    found["allocators"] = rs.compare_allocators(catalog, named, CENTER, **plans), {"plans": {HOSTILE: tile}}
    found["instruments"] = (
        rs.compare_instruments("uniform", [replace(named, name=SHORT), small], n_realizations=1, allocators="nearest"),
        {},
    )
    found["select"] = rs.selection_probabilities(catalog, named, tiling, 5, allocator="nearest", rng=1), {}
    grid = {"central_arm": np.linspace(7, 9, 4) * u.mm, "ratio": [1, 1.3, 1.6], "pitch": np.linspace(23, 29, 9) * u.mm}
    found["designs"] = rs.design.explore_designs(**grid, clearance=2.25 * u.mm), {}
    found["estimate"] = (
        rs.collision_probability(named, method="quadrature", precision=rs.probability.Precision(max_iterations=64)),
        {},
    )
    found["benchmark"] = rs.benchmark.benchmark_collisions(named, methods=["exact"], n_configurations=1, repeats=1), {}
    table = QTable({HOSTILE: np.arange(150), "b": [HOSTILE] * 150}, meta={"title": HOSTILE, "note": {HOSTILE: HOSTILE}})
    found["table"] = table, {}
    return found


def of_living(folder):
    catalog = living.targets(n=100)
    catalog = rs.Catalog(catalog.coord, id=[f"{k}{HOSTILE}" for k in range(100)], visits=catalog.visits)
    tiles = living.tiling().table
    tiles["tile"] = [f"{k}{HOSTILE}" for k in range(len(tiles))]
    instrument = replace(living.instrument(), name=HOSTILE)
    survey = rs.plan_survey(catalog, instrument, rs.Tiling(tiles), allocator="nearest", folder=folder)
    survey.record(living.events(tile=tiles["tile"][:3].tolist(), date="2025-12-03", state=["done", "partly", "bad"]))
    return (survey.status(), {}), (survey.state(), {})


@pytest.fixture(scope="module")
def file(results, tmp_path_factory):
    folder = tmp_path_factory.mktemp("pages")

    def write(kind):
        path = folder / f"{kind}.html"
        if not path.exists():
            rs.write_report(results[kind][0], path, title=HOSTILE if kind == "table" else None, **results[kind][1])
        return path

    return write


@pytest.mark.parametrize("width", [375, 1400])
@pytest.mark.parametrize("kind", KINDS.split())
def test_the_result_is_on_the_first_screen(visit, file, kind, width):
    height, scheme = (800, "dark") if width == 375 else (900, "light")
    page = visit(file(kind), width=width, height=height, scheme=scheme)
    page.wait_for_timeout(300)
    found = page.evaluate(FIRST)
    assert (found["wide"], found["open"]) == (0, [])
    assert kind in WITHOUT_PLOT or found["plot"] < height - 60
    assert kind in WITHOUT_LAYOUT or re.search("layout of the instrument: nominal", found["text"])
    if kind in ("tile", "survey", "allocators"):
        assert "standard" in found["text"]  # the requirement that is not met
    counts = page.evaluate(NUMBERS)
    assert max(counts.values(), default=0) < 6, counts


@pytest.mark.parametrize("kind", KINDS.split())
def test_hostile_names_run_nothing_and_nothing_is_fetched(visit, file, kind):
    """The fixture `visit` asserts that there is no request, no dialog and no error."""
    page = visit(file(kind), width=375)
    page.evaluate("for (const part of document.querySelectorAll('details')) part.open = true")
    page.wait_for_timeout(300)
    page.evaluate("""() => { for (const section of document.querySelectorAll(".view")) {
        const { view } = section;
        for (const k of [0, 1, 2]) view.choose?.(k);
        view.find?.(document.title);
        for (const button of section.querySelectorAll(".export button:last-child")) button.click();
    } }""")
    assert page.locator("img, main script:not([type])").count() == 0
    assert page.evaluate("document.documentElement.scrollWidth - document.documentElement.clientWidth") == 0
    text = page.locator("body").text_content()
    assert (HOSTILE in text) == (kind not in ("designs", "estimate", "instruments"))


CAPTIONS = {"survey": "The tiles of the survey", "tiling": "The tiles in the order", "designs": "108 rows"}
CAPTIONS |= {"select": "Targets in the order", "table_of_status": "The visits of each class"}


def test_numbers_of_pages_are_those_of_the_tables(results, file):
    compared = 0
    for kind, caption in CAPTIONS.items():
        result = results[kind][0]
        table = {"survey": lambda r: r.tiles, "tiling": lambda r: r.table, "select": lambda r: r.table}.get(
            kind, lambda r: r
        )(result)
        heads, rows = Reader(file(kind).read_text()).table(caption)
        for k, head in enumerate(heads):
            name = next((name for name in table.colnames if head.startswith(name.replace("_", " "))), None)
            names = [name for name in table.colnames if head.split(" ")[: name.count("_") + 1] == name.split("_")]
            name = max(names, key=len, default=None)
            values = None if name is None else np.asarray(getattr(table[name], "value", table[name]))
            if values is None or values.dtype.kind not in "if":
                continue
            shown = [full(row[k]) for row in rows]
            np.testing.assert_allclose(shown, values[: len(rows)].astype(float), rtol=1e-6, err_msg=f"{kind} {name}")
            compared += len(shown)
    assert compared > 3000
