"""Times on which the default method of collision probabilities depends: ``conditional`` against ``monte_carlo``.

``python tests/benchmarks/automatic_figures.py`` takes about 20 minutes on one core. For each preset and several numbers
of targets per positioner, it prints the time of ``conditional`` divided by the time of ``monte_carlo``. For many
targets per positioner, it prints the time of ``conditional`` with ``most_entries`` divided by the time without it. Each
ratio is printed twice: for the same small standard error, and for calls with a precision of 0.001, which have a minimum
number of realizations. The time to a small standard error is the median time of a realization, multiplied by the
variance of the collision rate of a realization; its uncertainty is a standard error over the repeats. The settings are
called alternately.
"""

from time import perf_counter

import numpy as np
from measure import arguments

import rfpsurvey as rs
from rfpsurvey.probability import Precision, RandomTargets

PRESETS = ("sdss_apo", "moons", "desi", "lamost")
EACH, MANY, ENTRIES = [1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 6.0], [40.0], [8, 12, 16, 24, 32]
LARGE, N_DRAWN, N_AVERAGED = 2000, (256, 64), (32, 8)
"""Number of positioners of a large plane, and numbers of realizations of one call for small and for large planes."""


def timed(instrument, number, options, precision, rng):
    """Return the time (s) of one estimate, and the estimate."""
    begin = perf_counter()
    targets = RandomTargets(number=number)
    found = rs.collision_probability(instrument, targets=targets, precision=precision, rng=rng, **options)
    return perf_counter() - begin, found


def ratios(instrument, number, settings, repeats, precision):
    """Return the times of all settings but the last, divided by the time of the last.

    The result has three rows: the ratios for the same small standard error, their uncertainties, and the ratios of the
    median times of calls with a precision.
    """
    seconds, variance, whole = np.empty((3, repeats, len(settings)))
    large = len(instrument.focal_plane) >= LARGE
    for repeat in range(-1, repeats):  # the first calls, which are not counted, compile or load the kernels
        for column, options in enumerate(settings):
            n = (N_DRAWN if options["method"] == "monte_carlo" else N_AVERAGED)[large]
            spent, found = timed(instrument, number, options, Precision(max_iterations=n), repeat + 1)
            seconds[repeat, column], variance[repeat, column] = spent / n, n * found.standard_error**2
            if repeat < 5:
                whole[repeat, column], _ = timed(instrument, number, options, precision, repeat + 1)
    work = np.median(seconds, axis=0) * variance.mean(axis=0)
    error = variance.std(axis=0, ddof=1) / variance.mean(axis=0) / np.sqrt(repeats)
    found, whole = work[:-1] / work[-1], np.median(whole[: min(5, repeats)], axis=0)
    return found, found * np.hypot(error[:-1], error[-1]), whole[:-1] / whole[-1]


def main():
    many = {"each": EACH, "many": MANY, "entries": ENTRIES}
    given = arguments(__doc__, PRESETS, **many, repeats=15, precision=1e-3)
    averaged, drawn = {"method": "conditional"}, {"method": "monte_carlo"}
    for name in given.words:
        instrument = rs.Instrument.preset(name)
        n = len(instrument.focal_plane)
        print(f"{name}: {n} positioners", flush=True)
        for each in given.each:
            found = ratios(instrument, each * n, [averaged, drawn], given.repeats, given.precision)
            show(each, ["conditional / monte_carlo"], found)
        for each in given.many:
            settings = [*({"most_entries": most, **averaged} for most in given.entries), averaged]
            found = ratios(instrument, each * n, settings, given.repeats, given.precision)
            show(each, [f"most_entries={most} / all" for most in given.entries], found)


def show(each, labels, found):
    """Print the results of `ratios`."""
    for label, small, error, whole in zip(labels, *found, strict=True):
        print(f"  {each:4g} targets: {label} {small:.2f} +- {error:.2f}, whole calls {whole:.2f}", flush=True)


if __name__ == "__main__":
    main()
