"""Record and replan a survey of DESI's tiles night by night: python tests/benchmarks/night_survey.py.

The tiles are those nearest to a center, and the targets are a synthetic catalog around it. The table has a row for each
night: the tiles, the merit and its upper limit, the completeness after the night, and the times (s) of the plan of the
night and of the plan of the rest.
"""

import argparse
import tempfile
from pathlib import Path
from time import perf_counter

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord
from astropy.table import QTable, Table
from night_windows import desi_tiles

import rfpsurvey as rs
from rfpsurvey.night import plan_night

COLUMNS = ("date", "n_tiles", "merit", "bound", "completeness", "seconds_night", "seconds_rest")
CENTER, FIRST = SkyCoord(150 * u.deg, 30 * u.deg), np.datetime64("2025-01-20")


def nights(n_tiles, n_targets, n_nights, method, folder):
    """Return the table of the nights."""
    tiling = desi_tiles("DARK")
    distance = tiling.coord.separation(CENTER)
    near = np.argsort(distance)[:n_tiles]
    radius = distance[near].max() + 1.6 * u.deg
    sky, rows = rs.synthetic_catalog("uniform", CENTER, radius, n_targets=n_targets, rng=1), []
    survey = rs.plan_survey(sky, "desi", rs.Tiling(tiling.table[np.sort(near)]), folder=folder, visits=2)
    n_visits = survey.summary["n_visits_requested"]
    for date in (FIRST + np.arange(n_nights)).astype(str):
        begin = perf_counter()
        night = plan_night(survey, date, method=method, time_limit=15 * u.s)
        between = perf_counter()
        if len(night):
            survey.record(Table({"tile": night.table["tile"], "date": [date] * len(night)}))
            survey = survey.replan()
        done = sum(row[2] for row in rows) + night.summary["merit"]
        times = round(between - begin, 1), round(perf_counter() - between, 1)
        rows.append((date, len(night), night.summary["merit"], night.summary["bound"], done / n_visits, *times))
        print(*rows[-1], flush=True)
    return QTable(rows=rows, names=COLUMNS)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--tiles", type=int, default=60)
    parser.add_argument("--targets", type=int, default=100_000)
    parser.add_argument("--nights", type=int, default=30)
    parser.add_argument("--method", default="greedy")
    parser.add_argument("--output")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        result = nights(given.tiles, given.targets, given.nights, given.method, Path(folder) / "survey")
    if given.output:
        result.write(given.output, format="ascii.ecsv", overwrite=True)
