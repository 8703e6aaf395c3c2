"""Legends of interactive views contain the colors, symbols and numbers that are drawn, in a real browser."""

import astropy.units as u
import living
import numpy as np
import pytest
from astropy.coordinates import SkyCoord

import rfpsurvey as rs

CENTER = SkyCoord(95, 23, unit="deg")
VIEW = "document.querySelector('.view').view"
READY = f"async () => {{ while (!({VIEW}?.stage.width > 1)) await new Promise(requestAnimationFrame); }}"
LEGEND = """(view) => [...view.legend.children].map((entry) => {
  const mark = entry.querySelector(".mark"), color = getComputedStyle(mark).getPropertyValue("--color").trim();
  return [entry.textContent, color, mark.className.replace("mark ", "")];
})"""
# draws on a recorder, and returns the number of symbols of each color: disks, rings (without a filling) and diamonds
DRAWN = """(view) => {
  const own = view.stage.canvas.getContext("2d"), counts = {};
  let path = [];
  const draw = (name) => {
    const color = name === "fill" ? own.fillStyle : own.strokeStyle;
    for (const shape of path) {
      const symbol = name === "fill" ? { arc: "dot" }[shape] ?? shape : { arc: "ring" }[shape] ?? `open ${shape}`;
      counts[`${color} ${symbol}`] = (counts[`${color} ${symbol}`] ?? 0) + 1;
    }
  };
  const actions = { beginPath: () => { path = []; }, arc: () => path.push("arc"), closePath: () => path.push("diamond"),
    fill: () => draw("fill"), stroke: () => draw("stroke") };
  const recorder = new Proxy(own, {
    get: (_, name) => (typeof own[name] !== "function" ? own[name] :
      (...all) => { actions[name]?.(); return own[name](...all); }),
    set: (_, name, value) => { own[name] = value; return true; },
  });
  view.paint(recorder, view.stage);
  return counts;
}"""
TILES = """(view) => {
  const found = {}, keep = view.pathOf;
  view.pathOf = (context, stage, k) => { found[k] = context.strokeStyle; return keep.call(view, context, stage, k); };
  view.selected = -1;
  view.stage.paint();
  delete view.pathOf;
  return found;
}"""


def color_of(text, page):
    """Return a color as the canvas returns it."""
    return page.evaluate(
        "(text) => { const own = document.createElement('canvas').getContext('2d'); own.fillStyle = text;"
        "return own.fillStyle; }",
        text,
    )


@pytest.mark.parametrize(("scheme", "allocator", "n"), [("light", "nearest", 4), ("dark", "repair", 5)])
def test_the_legend_of_a_tile_is_what_is_drawn(visit, write_view, presets, tmp_path, scheme, allocator, n):
    apo = presets["sdss_apo"]
    sky = rs.synthetic_catalog("poisson", CENTER, apo.field_radius, density=apo.target_density / 2, rng=1)
    kind = np.array(["science", "science", "standard", "sky"])[np.arange(len(sky)) % 4]
    needs = ["standard=5", "sky=5"] if allocator == "repair" else []
    options = rs.AllocationOptions(allocator, requirements=needs)
    tile = rs.plan_tile(rs.Catalog(sky.coord, kind=kind), apo, CENTER, allocator=options)
    write_view(tile, tmp_path / "page.html")
    page = visit(tmp_path / "page.html", scheme=scheme, width=500, height=600)
    page.evaluate(READY)
    assert page.evaluate(f"{VIEW}.outer[0] * {VIEW}.stage.scale") < 9  # dots are drawn
    legend = page.evaluate(f"({LEGEND})({VIEW})")
    drawn = page.evaluate(f"({DRAWN})({VIEW})")
    table = tile.table
    free = ~np.asarray(table["in_collision"])
    numbers = {"in collision": int((~free).sum()), "no target": int((free & (table["status"] == "idle")).sum())}
    for name, text in {"science": "science target", "standard": "standard star", "sky": "blank sky"}.items():
        numbers[text] = int((free & (table["status"] == "assigned") & (table["kind"] == name)).sum())
    numbers["fiducial or other obstacle"] = len(table.meta["geometry"]["obstacles_mm"])
    expected = {f"{color_of(color, page)} {shape.removeprefix('pale ')}": text for text, color, shape in legend}
    assert set(drawn) == set(expected)
    assert {text: drawn[key] for key, text in expected.items()} == {text: numbers[text] for text in expected.values()}
    assert len(expected) == n


@pytest.mark.parametrize("column", ["completeness", "pass", "n_assigned"])
def test_the_legend_of_a_map_is_what_is_drawn(visit, write_view, small, tmp_path, column):
    sky = rs.synthetic_catalog("poisson", CENTER, 1 * u.deg, density=60 / u.deg**2, rng=3)
    survey = rs.plan_survey(sky, small, rs.place_tiles(sky, small, passes=2))
    write_view(survey, tmp_path / "page.html")
    page = visit(tmp_path / "page.html")
    page.evaluate(READY)
    page.get_by_label("Color", exact=True).select_option(column)
    legend = [
        (text, color_of(color, page)) for text, color, shape in page.evaluate(f"({LEGEND})({VIEW})") if shape == "dot"
    ]
    drawn = page.evaluate(f"({TILES})({VIEW})")
    assert len(drawn) == len(survey.tiles)
    limits = {color: [float(v) for v in text.split(" to ")] for text, color in legend}
    for k, value in enumerate(np.asarray(survey.tiles[column], dtype=float).tolist()):
        low, high = limits[drawn[str(k)]][0], limits[drawn[str(k)]][-1]
        assert low * 0.999 <= value <= high * 1.001


def test_the_legends_of_a_state_are_what_is_drawn(visit, tmp_path):
    folder = tmp_path / "plan"
    survey = rs.plan_survey(
        living.targets(n=100), living.instrument(), living.tiling(), allocator="nearest", folder=folder
    )
    names = survey.tiles["tile"].tolist()
    survey.record(living.events(tile=names[:4], date="2025-12-03", state=["done", "partly", "bad", "dropped"]))
    fiber = survey.tile(names[0])["positioner"].tolist()[:1]
    survey.record(living.events(tile=names[0], date="2025-12-03", positioner=fiber, reason="off"))
    rs.write_report(survey.state(), tmp_path / "page.html")
    page = visit(tmp_path / "page.html")
    page.evaluate(READY)
    legend = page.evaluate(f"({LEGEND})({VIEW})")
    drawn = list(page.evaluate(f"({TILES})({VIEW})").values())
    counts = {text: (color_of(color, page), shape) for text, color, shape in legend}
    expected = {"planned (2)", "observed (1)", "partly observed (1)", "bad (1)", "dropped (1)"}
    assert set(counts) == expected
    for text, (color, _) in counts.items():
        assert drawn.count(color) == int(text[text.index("(") + 1 : -1])
    page.evaluate(f"{VIEW}.choose(0)")
    entries = page.evaluate(f"({LEGEND})({VIEW}.fibers)")
    drawn = page.evaluate(f"({DRAWN})({VIEW}.fibers)")
    wanted = {}
    for text, color, shape in entries:
        if shape != "cross":
            key = f"{color_of(color, page)} {shape}"
            wanted[key] = wanted.get(key, 0) + int(text[text.index("(") + 1 : -1])
    assert {key: drawn.get(key, 0) for key in wanted} == wanted
    assert sum(wanted.values()) == 7
    lines = page.evaluate(
        "[...document.querySelectorAll('svg.curve path, svg.key line')].map((e) => "
        "[e.localName, e.getAttribute('stroke'), e.getAttribute('stroke-dasharray')])"
    )
    curves, keys = ([line[1:] for line in lines if line[0] == name] for name in ("path", "line"))
    assert curves == keys
    assert len(curves) > 1
