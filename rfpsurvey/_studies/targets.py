"""Sources of targets: random targets, given points, or a user-defined function, and the precision to reach."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord

from rfpsurvey._common.settings import Settings, option
from rfpsurvey._common.units import to_points_mm, to_scalar
from rfpsurvey._field.constraints import project_field
from rfpsurvey._instruments.focal_plane import FocalPlane
from rfpsurvey._instruments.instrument import Instrument
from rfpsurvey._kernels import simulate
from rfpsurvey._sky.arrays import has_role
from rfpsurvey._sky.catalog import Catalog
from rfpsurvey._studies.intervals import INTERVALS, quantile
from rfpsurvey.errors import InputError, InputTypeError, check_keywords, short

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


PER_FIBER = 4.0
"""Default number of targets per positioner; Chen et al. (2024) use this number for LAMOST."""
FILLING = 0.5
"""Largest fraction of the circle of targets that the discs of ``poisson_disc`` targets may fill.

Discs that are added at random positions without overlap fill at most a fraction of 0.547 of the area. Near this limit,
adding discs is slow.
"""
FINEST = 700
"""Largest ratio of the radius of the circle of targets to the minimum separation of the targets.

Smaller separations have little effect, but require much memory.
"""


@dataclass(frozen=True, eq=False)
class Source:
    """A source of target positions in mm: given points, a user-defined function, or ``number`` random points."""

    kind: str
    number: float = 0.0
    each: float = 0.0
    """Number of targets per positioner."""
    center: tuple[float, float] = (0.0, 0.0)
    radius: float = 0.0
    separation: float = 0.0
    points: np.ndarray | None = None
    types: np.ndarray | None = None
    priority: np.ndarray | None = None
    sampler: Callable | None = None

    @property
    def compiled(self) -> bool:
        """Whether compiled kernels draw these targets."""
        return self.kind in KINDS

    @property
    def sky(self) -> simulate.TargetCircle:
        """The circle that contains the targets, and their minimum separation, as the kernels require them."""
        return simulate.TargetCircle(*self.center, self.radius, self.separation if self.kind == "poisson_disc" else 0.0)

    def numbers(self, size: int, rng: np.random.Generator) -> np.ndarray:
        """Return the number of targets in each of ``size`` realizations."""
        if self.kind == "poisson":
            return rng.poisson(self.number, size)
        return np.full(size, round(self.number))

    @property
    def grid_cells(self) -> int:
        """Number of grid cells that `scatter_apart` uses; each cell is so small that it contains at most one target."""
        if self.kind != "poisson_disc":
            return 0
        wide = self.radius + 2 * self.separation
        return int(np.ceil(2 * np.sqrt(2) * wide / self.separation)) ** 2

    def draw(self, rng: np.random.Generator) -> np.ndarray:
        """Return the positions (mm) of the targets of one realization, shape (n, 2)."""
        if self.kind == "given":
            return self.points
        if self.kind == "sampler":
            return to_points_mm(self.sampler(rng), "the result of the function given as targets")
        x, y = np.empty((2, int(self.numbers(1, rng)[0])))
        if self.kind == "poisson_disc":
            n_placed = simulate.scatter_apart(rng, self.sky, np.empty((2, self.grid_cells)), x, y)
            x, y = x[:n_placed], y[:n_placed]
        else:
            simulate.scatter(rng, self.sky, x, y)
        return np.column_stack([x, y])

    def describe(self) -> dict:
        """Return the entries of ``Estimate.meta`` that describe the targets."""
        if self.kind == "given":
            return {"targets": "given", "n_targets": len(self.points)}
        if self.kind == "sampler":
            return {"targets": "sampler"}
        separation = {"min_separation_mm": self.separation} if self.kind == "poisson_disc" else {}
        return {"targets": self.kind, "n_targets": self.number, "target_radius_mm": self.radius, **separation}


def make_source(
    plane: FocalPlane, instrument: Instrument | None, targets: object = "uniform", center: SkyCoord | None = None
) -> Source:
    """Return the source of targets that the arguments describe."""
    if isinstance(targets, str):
        targets = RandomTargets(targets)
    if isinstance(targets, RandomTargets):
        return _random(plane, instrument, targets)
    if isinstance(targets, Catalog):
        return _from_catalog(instrument, targets, center)
    if isinstance(targets, u.Quantity):
        return _given(to_points_mm(targets, "targets"))
    if callable(targets) and not isinstance(targets, type):
        return Source("sampler", sampler=targets)
    raise InputTypeError(
        f"targets must be RandomTargets or one of {', '.join(KINDS)}, a Catalog, a Quantity of shape (n, 2), or a "
        f"function of a Generator that returns such a Quantity, got {short(targets)}"
    )


def _random(plane, instrument, targets):
    cover = float((np.hypot(*(plane.arrays.xy - _center(plane)).T) + plane.arrays.outer_radius).max())
    radius = cover if targets.radius is None else to_scalar(targets.radius, u.mm, "radius")
    number, separation = targets.number, 0.0
    if number is None:
        number = (instrument.targets_per_fiber if instrument else PER_FIBER) * len(plane)
    if targets.kind == "poisson_disc":
        separation = to_scalar(targets.min_separation, u.mm, "min_separation", low=0, high=2 * radius)
        if round(number) * separation**2 > 4 * FILLING * radius**2:
            raise InputError(
                f"{round(number)} targets at least {separation:g} mm apart do not fit into a circle with the radius "
                f"{radius:g} mm: discs with a diameter of {separation:g} mm must fill at most the fraction {FILLING:g} "
                "of the circle"
            )
        if separation * FINEST < radius:
            raise InputError(
                f"min_separation must be at least {radius / FINEST:.3g} mm for targets in a circle with the radius "
                f"{radius:g} mm, got {targets.min_separation}"
            )
    return Source(targets.kind, float(number), number / len(plane), _center(plane), radius, separation)


def _center(plane):
    """Return the center (mm) of the circle of targets: the origin or, for a plane without the origin, its midpoint."""
    low, high = plane.arrays.xy.min(axis=0), plane.arrays.xy.max(axis=0)
    away = (low > 0).any() or (high < 0).any()
    return tuple((0.5 * (low + high)).tolist()) if away else (0.0, 0.0)


def _from_catalog(instrument, targets, center):
    if instrument is None:
        raise InputError("targets in a Catalog require an Instrument, since a FocalPlane has no plate scale")
    if center is None:
        if len(targets) == 0:
            raise InputError("targets must have at least one row, got an empty Catalog")
        center = targets.mean_direction
    wanted = np.ones(len(targets), dtype=bool) if targets.kind is None else has_role(targets.kind, "science")
    science = np.flatnonzero(wanted if targets.visits is None else wanted & (targets.visits > 0))
    types, priority = (None if c is None else c[science] for c in (targets.fiber_type, targets.priority))
    xy, types = project_field(instrument, instrument.projection(center).plain, targets.arrays.vectors[science], types)
    return _given(xy, types, priority)


def _given(points, types=None, priority=None):
    if len(points) == 0:
        raise InputError(
            "targets must have at least one row (a Catalog, one science target with requested visits), got none"
        )
    return Source("given", points=points, types=types, priority=priority)
