"""What the rules for ties of ``optimal`` cost, and which targets a requirement selects (page on target allocation).

Run ``python tests/benchmarks/tie_figures.py``, which takes about two minutes. Times are medians of alternating runs.
"""

import os

os.environ.setdefault("NUMBA_NUM_THREADS", "1")

from time import process_time

import astropy.units as u
import numpy as np

import rfpsurvey as rs

N_RUNS = 5


def scene(name, density, seed=3):
    """Return the focal plane of a preset, and targets that are uniform in a circle around it."""
    plane = rs.Instrument.preset(name).focal_plane
    rng, n = np.random.default_rng(seed), int(density * len(plane))
    radius = np.hypot(*plane.xy.to_value(u.mm).T).max() + plane.arrays.outer_radius.max()
    r, angle = radius * np.sqrt(rng.random(n)), rng.uniform(0, 2 * np.pi, n)
    return plane, np.column_stack([r * np.cos(angle), r * np.sin(angle)]) * u.mm


def costs():
    print("processor time of optimal in ms: ties by the hash, and largest sum of random subpriorities")
    for name in ("lamost", "sdss_apo", "moons", "pfs", "desi"):
        for density in (1, 2, 5):
            plane, xy = scene(name, density)
            times = {None: [], 0: []}
            for _ in range(N_RUNS + 1):
                for seed, found in times.items():
                    begin = process_time()
                    rs.allocate(plane, xy, allocator=rs.AllocationOptions("optimal", subpriority=seed))
                    found.append(1e3 * (process_time() - begin))
            hashed, exact = (np.median(found[1:]) for found in times.values())
            print(
                f"  {name:<9} {density} targets per positioner: {hashed:6.0f} {exact:6.0f}, ratio {exact / hashed:.1f}"
            )


def requirements():
    print("targets of category A: without a requirement, with requirements for fewer and for more of them")
    for name, density in (("sdss_apo", 2), ("desi", 2)):
        plane, xy = scene(name, density)
        for seed in range(3):
            category = np.random.default_rng(seed).choice(["A", "B"], len(xy))

            def count(*asked, plane=plane, xy=xy, category=category):
                options = rs.AllocationOptions("optimal", requirements=list(asked))
                used = rs.allocate(plane, xy, allocator=options, category=category).target_of_positioner
                return int((category[used[used >= 0]] == "A").sum()), int((used >= 0).sum())

            n, total = count()
            more = {k: count(f"A={n + k}")[0] for k in (-20, -5, 5)}
            print(f"  {name:<9} {n} of {total}; " + ", ".join(f"A={n + k}: {m}" for k, m in more.items()))


if __name__ == "__main__":
    costs()
    requirements()
