"""Print sizes of reports, and times of their interactive views in Chromium.

Run ``python tests/benchmarks/page_figures.py [FOLDER]``; the pages remain in the folder. The map of the DESI survey
requires the file ``desi_tiles_main.ecsv.gz`` in the folder RFPSURVEY_TEST_DATA.
"""

import sys
import tempfile
from pathlib import Path
from statistics import median
from time import perf_counter

import numpy as np
from astropy.coordinates import SkyCoord

sys.path.insert(0, str(Path(__file__).parent.parent / "helpers"))

from measure import TILES

import rfpsurvey as rs
from browser import open_browser

CENTER = SkyCoord(95, 23, unit="deg")
VIEW = "document.querySelector('.view').view"
# the content security policy of pages forbids Page.wait_for_function
READY = f"async () => {{ while (!({VIEW}?.stage.width > 1)) await new Promise(requestAnimationFrame); }}"
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


# frames of a motion at the default speed and 60 frames per second, at five times, until the pixels are there
FRAMES = """async ([view, planned]) => {
  const times = [], { motion, stage } = view, context = stage.canvas.getContext("2d");
  motion.planned = planned;
  for (const part of [0.02, 0.25, 0.5, 0.75, 0.9]) {
    view.show(0);
    view.show(part * motion.data.duration);
    for (let k = 0; k < 30; k += 1) {
      const begin = performance.now();
      view.show(motion.time + view.rate() / 60);
      stage.paint();
      context.getImageData(0, 0, 1, 1);
      if (k) times.push(performance.now() - begin);
      await new Promise(requestAnimationFrame);
    }
  }
  return times;
}"""
WIDEST = "10 / Math.max(...view.outer)"  # mm to pixels; the smallest scale at which arms are drawn


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


def motions(folder, name):
    instrument = rs.Instrument.preset(name)
    density = 100_000 / (np.pi * instrument.field_radius**2) if name == "must" else instrument.target_density
    sky = rs.synthetic_catalog("poisson", CENTER, instrument.field_radius, density=density, rng=1)
    tile = rs.plan_tile(sky, instrument, CENTER, allocator="repair")
    rs.write_report(tile, folder / f"motion_{name}.html", overwrite=True, paths=True)
    return f"motion_{name}.html"


def time_motion(visit, file):
    """Print the size of a page with a motion, and the times of its frames in three parts of the focal plane."""
    page = visit(file)
    page.evaluate(READY)
    print(f"{file.name}: {file.stat().st_size / 1e6:.2f} MB, {page.evaluate(VIEW + '.n')} positioners; ms per frame:")
    for where, move in (
        ("everything", "stage.fit()"),
        ("all visible arms", f"stage.show(0.2 * view.x[0], 0.2 * view.y[0], {WIDEST})"),
        ("enlarged", f"stage.show(0.2 * view.x[0], 0.2 * view.y[0], 6 * {WIDEST})"),
    ):
        for planned in (True, False):
            page.evaluate(f"(() => {{ const view = {VIEW}; view.{move}; }})()")
            times = sorted(page.evaluate(f"() => ({FRAMES})([{VIEW}, {str(planned).lower()}])"))
            kind = "planned paths" if planned else "constant rates"
            print(f"  {where}, {kind}: median {median(times):.1f}, 95 % below {times[int(0.95 * len(times))]:.1f}")


def desi_survey(folder):
    if not TILES.exists():
        print("no map of the DESI survey: desi_tiles_main.ecsv.gz is not in RFPSURVEY_TEST_DATA")
        return []
    rs.write_report(rs.Tiling.read(TILES), folder / "desi_sky.html", overwrite=True)
    return ["desi_sky.html"]


def main(folder):
    names = desi_tile(folder) + must_tile(folder) + desi_survey(folder)
    moving = [motions(folder, name) for name in ("sdss_apo", "desi", "must")]
    with open_browser(ignored="console: Canvas2D") as visit:
        for name in moving:
            time_motion(visit, folder / name)
        for name in names:
            page = visit(folder / name)
            page.evaluate(READY)
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
