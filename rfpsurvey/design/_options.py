"""Options that define how a scan of designs computes the loss (the fraction of fibers lost to collisions)."""

from collections.abc import Sequence
from dataclasses import dataclass

import astropy.units as u

from rfpsurvey._methods import describe_methods
from rfpsurvey._settings import Settings, option
from rfpsurvey.design._losses import ESTIMANDS, METHODS, automatic
from rfpsurvey.design._work import MOST_TARGETS
from rfpsurvey.errors import InputError, check_keywords, warn_of_unused

PER_POSITIONER = 4.0
"""Default number of targets per positioner."""


@check_keywords
@describe_methods(METHODS)
@dataclass(frozen=True, eq=False, repr=False)
class LossOptions(Settings):
    """Definition of the fraction of fibers that a design loses to collisions, and the method that computes it.

    Parameters
    ----------
    estimand : {"independent", "allocated", "collision_free"}, optional
        Definition of the loss, see `~rfpsurvey.design.explore_designs`. By default, it is the definition that
        ``method`` uses; for the method ``auto``, it is ``independent``.
    method : str, optional
        Method that computes the loss.
        {methods}
        ``auto`` selects the fastest method that is accurate enough for a design: for ``independent``, ``surrogate`` if
        the design is within the range of this method and the result is at least 0.01, otherwise ``quadrature``; for
        ``allocated``, ``conditional``; for ``collision_free``, ``optimal``.
    targets_per_positioner : float, optional
        Mean number of Poisson-distributed targets per positioner; four by default.
    target_density : Quantity, optional
        Number of Poisson-distributed targets per area of the focal plane, instead of ``targets_per_positioner``. The
        number of targets per positioner then increases with the pitch.
    n_skies : int, optional
        Number of realizations of the targets over which methods for allocated targets average the loss. In each
        realization, 91 positioners are counted.
    time_limit : Quantity, optional
        Time limit of each search for a plan.

    Raises
    ------
    InputError
        If the estimand or the method is unknown, if the method does not compute the estimand, or if a number is out of
        range.

    Examples
    --------
    >>> import rfpsurvey as rs
    >>> rs.design.LossOptions(method="repair", n_skies=4).question
    ('collision_free', 'repair')
    """

    estimand: str | None = option(None, choices=ESTIMANDS)
    method: str = option("auto", choices=[*METHODS, "auto"], what="method of design studies")
    targets_per_positioner: float | None = option(None, above=0, high=MOST_TARGETS)
    target_density: u.Quantity[u.mm**-2] | None = option(None, above=0, below=1e3, record="target_density_per_mm2")
    n_skies: int = option(8, low=2)
    time_limit: u.Quantity[u.s] = option(10 * u.s, above=0)

    def _check(self):
        _ = self.question, self.targets  # raises an error if options do not fit each other

    @property
    def question(self) -> tuple[str, str]:
        """The estimand (definition of the loss), and the method that computes the loss."""
        if self.method == "auto":
            return self.estimand or "independent", self.method
        estimand = METHODS[self.method].estimand
        if self.estimand not in (None, estimand):
            raise InputError(f"the estimand must be {estimand!r} for the method {self.method!r}, got {self.estimand!r}")
        return estimand, self.method

    def warn_of_unused(self, also: Sequence[str] = ()) -> None:
        """Issue a warning for each given option that the method does not use.

        Parameters
        ----------
        also : sequence of str, optional
            Names of options of the scan that were given.
        """
        estimand, method = self.question
        given = [name for name in ("n_skies", "time_limit") if name in self.changed()]
        chosen = automatic(estimand) if method == "auto" else [METHODS[method]]
        warn_of_unused([*given, *also], chosen, METHODS.values(), "method")

    @property
    def targets(self) -> tuple[float, bool]:
        """Number of targets, and whether the number is per mm^2 (True) or per positioner (False)."""
        each = self.targets_per_positioner
        if each is not None and self.target_density is not None:
            raise InputError("give either targets_per_positioner or target_density, but not both")
        if self.target_density is not None:
            return float(self.target_density.to_value(u.mm**-2)), True
        return float(PER_POSITIONER if each is None else each), False

    @property
    def seconds(self) -> float:
        """Time limit of each search for a plan, in seconds."""
        return float(self.time_limit.to_value(u.s))
