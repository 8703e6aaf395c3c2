"""Numbers on the page on benchmarks: the time of allocations, and the targets lost to collisions.

Run ``python tests/benchmarks/allocation_figures.py``, which takes a few minutes on one core. Real fields require
RFPSURVEY_TEST_DATA.
"""

import os
import sys
from pathlib import Path
from time import perf_counter

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord
from measure import hexagon, in_circle
from scipy.sparse.csgraph import maximum_bipartite_matching

import rfpsurvey as rs

sys.path.insert(0, str(Path(__file__).parents[1] / "helpers"))
import flat

REPEATS = 15
# rings, pitch, central and eccentric arm, minimum separation (mm), targets
HEXAGONS = {
    "LAMOST": (36, 25.6, 8.25, 8.25, 4.5, 15988),
    "DESI-like": (40, 10.4, 3, 3, 2.0, 24605),
    "MOONS-like": (18, 25.0, 8, 17, 5.0, 1232),
    "SDSS-V": (36, 22.4, 7.4, 15, 5.0782, 15988),
    "SDSS-V, few targets": (36, 22.4, 7.4, 15, 5.0782, 3997),
}
REQUIRED = ["sky_boss=300", "standard_boss=20", "sky_apogee=50", "standard_apogee=20"]
SKY = ["sky=20/spectrograph", "standard=5/spectrograph"]


def disc(radius, n, seed):
    return in_circle(np.random.default_rng(seed), radius, n)


def median(call, *arguments, repeats=REPEATS, **options):
    """Return the median time of calls after compilation, and the result."""
    result, times = call(*arguments, **options), []
    for _ in range(repeats):
        start = perf_counter()
        result = call(*arguments, **options)
        times.append(perf_counter() - start)
    return np.median(times), result


def hexagons():
    print("full hexagons, one elbow, all targets alike; seeds 0 to 4")
    for name, (rings, pitch, l1, l2, separation, n) in HEXAGONS.items():
        plane = hexagon(l1, l2, separation / 2, pitch, rings)
        floor(plane, disc(0.95 * (rings + 0.5) * pitch, n, 0))
        for seed in range(5):
            xy = disc(0.95 * (rings + 0.5) * pitch, n, seed)
            options = {"parked_obstacles": False}
            seconds, best = median(flat.allocate, plane, xy, allocator="optimal", repeats=5, **options)
            mend_s, repaired = median(flat.allocate, plane, xy, allocator="repair", repeats=5, **options)
            blind = int((maximum_bipartite_matching(plane.reachable(xy), perm_type="column") >= 0).sum())
            rule = flat.allocate(plane, xy, allocator="lamost_rule", **options)
            usable = rule.n_assigned - int(rs.find_collisions(plane, rule).in_collision.sum())
            pairs = len(rs.find_collisions(plane, best).pairs)
            print(
                f"  {name:<20} {best.n_assigned:>5} of {blind}  gap {best.gap:g}  collisions {pairs}  {seconds:.3f} s"
                f"   repair {repaired.n_assigned} in {1e3 * mend_s:.1f} ms   lamost {rule.n_assigned}, usable {usable}"
                f"   {best.meta['n_candidates']} candidates, {best.meta['n_conflicts']} conflicts, "
                f"{best.meta['n_open']} positioners left to the solver"
            )


def floor(plane, xy):
    """Print the time of work that every method must do: finding the reach, and listing the pairs of candidates of
    neighbors.
    """
    seconds, reach = median(plane.reachable, xy)
    size = np.diff(reach.indptr).astype(int)
    pairs = plane.neighbor_pairs()
    n_pairs = int((size[pairs[:, 0]] * size[pairs[:, 1]]).sum())
    print(f"  reach {1e3 * seconds:.1f} ms, {n_pairs} pairs of candidates to look at")


def rules():
    print("100,000 targets over LAMOST")
    plane = rs.Instrument.preset("lamost").focal_plane
    xy = disc(873.0, 100_000, 1)
    kind = np.where(np.arange(100_000) % 50 == 0, "standard", "science")
    for name in ("balanced", "nearest", "lamost_rule"):
        seconds, _ = median(flat.allocate, plane, xy, allocator=name)
        print(f"  {name:<10} {1e3 * seconds:.1f} ms")
    options = {"kind": kind, "requirements": SKY, "sky_separation": 1 * u.mm}
    seconds, found = median(flat.allocate, plane, xy, allocator="lamost_rule", **options)
    print(f"  lamost with sky and standards {1e3 * seconds:.1f} ms, {len(found.unmet)} requirements not met")
    for name in ("network_flow", "optimal"):
        seconds, found = median(flat.allocate, plane, xy, allocator=name, repeats=3)
        print(f"  {name:<10} {seconds:.3f} s, {found.n_assigned} positioners, gap {found.gap:g}")
        seconds, found = median(flat.allocate, plane, xy, allocator=name, repeats=3, **options)
        print(f"  {name:<10} {seconds:.3f} s with sky and standards, gap {found.gap:g}")
    for n in (50_000, 100_000):
        plane = hexagon(7.4, 15, 2.5391, 22.4, 36)
        seconds, found = median(flat.allocate, plane, disc(776.0, n, 0), allocator="optimal", repeats=1)
        print(f"  optimal, {n} targets over 3997 SDSS-V arms {seconds:.1f} s, gap {found.gap:g}")


def classes():
    print("presets and priority classes: seconds of optimal, once each (gap where it is not proven within 60 s)")
    rng = np.random.default_rng(0)
    for name in ("lamost", "sdss_apo", "moons", "desi", "pfs"):
        model = rs.Instrument.preset(name)
        plane = model.focal_plane
        n = int(4 * len(plane))
        xy = disc(np.hypot(*plane.xy.to_value(u.mm).T).max(), n, 0)
        types = None if plane.fiber_types == ("",) else rng.choice(plane.fiber_types, n)
        cells = []
        for k in (1, 3, 10, 100, n):
            options = {"method": "optimal", "priority": rng.integers(0, k, n), "fiber_type": types}
            start = perf_counter()
            found = flat.allocate(plane, xy, **options)
            cells.append(f"{k} classes {perf_counter() - start:.2f} s" + (f" gap {found.gap:.4f}" if found.gap else ""))
        print(f"  {name:<10} " + "   ".join(cells), flush=True)


def fields(folder):
    catalog = rs.Catalog.read(folder / "sdssv_robostrategy_field_a.ecsv")
    options = {"position_angle": 40 * u.deg, "requirements": REQUIRED}
    print("an SDSS-V field with its requirements (its own planner assigned 494 of 500)")
    center = SkyCoord(269.59, 66.55, unit="deg")
    seconds, tile = median(flat.plan_tile, catalog, "sdss_apo", center, allocator="optimal", repeats=3, **options)
    print(f"  optimal: {tile.summary['n_assigned']} assigned, gap {tile.summary['gap']}, {seconds:.2f} s in all")
    show(catalog, "sdss_apo", center, **options)
    for name, file in (("moons", "zcosmos_bright.ecsv"), ("lamost", "tycho2_pleiades_r4.ecsv")):
        catalog = rs.Catalog.read(folder / file)
        print(file)
        show(catalog, name, catalog.mean_direction)
    print("tycho2_anticentre_r8.ecsv.gz, M35")
    show(rs.Catalog.read(folder / "tycho2_anticentre_r8.ecsv.gz"), "lamost", SkyCoord(92.25, 24.35, unit="deg"))


def show(catalog, name, center, **options):
    own, others = flat.split("lamost_rule", options)
    table = rs.compare_allocators(catalog, name, center, options=own, **others)
    for column in ("loss", "seconds"):
        table[column].info.format = ".4f"
    print("\n".join(table.pformat(max_lines=-1, max_width=-1)))


if __name__ == "__main__":
    hexagons()
    rules()
    classes()
    if os.environ.get("RFPSURVEY_TEST_DATA"):
        fields(Path(os.environ["RFPSURVEY_TEST_DATA"]))
