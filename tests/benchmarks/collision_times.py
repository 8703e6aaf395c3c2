"""Processor times of the methods of finding collisions, for the tables of speed and accuracy of the page on benchmarks.

``python tests/benchmarks/collision_times.py`` takes two minutes. ``rfpsurvey benchmark collisions`` measures the same
calls, but elapsed times, which other jobs on the machine change. The methods take turns, and each method alternates
between 50 configurations, so that the branch prediction of the processor does not adapt to one of them. The shortest
of the times of all turns is printed.
"""

from dataclasses import replace
from time import process_time

import numpy as np

import rfpsurvey as rs
from rfpsurvey._studies.benchmark_collisions import COMPARED, _case
from rfpsurvey._studies.benchmark_probability import random_tips

RUNS = [("exact", 2), ("endpoints", 2), *(("sampled", n) for n in (3, 5, 9, 65)), ("every_pair", 2)]
RUNS += [("shapely", 2), ("scipy", 2), ("sweep", 65)]
SLOW = {"sweep": 2, "scipy": 10}
"""Numbers of configurations for slow methods."""
TURNS = 25


def main():
    for name in ("lamost", "sdss_apo"):
        plane, rng = rs.Instrument.preset(name).focal_plane, np.random.default_rng(0)
        cases = [_case(plane, random_tips(plane, rng)) for _ in range(50)]
        times = {run: [] for run in RUNS}
        for turn in range(TURNS):
            for method, n in (RUNS[k] for k in rng.permutation(len(RUNS))):
                if method == "sweep" and turn > 3:
                    continue
                own = [replace(case, n_points=n) for case in cases[: SLOW.get(method, len(cases))]]
                begin = process_time()
                for case in own:
                    COMPARED[method].function(case)
                times[method, n].append((process_time() - begin) / len(own))
        least = {run: min(found[1:]) for run, found in times.items()}  # the first turn compiles
        for (method, n), seconds in least.items():
            label = f"{method} {n}" if COMPARED[method].numbers_of_points else method
            print(f"{name:9} {label:12} {1e3 * seconds:9.4g} ms, ratio {seconds / least['exact', 2]:8.3g}", flush=True)


if __name__ == "__main__":
    main()
