"""Fit the second-order polynomial of Chen et al. (2024) in arm length, arm ratio and pitch by ridge regression."""

from dataclasses import dataclass

import astropy.units as u
import numpy as np
from scipy.linalg import solve

from rfpsurvey._common.units import to_generator, to_mm
from rfpsurvey.errors import InputError

__all__ = ["PUBLISHED", "PolynomialFit", "features", "fit_polynomial"]

PENALTIES = np.logspace(-8, 2, 21)
FOLDS = 5
PUBLISHED = 1e-3 * np.array(
    [18.6635, 4.61227, 15.9225, -15.0398, 1.07078, 2.67496, 2.87948, 2.23372, -3.19570, -8.26024]
)
"""Coefficients a to j of Table 3 of Chen et al. (2024), arXiv:2409.07288."""


@dataclass(frozen=True, eq=False)
class PolynomialFit:
    """A second-order polynomial in central arm x, arm ratio y and pitch z that approximates collision probabilities.

    Parameters
    ----------
    coefficients : ndarray of float, shape (10,)
        Coefficients of 1, x, y, z, x^2, y^2, z^2, xy, xz, yz, where x, y and z are standardized: ``mean`` is
        subtracted, and the difference is divided by ``scale``.
    mean, scale : ndarray of float, shape (3,)
        Means and standard deviations of the central arm (mm), arm ratio and pitch (mm) of the fitted designs.
    penalty : float
        Penalty of the ridge regression; the constant coefficient is not penalized.
    r2 : float
        Coefficient of determination for the fitted designs.
    r2_held_back : float
        Coefficient of determination for the designs that were held back from the fit.

    Examples
    --------
    >>> import astropy.units as u
    >>> import numpy as np
    >>> from reproduction._fit import fit_polynomial
    >>> l1, ratio, pitch = np.random.default_rng(1).uniform((8, 1, 25), (14, 2, 35), (80, 3)).T
    >>> fit = fit_polynomial(l1 * u.mm, ratio, pitch * u.mm, 0.1 * ratio**2)
    >>> fit.predict([10] * u.mm, [1.5], [30] * u.mm).round(3)
    array([0.225])
    """

    coefficients: np.ndarray
    mean: np.ndarray
    scale: np.ndarray
    penalty: float
    r2: float
    r2_held_back: float

    def predict(self, central_arm: u.Quantity, ratio: np.ndarray, pitch: u.Quantity) -> np.ndarray:
        """Return the value of the polynomial for each design; the value may be below 0 or above 1.

        Parameters
        ----------
        central_arm : Quantity, shape (n,)
            Length of the central arm.
        ratio : array_like of float, shape (n,)
            Length of the eccentric arm divided by the length of the central arm.
        pitch : Quantity, shape (n,)
            Distance between the centers of adjacent positioners.

        Returns
        -------
        ndarray of float, shape (n,)
            Predicted collision probability of each design.

        Raises
        ------
        InputError
            If an argument has more than one dimension, or if values are not finite.
        """
        designs = _designs(central_arm, ratio, pitch)
        return features((designs - self.mean) / self.scale) @ self.coefficients


def fit_polynomial(
    central_arm: u.Quantity,
    ratio: np.ndarray,
    pitch: u.Quantity,
    probability: np.ndarray,
    *,
    held_back: float = 0.25,
    rng: int | np.random.Generator | None = 0,
) -> PolynomialFit:
    """Fit the polynomial of Chen et al. (2024), arXiv:2409.07288, Eq. 13, to collision probabilities of designs.

    Parameters
    ----------
    central_arm : Quantity, shape (n,)
        Length of the central arm.
    ratio : array_like of float, shape (n,)
        Length of the eccentric arm divided by the length of the central arm.
    pitch : Quantity, shape (n,)
        Distance between the centers of adjacent positioners.
    probability : array_like of float, shape (n,)
        Collision probability of each design.
    held_back : float, optional
        Fraction (below 0.8) of the designs that is held back to test the fit. The penalty is chosen by cross-validation
        with the other designs.
    rng : int, Generator or None, optional
        Seed or random number generator for the choice of the designs that are held back.

    Returns
    -------
    PolynomialFit
        The polynomial, with its coefficients of determination for the fitted designs and for the designs that were held
        back.

    Raises
    ------
    InputError
        If shapes do not agree, if values are not finite, if ``held_back`` is out of range, if there are fewer than 20
        designs, or if all designs have the same central arm, ratio or pitch.

    Examples
    --------
    >>> import astropy.units as u
    >>> import numpy as np
    >>> import rfpsurvey as rs
    >>> from reproduction._fit import fit_polynomial
    >>> l1, ratio, pitch = np.random.default_rng(1).uniform((8, 1, 25), (14, 2, 35), (80, 3)).T
    >>> p = rs.probability.surrogate_probability(l1 * u.mm, ratio * l1 * u.mm, pitch * u.mm, 4.5 * u.mm)
    >>> fit_polynomial(l1 * u.mm, ratio, pitch * u.mm, p).r2_held_back > 0.97
    True
    """
    designs, value = _designs(central_arm, ratio, pitch), np.asarray(probability, dtype=float)
    n = len(designs)
    if value.shape != (n,) or not np.isfinite(value).all():
        raise InputError(f"probability must be {n} finite numbers, one for each design, got the shape {value.shape}")
    if n < 20 or not 0 < held_back < 0.8:
        raise InputError(
            f"a fit requires at least 20 designs and 0 < held_back < 0.8, got {n} designs and held_back={held_back!r}"
        )
    order = to_generator(rng).permutation(n)
    test, train = np.split(order, [max(2, round(held_back * n))])
    mean, scale = designs[train].mean(axis=0), designs[train].std(axis=0)
    if not (scale > 0).all():
        raise InputError("central_arm, ratio and pitch must each have at least two different values")
    columns = features((designs - mean) / scale)
    folds = np.array_split(train, FOLDS)
    errors = [sum(_miss(columns, value, np.setdiff1d(train, f), f, w) for f in folds) for w in PENALTIES]
    penalty = float(PENALTIES[np.argmin(errors)])
    coefficients = _ridge(columns[train], value[train], penalty)
    left = value - columns @ coefficients
    r2 = [1 - float(left[k] @ left[k]) / float(((value[k] - value[k].mean()) ** 2).sum()) for k in (train, test)]
    return PolynomialFit(coefficients, mean, scale, penalty, *r2)


def _designs(central_arm, ratio, pitch):
    columns = [to_mm(central_arm, "central_arm"), np.asarray(ratio, dtype=float), to_mm(pitch, "pitch")]
    message = "central_arm, ratio and pitch must be one-dimensional and finite, with the same length"
    try:
        designs = np.column_stack(np.broadcast_arrays(*map(np.atleast_1d, columns)))
    except ValueError:
        shapes = ", ".join(str(column.shape) for column in columns)
        raise InputError(f"{message}, got the shapes {shapes}") from None
    if designs.shape[1] != 3 or not np.isfinite(designs).all():
        raise InputError(message)
    return designs


def features(t: np.ndarray) -> np.ndarray:
    """Return the terms of the polynomial for designs with the columns x, y and z, shape (n, 3)."""
    x, y, z = t.T
    return np.column_stack([np.ones(len(t)), x, y, z, x * x, y * y, z * z, x * y, x * z, y * z])


def _ridge(features, value, penalty):
    weight = np.diag([0.0] + [penalty] * (features.shape[1] - 1))
    return solve(features.T @ features + len(value) * weight, features.T @ value, assume_a="pos")


def _miss(features, value, train, test, penalty):
    left = value[test] - features[test] @ _ridge(features[train], value[train], penalty)
    return float(left @ left)
