"""Measure how often the interval contains the true value if collisions are rare, for the page on probability.

``python tests/benchmarks/rare_collisions.py`` takes a minute on one core.
"""

import numpy as np
from measure import hexagon

import rfpsurvey as rs
from rfpsurvey.probability import Precision

REPEATS = 500


def main():
    for pitch, n in ((33.0, 100_000), (35.0, 100_000), (36.5, 400_000)):
        plane = hexagon(8.25, 8.25, 2.25, pitch, 2)
        truth = rs.collision_probability(plane, precision=Precision(max_iterations=n), rng=99)
        found = [rs.collision_probability(plane, precision=1e-3, rng=k) for k in range(REPEATS)]
        held = np.mean([e.low <= truth.value <= e.high for e in found])
        iterations = np.median([e.n for e in found])
        print(
            f"pitch {pitch} mm: p = {truth.value:.2g} +- {truth.standard_error:.1g}, held {held:.3f}, "
            f"{iterations:.0f} realizations"
        )


if __name__ == "__main__":
    main()
