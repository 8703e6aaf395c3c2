"""Numbers on the page on benchmarks: the time that each method takes to reach a precision.

``python tests/benchmarks/probability_figures.py`` takes a few minutes on one core.
"""

from time import perf_counter

import astropy.units as u
import numpy as np
from measure import hexagon, timed

import rfpsurvey as rs
from rfpsurvey.probability import Precision, RandomTargets

N_TARGETS, STANDARD_ERROR, REPEATS = 20_000, 2e-4, 9
ARMS = {"LAMOST": (8.25, 8.25, 2.25, 25.6), "SDSS-V": (7.4, 15.0, 2.5391, 22.4)}


def medians(*calls):
    """Return the median times (s) of functions that are called alternately with different random numbers, and their
    results.
    """
    for call in calls:
        call(0)
    runs = [[timed(call, k, clock=perf_counter) for call in calls] for k in range(1, REPEATS + 1)]
    return [(np.median([r[j][1] for r in runs]), [r[j][0] for r in runs]) for j in range(len(calls))]


def compare(plane):
    """Print the times of plain simulation, conditional simulation and quadrature."""

    targets = RandomTargets(number=N_TARGETS)

    def estimate(**options):
        return lambda seed: rs.collision_probability(plane, rng=seed, **{"targets": targets, **options})

    runs = medians(
        estimate(method="monte_carlo", precision=Precision(max_iterations=640)),
        estimate(method="conditional", precision=Precision(max_iterations=32)),
    )
    numbers, times = [], []
    for method, size, (seconds, found) in zip(("monte_carlo", "conditional"), (640, 32), runs, strict=True):
        numbers.append(np.mean([e.n * e.standard_error**2 for e in found]) / STANDARD_ERROR**2)
        times.append(numbers[-1] * seconds / size)
        print(
            f"  {method}: {1e3 * seconds / size:.2f} ms each, {numbers[-1]:.0f} to a standard error of "
            f"{STANDARD_ERROR:g}: {times[-1]:.3f} s"
        )
    print(f"  ratio: {numbers[0] / numbers[1]:.0f} in number, {times[0] / times[1]:.0f} in time")
    both = medians(estimate(method="conditional", precision=STANDARD_ERROR), estimate(precision=STANDARD_ERROR))
    for name, (seconds, found) in zip(("conditional", "auto"), both, strict=True):
        n = np.median([e.n for e in found])
        print(f"  {name} with precision {STANDARD_ERROR:g}: {seconds:.3f} s, {n:.0f} realizations")
    value = rs.collision_probability(plane, method="quadrature").value
    ((seconds, found),) = medians(estimate(method="quadrature", targets="uniform", precision=1e-3 * value))
    error = max(e.standard_error / e.value for e in found)
    print(f"  quadrature to 1e-3: {seconds:.3f} s, {found[0].value:.5f}, largest relative standard error {error:.1e}")
    options = {"targets": RandomTargets(number=len(plane)), "precision": Precision(max_iterations=256)}
    sparse = medians(estimate(method="conditional", **options), estimate(method="monte_carlo", **options))
    worth = [np.mean([e.standard_error**2 for e in found]) * seconds for seconds, found in sparse]
    print(f"  {len(plane)} targets: conditional takes {worth[0] / worth[1]:.2f} times as long to a precision")


def main():
    for name, arms in ARMS.items():
        plane = hexagon(*arms, 12)
        print(f"{name}: {len(plane)} positioners, {len(plane.neighbor_pairs())} pairs, {N_TARGETS} targets")
        compare(plane)
    plane = hexagon(*ARMS["LAMOST"], 12)
    discs = RandomTargets("poisson_disc", number=N_TARGETS, radius=200 * u.mm, min_separation=1.5 * u.mm)
    options = {"targets": discs, "method": "monte_carlo", "precision": Precision(max_iterations=16)}
    ((seconds, _),) = medians(lambda seed: rs.collision_probability(plane, rng=seed, **options))
    print(f"Poisson-disc targets, 1.5 mm apart, with the simulation: {1e3 * seconds / 16:.1f} ms a set")
    l1 = np.random.default_rng(1).uniform(7.25, 14.5, 100_000) * u.mm
    ((seconds, _),) = medians(lambda seed: rs.probability.surrogate_probability(l1, 1.5 * l1, 30 * u.mm, 4.5 * u.mm))
    print(f"surrogate: {1e6 * seconds / len(l1):.2f} microseconds a design")


if __name__ == "__main__":
    main()
