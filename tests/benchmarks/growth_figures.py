"""Measure how the time and the memory of the main calls grow, and fit exponents.

python tests/benchmarks/growth_figures.py [NAME ...]

Each call is repeated with sizes over three decades. The exponent is the slope of log(time) against log(size), fitted to
the sizes whose time is at least three times that of the smallest size; for smaller sizes, constant costs dominate. For
comparison, the script prints the exponent of n log n over the same sizes. The memory is the largest memory of NumPy
arrays during the call (tracemalloc). docs/figures/growth.py plots the printed numbers.
"""

import gc
import tracemalloc
import warnings
from time import perf_counter

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord
from measure import arguments, machine

import rfpsurvey as rs
from rfpsurvey._sky.arrays import SkyIndex

CENTER = SkyCoord(180 * u.deg, 30 * u.deg)
POSITIONER = rs.Positioner(8.25 * u.mm, 8.25 * u.mm, 2.25 * u.mm)
SCALE, NARROW = 200 * u.mm / u.deg, 1600 * u.mm / u.deg
FACTOR = 3.0


def instrument(rings, scale=SCALE):
    """Return an instrument with 1 + 3 n (n + 1) positioners."""
    return rs.Instrument(
        "growth", rs.FocalPlane.hexagonal(POSITIONER, rings=rings, pitch=25.6 * u.mm), plate_scale=scale
    )


def rings_of(n):
    return max(round(((12 * n - 3) ** 0.5 - 3) / 6), 1)


def targets(n, radius, rng=1):
    return rs.synthetic_catalog("uniform", CENTER, radius, n_targets=n, rng=rng)


def tile_by_targets(allocator):
    """Return a case: one tile of 4000 positioners with n targets."""
    lamost = rs.Instrument.preset("lamost")

    def make(n):
        catalog = targets(n, 2.5 * u.deg)
        return n, lambda: rs.plan_tile(catalog, lamost, center=CENTER, allocator=allocator)

    return make


def tile_by_positioners(n):
    """Return one tile with n positioners and five targets for each."""
    model = instrument(rings_of(n))
    catalog = targets(5 * len(model.focal_plane), model.field_radius)
    return len(model.focal_plane), lambda: rs.plan_tile(catalog, model, center=CENTER, allocator="lamost_rule")


def collisions(n):
    plane = instrument(rings_of(n)).focal_plane
    r, angle = np.random.default_rng(1).uniform(0, [[16.0], [2 * np.pi]], (2, len(plane)))
    xy = plane.xy + np.column_stack([r * np.cos(angle), r * np.sin(angle)]) * u.mm
    return len(plane), lambda: rs.find_collisions(plane, xy)


def configurations(n):
    plane = rs.Instrument.preset("sdss_apo").focal_plane
    rng = np.random.default_rng(1)
    r, angle = 8.0 + 14.0 * rng.random((n, len(plane))), rng.uniform(0, 2 * np.pi, (n, len(plane)))
    xy = plane.xy + np.stack([r * np.cos(angle), r * np.sin(angle)], axis=-1) * u.mm
    return n, lambda: rs.collision.count_collisions(plane, xy)


def trials(n):
    plane = rs.Instrument.preset("lamost").focal_plane
    return n, lambda: rs.collision_probability(
        plane, method="monte_carlo", precision=rs.probability.Precision(max_iterations=n), rng=1
    )


def index(n):
    vectors = np.random.default_rng(1).normal(size=(n, 3))
    vectors /= np.linalg.norm(vectors, axis=1)[:, None]
    return n, lambda: SkyIndex(vectors)


def square(side):
    """Return a region around the center whose sides are about as long as ``side``."""
    half = side / 2
    ra = half / np.cos(CENTER.dec)
    return rs.Region.box((CENTER.ra - ra, CENTER.ra + ra), (CENTER.dec - half, CENTER.dec + half))


def wide(n):
    """Return targets, an instrument with 217 positioners, and about n tiles of one covering."""
    model = instrument(8, NARROW)
    side = (n**0.5 * 1.6 * model.field_radius).to(u.deg)
    return model, rs.place_tiles(square(side), model), side


def tiling(n):
    model, found, side = wide(n)
    return len(found), lambda: rs.place_tiles(square(side), model)


def survey(n):
    model, tiles, side = wide(n)
    catalog = targets(len(tiles) * 500, 0.75 * side)
    return len(tiles), lambda: rs.plan_survey(catalog, model, tiles, allocator="lamost_rule")


def realizations(n):
    model, tiles, side = wide(7)
    catalog = targets(5000, 0.75 * side)
    return n, lambda: rs.selection_probabilities(catalog, model, tiles, n, allocator="nearest")


CASES = {
    "find_collisions, positioners": (collisions, [40, 120, 400, 1200, 4000, 12000, 40000]),
    "count_collisions, configurations": (configurations, [10, 30, 100, 300, 1000, 3000, 10000]),
    "collision_probability, trials": (trials, [10, 30, 100, 300, 1000, 3000, 10000]),
    "plan_tile (lamost), targets": (
        tile_by_targets("lamost_rule"),
        [1000, 3000, 10000, 30000, 100000, 300000, 1000000],
    ),
    "plan_tile (nearest), targets": (tile_by_targets("nearest"), [1000, 3000, 10000, 30000, 100000, 300000, 1000000]),
    "plan_tile (repair), targets": (tile_by_targets("repair"), [1000, 3000, 10000, 30000, 100000, 300000, 1000000]),
    "plan_tile (lamost), positioners": (tile_by_positioners, [40, 120, 400, 1200, 4000, 12000, 40000]),
    "index of a catalog, targets": (index, [1000, 10000, 100000, 1000000, 10000000]),
    "place_tiles, tiles": (tiling, [10, 30, 100, 300, 1000, 3000, 10000]),
    "plan_survey, tiles": (survey, [3, 10, 30, 100, 300, 1000, 3000]),
    "selection_probabilities, realizations": (realizations, [4, 16, 64, 256, 1024, 4096]),
}


def seconds_of(call):
    """Return the smallest time of several calls, as many as two seconds permit."""
    found, begin = [], perf_counter()
    while not found or (len(found) < 7 and perf_counter() - begin < 2.0):
        start = perf_counter()
        call()
        found.append(perf_counter() - start)
    return min(found)


def megabytes_of(call):
    """Return the largest memory of a call."""
    gc.collect()
    tracemalloc.start()
    call()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak / 1e6


def slope(x, y):
    """Return the fitted exponent of y for the sizes at which y is large enough; NaN for fewer than two."""
    x, y = np.asarray(x, float), np.asarray(y, float)
    keep = y >= FACTOR * y[0]
    return np.polyfit(np.log(x[keep]), np.log(y[keep]), 1)[0] if keep.sum() > 1 else np.nan


def main():
    options = arguments(__doc__, [""])
    warnings.simplefilter("ignore", rs.RfpsurveyWarning)
    print(f"{machine()}, one thread")
    for name, (make, sizes) in CASES.items():
        if not any(word in name for word in options.words):
            continue
        make(sizes[0])[1]()  # compile
        n, seconds, memory = [], [], []
        for size in sizes:
            number, call = make(size)
            n.append(number)
            seconds.append(seconds_of(call))
            memory.append(megabytes_of(call))
        keep = np.array(seconds) >= FACTOR * seconds[0]
        log = slope(np.array(n)[keep], (np.array(n) * np.log(n))[keep]) if keep.sum() > 1 else np.nan
        print(f'    "{name}": (')
        for values, form in ((n, "d"), (seconds, ".3g"), (memory, ".3g")):
            print(f"        [{', '.join(format(value, form) for value in values)}],")
        print(f"    ),  # time {slope(n, seconds):.2f}, n log n {log:.2f}, memory {slope(n, memory):.2f}", flush=True)


if __name__ == "__main__":
    main()
