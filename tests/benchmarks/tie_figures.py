"""What the rules for ties of ``optimal`` cost, and which targets a requirement selects (page on target allocation).

Run ``python tests/benchmarks/tie_figures.py``, which takes about two minutes. Times are medians of alternating runs.
"""

import os

os.environ.setdefault("NUMBA_NUM_THREADS", "1")

from functools import partial

import astropy.units as u
import numpy as np
from measure import alternated, in_circle

import rfpsurvey as rs

N_RUNS = 5


def scene(name, density, seed=3):
    """Return the focal plane of a preset, and targets that are uniform in a circle around it."""
    plane = rs.Instrument.preset(name).focal_plane
    radius = np.hypot(*plane.xy.to_value(u.mm).T).max() + plane.arrays.outer_radius.max()
    return plane, in_circle(np.random.default_rng(seed), radius, int(density * len(plane)))


def costs():
    print("processor time of optimal in ms: ties by the hash, and largest sum of random subpriorities")
    for name in ("lamost", "sdss_apo", "moons", "pfs", "desi"):
        for density in (1, 2, 5):
            plane, xy = scene(name, density)
            options = [rs.AllocationOptions("optimal", subpriority=seed) for seed in (None, 0)]
            times = alternated([partial(rs.allocate, plane, xy, allocator=one) for one in options], N_RUNS)
            hashed, exact = 1e3 * np.median(times, axis=0)
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
