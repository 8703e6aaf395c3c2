"""Pages in a real browser: Chromium or a related one, if it is installed; RFPSURVEY_BROWSER names another browser."""

from contextlib import suppress
from functools import cache

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import MaskedColumn, QTable

import flat
import rfpsurvey as rs
from pages import Reader

CENTER = SkyCoord(95, 23, unit="deg")
TRY = """() => {
  for (const part of document.querySelectorAll("details")) {
    part.open = true;
    part.dispatchEvent(new Event("toggle"));
  }
  const cut = Array.from(document.querySelectorAll("figure:not(.wide) .scroll"),
    (region) => region.scrollWidth - region.clientWidth);
  const hidden = Array.from(document.querySelectorAll(".scroll:has(table)"), (region) => {
    const edge = region.getBoundingClientRect().right + 1;
    const heads = Array.from(region.querySelectorAll("thead th"));
    const more = region.previousElementSibling;
    return [heads.filter((head) => head.getBoundingClientRect().right > edge).length,
      more.className === "more" && !more.hidden ? more.textContent : ""];
  });
  const orders = Array.from(document.querySelectorAll("table.rows"), (table) =>
    Array.from(table.querySelectorAll("thead button"), (button, k) => [1, 2].map(() => {
      button.focus();
      document.activeElement.click();
      const head = button.closest("th");
      const states = Array.from(table.querySelectorAll("thead th"), (th) => th.getAttribute("aria-sort"));
      return [head.getAttribute("aria-sort"), states.filter((state) => state !== "none").length,
        Array.from(table.tBodies[0].rows, (row) => row.cells[k].dataset.value ?? row.cells[k].textContent),
        Array.from(table.tBodies[0].rows, (row) => row.cells[0].textContent)];
    })));
  const wide = document.documentElement.scrollWidth - document.documentElement.clientWidth;
  return { orders, wide, cut, hidden };
}"""


@pytest.fixture
def tried(visit):
    """Return a function that clicks every column name of a page twice, and returns the results."""
    return lambda path, width=1200: visit(path, width=width, height=900).evaluate(TRY)


@pytest.fixture(scope="module")
def page_of(small, tmp_path_factory):
    """Return a function that returns the path of the page of a kind of result, written once."""
    return cache(lambda kind: write_page(kind, tmp_path_factory.mktemp(kind), small))


def write_page(kind, folder, small):
    """Write the page of a small result."""
    sky = rs.synthetic_catalog("poisson", CENTER, 0.5 * u.deg, density=200 / u.deg**2, rng=3)
    make = {
        "tile": lambda: rs.plan_tile(sky, "sdss_apo", CENTER, allocator="lamost_rule"),
        "tiling": lambda: rs.place_tiles(sky, small, passes=2),
        "allocators": lambda: rs.compare_allocators(
            sky, small, CENTER, allocators=["lamost_rule", "nearest", "repair"]
        ),
        "estimate": lambda: flat.collision_probability(small, method="quadrature", max_iterations=64, rng=1),
    }
    path = folder / f"{kind}.html"
    rs.write_report(make[kind](), path)
    return path


N_TABLES = {"tile": 2, "tiling": 1, "allocators": 1, "estimate": 0}


@pytest.mark.parametrize(
    "kind", ["tile", "allocators", "estimate", pytest.param("tiling", marks=pytest.mark.exhaustive)]
)
def test_pages_open_without_an_error_and_sort_by_every_column(tried, page_of, kind):
    path = page_of(kind)
    tables = [t for t in Reader(path.read_text()).tables if t["class"].split()[0] == "rows" and len(t["rows"]) > 2]
    found = tried(path, 400)
    assert found["wide"] <= 0  # on a phone, tables and wide figures scroll, but the page does not
    assert max(found["cut"], default=0) <= 0  # figures are shown completely
    clicked = [orders for orders in found["orders"] if orders]
    # the script of the view of a tile makes one more table
    assert len(clicked) - (kind == "tile") == len(tables) == N_TABLES[kind]
    for orders in clicked:
        for (up, one, ascending, _), (down, other, descending, _) in orders:
            assert (up, one, down, other) == ("ascending", 1, "descending", 1)
            assert sorted(ascending) == sorted(descending)
            there = [[v for v in order if v not in ("", "\N{EN DASH}")] for order in (ascending, descending)]
            assert [order[: len(t)] for order, t in zip((ascending, descending), there, strict=True)] == there
            if all(map(is_number, there[0])):
                numbers = [[float(v) for v in t] for t in there]
                assert numbers == [sorted(numbers[0]), sorted(numbers[0], reverse=True)]


@pytest.mark.parametrize("width", [400, pytest.param(1200, marks=pytest.mark.exhaustive)])
def test_a_table_says_how_many_columns_are_hidden(tried, page_of, width):
    """Regression: wide tables ended at the edge of the page without any note."""
    hidden = tried(page_of("tile"), width)["hidden"]
    assert len(hidden) == 3  # the first is the table of assignments in the view
    assert width == 1200 or min(number for number, _ in hidden) > 0
    for number, words in hidden:
        more = f"{number} more column{'s' * (number > 1)}: scroll sideways \N{RIGHTWARDS ARROW}"
        assert words == (more if number else "")


def is_number(text):
    with suppress(ValueError):
        return float(text) is not None
    return False


def test_sorting_knows_numbers_keeps_ties_and_puts_what_is_missing_last(tried, tmp_path):
    table = QTable({"name": list("abcdef"), "number": [10.0, 9.0, np.nan, -1e-3, np.inf, -2.0] * u.mm})
    table["count"] = MaskedColumn([10, 9, 100, 9, 10, 2], mask=[0, 0, 0, 0, 0, 1])
    table["word"] = ["s10", "s9", "", "S1", "s9", "t"]
    rs.write_report(table, tmp_path / "page.html")
    ((_, number, count, word),) = tried(tmp_path / "page.html")["orders"]
    # rows with equal values stay in the order that the page had before the click
    assert ["".join(names) for *_, names in number] == ["fdbaec", "eabdfc"]
    assert ["".join(names) for *_, names in count] == ["bdeacf", "ceabdf"]
    assert ["".join(names) for *_, names in word] == ["debafc", "faebdc"]


def test_the_page_itself_runs_its_script_under_its_policy(visit, tmp_path):
    path, refused = tmp_path / "page.html", []
    rs.write_report(QTable({"a": [2, 1], "b": ["x", "y"]}), path)
    page = visit(path)
    assert page.content().count("<button") == page.content().count('aria-sort="none"') == 2
    # the browser refuses all other scripts
    path.write_text(path.read_text().replace("</body>", "<script>document.title = 'run'</script></body>"))
    other = page.context.browser.new_page()
    other.on("console", lambda message: refused.append(message.text))
    other.goto(path.as_uri())
    assert (other.title(), len(refused)) == ("Untitled table", 1)


def test_heads_and_numbers_of_a_table_end_at_the_same_place(visit, tmp_path):
    """Regression: the symbol of the sorting order moved the heads away from the ends of their numbers."""
    values = {"number": [1.0, 20.5] * u.mm, "a longer name": [1, 2], "n": [100_000, 2], "word": ["a", "b"]}
    rs.write_report(QTable(values), tmp_path / "page.html")
    ends = visit(tmp_path / "page.html").evaluate("""[...document.querySelectorAll("thead th.number")].map((head) => {
        const end = (element) => { const range = document.createRange(); range.selectNodeContents(element);
          return Math.max(...[...range.getClientRects()].map((box) => box.right)); };
        return [end(head.firstChild), end(document.querySelector("tbody tr").cells[head.cellIndex])];
    })""")
    assert len(ends) == 3
    for head, cell in ends:
        assert head == pytest.approx(cell, abs=1)


def test_heads_have_no_boxes_on_paper(visit, tmp_path):
    """Regression: Chromium does not repeat a head on the next page if the head contains the box of a button."""
    rs.write_report(QTable({"number": np.arange(300), "other": np.arange(300)}), tmp_path / "page.html")
    page = visit(tmp_path / "page.html")
    page.emulate_media(media="print")
    styles = page.evaluate("[...document.querySelectorAll('thead button')].map((e) => getComputedStyle(e).display)")
    assert styles == ["contents"] * 2
    assert page.evaluate("getComputedStyle(document.querySelector('thead')).display") == "table-header-group"


@pytest.mark.parametrize(("n", "is_open"), [(100, True), (101, False)])
def test_long_tables_are_closed_except_on_paper(visit, tmp_path, n, is_open):
    rs.write_report(QTable({"number": np.arange(n)}), tmp_path / "page.html")
    page = visit(tmp_path / "page.html")
    assert page.locator("table.rows").is_visible() == is_open
    page.pdf()
    assert page.locator("table.rows").is_visible()
