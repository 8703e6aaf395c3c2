"""Plan successive nights of DESI's dark tiles with greedy and exact: python tests/benchmarks/night_orders.py.

The merit of a tile is 1, and a random number up to 1 in addition. Tiles that greedy observes are left out in the
following nights. The table has a row for each night: the sums of merits, the upper limit, and the times (s).
"""

import argparse
from time import process_time

import astropy.units as u
import numpy as np
from astropy.table import QTable
from night_windows import desi_tiles

import rfpsurvey as rs
from rfpsurvey.night import plan_night

COLUMNS = ("date", "n_tiles", "greedy", "exact", "bound", "seconds_greedy", "seconds_exact", "is_optimum")


def nights(n_nights, time_limit, fraction):
    """Return the table of the nights; ``fraction`` of the tiles is left at the beginning."""
    rng, tiling, rows = np.random.default_rng(1), desi_tiles("DARK"), []
    table = QTable(tiling.table[rng.random(len(tiling)) < fraction])
    table["merit"] = 1 + rng.random(len(table))
    for k in range(n_nights):
        date, found, seconds = np.datetime64("2027-01-03") + k, {}, {}
        for method in ("greedy", "exact"):
            begin = process_time()
            options = {"instrument": "desi", "method": method, "time_limit": time_limit * u.s}
            found[method] = plan_night(rs.Tiling(table), str(date), **options)
            seconds[method] = process_time() - begin
        one, other = (found[method].summary for method in ("greedy", "exact"))
        row = str(date), one["n_tiles"], one["merit"], other["merit"], other["bound"], *seconds.values()
        rows.append((*row, other["is_optimum"]))
        print(*rows[-1], flush=True)
        table = table[~np.isin(table["tile"], found["greedy"].table["tile"])]
    return QTable(rows=rows, names=COLUMNS)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--nights", type=int, default=30)
    parser.add_argument("--time-limit", type=float, default=15.0)
    parser.add_argument("--fraction", type=float, default=0.2)
    parser.add_argument("--output")
    given = parser.parse_args()
    result = nights(given.nights, given.time_limit, given.fraction)
    result.meta["fraction"] = given.fraction
    if given.output:
        for name in COLUMNS[2:7]:
            result[name] = result[name].round(4)
        result.write(given.output, format="ascii.ecsv", overwrite=True)
