"""Estimate from one sky how far the mean over positioners of another sky of the same kind may differ."""

import numpy as np
from scipy.sparse import coo_array

from rfpsurvey.focal_plane import FocalPlane

__all__ = ["FEWEST_DEGREES", "sky_variance"]

FEWEST_DEGREES = 3.0
"""With fewer degrees of freedom the variance is so uncertain that no interval is given."""
ENOUGH_DEGREES = 20.0
"""Where that many are left, correlations with all neighbors count; below that, those with the nearest ring alone."""
NEAREST_RING = 1.5
"""Neighbors are in the nearest ring up to this many median distances to the nearest neighbor."""
CORRELATION = 0.2
"""Typical correlation of positioners in the nearest ring (0.13 to 0.28 for LAMOST, SDSS-V and MOONS). Only the degrees
of freedom depend on it."""


def sky_variance(plane: FocalPlane, risk: np.ndarray) -> tuple[float, float]:
    """Return the variance of the mean over positioners, estimated from one sky, and its degrees of freedom.

    Positioners share targets with their neighbors, so that their collisions are correlated. The estimate is unbiased
    if all pairs of neighbors have the same covariance and the expected value of a positioner is linear in its number
    of neighbors, which at an edge is smaller.

    Parameters
    ----------
    plane : FocalPlane
        The positioners.
    risk : ndarray of float, shape (n_positioners,)
        Collision probability of each positioner, or whether it collides; NaN where it does not count.

    Returns
    -------
    variance : float
        Variance of the mean; NaN if the plane is too small to estimate it.
    degrees : float
        Degrees of freedom of the variance, in the sense of Satterthwaite (1946); 0 if there is no variance.

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
    counts = ~np.isnan(risk)
    n = int(np.count_nonzero(counts))
    if n < 3:
        return np.nan, 0.0
    pairs, near = plane._neighbors, _nearest_ring(plane)
    all_of, ring_of = (_adjacency(len(plane), p)[counts][:, counts] for p in (pairs, pairs[near]))
    basis = _profile(np.bincount(pairs.ravel(), minlength=len(plane))[counts].astype(float))
    typical = CORRELATION * ring_of.sum() / max(all_of.sum(), 1.0)
    found = _Quadratic(all_of, basis, typical) if len(near) > near.sum() else None
    if found is None or found.degrees < ENOUGH_DEGREES:
        found = _Quadratic(ring_of, basis, CORRELATION)
    return found.variance(risk[counts]), found.degrees


def _nearest_ring(plane: FocalPlane) -> np.ndarray:
    """Say which pairs of neighbors are about as close as the nearest neighbors are."""
    first, second = plane._neighbors.T
    distance = np.hypot(*(plane._xy_mm[first] - plane._xy_mm[second]).T)
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
    """Return an orthonormal basis of constants and of the number of neighbors, shape (n, 1) or (n, 2)."""
    constant = np.full(len(numbers), len(numbers) ** -0.5)
    slope = numbers - numbers.mean()
    length = np.sqrt(slope @ slope)
    return np.column_stack([constant, slope / length] if length > 1e-9 else [constant])


class _Quadratic:
    """Unbiased quadratic estimate of the variance of the mean if variances are equal, and covariances of neighbors.

    With the residuals e of the profile, the sum of squares e'e and the sum over ordered pairs of neighbors e'Ae have
    expected values linear in variance and covariance; the solution is e'(aI + bA)e.
    """

    def __init__(self, adjacency, basis: np.ndarray, correlation: float):
        n, k = basis.shape
        through = adjacency @ basis
        inner = basis.T @ through
        pairs = float(adjacency.sum())
        # traces of P, PA and PAPA, with P = 1 - basis basis'
        t0, t1 = n - k, -float(np.trace(inner))
        t2 = pairs - 2 * float((through**2).sum()) + float((inner**2).sum())
        determinant = t0 * t2 - t1**2
        self.adjacency, self.basis, self.n, self.free = adjacency, basis, n, t0
        self.a, self.b, self.degrees = (1.0 / t0 / n if t0 else np.nan), 0.0, float(t0)
        if pairs == 0:
            return
        if t0 < 1 or determinant <= 1e-9 * t0 * t2:
            self.a, self.degrees = np.nan, 0.0
            return
        self.a, self.b = (n * t2 - pairs * t1) / determinant / n**2, (pairs * t0 - n * t1) / determinant / n**2
        self.degrees = self._degrees(correlation, through, inner)

    def _degrees(self, correlation, through, inner):
        """Return 2 E(V)^2 / Var(V) for normal variables, without making the dense matrix P (aI + bA) P."""
        a, b, basis, adjacency = self.a, self.b, self.basis, self.adjacency
        expected = (self.n + correlation * adjacency.sum()) / self.n**2
        weighted = a * basis + b * through
        beside = weighted - basis @ (a * np.eye(basis.shape[1]) + b * inner) / 2
        left, right = np.hstack([-basis, -beside]), np.hstack([beside, basis])  # P K P = K + left right'

        def covariance(x):
            return x + correlation * (adjacency @ x)

        def weight(x):
            return a * x + b * (adjacency @ x)

        squares = a * correlation + b
        square = (adjacency @ adjacency).tocsr()
        # K S = a + (a rho + b) A + b rho A^2, and the trace of its square is the sum of its squared entries
        product = squares * adjacency + b * correlation * square
        diagonal = product.diagonal()
        trace = float((product.data**2).sum() + 2 * a * diagonal.sum() + a * a * self.n)
        mixed = right.T @ covariance(left)
        trace += 2 * float(np.trace(right.T @ covariance(weight(covariance(left))))) + float(np.trace(mixed @ mixed))
        return float(expected**2 / trace) if trace > 0 else 0.0

    def variance(self, risk: np.ndarray) -> float:
        """Return the estimate, which is not below that of independent positioners."""
        away = risk - self.basis @ (self.basis.T @ risk)
        own = float(away @ away)
        if np.isnan(self.a) or self.free < 1:
            return np.nan
        return max(self.a * own + self.b * float(away @ (self.adjacency @ away)), own / self.free / self.n)
