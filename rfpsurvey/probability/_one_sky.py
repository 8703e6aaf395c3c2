"""Estimate, from one set of targets (sky), how much the mean collision probability varies between such sets."""

import numpy as np
from scipy.sparse import coo_array, eye_array

from rfpsurvey.focal_plane import FocalPlane

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
    found = _Quadratic(all_of, basis, typical) if beyond.nnz else None
    if found is None or found.degrees < ENOUGH_DEGREES:
        found = _Quadratic(ring_of, basis, CORRELATION, BEYOND * beyond)
    return found.variance(probability[counts]), found.degrees


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


class _Quadratic:
    """Unbiased quadratic estimate of the variance of the mean.

    All positioners are assumed to have the same variance, and all pairs of neighbors the same covariance. Let e be the
    residuals of the probabilities after a linear fit with the columns of ``basis``, and A the adjacency matrix of
    neighbors. The expected values of the sums e'e and e'Ae are linear in the variance and the covariance. The solution
    of these two linear equations gives an estimate of the form e'(aI + bA)e. ``known`` contains correlations that are
    assumed and not estimated.
    """

    def __init__(self, adjacency, basis: np.ndarray, correlation: float, known=None):
        n, k = basis.shape
        own = eye_array(n, format="csr")
        base = own if known is None else (own + known).tocsr()
        self.adjacency, self.basis, self.n = adjacency, basis, n
        # expected values of e'e and e'Ae for unit variance, and for unit covariance of neighbors
        moments = np.array([[_trace(form, one, basis) for one in (base, adjacency)] for form in (own, adjacency)])
        sums = np.array([base.sum(), adjacency.sum()])
        self.a, self.b, self.degrees, self.least = np.nan, 0.0, 0.0, np.nan
        if n - k < 1 or moments[0, 0] <= 0:
            return
        self.least = sums[0] / moments[0, 0] / n**2
        if sums[1] == 0:
            self.a, self.degrees = self.least, float(n - k)
        elif np.linalg.det(moments) > 1e-9 * moments[0, 0] * moments[1, 1]:
            self.a, self.b = np.linalg.solve(moments.T, sums) / n**2
            self.degrees = self._degrees((base + correlation * adjacency).tocsr())

    def _degrees(self, covariance):
        """Return the degrees of freedom 2 E(V)^2 / Var(V) of the variance V, for normally distributed probabilities.

        Let K = aI + bA, and let P be the projection onto residuals. The code avoids the dense matrix P K P.
        """
        basis, weight = self.basis, self.a * eye_array(self.n, format="csr") + self.b * self.adjacency
        expected = covariance.sum() / self.n**2
        weighted = weight @ basis
        beside = weighted - basis @ (basis.T @ weighted) / 2
        left, right = np.hstack([-basis, -beside]), np.hstack([beside, basis])  # P K P = K + left right'
        product = (weight @ covariance).tocsr()
        mixed = right.T @ (covariance @ left)
        trace = float(product.multiply(product.T).sum()) + float((mixed * mixed.T).sum())
        trace += 2 * float(np.trace(right.T @ (covariance @ (weight @ (covariance @ left)))))
        return float(expected**2 / trace) if trace > 0 else 0.0

    def variance(self, probability: np.ndarray) -> float:
        """Return the larger of two estimates of the variance: with and without the covariances of neighbors."""
        away = probability - self.basis @ (self.basis.T @ probability)
        own = float(away @ away)
        if np.isnan(self.a):
            return np.nan
        return float(max(self.a * own + self.b * float(away @ (self.adjacency @ away)), self.least * own))


def _trace(first, second, basis: np.ndarray) -> float:
    """Return the trace of P F P S for symmetric matrices F and S, with P = 1 - basis basis'."""
    left, right = first @ basis, second @ basis
    outer = float(((basis.T @ left) * (basis.T @ right)).sum())
    return float(first.multiply(second).sum()) - 2 * float((left * right).sum()) + outer
