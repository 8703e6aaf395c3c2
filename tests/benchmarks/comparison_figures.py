"""Measure the time of a comparison of all presets, and how often its intervals contain the true value.

Run ``python tests/benchmarks/comparison_figures.py``.
"""

from time import perf_counter

import numpy as np
from measure import timed

import rfpsurvey as rs

ONE = {"n_realizations": 1, "allocators": "lamost_rule"}


def main():
    """Print both results."""
    rs.compare_instruments()  # compile the kernels
    _, seconds = timed(rs.compare_instruments, clock=perf_counter)
    print(f"all presets, four skies, lamost and optimal: {seconds:.1f} s")
    for name in ("sdss_apo", "moons"):
        model = rs.Instrument.preset(name)
        for targets in (1.0, 3.0):
            rows = [
                rs.compare_instruments("poisson", model, targets_per_positioner=targets, rng=seed, **ONE)[0]
                for seed in range(200)
            ]
            value, low, high = (np.array([row[key] for row in rows]) for key in ("probability", "low", "high"))
            held = np.mean((low <= value.mean()) & (value.mean() <= high))
            print(f"{name}, {targets:g} targets a positioner: {value.mean():.4f} is held by {100 * held:.1f} %")


if __name__ == "__main__":
    main()
