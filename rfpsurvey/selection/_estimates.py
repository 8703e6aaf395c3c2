"""Estimates of selection probabilities and of their inverse from counts of realizations."""

import numpy as np


def inverse_probability(count: np.ndarray, n: int) -> np.ndarray:
    """Return the estimate ``(n + 1) / (count + 1)`` of the inverse probability of targets that a survey observed.

    The survey itself counts as one more realization that observed the target. If a realization observes the target with
    the probability p, the expected value of the estimate is ``(1 - (1 - p)**(n + 1)) / p``.
    """
    return (n + 1) / (np.asarray(count) + 1.0)


def probability_error(count: np.ndarray, n: int) -> np.ndarray:
    """Return the standard error of the probability ``count / n``.

    The standard error is the standard deviation of the posterior distribution of the probability for a uniform prior.
    It is never 0.
    """
    a, b = np.asarray(count) + 1.0, n - np.asarray(count) + 1.0
    return np.sqrt(a * b / (a + b + 1.0)) / (a + b)


def inverse_probability_error(count: np.ndarray, n: int) -> np.ndarray:
    """Return the standard error of `inverse_probability`, by first-order propagation of `probability_error`."""
    return inverse_probability(count, n) ** 2 * probability_error(count, n)
