"""Time of kaiju and of rfpsurvey to find all colliding pairs of 3997 arms, side by side.

``python tests/benchmarks/kaiju_calls.py`` prints the medians of the processor time and their ratio for the arms of
LAMOST and SDSS-V. Blocks of 10 of 20 configurations alternate between the programs, and each configuration is measured
twice in succession. rfpsurvey: `find_collisions`, from the positions of the fibers (quantities) to the report. kaiju:
``robotColliders`` of each robot, with the poses already set; the time to set the poses is separate. Install kaiju as
described in ``tests/benchmarks/planners/sdss_kaiju.py``.
"""

from collections import defaultdict
from statistics import median

import astropy.units as u
import numpy as np
from measure import arguments, hexagon, timed

import rfpsurvey as rs
from kaiju_grid import make_grid, set_poses
from rfpsurvey._studies.benchmark_probability import random_tips
from rfpsurvey.collision import place_arms

BLOCK = 10
"""Configurations that one program receives, before the other program receives them."""
GEOMETRIES = {"lamost": (8.25, 8.25, 2.25, 25.6, 36), "sdss": (7.4, 15.0, 2.5, 22.4, 36, 0.1)}


def compare(name: str, repeats: int) -> None:
    """Print the medians of both programs for one geometry."""
    plane = hexagon(*GEOMETRIES[name])
    rng, grid, times = np.random.default_rng(1), make_grid(plane), defaultdict(list)
    many = [random_tips(plane, rng) * u.mm for _ in range(20)]
    rs.find_collisions(plane, many[0])  # compile
    arms = [place_arms(plane, tips) for tips in many]
    numbers = range(len(plane))
    for block in range(repeats):
        some = [(BLOCK * block + k) % len(many) for k in range(BLOCK)]
        for k in some:
            for again in ("", ", again"):
                report, spent = timed(lambda k=k: rs.find_collisions(plane, many[k]))
                times["rfpsurvey" + again].append(spent)
        for k in some:
            times["set poses"].append(timed(lambda k=k: set_poses(grid, arms[k].theta, arms[k].phi))[1])
            for again in ("", ", again"):
                found, spent = timed(lambda: [grid.robotColliders(i) for i in numbers])
                times["kaiju" + again].append(spent)
        if [sorted(one) for one in found] != report.colliding_with:
            raise RuntimeError(f"{name}: kaiju and rfpsurvey must find the same pairs, got others")
    middle = {key: 1e3 * median(values) for key, values in times.items()}
    print(f"{name}: {len(plane)} arms, setting the poses of kaiju takes {middle['set poses']:.1f} ms")
    for again, label in (("", "new poses"), (", again", "same poses again")):
        ours, other = middle["rfpsurvey" + again], middle["kaiju" + again]
        print(f"  {label}: rfpsurvey {ours:.3f} ms, kaiju {other:.2f} ms, ratio {other / ours:.0f}")


def main() -> None:
    """Print the comparison."""
    given = arguments(__doc__, repeats=20)
    for name in GEOMETRIES:
        compare(name, given.repeats)


if __name__ == "__main__":
    main()
