"""Print sizes of reports, and times of their interactive views in Chromium.

Run ``python tests/benchmarks/page_figures.py [FOLDER]``; the pages remain in the folder. The map of the DESI survey
requires the file ``desi_tiles_main.ecsv.gz`` in the folder RFPSURVEY_TEST_DATA.
"""

import sys
import tempfile
from pathlib import Path
from statistics import median
from time import perf_counter

from astropy.coordinates import SkyCoord

sys.path.insert(0, str(Path(__file__).parent.parent / "helpers"))

from measure import TILES

import rfpsurvey as rs
from browser import open_browser

CENTER = SkyCoord(95, 23, unit="deg")
VIEW = "document.querySelector('.view').view"
# reading the pixels back waits until everything is drawn
ZOOM = """async (view) => {
  const times = [], { stage } = view, context = stage.canvas.getContext("2d");
  for (let k = 0; k < 80; k += 1) {
    const begin = performance.now();
    stage.zoom(k < 40 ? 1.12 : 1 / 1.12, stage.width * 0.4, stage.height * 0.55);
    stage.paint();
    times.push([performance.now() - begin, 0]);
    const wait = performance.now();
    context.getImageData(0, 0, 1, 1);
    times.at(-1)[1] = performance.now() - wait;
    await new Promise(requestAnimationFrame);
  }
  return times;
}"""


def desi_tile(folder):
    desi = rs.Instrument.preset("desi")
    sky = rs.synthetic_catalog("poisson", CENTER, desi.field_radius, density=desi.target_density, rng=1)
    plans = {name: rs.plan_tile(sky, desi, CENTER, allocator=name) for name in ("lamost_rule", "repair")}
    rs.write_report(plans["lamost_rule"], folder / "desi.html", overwrite=True)
    rs.write_report(plans["lamost_rule"], folder / "desi_two.html", overwrite=True, plans={"repair": plans["repair"]})
    times = []
    for _ in range(3):
        begin = perf_counter()
        rs.write_report(plans["lamost_rule"], folder / "desi.html", overwrite=True)
        times.append(perf_counter() - begin)
    print(f"report of a DESI tile: {min(times):.2f} s (smallest of 3)")
    return ["desi.html", "desi_two.html"]


def must_tile(folder):
    must = rs.Instrument.preset("must")
    sky = rs.synthetic_catalog("uniform", CENTER, must.field_radius, n_targets=100_000, rng=1)
    rs.write_report(rs.plan_tile(sky, must, CENTER), folder / "must.html", overwrite=True)
    return ["must.html"]


def desi_survey(folder):
    if not TILES.exists():
        print("no map of the DESI survey: desi_tiles_main.ecsv.gz is not in RFPSURVEY_TEST_DATA")
        return []
    rs.write_report(rs.Tiling.read(TILES), folder / "desi_sky.html", overwrite=True)
    return ["desi_sky.html"]


def main(folder):
    names = desi_tile(folder) + must_tile(folder) + desi_survey(folder)
    with open_browser(ignored="console: Canvas2D") as visit:
        for name in names:
            page = visit(folder / name)
            page.wait_for_function(f"{VIEW}?.stage.width > 1")
            first = float(page.evaluate(f"{VIEW}.stage.canvas.dataset.milliseconds"))
            start = page.evaluate(
                "(() => { const s = document.querySelector('.view'), b = performance.now();"
                "const d = JSON.parse(s.querySelector('script').textContent);"
                "const live = document.createElement('div'); document.body.append(live);"
                "const v = new VIEWS[s.dataset.view](live, d); v.stage.resize(); v.stage.paint();"
                "v.stage.canvas.getContext('2d').getImageData(0, 0, 1, 1);"
                "const t = performance.now() - b; live.remove(); return t; })()"
            )
            times = page.evaluate(f"() => ({ZOOM})({VIEW})")
            print(
                f"{name}: {(folder / name).stat().st_size / 1e6:.2f} MB, first drawing {first:.1f} ms, data and view "
                f"and first drawing {start:.1f} ms, draw call while zooming: median {median(t for t, _ in times):.1f} "
                f"ms, largest {max(t for t, _ in times):.1f} ms; until the pixels are there: median "
                f"{median(t + w for t, w in times):.1f} ms"
            )


if __name__ == "__main__":
    if len(sys.argv) > 1:
        main(Path(sys.argv[1]))
    else:
        with tempfile.TemporaryDirectory() as temporary:
            main(Path(temporary))
