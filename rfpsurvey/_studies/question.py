"""The input and the result of every method that computes collision probabilities."""

from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from rfpsurvey._assignment.allocation import Allocation
from rfpsurvey._assignment.options import AllocationOptions
from rfpsurvey._common.descriptions import to_html
from rfpsurvey._instruments.focal_plane import FocalPlane
from rfpsurvey._instruments.joint_motion import JointMotion
from rfpsurvey._studies.simulate import QUEUEING, Simulation
from rfpsurvey._studies.targets import Precision, Source


@dataclass(frozen=True, eq=False)
class ProbabilityQuestion:
    """The input of a method: a focal plane, the targets, and the precision of the collision probability.

    Built-in methods and methods of other packages are functions whose only argument is this object. A method returns an
    array of float, shape (n_positioners,), with the probability that each positioner is in collision, and NaN for
    positioners that are never counted. Instead of this array, the method may return a dict with any of the fields of
    `~rfpsurvey.probability.Estimate` except ``method``, ``estimand`` and ``seconds``. The dict must contain
    ``per_positioner`` or ``value``. If the dict does not contain ``low`` and ``high``, they are computed from
    ``standard_error``. The attribute ``estimand`` of the method names the quantity that the method estimates:
    "independent", the default, or "allocated".

    Parameters
    ----------
    focal_plane : FocalPlane
        The positioners.
    targets : Source, optional
        Source of allocated targets; None for independent targets.
    options : AllocationOptions, optional
        Options that state how targets are allocated, and whether unassigned positioners with arms of equal
        lengths are obstacles.
    precision : Precision, optional
        Options that state when iterations end. In this object, ``max_iterations`` is never None. If ``standard_error``
        is None, the method does exactly ``max_iterations`` iterations.
    rng : numpy.random.Generator, optional
        Random number generator. Methods must use no other generator, so that estimates are reproducible.
    most_entries : int, optional
        Maximum number of targets that ``conditional`` uses from each queue; None for all targets.
    density : str, callable, Allocation or list of Allocation, optional
        Density of independent targets.
    variant : str, optional
        Variant of the closed form.
    executor : concurrent.futures.Executor, optional
        Executor that runs parts of the computation. With None, the calling thread runs all parts.
    progress : bool or callable, optional
        Whether to show the progress on the standard error stream, or a function. The function is called with two
        numbers: the completed fraction of the work, and the total, which is always 1.

    Examples
    --------
    >>> import astropy.units as u
    >>> import rfpsurvey as rs
    >>> def one_shot(question):  # fraction of positioners that collide in one realization
    ...     plan = question.realize(question.rng)
    ...     report = rs.find_collisions(question.focal_plane, plan)
    ...     return {"value": report.rate, "n": 1}
    >>> one_shot.estimand = "allocated"
    >>> robot = rs.Positioner(8.25 * u.mm, 8.25 * u.mm, 2.25 * u.mm)
    >>> plane = rs.FocalPlane.hexagonal(robot, rings=3, pitch=25.6 * u.mm)
    >>> rs.collision_probability(plane, method=one_shot).n
    1
    """

    focal_plane: FocalPlane
    targets: Source | None = None
    options: AllocationOptions = field(default_factory=lambda: AllocationOptions(QUEUEING))
    precision: Precision = field(default_factory=Precision().for_method)
    rng: np.random.Generator | None = None
    most_entries: int | None = None
    density: object = "uniform"
    variant: str = "corrected"
    executor: Executor | None = None
    progress: bool | Callable = False

    @property
    def parked_obstacles(self) -> bool:
        """Whether unassigned positioners with arms of equal lengths are obstacles and are counted."""
        return self.options.parked_obstacles

    @cached_property
    def simulation(self) -> Simulation | None:
        """Simulation of allocated targets; None for independent targets."""
        if self.targets is None:
            return None
        return Simulation(self.focal_plane, self.targets, self.options, self.most_entries)

    @property
    def realize(self) -> Callable[[np.random.Generator], Allocation] | None:
        """Function that draws targets with a random generator, allocates them, and returns an Allocation with queues.

        The attribute ``options`` states how the targets are allocated. ``realize`` is None for independent targets.
        """
        return None if self.simulation is None else self.simulation.realize


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

    names = ("value", "value_assigned", "low", "high", "per_positioner")
    changed = {name: 1 - (1 - getattr(estimate, name)) * (1 - rate) for name in names}
    error = (1 - rate) * estimate.standard_error
    return replace(estimate, **changed, standard_error=error, meta={**estimate.meta, "dynamic": rate})


N_PATHS = 4
"""Number of realizations in which the paths of the arms are planned."""


def with_measured_paths(estimate: Estimate, question: ProbabilityQuestion, motion: JointMotion | None) -> Estimate:
    """Return an estimate that includes the measured fraction of arms for which no path is found."""
    from rfpsurvey._instruments.path_report import paths_to  # most scripts plan no paths

    n = n_late = 0
    for rng in question.rng.spawn(N_PATHS):
        arms = question.realize(rng).place_arms(question.focal_plane)
        paths = paths_to(question.focal_plane, arms, motion)  # without arms that collide at their targets
        n, n_late = n + paths.assigned.sum(), n_late + (paths.assigned & ~paths.arrives).sum()
    rate = float(n_late / max(n, 1))
    estimate = with_dynamic(estimate, rate)
    return replace(estimate, meta={**estimate.meta, "dynamic": rate, "n_paths": int(n)})
