"""Compare the allocators that could be the default: time, and targets assigned without a collision.

python tests/benchmarks/default_allocator.py [--seconds 10]
RFPSURVEY_TEST_DATA=... python tests/benchmarks/default_allocator.py --tiles 500
RFPSURVEY_TEST_DATA=... python tests/benchmarks/default_allocator.py --tiles 20 --realizations 128

The first command plans one field of each preset. The second command plans the tiles of DESI's main survey that are
nearest to a position. The third command computes selection probabilities for these tiles. Times are
processor times without compilation; those of the first command are medians of alternating runs.
"""

import argparse
from time import process_time

import astropy.units as u
import numpy as np
from selection_figures import MIDDLE, all_tiles, some_tiles

import rfpsurvey as rs
from sky_center import CENTER

ALLOCATORS = ("lamost_rule", "repair", "optimal")
EACH = (0.5, 1, 2, 5, 10, 20, 50)
DENSITY = 1400 / u.deg**2
REPEATS = 3


def one_tile(name, each, options):
    """Return the median processor time (ms) and the number of usable fibers of each allocator."""
    model = rs.Instrument.preset(name)
    n = round(each * len(model.focal_plane))
    sky = rs.synthetic_catalog("uniform", CENTER, model.field_radius, n_targets=n, rng=1)
    times, usable = [[] for _ in options], [0] * len(options)
    for _ in range(REPEATS):
        for k, option in enumerate(options):
            if sum(times[k]) >= 2e3:  # slow plans are made only once
                continue
            begin = process_time()
            tile = rs.plan_tile(sky, model, CENTER, allocator=option)
            times[k].append(1e3 * (process_time() - begin))
            usable[k] = np.count_nonzero((tile.table["kind"] == "science") & ~tile.table["in_collision"])
    return [(np.median(some), n) for some, n in zip(times, usable, strict=True)]


def tiles(options):
    """Print the times and usable fibers for each preset and number of targets per positioner."""
    words = "".join(f"{option.name:>22}" for option in options)
    print(f"{'instrument':<11}{'targets per positioner':>7}{words}   (ms, usable fibers)")
    for name in rs.available_instruments():
        one_tile(name, 1, options)  # compiles
        for each in EACH:
            found = one_tile(name, each, options)
            words = "".join(f"{time:>12.0f}{usable:>10}" for time, usable in found)
            print(f"{name:<11}{each:>7}{words}", flush=True)


def survey(n_tiles, n_realizations, options):
    """Print the time and the observed visits of a part of DESI's main survey."""
    tiling = all_tiles()
    tiling = some_tiles(rs.Tiling(tiling.table[tiling.table["program"] == "DARK"]), n_tiles)
    radius = tiling.coord.separation(MIDDLE).max() + 1.6 * u.deg
    sky = rs.synthetic_catalog("poisson", MIDDLE, radius, density=DENSITY, rng=1)
    sky = rs.Catalog(sky.coord, id=np.arange(len(sky)), visits=np.random.default_rng(1).integers(1, 5, len(sky)))
    print(f"{len(tiling)} tiles, {len(sky)} targets, {n_realizations} realizations")
    for option in options:
        rs.plan_survey(sky, "desi", rs.Tiling(tiling.table[:2]), allocator=option)
        begin = process_time()
        if n_realizations:
            done = rs.selection_probabilities(sky, "desi", tiling, n_realizations, allocator=option)
        else:
            done = rs.plan_survey(sky, "desi", tiling, allocator=option)
        seconds = process_time() - begin
        s = done.summary
        observed = s["n_observed"] if n_realizations else s["n_visits_observed"]
        print(f"{option.name:<9}{seconds:8.1f} s{observed:>12} visits observed of {s['n_assigned']}", flush=True)


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--seconds", type=float, default=10.0, help="time limit of a search")
    parser.add_argument("--tiles", type=int, default=0)
    parser.add_argument("--realizations", type=int, default=0)
    parser.add_argument("--allocator", action="append", help="such as repair or repair:exchange; by default, three")
    given = parser.parse_args()
    options = []
    for text in given.allocator or ALLOCATORS:
        name, _, moves = text.partition(":")
        searches = rs.allocation.METHODS[name].searches
        own = {"time_limit": given.seconds * u.s} if searches else {"moves": moves} if moves else {}
        options.append(rs.AllocationOptions(name, **own))
    if given.tiles:
        survey(given.tiles, given.realizations, options)
    else:
        tiles(options)


if __name__ == "__main__":
    main()
