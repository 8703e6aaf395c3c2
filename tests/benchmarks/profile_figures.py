"""Print the times of the page "Computing time of each stage": stages of calls, and their lower limits.

python tests/benchmarks/profile_figures.py [tile] [collisions] [configurations] [survey] [modules] [start]

All times are the smallest of many repetitions. The survey requires the file ``desi_tiles_main.ecsv.gz`` in the folder
RFPSURVEY_TEST_DATA.
"""

import os
import resource
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from time import perf_counter, process_time

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord
from measure import TILES, machine, smallest
from selection_figures import MIDDLE, some_tiles

import rfpsurvey as rs
from rfpsurvey._instruments.arms import nearest_distance
from rfpsurvey._kernels import collisions as kernels
from rfpsurvey.collision import place_arms

CENTER = SkyCoord(180 * u.deg, 30 * u.deg)
N_TILES, DENSITY = 300, 1500


def smallest_ms(call, n=200):
    return 1e3 * smallest(call, n)


def show(name, ms):
    print(f"  {name:44} {ms:8.3f} ms", flush=True)


def bandwidth():
    """Return the bandwidth (bytes per ms) of copies of arrays in the memory and in the cache."""
    rates = []
    for size, n in ((1 << 25, 10), (1 << 15, 2000)):
        source, target = np.ones(size), np.ones(size)
        rates.append(16 * size / smallest_ms(lambda s=source, t=target: np.copyto(t, s), n))
    return rates


def tile():
    """Print the stages of one tile of LAMOST with 100,000 targets, and the time to read and write its arrays."""
    lamost = rs.Instrument.preset("lamost")
    catalog = rs.synthetic_catalog("uniform", CENTER, 2.5 * u.deg, n_targets=100_000, rng=1)
    plane, stages, total = lamost.focal_plane, {}, np.inf
    for _ in range(60):
        begin = perf_counter()
        found = rs.plan_tile(catalog, lamost, center=CENTER, allocator="lamost_rule")
        total = min(total, perf_counter() - begin)
        for name, value in found.summary["seconds"].items():
            stages[name] = min(stages.get(name, np.inf), value)
    print("plan_tile, LAMOST, 100,000 targets, allocator lamost_rule")
    for name, value in stages.items():
        show(name, 1e3 * value)
    show("rest", 1e3 * (total - sum(stages.values())))
    show("whole call", 1e3 * total)
    targets = found.outcomes
    xy = np.column_stack([targets["x"].to_value(u.mm), targets["y"].to_value(u.mm)])
    pairs = plane.arrays.reach(xy)
    posed = rs.allocate(plane, xy * u.mm, allocator="balanced").place_arms(plane)
    show("of which clearances", smallest_ms(lambda: nearest_distance(plane, posed)))
    show("of which pairs in reach alone", smallest_ms(lambda: plane.arrays.reach(xy)))
    # vectors are read twice and written once, positions written and read twice, pairs (17 bytes) written and read
    size = 3 * 24 * len(xy) + 4 * 16 * len(xy) + 2 * 17 * len(pairs.owner)
    memory, cache = bandwidth()
    for kind, rate in (("memory", memory), ("cache", cache)):
        print(f"  {size / 1e6:.1f} MB take {size / rate:.2f} ms at the {rate / 1e6:.0f} GB/s of the {kind}")


def random_tips(n_configurations):
    """Yield the names of LAMOST and SDSS-V, lattices of 3997 of their positioners, and random tips."""
    for name, pitch in (("lamost", 25.6), ("sdss_apo", 22.4)):
        # with one fiber per positioner, the arm extends in the direction of the fiber
        positioner = replace(rs.Instrument.preset(name).focal_plane.positioner, arm_angle=None)
        plane = rs.FocalPlane.hexagonal(positioner, rings=36, pitch=pitch * u.mm)
        columns, rng, shape = plane.arrays, np.random.default_rng(1), (n_configurations, len(plane))
        low, high = columns.inner_radius + 1e-3, columns.outer_radius - 1e-3
        r, angle = low + (high - low) * rng.random(shape), rng.uniform(0, 2 * np.pi, shape)
        yield name, plane, (columns.xy + np.stack([r * np.cos(angle), r * np.sin(angle)], axis=-1)) * u.mm


def collisions():
    """Print the stages of find_collisions for 3997 arms of LAMOST and of SDSS-V."""
    for name, plane, many in random_tips(1):
        tips, columns = many[0], plane.arrays
        segments = np.ascontiguousarray(place_arms(plane, tips).segments.T)
        n = len(columns.neighbors)
        halves, scratch = np.empty_like(segments), (np.empty(n, np.int64), np.empty(n, np.int64), np.empty(n))
        kernels.halve(segments, halves)
        args = segments, halves, columns.runs, columns.limits, *scratch
        print(f"find_collisions, {name}, {len(plane)} positioners, {n} pairs of neighbors")
        kernel = smallest_ms(lambda args=args: kernels.colliding_pairs(*args), 2000)
        show("whole call", smallest_ms(lambda plane=plane, tips=tips: rs.find_collisions(plane, tips), 2000))
        show("of which the kernel", kernel)
        print(f"  {1e6 * kernel / n:.2f} ns per pair of neighbors")


def configurations():
    """Print the time of count_collisions for 10,000 configurations, in two threads."""
    for name, plane, tips in random_tips(1000):
        with ThreadPoolExecutor(2) as pool:
            ms = smallest_ms(
                lambda pool=pool, plane=plane, tips=tips: rs.collision.count_collisions(plane, tips, executor=pool), 15
            )
        print(f"count_collisions, {name}, {len(plane)} positioners, two threads")
        show("10,000 configurations", 10 * ms)


def start():
    """Print the times of commands: the first call of ``plan``, which compiles kernels, later calls, and the help."""
    print("commands")
    for allocator in ("lamost_rule", "repair"):
        with tempfile.TemporaryDirectory() as folder:
            env, words = {**os.environ, "NUMBA_CACHE_DIR": folder}, ["plan", "--allocator", allocator]
            show_command(f"first plan, {allocator}", words, env, 1)
            show_command(f"later plan, {allocator}", words, env, 7)
    for option in ("--help", "--version"):
        show_command(option, [option], os.environ, 7)


def show_command(name, words, env, n):
    """Print the smallest processor time and elapsed time of n calls of a command."""
    times = []
    for _ in range(n):
        before, begin = resource.getrusage(resource.RUSAGE_CHILDREN), perf_counter()
        subprocess.run([sys.executable, "-m", "rfpsurvey", *words], env=env, check=True, capture_output=True)
        wall, after = perf_counter() - begin, resource.getrusage(resource.RUSAGE_CHILDREN)
        times.append((sum(getattr(after, key) - getattr(before, key) for key in ("ru_utime", "ru_stime")), wall))
    print(f"  {name:44} {min(times)[0]:8.2f} s of processor time, {min(t[1] for t in times):.2f} s in all")


def survey():
    """Print the processor time per tile of the tiles of DESI near a position."""
    if not TILES.exists():
        print("no survey: desi_tiles_main.ecsv.gz is not in RFPSURVEY_TEST_DATA")
        return
    tiling = some_tiles(rs.Tiling.read(TILES), N_TILES)
    targets = rs.synthetic_catalog("uniform", MIDDLE, 15 * u.deg, density=DENSITY / u.deg**2, rng=1)
    for allocator in ("nearest", "repair"):
        print(f"plan_survey, {len(tiling)} tiles of DESI, {len(targets)} targets, allocator {allocator}")
        for name in ("with files", "without files"):
            times = []
            for _ in range(5):  # the first repetition compiles the kernels
                with tempfile.TemporaryDirectory() as folder:
                    begin, where = process_time(), Path(folder) / "survey" if name == "with files" else None
                    rs.plan_survey(targets, "desi", tiling, allocator=allocator, folder=where)
                    times.append(process_time() - begin)
            show(f"processor time per tile, {name}", 1e3 * min(times) / len(tiling))


def modules():
    """Print the time of a tile of MUST with a requirement for each module."""
    must = rs.Instrument.preset("must")
    sky = rs.synthetic_catalog("uniform", CENTER, must.field_radius, n_targets=60_000, rng=1)
    options = rs.AllocationOptions(requirements="sky=2/module", sky_separation=3 * u.arcsec)
    print(f"plan_tile, MUST, {len(sky)} targets, two sky positions per module, allocator repair")
    show("whole call", smallest_ms(lambda: rs.plan_tile(sky, must, center=CENTER, allocator=options), 2))


CASES = {f.__name__: f for f in (tile, collisions, configurations, survey, modules, start)}


def main():
    print(machine())
    for name in sys.argv[1:] or CASES:
        CASES[name]()


if __name__ == "__main__":
    main()
