import base64
import hashlib
import json
import os
import re
import subprocess
import sys
from functools import cache

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import MaskedColumn, QTable
from astropy.time import Time
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from statuses import status_table

import flat
import rfpsurvey as rs
from pages import LOADING, Reader, full
from rfpsurvey.report import _html as _svg
from rfpsurvey.report import _tile

CENTER = SkyCoord(95, 23, unit="deg")
NASTY = "<script>alert('x')</script> \x07 & \"y\" ]]> --> </svg>"


@pytest.fixture(scope="module")
def tile(presets):
    sky = rs.synthetic_catalog("poisson", CENTER, 1.5 * u.deg, density=100 / u.deg**2, rng=3)
    return rs.plan_tile(sky, presets["sdss_apo"], CENTER, allocator="balanced")


@pytest.fixture(scope="module")
def survey(small):
    sky = rs.synthetic_catalog("poisson", CENTER, 1 * u.deg, density=60 / u.deg**2, rng=3)
    return rs.plan_survey(sky, small, rs.place_tiles(sky, small, passes=2))


def nasty_table():
    table = QTable({"name": [NASTY, "plain", ""], "<b>length": [1.23456789, np.nan, -3e-9] * u.mm})
    table["count"] = MaskedColumn([10, 9, 100], mask=[False, True, False])
    table["pair"], table["when"] = [[1, 2], [3, 4], [5, 6]], Time(["2026-01-01", "2026-02-01", "2026-03-01"])
    table.meta = {"title": "x", "note": NASTY, "nested": {NASTY: {"deeper": [NASTY, None]}}, "length": [1, 2] * u.mm}
    table.meta["nan"] = np.nan
    return table


def test_links_of_a_figure_run_no_code(tmp_path):
    """Regression: a link of an artist in a figure of the user was kept, whatever it referred to."""
    ax, urls = Figure().add_subplot(), ("javascript:alert(1)", " JavaScript:alert(1)", "data:text/html,x", "file:x")
    for k, link in enumerate((*urls, "vbscript:x", "https://example.org/")):
        ax.plot([0, 1], [k, k])[0].set_url(link)
        ax.text(k, k, "text", url=link)
    rs.write_report(QTable({"a": [1]}), tmp_path / "page.html", figures=ax)
    links = re.findall(r'href="([^"]*)"', (tmp_path / "page.html").read_text().partition("<svg")[2])
    assert "https://example.org/" in links
    assert all(link.startswith(("#", "https://", "data:image/png")) for link in links)


def nasty_figure():
    ax = Figure().add_subplot()
    ax.plot([1, 10, 100], [1, 2, 3], color="0.5")
    ax.set_xscale("log")
    ax.set_xlabel(NASTY.replace("\x07", ""))
    return ax


@pytest.fixture(scope="module")
def results(tile, survey, small):
    sky = rs.synthetic_catalog("uniform", CENTER, 0.3 * u.deg, n_targets=60, rng=1)
    return {
        "tile": tile,
        "survey": survey,
        "tiling": rs.place_tiles(rs.Region.box(ra=[100, 120] * u.deg, dec=[20, 30] * u.deg), "lamost"),
        "estimate": flat.collision_probability(small, method="quadrature", max_iterations=64, rng=1),
        "table": nasty_table(),
        "status": status_table(),
        "allocators": rs.compare_allocators(sky, small, CENTER, allocators=["nearest", "repair"]),
    }


@pytest.fixture(scope="module")
def plain_page(results, tmp_path_factory):
    """Return a function that returns the page of a kind of result without options, written once."""
    return cache(lambda kind: written(results[kind], tmp_path_factory.mktemp(kind)))


def written(result, folder, **options):
    path = folder / "page.html"
    rs.write_report(result, path, overwrite=True, **options)
    return path.read_text(encoding="utf-8")


@pytest.mark.few(2)
@pytest.mark.parametrize("kind", ["tile", "survey", "tiling", "estimate", "table", "allocators", "status"])
def test_a_page_is_well_formed_complete_and_fetches_nothing(results, tmp_path, kind):
    page = Reader(written(results[kind], tmp_path, figures={NASTY: nasty_figure(), "again": nasty_figure()}))
    assert page.all("html") == [{"lang": "en"}]
    assert [len(page.all(tag)) for tag in ("title", "h1", "main", "footer")][1:] == [1, 1, 1]
    metas = {a.get("name", a.get("http-equiv")): a.get("content") for a in page.all("meta")}
    assert "width=device-width" in metas["viewport"]
    # the page contains only its own script, and the policy permits no other script
    script = page.text("script")[-1]  # the elements before contain data
    assert [a.get("type") for a in page.all("script")] == ["application/json"] * (len(page.all("script")) - 1) + [None]
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    assert metas["Content-Security-Policy"].startswith("default-src 'none'")
    assert f"script-src 'sha256-{digest}'" in metas["Content-Security-Policy"]
    ids = [attrs["id"] for _, attrs, _ in page.elements if "id" in attrs]
    assert len(ids) == len(set(ids))
    for tag, attrs, _ in page.elements:
        assert not any(name.startswith("on") for name in attrs), (tag, attrs)
        for name in LOADING & set(attrs):
            assert attrs[name].startswith(("#", "data:image/png;base64,", "data:,")), (tag, name, attrs[name][:80])
            assert not attrs[name].startswith("#") or attrs[name][1:] in ids
        for value in attrs.values():
            assert all(name in ids for name in re.findall(r"url\(([^)]*)\)", value or "") if name[:1] != "#")
            assert all(name in ids for name in re.findall(r"url\(#([^)]*)\)", value or ""))
    (style,) = page.text("style")
    assert not re.search(r"@import|url\(|https?:", style)
    assert all(attrs.get("scope") in ("col", "row") for attrs in page.all("th"))
    for tag, attrs, above in page.elements:
        if tag == "svg":
            assert attrs["role"] == "img"
            assert set(attrs["aria-labelledby"].split()) <= set(ids)
            assert above[-2:] == ("figure", "div")
    titles = [above[-1] for tag, _, above in page.elements if tag == "title"]
    assert titles.count("svg") == len(page.all("svg")) == len(page.all("figcaption")) >= 2


def test_what_others_wrote_is_shown_as_text(tmp_path):
    page = Reader(written(nasty_table(), tmp_path, title=NASTY, figures={NASTY: nasty_figure()}))
    shown = NASTY.replace("\x07", "\N{REPLACEMENT CHARACTER}")
    assert "".join(page.text("h1")) == shown
    heads, rows = page.table("3 rows and 5 columns.")
    assert (rows[0][0]["text"], heads) == (shown, ["name", "<b>length mm", "count", "pair", "when"])
    assert page.facts()["note"] == shown
    assert page.facts()["deeper"].startswith(shown)
    assert shown in page.text("figcaption") + page.text("strong")
    assert NASTY.replace("\x07", "") in "".join(page.text("text"))
    assert len(page.all("script")) == 1


def test_a_title_that_marks_itself_as_safe_is_shown_as_text(tmp_path):
    class Safe(str):
        def __html__(self):
            return self

    assert Reader(written(QTable({"a": [1]}), tmp_path, title=Safe("<b>x</b>"))).text("h1") == ["<b>x</b>"]


def test_cells_hold_full_values_and_say_what_is_missing(tmp_path):
    _, rows = Reader(written(nasty_table(), tmp_path)).table("3 rows and 5 columns.")
    assert [row[1]["text"] for row in rows] == ["1.235", "\N{EN DASH}", "-3.000e-09"]
    np.testing.assert_array_equal([full(row[1]) for row in rows], [1.23456789, np.nan, -3e-9])
    assert [row[2]["text"] for row in rows] == ["10", "\N{EN DASH}", "100"]
    assert ["missing" in row[2]["class"] for row in rows] == [False, True, False]
    assert (rows[2][0]["class"], rows[0][3]["text"]) == ("missing", "[1 2]")
    assert rows[1][4]["text"].startswith("2026-02-01")


def test_a_tile_has_its_own_numbers(tile, tmp_path):
    page = Reader(written(tile, tmp_path, data="/some/where/tile.fits"))
    t, facts = tile.table, page.facts()
    colliding = t[t["in_collision"]]
    heads, rows = page.table("Positioners in collision.")
    assert len(rows) == len(colliding) == int(facts["in collision"]) > 20
    for name, head in (("clearance", "clearance mm"), ("ra", "ra deg"), ("x", "x mm"), ("target_id", "target id")):
        values = [full(row[heads.index(head)]) for row in rows]
        np.testing.assert_array_equal(values, getattr(colliding[name], "value", colliding[name]))
    assert [row[0]["text"] for row in rows] == colliding["id"].tolist()
    assert facts["digest"] == tile.provenance["instrument"]["digest"]
    assert facts["rng"] == str(tile.provenance["parameters"]["rng"])
    # the provenance contains all digits
    assert float(facts["radius_deg"]) == pytest.approx(tile.provenance["catalog"]["radius_deg"], rel=1e-14)
    # the smallest clearances without a collision, compared with a direct calculation
    heads, rows = page.table("Positioners without a collision that have the smallest")
    free = np.sort(t["clearance"][~t["in_collision"] & np.isfinite(t["clearance"])].value)
    np.testing.assert_array_equal([full(row[heads.index("clearance mm")]) for row in rows], free[:25])
    (caption,) = [c["caption"] for c in page.tables if c["caption"].startswith("Positioners without a collision")]
    assert f"Shown: 25 of {len(free)} rows; tile.fits contains all rows." in caption
    assert "/some/where" not in "".join(text for _, text in page.texts)


@pytest.mark.exhaustive
def test_a_tile_lists_all_its_assignments(presets, tmp_path):
    """Regression: the page referred to a file with all assignments, and showed only some of them."""
    pfs = presets["pfs"]
    sky = rs.synthetic_catalog("uniform", CENTER, pfs.field_radius, n_targets=4000, rng=1)
    tile = rs.plan_tile(sky, pfs, CENTER, allocator="balanced")
    text = written(tile, tmp_path)
    data, t = json.loads(Reader(text).text("script")[0]), tile.table
    (plan,) = data["plans"]
    for name, decimals in (("ra", 6), ("dec", 6), ("tip_x", 3), ("phi", 3), ("clearance", 3)):
        np.testing.assert_allclose(unpacked(plan["columns"][name]), t[name].value, atol=0.51 * 10.0**-decimals, rtol=0)
    assert unpacked(data["id"]) == t["id"].astype(str).tolist()
    assert unpacked(plan["columns"]["target_id"]) == np.ma.filled(t["target_id"].astype(str), "").tolist()
    assert unpacked(plan["columns"]["colliding_with"]) == t["colliding_with"].tolist()
    assert unpacked(plan["columns"]["status"]) == t["status"].tolist()
    assert len(text) < 1_000_000


def unpacked(column):
    """Return the values of a column of a view."""
    values = column["v"] if "v" in column else column["c"]
    if "names" in column:
        return [column["names"][k] for k in values]
    return np.array(values, dtype=float) / 10 ** column["d"] if "d" in column else values


def test_the_rows_of_a_page_can_be_limited(tile, tmp_path):
    page = Reader(written(tile, tmp_path, max_rows=30, data="tile.fits"))
    assert json.loads(page.text("script")[0])["max_rows"] == 30
    n = tile.summary["n_colliding"]
    assert f"Shown: 30 of {n} rows; tile.fits contains all rows." in "".join(p["caption"] for p in page.tables)


@pytest.mark.few(1)
@pytest.mark.parametrize("kind", ["tile", "survey"])
def test_a_number_has_one_form_on_a_page(results, plain_page, kind):
    """Regression: the same rate was 2.10 % at the top of the page, and 0.021 below."""
    page, rate = Reader(plain_page(kind)), results[kind].summary["collision_rate_assigned"]
    text = page.facts()["collision rate of assigned arms"]
    assert text in page.text("dd")
    assert float(text) == pytest.approx(rate, rel=1e-3)
    assert not [text for text in page.text("dd") if "%" in text]


def test_a_table_is_not_called_table_thrice(tmp_path):
    page = Reader(written(QTable({"a": [1]}), tmp_path))
    heads = [*page.text("h1"), *page.text("h2"), page.tables[0]["caption"]]
    assert heads == ["Untitled table", "All values", "Provenance", "1 row and 1 column."]
    page = Reader(written(QTable({"a": [1]}, meta={"title": "Pitches"}), tmp_path))
    assert "".join(page.text("h1", "h2", "strong")).count("Pitches") == 1


def test_a_survey_has_its_own_numbers(survey, plain_page):
    page = Reader(plain_page("survey"))
    heads, rows = page.table("The tiles of the survey in the order of the tiling")
    assert len(rows) == len(survey)
    for name in ("n_observed", "collision_rate", "completeness"):
        values = [full(row[heads.index(name.replace("_", " "))]) for row in rows]
        np.testing.assert_array_equal(values, survey.tiles[name])
    heads, rows = page.table("The table lists the completeness after each pass")
    shown = [full(row[heads.index("n observed")]) for row in rows]
    np.testing.assert_array_equal(shown, survey.completeness["n_observed"])
    assert int(page.facts()["visits requested"]) == survey.summary["n_visits_requested"]
    assert (page.facts()["model"], len(page.all("svg"))) == (survey.summary["model"], 2)


def test_the_summary_of_a_tiling_has_labels(results, small, tmp_path):
    """Regression: the page of a tiling had labels such as "n on tiles" and "radius deg"."""
    sky = rs.synthetic_catalog("uniform", CENTER, 0.5 * u.deg, n_targets=60, rng=1)
    for tiling in (results["tiling"], rs.place_tiles(sky, small)):
        facts = Reader(written(tiling, tmp_path)).facts()
        keys = {key.replace("_", " ") for key in tiling.summary if "_" in key} - {"arm model"}
        assert not keys & (set(facts) - {key for key in facts if "_" in key})
        assert float(facts["radius of a field in degrees"]) == pytest.approx(tiling.summary["radius_deg"], rel=1e-3)
    assert int(facts["targets with requested visits"]) == tiling.summary["n_targets"]


def test_the_first_sentence_of_a_caption_is_in_bold(tmp_path):
    caption = "Designs. The line is the front. Bars are errors."
    text = written(QTable({"k": [1]}), tmp_path, figures={caption: Figure(), "One sentence.": Figure()})
    assert "<strong>Designs.</strong> The line is the front. Bars are errors.</figcaption>" in text
    assert "<strong>One sentence.</strong></figcaption>" in text


def test_the_map_of_a_survey_is_explained(survey, plain_page):
    text = plain_page("survey")
    assert "The color of a field shows the completeness of the field." in text
    assert ("drawn with a smaller radius" in text) == (len(set(survey.tiles["pass"])) > 1)


def test_no_row_is_left_out_in_silence(tmp_path):
    table = QTable({"k": np.arange(150)})
    page = Reader(written(table, tmp_path, max_rows=100, data="all.fits"))
    _, rows = page.table("150 rows and 1 column.")
    assert [full(row[0]) for row in rows] == list(range(100))
    assert page.tables[0]["caption"] == "150 rows and 1 column. Shown: 100 of 150 rows; all.fits contains all rows."
    assert Reader(written(table, tmp_path)).tables[0]["caption"] == "150 rows and 1 column."
    assert "no rows" in written(QTable({"k": []}), tmp_path)


@pytest.mark.few(1)
@pytest.mark.parametrize("kind", ["tile", "table", "survey", "allocators"])
def test_the_same_result_gives_the_same_bytes(results, plain_page, tmp_path, kind):
    assert written(results[kind], tmp_path) == plain_page(kind)


SAME = """
import sys; from matplotlib.figure import Figure; from astropy.table import QTable; import rfpsurvey as rs
ax = Figure().add_subplot(); ax.plot([1, 2], 'o-', label='a'); ax.scatter([1, 2], [3, 4]); ax.legend()
rs.write_report(QTable({'a': [1.5]}), sys.argv[1], figures=ax)
"""


def test_another_process_writes_the_same_bytes(tmp_path, monkeypatch):
    there, here = tmp_path / "there.html", tmp_path / "here.html"
    subprocess.run([sys.executable, "-c", SAME, there], check=True, env={**os.environ, "PYTHONHASHSEED": "7"})
    monkeypatch.setattr(sys, "argv", ["-c", str(here)])
    exec(SAME, {})
    assert here.read_bytes() == there.read_bytes()


def test_heavy_figures_become_images_and_are_left_as_they_were(tmp_path):
    ax = Figure().add_subplot()
    lines = ax.add_collection(LineCollection(np.random.default_rng(1).random((31_000, 2, 2))))
    text = written(QTable({"a": [1]}), tmp_path, figures=ax)
    assert text.count("data:image/png") == 1
    assert len(text) < 1_000_000
    assert not lines.get_rasterized()


@pytest.mark.exhaustive
def test_the_page_of_a_large_instrument_is_not_large(presets, tmp_path):
    sky = rs.synthetic_catalog("poisson", CENTER, 2.5 * u.deg, density=800 / u.deg**2, rng=1)
    assert len(written(rs.plan_tile(sky, presets["lamost"], CENTER), tmp_path)) < 2_000_000


def test_grays_follow_the_page_and_colors_do_not(tmp_path):
    ax = Figure().add_subplot()
    ax.plot([1, 2], color="#444444")
    ax.plot([1, 3], color="#d00000")
    text = written(QTable({"a": [1]}), tmp_path, figures=ax)
    assert "stroke: var(--g44,#444444)" in text
    assert "stroke: #d00000" in text
    dark = dict(re.findall(r"--g([0-9a-f]{2}):#([0-9a-f]{6})", text))
    assert {"00", "44"} <= set(dark)
    assert set(dark) == set(re.findall(r"var\(--g([0-9a-f]{2}),", text.partition("<body>")[2]))
    # light text on a dark background, with the same order of gray levels
    assert int(dark["00"][:2], 16) > int(dark["44"][:2], 16) > 0x80


def test_the_part_that_is_shown_larger_has_the_most_collisions(tile):
    low, high = _tile._crowded(tile).to_value(u.mm)
    red = np.column_stack([tile.table["x"].value, tile.table["y"].value])[tile.table["in_collision"]]
    inside, half = ((red >= low) & (red <= high)).all(axis=1).sum(), (high - low) / 2
    assert inside >= max((np.abs(red - middle) < half).all(axis=1).sum() for middle in red) > 3


def test_ids_of_figures_never_clash():
    """Matplotlib computes identifiers from the content. Two equal figures therefore have equal identifiers."""
    first, second = (_svg.svg_of(nasty_figure(), name)["content"] for name in ("f1", "f2"))
    names = [set(re.findall(r'id="([^"]*)"', text)) for text in (first, second)]
    assert len(names[0]) == len(names[1]) > 3
    assert not names[0] & names[1]
    assert "<style" not in first


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"path": "page.pdf"}, "must end in .html or .htm"),
        ({"path": "no/page.html"}, "does not exist"),
        ({"path": "there.html"}, "exists; to replace it, use overwrite=True"),
        (
            {"result": [1]},
            "result must be one of Tile, Survey, Tiling, Estimate, SelectionProbabilities, SurveyState, Table, got "
            "list",
        ),
        ({"figures": ["x"]}, "figures must be Figures or Axes of matplotlib, got str"),
        ({"max_rows": 0}, "max_rows must be a whole number of at least 1, got 0"),
        ({"title": 3}, "title must be text, got 3"),
    ],
)
def test_bad_input_is_a_sentence_and_leaves_nothing(tmp_path, arguments, message):
    (tmp_path / "there.html").write_text("old")
    options = {"result": QTable({"a": [1]}), "path": "page.html", **arguments}
    options["path"] = tmp_path / options["path"]
    with pytest.raises(rs.InputError, match=re.escape(message)):
        rs.write_report(options.pop("result"), options.pop("path"), **options)
    assert [p.name for p in tmp_path.iterdir()] == ["there.html"]
    assert (tmp_path / "there.html").read_text() == "old"


@pytest.mark.parametrize("made_by", [None, 3, ["x"], "compare_instruments", "compare_allocators"])
def test_tables_that_are_not_what_they_seem(tmp_path, made_by):
    table = QTable({"n": [1]}, meta={"made_by": made_by, 5: 1, "deep": {6: {7: "x"}}})
    rs.write_report(table, tmp_path / "page.html", max_rows=np.int64(3), figures={"\x00\ud800": Figure()})
    assert "deep 6" in (tmp_path / "page.html").read_text()


def test_nothing_of_the_provenance_is_lost(tmp_path):
    meta = {"x": "first", "": {"y": "second"}, "a b": {"p": "third"}, "a": {"b": {"q": "fourth"}}}
    meta |= {"a_b": {"r": "fifth"}, "none here": {}}
    rs.write_report(QTable({"n": [1]}, meta=meta), tmp_path / "page.html")
    text = (tmp_path / "page.html").read_text()
    assert all(word in text for word in ("first", "second", "third", "fourth", "fifth", "none here"))
