"""Print the times of records, states and status of a survey that is observed in a thousand nights.

Run ``python tests/benchmarks/night_figures.py`` to record two tiles of SDSS-V per night, of which some visits fail, in
the folder of a survey with 2000 tiles (``--nights N`` for 2 N tiles). The command prints the median time of a record at
several times, the times of the status before and after the rest is planned, the size of its page, and the times in
which Chromium draws a night.
"""

import os
import sys
import tempfile
import time
import warnings
from datetime import date, timedelta
from pathlib import Path

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord
from astropy.table import Table
from measure import arguments

sys.path.insert(0, str(Path(__file__).parent.parent / "helpers"))

import rfpsurvey as rs
from browser import open_browser

os.environ["SOURCE_DATE_EPOCH"] = "1420070400"  # the survey is planned before the invented dates
FRAMES = """async () => {
  const section = document.querySelector(".view"), times = [];
  while (!(section.view?.stage.width > 1)) await new Promise(requestAnimationFrame);
  for (let k = 0; k < 100; k += 1) {
    const begin = performance.now();
    section.view.setNight(Math.floor(k * section.view.nights.length / 100));
    for (const { stage } of [section.view, section.view.fibers]) {
      stage.paint();
      stage.canvas.getContext("2d").getImageData(0, 0, 1, 1); // waits until everything is drawn
    }
    if (k) times.push(performance.now() - begin);
    await new Promise(requestAnimationFrame);
  }
  return times;
}"""
SHOWN = (10, 30, 100, 300, 1000)


def main(n_nights: int) -> None:
    """Record all nights of a survey, and print the times."""
    warnings.simplefilter("ignore")
    side = int(np.ceil(np.sqrt(2 * n_nights)))
    ra, dec = np.meshgrid(np.arange(side) * 2.5 + 100, np.arange(side) * 1.5 - 0.75 * side)
    tiles = SkyCoord(ra.ravel()[: 2 * n_nights] * u.deg, dec.ravel()[: 2 * n_nights] * u.deg)
    rng = np.random.default_rng(1)
    near = np.repeat(np.arange(len(tiles)), 200)
    offsets = rng.normal(0, 0.5, (2, len(near)))
    sky = SkyCoord(tiles.ra[near] + offsets[0] * u.deg, tiles.dec[near] + offsets[1] * u.deg)
    with tempfile.TemporaryDirectory() as place:
        survey = rs.plan_survey(rs.Catalog(sky), "sdss_apo", tiles, allocator="nearest", folder=Path(place) / "survey")
        seconds = []
        for night in range(n_nights):
            names = [2 * night, 2 * night, 2 * night + 1]
            failed = ["", str(survey.tile(names[0])["positioner"][0]), ""]
            day = str(date(2015, 1, 1) + timedelta(night))
            table = Table({"tile": names, "date": [day] * 3, "state": ["done", "", "done"], "positioner": failed})
            begin = time.perf_counter()
            survey.record(table)
            seconds.append(time.perf_counter() - begin)
            if night + 1 in SHOWN:
                print(f"record of night {night + 1:5d}: {np.median(seconds[-9:]):.4f} s", flush=True)
        for words in ("before", "after"):
            begin = time.perf_counter()
            status = survey.status()
            n = len(status.meta["progress"]["date"])
            print(f"status of {n} nights {words} the rest is planned: {time.perf_counter() - begin:.2f} s", flush=True)
            survey = survey.replan()
        begin, page = time.perf_counter(), Path(place) / "page.html"
        rs.write_report(survey.state(), page)
        seconds = time.perf_counter() - begin
        print(f"page of all nights: {page.stat().st_size / 1e6:.2f} MB, written in {seconds:.1f} s", flush=True)
        with open_browser("console: Canvas2D") as visit:
            times = visit(page, width=1400).evaluate(FRAMES)
        print(f"frame of a night with all pixels: {np.median(times):.1f} ms, 10 %: {np.quantile(times, 0.1):.1f} ms")


if __name__ == "__main__":
    main(arguments(__doc__, nights=1000).nights)
