"""Options that define how a scan of designs computes the loss (the fraction of fibers lost to collisions)."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from numbers import Number

import astropy.units as u
import numpy as np

from rfpsurvey._methods import describe_methods
from rfpsurvey._units import to_scalar
from rfpsurvey.design._losses import ESTIMANDS, METHODS, automatic
from rfpsurvey.design._work import MOST_TARGETS
from rfpsurvey.errors import InputError, check_choice, check_keywords, check_whole, refusal, warn_of_unused

PER_POSITIONER = 4.0
"""Default number of targets per positioner."""


@check_keywords
@describe_methods(METHODS)
@dataclass(frozen=True)
class LossOptions:
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

    estimand: str | None = None
    method: str = "auto"
    targets_per_positioner: float | None = None
    target_density: u.Quantity[u.mm**-2] | None = None
    n_skies: int = 8
    time_limit: u.Quantity[u.s] = field(default=10 * u.s)

    def __post_init__(self):
        self.question, self.targets, self.seconds  # noqa: B018  (raises an error for invalid options)
        check_whole(self.n_skies, "n_skies", 2)

    @property
    def question(self) -> tuple[str, str]:
        """The estimand (definition of the loss), and the method that computes the loss."""
        check_choice(self.method, [*METHODS, "auto"], "method of design studies")
        if self.estimand is not None:
            check_choice(self.estimand, ESTIMANDS, "estimand")
        if self.method == "auto":
            return self.estimand or "independent", self.method
        own = METHODS[self.method].estimand
        if self.estimand not in (None, own):
            raise InputError(f"the estimand must be {own!r} for the method {self.method!r}, got {self.estimand!r}")
        return own, self.method

    def warn_of_unused(self, also: Sequence[str] = ()) -> None:
        """Issue a warning for each given option that the method does not use.

        Parameters
        ----------
        also : sequence of str, optional
            Names of options of the scan that were given.
        """
        estimand, method = self.question
        given = [name for name in ("n_skies", "time_limit") if getattr(self, name) != getattr(LossOptions, name)]
        chosen = automatic(estimand) if method == "auto" else [METHODS[method]]
        warn_of_unused([*given, *also], chosen, METHODS.values(), "method")

    @property
    def targets(self) -> tuple[float, bool]:
        """Number of targets, and whether the number is per mm^2 (True) or per positioner (False)."""
        each = self.targets_per_positioner
        if each is not None and self.target_density is not None:
            raise InputError("give either targets_per_positioner or target_density, but not both")
        if self.target_density is not None:
            return to_scalar(self.target_density, u.mm**-2, "target_density", low=0, high=1e3), True
        number = PER_POSITIONER if each is None else each
        known = isinstance(number, int | float | np.number) and not isinstance(number, bool)
        if not (known and 0 < number <= MOST_TARGETS):
            raise refusal(f"targets_per_positioner must be a number above 0 and up to {MOST_TARGETS:g}", each, Number)
        return float(number), False

    @property
    def seconds(self) -> float:
        """Time limit of each search for a plan, in seconds."""
        return to_scalar(self.time_limit, u.s, "time_limit", low=0)
