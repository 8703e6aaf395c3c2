"""Numbers on the page on benchmarks about ``optimal``: gap and time of large problems, and compliance with time limits.

Run ``python tests/benchmarks/optimum_figures.py``, which takes about an hour on two cores. ``--only NAME`` runs one
part: ``large`` (40,000 positioners), ``sizes`` (1,000 to 100,000 positioners), ``clock`` (random scenes and time
limits), ``oracle`` (small scenes against an independent integer program) or ``quality`` (the number of targets against
the time limit).
"""

import sys
from pathlib import Path
from time import perf_counter, process_time

import astropy.units as u
import measure
import numpy as np
from measure import arguments, in_circle, peak_gb

import rfpsurvey as rs
from rfpsurvey._assignment import search as _search

sys.path.insert(0, str(Path(__file__).parents[1] / "helpers"))
from brute import edges_alone

# pitch, central and eccentric arm, minimum separation (mm)
ARMS = {"LAMOST": (25.6, 8.25, 8.25, 4.5), "SDSS-V": (22.4, 7.4, 15, 5.0782)}


def hexagon(arms, rings, multiplicity, seed):
    """Return a full hexagon of positioners, and targets that are uniform in the circle around it."""
    pitch, central, eccentric, separation = arms
    plane = measure.hexagon(central, eccentric, separation / 2, pitch, rings)
    n = max(round(multiplicity * len(plane)), 1)
    return plane, in_circle(np.random.default_rng(seed), (rings + 0.5) * pitch, n)


def solve(plane, xy, seconds, allocator="optimal"):
    """Return the plan, and its wall-clock time and processor time in seconds."""
    begin, begin_cpu = perf_counter(), process_time()
    found = rs.allocate(plane, xy, allocator=rs.AllocationOptions(allocator, time_limit=seconds * u.s))
    return found, perf_counter() - begin, process_time() - begin_cpu


def large():
    print("40,021 positioners, limit 60 s")
    for name, arms in ARMS.items():
        for multiplicity in (1, 4):
            scene = hexagon(arms, 115, multiplicity, 0)
            found, wall, cpu = solve(*scene, 60)
            n_pairs = len(rs.find_collisions(scene[0], found).pairs)
            print(
                f"  {name:<7} {multiplicity}: {found.n_assigned} of {found.bound:g}, gap {found.gap:.5f}, {wall:.1f} s "
                f"({cpu:.1f} s of processor time), {peak_gb():.2f} GB, {n_pairs} collisions"
            )


def sizes():
    print("SDSS-V arms, one target per positioner, limit 60 s")
    for rings in (18, 26, 36, 57, 81, 115, 182):
        scene = hexagon(ARMS["SDSS-V"], rings, 1, 0)
        found, wall, cpu = solve(*scene, 60)
        print(f"  {len(scene[0]):>6}  gap {found.gap:.5f}  {wall:.2f} s ({cpu:.2f} s)  {peak_gb():.2f} GB")


def clock(n_scenes, seed=0):
    """Print the seconds over the limit for random scenes: arms of 0.5 to 3.5 pitches, up to 50 targets each."""
    rng, over = np.random.default_rng(seed), []
    print("pitches, targets per positioner, positioners, limit, seconds over the limit, gap")
    for k in range(n_scenes):
        reach, multiplicity = rng.uniform(0.5, 3.5), 10 ** rng.uniform(np.log10(0.2), np.log10(50))
        rings = round(np.sqrt(10 ** rng.uniform(np.log10(50), np.log10(40_000)) / 3))
        seconds, share = 10 ** rng.uniform(-1, np.log10(60)), rng.uniform(0.3, 0.7)
        arms = (10.0, 10 * reach * share, 10 * reach * (1 - share), rng.uniform(1, 3))
        scene = hexagon(arms, rings, multiplicity, k)
        found, _, cpu = solve(*scene, seconds)
        late = found.seconds["allocation"] - seconds
        over.append(late - max(0.05 * seconds, 0.5))
        print(
            f"  {k:>3} {reach:.2f} {multiplicity:5.1f} {len(scene[0]):>6} {seconds:6.2f} {late:+7.2f} "
            f"reach {found.seconds['reach']:.2f} s, {cpu:.1f} s of processor time, gap {found.gap:.4f} "
            f"{peak_gb():.2f} GB{' LATE' if over[-1] > 0 else ''}",
            flush=True,
        )
    print(f"{(np.array(over) > 0).sum()} of {n_scenes} later than promised, at worst {max(over):.2f} s")


def oracle(n_scenes, seed=0):
    """Compare plans and bounds in small scenes with the optimum of a program with one constraint per collision."""
    rng, counts = np.random.default_rng(seed), dict.fromkeys(("proven", "not proven", "reference not solved"), 0)
    for k in range(n_scenes):
        reach, multiplicity = rng.uniform(0.5, 3.5), 10 ** rng.uniform(np.log10(0.2), np.log10(5))
        share, separation, rings = rng.uniform(0.3, 0.7), rng.uniform(1, 3), int(rng.integers(1, 5))
        plane, xy = hexagon((10.0, 10 * reach * share, 10 * reach * (1 - share), separation), rings, multiplicity, k)
        best = edges_alone(plane, xy.value, True, seconds=5)
        if best is None:
            counts["reference not solved"] += 1
            continue
        for seconds in (0.02, 10 ** rng.uniform(-1, 0.5)):
            found, _, _ = solve(plane, xy, seconds)
            assert found.n_assigned <= best <= found.bound, (k, seconds, found.n_assigned, best, found.bound)
            assert len(rs.find_collisions(plane, found).pairs) == 0
            counts["proven" if found.gap == 0 else "not proven"] += 1
    print(f"no plan above and no bound below the optimum of an independent program, {n_scenes} scenes: {counts}")


def quality():
    print("number of targets against the time limit")
    for arms, multiplicity in ((ARMS["SDSS-V"], 1), (ARMS["SDSS-V"], 2), ((10.0, 10, 15, 3.0), 1)):
        plane, xy = hexagon(arms, 57, multiplicity, 0)
        for name in ("lamost_rule", "repair"):
            found, wall, _ = solve(plane, xy, 60, name)
            usable = found.n_assigned - int(rs.find_collisions(plane, found).in_collision.sum())
            print(f"  {arms} {multiplicity} {name}: {usable} without collisions after {wall:.2f} s")
        for seconds in (0.5, 1, 2, 4, 8, 16, 32):
            found, wall, _ = solve(plane, xy, seconds)
            print(f"  {arms} {multiplicity} optimal, {seconds} s: {found.n_assigned} of {found.bound:g}, {wall:.2f} s")


def main():
    given = arguments(__doc__, only="", scenes=200)
    largest, _search.LARGEST = _search.LARGEST, 0  # compiles all kernels
    solve(*hexagon(ARMS["SDSS-V"], 8, 1, 0), 5)
    solve(*hexagon((10.0, 10, 15, 3.0), 3, 50, 0), 5)
    _search.LARGEST = largest
    for part in (large, sizes, quality):
        if given.only in ("", part.__name__):
            part()
    for part in (clock, oracle):
        if given.only in ("", part.__name__):
            part(given.scenes)


if __name__ == "__main__":
    main()
