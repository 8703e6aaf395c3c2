"""Options of `collision_probability`: the random targets, and the precision to reach."""

from dataclasses import dataclass, replace

import astropy.units as u
import numpy as np

from rfpsurvey._settings import Settings, option
from rfpsurvey.errors import InputError, check_keywords
from rfpsurvey.probability._intervals import INTERVALS, quantile

KINDS = ("uniform", "poisson", "poisson_disc")
STOPS = ("interval", "convergence")
ESTIMATORS = ("mean", "midpoint")
MOST_TARGETS = 1_000_000
STANDARD_ERROR = 1e-3
MOST_ITERATIONS = 1_000_000


@check_keywords
@dataclass(frozen=True, eq=False, repr=False)
class RandomTargets(Settings):
    """Random targets on the focal plane, which are drawn again for each realization.

    Parameters
    ----------
    kind : {"uniform", "poisson", "poisson_disc"}, optional
        ``uniform``: independent points in a circle. ``poisson``: independent points whose number has a Poisson
        distribution. ``poisson_disc``: points of which no two are closer than ``min_separation``.
    number : float, optional
        Number of targets (for ``poisson``, the expected number). The default is the number of positioners multiplied by
        the ``targets_per_fiber`` of the instrument. For a FocalPlane, the default is four targets per positioner.
    radius : Quantity, optional
        Radius (a length) of the circle on the focal plane that contains the targets. The center of the circle is the
        origin, or the midpoint of a focal plane that does not contain the origin. By default, the circle covers all
        patrol areas.
    min_separation : Quantity, optional
        Minimum separation (a length) of two targets on the focal plane; required only for ``poisson_disc``.

    Raises
    ------
    InputError
        If the kind is unknown, if a value is out of range or has the wrong unit, or if ``min_separation`` is missing
        for ``poisson_disc`` or is given for another kind.

    See Also
    --------
    rfpsurvey.collision_probability : Accepts random targets as its argument ``targets``.

    Examples
    --------
    >>> import astropy.units as u
    >>> from rfpsurvey.probability import RandomTargets
    >>> RandomTargets("poisson", number=2000)
    RandomTargets('poisson', number=2000)
    >>> RandomTargets("poisson_disc", number=500, min_separation=1 * u.mm).min_separation
    <Quantity 1. mm>
    """

    kind: str = option("uniform", choices=KINDS, what="kind of targets")
    number: float | None = option(None, low=0, high=MOST_TARGETS)
    radius: u.Quantity[u.mm] | None = option(None, above=0, below=1e7)
    min_separation: u.Quantity[u.mm] | None = option(None, above=0)

    def _check(self):
        if (self.kind == "poisson_disc") != (self.min_separation is not None):
            raise InputError(
                f"min_separation must be given for the kind 'poisson_disc' and for no other kind, got "
                f"{self.min_separation} for {self.kind!r}"
            )


@check_keywords
@dataclass(frozen=True, eq=False, repr=False)
class Precision(Settings):
    """Options that state when iterations end, and how the confidence interval is computed.

    Parameters
    ----------
    standard_error : float, optional
        Standard error to reach. Iterations end when the confidence interval is predicted to be no wider than the
        interval of a normal distribution with this standard error. The prediction uses other realizations or points
        than the estimate, which is therefore unbiased. If collisions are rare, there is also a minimum number of
        iterations. The default is 0.001; if ``max_iterations`` is given, the default is None.
    max_iterations : int, optional
        Maximum number of iterations, realizations or points, depending on the method. If ``standard_error`` is None,
        exactly this number is used (``quadrature`` rounds it down to a power of two). Each method has its own default.
    confidence : float, optional
        Confidence level of the interval.
    interval : {"wilson", "wilson_naive", "wilson_iterations", "bootstrap"}, optional
        ``wilson``: Wilson's interval with the effective number of independent trials, which is estimated from the
        scatter between iterations. ``wilson_naive``: Wilson's interval with every positioner of every iteration as an
        independent trial; it is too narrow for ``monte_carlo`` and too wide for ``conditional``.
        ``wilson_iterations``: Wilson's interval with every iteration as one trial; it is too wide. ``bootstrap``:
        percentiles of the means of resampled iterations.
    stop : {"interval", "convergence"}, optional
        ``interval``: iterations end when the interval is narrow enough for ``standard_error``. ``convergence``:
        iterations end when the running mean changes by less than ``standard_error`` three times in a row. The rule
        ``convergence`` does not limit the error, and its estimates are biased; it is provided for comparison with
        ``interval``.
    estimator : {"mean", "midpoint"}, optional
        ``mean``: the estimate is the mean of the collision rates, which is unbiased. ``midpoint``: the estimate is the
        midpoint of the confidence interval, which is too large for small probabilities. With the interval
        ``wilson_iterations`` and ``max_iterations=6000``, this is the estimator of Chen et al. (2024).

    Raises
    ------
    InputError
        If ``interval``, ``stop`` or ``estimator`` is unknown, or if a number is out of range.

    See Also
    --------
    rfpsurvey.collision_probability : Accepts a `Precision`, or only a standard error, as its argument ``precision``.

    Examples
    --------
    >>> from rfpsurvey.probability import Precision
    >>> Precision(0.002, confidence=0.9)
    Precision(0.002, confidence=0.9)
    >>> Precision(max_iterations=100)
    Precision(max_iterations=100)
    """

    standard_error: float | None = option(None, above=0, below=1)
    max_iterations: int | None = option(None, low=1)
    confidence: float = option(0.95, above=0, below=1 - 1e-9)
    interval: str = option("wilson", choices=INTERVALS)
    stop: str = option("interval", choices=STOPS, what="stopping rule")
    estimator: str = option("mean", choices=ESTIMATORS)

    @property
    def half_width(self) -> float:
        """Half width of the confidence interval at which iterations end; 0 if ``standard_error`` is None."""
        return 0.0 if self.standard_error is None else quantile(self.confidence, np.inf) * self.standard_error

    def for_method(self, most_iterations: int = MOST_ITERATIONS, *, powers_of_two: bool = False) -> "Precision":
        """Return a copy in which the options that are not given have the default values of a method.

        Parameters
        ----------
        most_iterations : int, optional
            Default maximum number of iterations of the method.
        powers_of_two : bool, optional
            Whether the number of iterations must be a power of two, and at most ``most_iterations``.

        Returns
        -------
        Precision
            The copy, in which ``max_iterations`` is never None.
        """
        if self.max_iterations is None:
            error = STANDARD_ERROR if self.standard_error is None else self.standard_error
            return replace(self, standard_error=error, max_iterations=most_iterations)
        most = int(self.max_iterations)
        if powers_of_two:
            most = 2 ** int(np.log2(min(most, most_iterations)))
        return replace(self, max_iterations=most)
