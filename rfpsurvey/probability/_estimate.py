"""The estimate that every method returns."""

from dataclasses import dataclass, field, replace

import numpy as np

from rfpsurvey._display import to_html


@dataclass(frozen=True, eq=False)
class Estimate:
    """An estimate of the static-collision probability.

    Parameters
    ----------
    value : float
        Expected fraction of positioners in collision, among the counted positioners. Assigned positioners are counted.
        A positioner without a target is counted only if its arms have equal lengths: it is then parked, and is an
        obstacle for its neighbors.
    value_assigned : float
        Expected fraction of positioners in collision, among the assigned positioners.
    low, high : float
        Limits of the confidence interval of ``value``; ``meta`` contains the confidence level. Both limits are NaN for
        methods without an error estimate. They are also NaN for one fixed set of targets if the focal plane has too few
        positioners; ``meta["no_interval"]`` then states the reason.
    standard_error : float
        Standard error of ``value``; NaN if there is no confidence interval.
    n : int
        Number of iterations (``monte_carlo``), of realizations (``conditional``), or of points per positioner in each
        randomized repetition (``quadrature``), from which ``value`` was computed. If allocations define the density for
        ``quadrature``, ``n`` is the mean number of targets in the queues of an allocation. For formulas, and if no arms
        can touch, ``n`` is 0.
    n_effective : float
        Number of independent trials that would give the same standard error.
    pairs_per_positioner : float
        Expected number of colliding pairs, divided by the number of counted positioners; NaN for formulas.
    per_positioner : ndarray of float, shape (n_positioners,)
        Probability that each positioner is in collision if it is counted; NaN if it is never counted.
    method : str
        Name of the method that was used.
    estimand : str
        The estimated quantity, ``allocated`` or ``independent``.
    seconds : float
        Duration of the computation in seconds.
    meta : dict
        Dictionary that describes the options, the targets, and the versions of other packages that were used.

    Examples
    --------
    >>> import astropy.units as u
    >>> import rfpsurvey as rs
    >>> robot = rs.Positioner(8.25 * u.mm, 8.25 * u.mm, 2.25 * u.mm)
    >>> plane = rs.FocalPlane.hexagonal(robot, rings=3, pitch=25.6 * u.mm)
    >>> answer = rs.collision_probability(plane, targets=rs.probability.RandomTargets(number=500))
    >>> answer.method, answer.estimand, answer.per_positioner.shape
    ('conditional', 'allocated', (37,))
    """

    value: float
    value_assigned: float
    low: float
    high: float
    standard_error: float
    n: int
    n_effective: float
    pairs_per_positioner: float
    per_positioner: np.ndarray
    method: str
    estimand: str
    seconds: float
    meta: dict = field(default_factory=dict)

    def _repr_html_(self) -> str:
        names = ("value", "low", "high", "standard_error", "value_assigned", "n", "n_effective", "seconds")
        return to_html(self, {**{name: getattr(self, name) for name in names}, **self.meta})

    def __repr__(self):
        error = "" if np.isnan(self.low) else f" [{self.low:.4g}, {self.high:.4g}]"
        return f"<Estimate by {self.method!r} of {self.estimand!r} targets: {self.value:.4g}{error}, n = {self.n}>"


def with_dynamic(estimate: Estimate, rate: float) -> Estimate:
    """Return an estimate that includes independent failures of the positioners with the probability ``rate``."""
    if rate == 0:
        return estimate

    def either(p):
        return 1 - (1 - p) * (1 - rate)

    names = ("value", "value_assigned", "low", "high", "per_positioner")
    changed = {name: either(getattr(estimate, name)) for name in names}
    error = (1 - rate) * estimate.standard_error
    return replace(estimate, **changed, standard_error=error, meta={**estimate.meta, "dynamic": rate})
