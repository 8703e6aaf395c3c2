"""Confidence intervals for a probability that is estimated from trials that are not independent."""

import numpy as np
from scipy.special import ndtri, stdtrit


def wilson(p: float, n: float, quantile: float) -> tuple[float, float]:
    """Return Wilson's interval for ``n`` independent trials with the fraction ``p`` of successes.

    ``n`` need not be a whole number. ``quantile`` is the quantile of the normal distribution, or of Student's t
    distribution, for the confidence level.
    """
    if not n > 0:
        return 0.0, 1.0
    q2 = quantile**2 / n if n < np.inf else 0.0
    center = (p + q2 / 2) / (1 + q2)
    half = np.sqrt(q2 * p * (1 - p) + q2**2 / 4) / (1 + q2)
    return float(max(0.0, center - half)) if p > 0 else 0.0, float(min(1.0, center + half)) if p < 1 else 1.0


def effective_number(p: float, standard_error: float, n: float) -> float:
    """Return the number of independent trials for which the fraction ``p`` would have the given standard error.

    If the error is 0, or if ``p`` is 0 or 1, this number is not defined, and ``n`` is returned.
    """
    return p * (1 - p) / standard_error**2 if standard_error > 0 and 0 < p < 1 else n


def _effective(rates, p, number, trials, quantile, confidence, rng):
    """Return Wilson's interval with the effective number of trials."""
    return wilson(p, number, quantile)


def _naive(rates, p, number, trials, quantile, confidence, rng):
    """Return Wilson's interval, treating every positioner of every iteration as an independent trial."""
    return wilson(p, trials, float(ndtri((1 + confidence) / 2)))


def _iterations(rates, p, number, trials, quantile, confidence, rng):
    """Return Wilson's interval, treating every iteration as one trial, as in Chen et al. (2024)."""
    return wilson(p, sum(map(len, rates)), float(ndtri((1 + confidence) / 2)))


def _bootstrap(rates, p, number, trials, quantile, confidence, rng, n_samples=2000):
    """Return the bootstrap interval: percentiles of the means of samples drawn from the rates with replacement."""
    means = np.zeros(n_samples)
    for own in rates:
        n = len(own)
        rows = max(1, 1_000_000 // n)  # draw this number of samples at a time, to limit the memory
        for k in range(0, n_samples, rows):
            drawn = rng.integers(0, n, (min(rows, n_samples - k), n))
            means[k : k + rows] += own[drawn].mean(axis=1) / len(rates)
    return tuple(np.quantile(means, [(1 - confidence) / 2, (1 + confidence) / 2]).tolist())


INTERVALS = {"wilson": _effective, "wilson_naive": _naive, "wilson_iterations": _iterations, "bootstrap": _bootstrap}
"""Functions that return the limits of a confidence interval, by the name of the interval.

The arguments of each function are the collision rates of the realizations (a list of one or two arrays, whose means
have equal weights), the mean of these rates, the effective number of trials, the number of counted positioners in all
realizations, the quantile, the confidence level, and a random number generator.
"""


def quantile(confidence: float, freedom: float) -> float:
    """Return the two-sided quantile of Student's t distribution or of the normal distribution.

    ``freedom`` is the number of degrees of freedom; if it is infinite, the normal distribution is used.
    """
    level = (1 + confidence) / 2
    return float(ndtri(level) if freedom == np.inf else stdtrit(max(freedom, 1), level))


def converged(means: list[float], tolerance: float, looks: int = 3) -> bool:
    """Return whether the running mean has changed by less than ``tolerance`` in each of the last ``looks`` checks.

    This stopping rule does not limit the error; it is provided for comparison with other stopping rules.
    """
    steps = np.abs(np.diff(means[-looks - 1 :]))
    return len(steps) == looks and bool((steps < tolerance).all())
