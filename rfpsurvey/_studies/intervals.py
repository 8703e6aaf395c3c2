"""Confidence intervals for a probability, and the variance of this probability between sets of targets (skies)."""

import numpy as np
from scipy.sparse import coo_array, eye_array
from scipy.special import ndtri, stdtrit

from rfpsurvey._instruments.focal_plane import FocalPlane


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
    for rates_of_part in rates:
        n = len(rates_of_part)
        rows = max(1, 1_000_000 // n)  # draw this number of samples at a time, to limit the memory
        for k in range(0, n_samples, rows):
            drawn = rng.integers(0, n, (min(rows, n_samples - k), n))
            means[k : k + rows] += rates_of_part[drawn].mean(axis=1) / len(rates)
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


FEWEST_DEGREES = 3.0
"""With fewer degrees of freedom than this, the variance is so uncertain that no interval is given."""
ENOUGH_DEGREES = 20.0
"""With at least this many degrees of freedom, the correlation between all neighbors is estimated; with fewer
degrees of freedom, only the correlation between neighbors in the nearest ring is estimated."""
NEAREST_RING = 1.5
"""Maximum distance of a neighbor in the nearest ring, in units of the median distance to the nearest neighbor."""
CORRELATION = 0.2
"""Typical correlation between collisions of a positioner and collisions of a neighbor in the nearest ring.

The correlation is 0.13 to 0.28 for LAMOST, SDSS-V and MOONS. Only the degrees of freedom depend on this value.
"""
BEYOND = -0.03
"""Typical correlation between collisions of a positioner and collisions of a neighbor beyond the nearest ring.

Such neighbors compete for targets, but rarely collide with each other. This value is assumed, since it cannot be
measured on a small focal plane. For SDSS-V and MOONS, this correlation is -0.03 to -0.05 with four targets per
positioner, and 0 to -0.01 with one target per positioner.
"""


def sky_variance(plane: FocalPlane, probability: np.ndarray) -> tuple[float, float]:
    """Return the variance of the mean collision probability between skies, and the degrees of freedom of this variance.

    A sky is a random set of targets; the variance is estimated from the collisions on one sky. Neighboring positioners
    share targets, and therefore their collisions are correlated. The estimate of the variance is unbiased if
    three conditions are met: all pairs of neighbors in the nearest ring have the same covariance; all pairs of
    neighbors beyond this ring have the correlation ``BEYOND``; the expected collision probability of a positioner
    is a linear function of its number of neighbors (positioners at an edge have fewer neighbors). If there are enough
    positioners, the first two conditions are replaced by one condition: all pairs of neighbors have the same
    covariance.

    Parameters
    ----------
    plane : FocalPlane
        The positioners.
    probability : ndarray of float, shape (n_positioners,)
        Collision probability of each positioner, or 1 if it collides and 0 if not; NaN for positioners that are not
        counted.

    Returns
    -------
    variance : float
        Variance of the mean; NaN if the focal plane has too few positioners to estimate the variance.
    degrees : float
        Degrees of freedom of the variance, as defined by Satterthwaite (1946); 0 if the variance is not estimated.

    References
    ----------
    Satterthwaite, F. E. 1946, Biometrics Bulletin, 2, 110.

    Examples
    --------
    >>> import astropy.units as u
    >>> import numpy as np
    >>> import rfpsurvey as rs
    >>> robot = rs.Positioner(8.25 * u.mm, 8.25 * u.mm, 2.25 * u.mm)
    >>> plane = rs.FocalPlane.hexagonal(robot, rings=3, pitch=25.6 * u.mm)
    >>> variance, degrees = sky_variance(plane, np.arange(37) % 7 / 10)
    >>> bool(variance > 0), round(degrees)
    (True, 8)
    """
    counts = ~np.isnan(probability)
    n = int(np.count_nonzero(counts))
    if n < 3:
        return np.nan, 0.0
    pairs, near = plane.arrays.neighbors, _nearest_ring(plane)
    all_of, ring_of, beyond = (
        _adjacency(len(plane), some)[counts][:, counts] for some in (pairs, pairs[near], pairs[~near])
    )
    basis = _profile(np.bincount(pairs.ravel(), minlength=len(plane))[counts].astype(float))
    typical = CORRELATION * ring_of.sum() / max(all_of.sum(), 1.0)
    variance, degrees = _quadratic(probability[counts], all_of, basis, typical) if beyond.nnz else (np.nan, 0.0)
    if degrees < ENOUGH_DEGREES:
        variance, degrees = _quadratic(probability[counts], ring_of, basis, CORRELATION, BEYOND * beyond)
    return variance, degrees


def _nearest_ring(plane: FocalPlane) -> np.ndarray:
    """Return, for each pair of neighbors, whether one positioner is in the nearest ring around the other."""
    first, second = plane.arrays.neighbors.T
    distance = np.hypot(*(plane.arrays.xy[first] - plane.arrays.xy[second]).T)
    nearest = np.full(len(plane), np.inf)
    np.minimum.at(nearest, first, distance)
    np.minimum.at(nearest, second, distance)
    some = nearest[np.isfinite(nearest)]
    return distance < NEAREST_RING * (np.median(some) if len(some) else 0.0)


def _adjacency(n: int, pairs: np.ndarray):
    first, second = pairs.T
    ones = np.ones(2 * len(pairs))
    return coo_array((ones, (np.r_[first, second], np.r_[second, first])), shape=(n, n)).tocsr()


def _profile(numbers: np.ndarray) -> np.ndarray:
    """Return an orthonormal basis of the vectors a + b ``numbers``, shape (n, 2), where a and b are any two constants.

    ``numbers`` contains the number of neighbors of each positioner. If all positioners have the same number of
    neighbors, the shape is (n, 1).
    """
    constant = np.full(len(numbers), len(numbers) ** -0.5)
    slope = numbers - numbers.mean()
    length = np.sqrt(slope @ slope)
    return np.column_stack([constant, slope / length] if length > 1e-9 else [constant])


def _quadratic(probability, adjacency, basis, correlation, known=None) -> tuple[float, float]:
    """Return an unbiased quadratic estimate of the variance of the mean, and its degrees of freedom.

    All positioners are assumed to have the same variance, and all pairs of neighbors the same covariance. Let e be the
    residuals of the probabilities after a linear fit with the columns of ``basis``, and A the adjacency matrix of
    neighbors. The expected values of the sums e'e and e'Ae are linear in the variance and the covariance. The solution
    of these two linear equations gives an estimate of the form e'(aI + bA)e. The result is at least the estimate
    without the covariances of neighbors. ``known`` contains correlations that are assumed and not estimated.
    """
    n, k = basis.shape
    unit = eye_array(n, format="csr")
    base = unit if known is None else (unit + known).tocsr()
    # expected values of e'e and e'Ae for unit variance, and for unit covariance of neighbors
    moments = np.array([[_trace(form, cov, basis) for cov in (base, adjacency)] for form in (unit, adjacency)])
    sums = np.array([base.sum(), adjacency.sum()])
    if n - k < 1 or moments[0, 0] <= 0:
        return np.nan, 0.0
    least = sums[0] / moments[0, 0] / n**2
    if sums[1] == 0:
        a, b, degrees = least, 0.0, float(n - k)
    elif np.linalg.det(moments) > 1e-9 * moments[0, 0] * moments[1, 1]:
        a, b = np.linalg.solve(moments.T, sums) / n**2
        degrees = _degrees(a * unit + b * adjacency, basis, (base + correlation * adjacency).tocsr())
    else:
        return np.nan, 0.0
    away = probability - basis @ (basis.T @ probability)
    squares = float(away @ away)
    return float(max(a * squares + b * float(away @ (adjacency @ away)), least * squares)), degrees


def _degrees(weight, basis, covariance) -> float:
    """Return the degrees of freedom 2 E(V)^2 / Var(V) of the variance V, for normally distributed probabilities.

    Let K be the ``weight`` aI + bA, and let P be the projection onto residuals. The code avoids the dense matrix P K P.
    """
    expected = covariance.sum() / len(basis) ** 2
    weighted = weight @ basis
    beside = weighted - basis @ (basis.T @ weighted) / 2
    left, right = np.hstack([-basis, -beside]), np.hstack([beside, basis])  # P K P = K + left right'
    product = (weight @ covariance).tocsr()
    mixed = right.T @ (covariance @ left)
    trace = float(product.multiply(product.T).sum()) + float((mixed * mixed.T).sum())
    trace += 2 * float(np.trace(right.T @ (covariance @ (weight @ (covariance @ left)))))
    return float(expected**2 / trace) if trace > 0 else 0.0


def _trace(first, second, basis: np.ndarray) -> float:
    """Return the trace of P F P S for symmetric matrices F and S, with P = 1 - basis basis'."""
    left, right = first @ basis, second @ basis
    outer = float(((basis.T @ left) * (basis.T @ right)).sum())
    return float(first.multiply(second).sum()) - 2 * float((left * right).sum()) + outer
