"""Measure the bias of the mean of many estimates if collisions are rare, for the page on probability.

The scene is seven positioners with two Poisson targets and a precision of 0.01. ``python
tests/benchmarks/stopping_bias.py`` takes three minutes on one core.
"""

import numpy as np
from measure import hexagon

import rfpsurvey as rs
from rfpsurvey.probability import Precision, RandomTargets

PRECISION, REPEATS = 0.01, 4000


def main():
    for pitch in (24, 28, 32, 36, 40):
        plane = hexagon(7.4, 15, 2.5, pitch, 1, 0.1)
        options = {"method": "monte_carlo", "targets": RandomTargets("poisson", number=2)}
        truth = rs.collision_probability(plane, precision=Precision(max_iterations=1_000_000), rng=1, **options)
        seeds = np.random.default_rng(5).spawn(REPEATS)
        found = [rs.collision_probability(plane, precision=PRECISION, rng=rng, **options) for rng in seeds]
        values, n = (np.array([getattr(e, name) for e in found]) for name in ("value", "n"))
        error = np.hypot(values.std() / np.sqrt(REPEATS), truth.standard_error)
        held = np.mean([e.low <= truth.value <= e.high for e in found])
        bias = values.mean() - truth.value
        print(
            f"pitch {pitch} mm: p = {truth.value:.5f}; mean of the estimates "
            f"{100 * bias / truth.value:+.1f} +- {100 * error / truth.value:.1f} %, {bias / PRECISION:+.3f} of the "
            f"precision; interval holds {held:.3f}; {np.median(n):.0f} iterations"
        )


if __name__ == "__main__":
    main()
