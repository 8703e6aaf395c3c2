"""The function that estimates collision probabilities."""

from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import replace
from time import perf_counter

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord

from rfpsurvey._assignment.allocation import Allocation
from rfpsurvey._assignment.options import AllocationOptions, as_options
from rfpsurvey._assignment.plugin import packages, warn_of_unused_options
from rfpsurvey._common.descriptions import describe_methods
from rfpsurvey._common.settings import Option, number_within, options_of
from rfpsurvey._common.units import is_seed_given, to_spawner
from rfpsurvey._instruments.focal_plane import FocalPlane
from rfpsurvey._instruments.instrument import Instrument, as_focal_plane, as_instrument
from rfpsurvey._sky.catalog import Catalog
from rfpsurvey._studies.methods import ESTIMANDS, METHODS, automatic, check_usable, find_method
from rfpsurvey._studies.quadrature import DENSITIES
from rfpsurvey._studies.question import Estimate, ProbabilityQuestion, with_dynamic, with_measured_paths
from rfpsurvey._studies.simulate import QUEUEING
from rfpsurvey._studies.targets import MOST_ITERATIONS, Precision, RandomTargets, make_source
from rfpsurvey.errors import (
    InputError,
    InputTypeError,
    check_choice,
    check_keywords,
    check_whole,
    refusal,
    short,
    warn,
    warn_no_effect,
    warn_of_unused,
)


@check_keywords
@describe_methods(METHODS)
def collision_probability(
    instrument: FocalPlane | Instrument | str,
    *,
    method: str | Callable = "auto",
    estimand: str | None = None,
    targets: RandomTargets | str | Catalog | u.Quantity | Callable = "uniform",
    center: SkyCoord | None = None,
    allocator: str | Callable | AllocationOptions = QUEUEING,
    most_entries: int | None = None,
    density: str | Callable | Allocation | list[Allocation] | None = None,
    variant: str = "corrected",
    precision: float | Precision | None = None,
    dynamic: float | str = 0.0,
    rng: int | np.random.Generator | None = 0,
    executor: Executor | None = None,
    progress: bool | Callable = False,
) -> Estimate:
    """Estimate the probability that a positioner at its target collides with another positioner.

    The probability is the expected collision rate: the number of positioners in collision, divided by the number of
    counted positioners. Positioners with a target are counted. A positioner without a target is counted only if its
    arms have equal lengths: it is then parked, and is an obstacle for its neighbors.

    Each method estimates one of two quantities; this quantity is the estimand of the method. For the first quantity,
    each target is **allocated** to one positioner. The targets of a positioner are its queue, and the positioner
    observes one target of its queue. For the second quantity, every positioner draws a target **independently** of all
    other positioners. The two quantities differ by up to a factor of five: compare only methods with the same estimand.

    Parameters
    ----------
    instrument : FocalPlane, Instrument or str
        Object that contains the positioners. A str is the name of a preset, or the path of a TOML file.
    method : str or callable, optional
        {methods}
        ``auto``: the fastest method that estimates the requested estimand and its error. Any other name refers to a
        method of an installed package. A function is called with a `~rfpsurvey.probability.ProbabilityQuestion`.
    estimand : {"allocated", "independent"}, optional
        Quantity that ``auto`` estimates, ``allocated`` by default. With any other ``method``, the only allowed value is
        the estimand of that method.
    targets : RandomTargets, str, Catalog, Quantity (n, 2) or callable, optional
        Targets to allocate; methods for independent targets do not use this argument. For random targets, give
        `~rfpsurvey.probability.RandomTargets`, the name of a kind of random targets (``"uniform"`` or ``"poisson"``),
        or a function that takes a Generator and returns new targets (a Quantity of shape (n, 2)) at each call. For one
        fixed set of targets, give points on the focal plane (a Quantity of shape (n, 2)), or a Catalog. The science
        targets of a Catalog are projected onto the focal plane of the Instrument.
    center : SkyCoord, optional
        Field center for a Catalog; by default the mean direction of all targets in the Catalog.
    allocator : str, callable or AllocationOptions, optional
        Rule that assigns targets, see `allocate`. A rule that makes no queues, such as ``lamost_rule``, gives one
        configuration for each realization. The option ``parked_obstacles`` of AllocationOptions states whether
        unassigned positioners with arms of equal lengths are obstacles and are counted (by default, they are). The
        options must not contain requirements, a sky separation, required targets or keep-out regions.
    most_entries : int, optional
        Maximum number of targets that ``conditional`` uses from each queue. If a queue is longer, each realization uses
        a random sample of this size from the queue. Realizations are then faster, and a given precision is reached
        sooner. With None, all targets are used; the method ``auto`` uses at most 24 random targets of each queue.
    density : str, callable, Allocation or list of Allocation, optional
        Density of independent targets: ``"uniform"`` (default) over the patrol area; ``"shared"``, with the weight 1/k
        at points that k positioners reach; ``"voronoi"``, uniform over the points that are nearer to the center of the
        positioner than to any other center; a function that takes points (a Quantity of shape (n, 2)) and returns
        the density at each point, up to a constant factor; or one or several Allocations: each
        positioner then draws its target from its queues in these Allocations.
    variant : {"corrected", "pitch", "printed"}, optional
        Variant of the closed form. ``corrected``: both misprints of the paper are corrected; the formula then contains
        the distance to each neighbor. ``pitch``: only the misprint of the radius is corrected; the formula then
        contains the pitch instead of the distances, as in the paper. ``printed``: no misprint is corrected; the formula
        is then 0/0 if both arms have the same length.
    precision : float or Precision, optional
        Standard error to reach, or a `~rfpsurvey.probability.Precision`, which states when iterations end and how the
        confidence interval is computed. The default is a standard error of 0.001.
    dynamic : float or "paths", optional
        Probability that a positioner does not reach its target, for example because of a dynamic collision. Such
        failures of different positioners are assumed to be independent. For LAMOST, this probability is 0.025. With
        ``"paths"``, it is the fraction of the arms for which `~rfpsurvey.collision.find_paths` finds no path, among
        arms that do not collide at their targets, in four realizations of allocated targets.
    rng : int, Generator or None, optional
        Seed or random number generator. Results do not depend on the number of workers.
    executor : concurrent.futures.Executor, optional
        Executor that runs parts of the computation. A thread pool is sufficient, because the kernels release the GIL.
        With None, the calling thread runs all parts.
    progress : bool or callable, optional
        Whether to show the progress on the standard error stream, or a function. The function is called with two
        numbers: the completed fraction of the work, and the total, which is always 1.

    Returns
    -------
    Estimate
        The probability with its confidence interval, the probability of each positioner, and the expected number of
        colliding pairs per positioner. If ``targets`` is a Quantity or a Catalog, the value applies to these targets.
        The standard error then states how much the value may differ from the mean over all sets of targets with the
        same statistical properties. A focal plane with too few positioners, for example seven, does not allow an
        estimate of this error. In this case, there is no confidence interval, and ``meta["no_interval"]`` states the
        reason.

    Raises
    ------
    InputError
        If the name of a preset, method, estimand, allocator or other option is unknown, if a number is out of range, or
        if a method that is not built in fails or returns an invalid result.

    Warns
    -----
    RfpsurveyWarning
        If the requested precision was not reached, or if an option is given that the method does not use.

    References
    ----------
    Chen et al. (2024), arXiv:2409.07288, "General Methods for Evaluating Collision Probability of Different Types of
    Theta-phi Positioners".

    Examples
    --------
    >>> import astropy.units as u
    >>> import rfpsurvey as rs
    >>> from rfpsurvey.probability import Precision, RandomTargets
    >>> robot = rs.Positioner(8.25 * u.mm, 8.25 * u.mm, 2.25 * u.mm)
    >>> plane = rs.FocalPlane.hexagonal(robot, rings=3, pitch=25.6 * u.mm)
    >>> answer = rs.collision_probability(plane, targets=RandomTargets(number=500), precision=0.002)
    >>> bool(answer.low < answer.value < answer.high)
    True
    >>> round(rs.collision_probability(plane, method="quadrature").value, 2)
    0.09
    >>> rs.collision_probability(plane, precision=Precision(max_iterations=100)).n
    100
    """
    start = perf_counter()
    plane = as_focal_plane(instrument)
    if plane.arrays.any_hidden:  # circles without targets do not affect collisions
        plane = replace(plane, hidden=None, margins=replace(plane.margins, broken_factor=0.0, hidden_factor=1.0))
    instrument = None if isinstance(instrument, FocalPlane) else as_instrument(instrument)
    options, precision = as_options(allocator), precision if isinstance(precision, Precision) else Precision(precision)
    if estimand is not None:
        check_choice(estimand, ESTIMANDS, "estimand")
    chosen = None if isinstance(method, str) and method == "auto" else find_method(method)
    if chosen is not None and estimand not in (None, chosen.estimand):
        raise InputError(
            f"{chosen.name!r} estimates the probability for {chosen.estimand!r} targets, not for {estimand!r} targets"
        )
    estimand = (estimand or "allocated") if chosen is None else chosen.estimand
    _check_density(density)
    is_measured = isinstance(dynamic, str) and dynamic == "paths"
    if not is_measured:
        dynamic = float(number_within(dynamic, "dynamic", Option(low=0, below=1)))
    elif estimand != "allocated":
        raise InputError(f"dynamic='paths' requires the estimand 'allocated', got {estimand!r}")
    if most_entries is not None:
        check_whole(most_entries, "most_entries")
    if executor is not None and not isinstance(executor, Executor):
        raise InputTypeError(f"executor must be a concurrent.futures.Executor, got {short(executor)}")
    _check_science_only(options)
    source = None
    if estimand == "allocated":
        source = make_source(plane, instrument, targets, center)
        warn_of_unused_options([options], plane)
    if chosen is None:
        chosen, fewer, choice = automatic(estimand, options, source, most_entries)
    else:
        fewer, choice = most_entries, f"{chosen.name}, as requested"
    usual = isinstance(targets, RandomTargets) and targets == RandomTargets()
    given = {"density": density, "variant": variant, "targets": "uniform" if usual else targets, "center": center}
    given["most_entries"] = most_entries
    _warn_of_unused(chosen, options, precision, rng, given)
    precision = precision.for_method(chosen.most_iterations or MOST_ITERATIONS, powers_of_two=chosen.powers_of_two)
    question = ProbabilityQuestion(
        plane,
        source,
        options,
        precision,
        to_spawner(rng),
        fewer,
        "uniform" if density is None else density,
        variant,
        executor,
        progress,
    )
    nothing_can_touch = len(plane.arrays.neighbors) == len(plane.arrays.obstacle_pairs) == 0
    has_error = chosen.most_iterations is not None
    result = _zero(plane, source) if nothing_can_touch and has_error else chosen.estimate(question)
    wanted, met = precision.standard_error, result.pop("met", True)
    if wanted is not None and not met:
        warn(
            f"the standard error after {result['n']} iterations{' (the maximum)' if has_error else ''} is "
            f"{result['standard_error']:.2g}: the confidence interval is too wide for the requested standard error "
            f"{wanted:g}"
        )
    meta = {"confidence": precision.confidence, "interval": precision.interval, "n_positioners": len(plane)}
    meta |= {} if instrument is None else {"layout": instrument.layout}
    meta |= {} if precision.estimator == "mean" else {"estimator": precision.estimator}
    meta |= result.pop("meta")
    meta["choice"] = meta.get("certain") or choice
    if source is not None and (software := packages(options)):
        meta["software"] = {**software, **meta.get("software", {})}
    estimate = Estimate(
        **result, method=chosen.name, estimand=chosen.estimand, seconds=perf_counter() - start, meta=meta
    )
    if is_measured:
        return with_measured_paths(estimate, question, None if instrument is None else instrument.motion)
    return with_dynamic(estimate, dynamic)


def _warn_of_unused(method, options, precision, rng, given) -> None:
    """Issue a warning for each given option that the method does not use."""
    usual = {"targets": "uniform", "variant": "corrected"}
    names = [name for name, value in given.items() if not _is_usual(value, usual.get(name))]
    if (options.allocator != QUEUEING or options.changed()) and _is_usual(given["density"], None, str, Callable):
        names.append("allocator")
    changed = [option.name for option in options_of(Precision) if not option.is_default(precision)]
    names += ["rng"] if is_seed_given(rng) else []
    names += dict.fromkeys(name if name in ("interval", "stop", "estimator") else "precision" for name in changed)
    warn_of_unused(names, [method], METHODS.values(), "method")
    if "center" in names and "center" in (method.options or ()) and not isinstance(given["targets"], Catalog):
        warn_no_effect("center", "because targets is not a Catalog")


def _is_usual(value, usual, *types) -> bool:
    """Return whether a value is the default value, or has one of ``types``."""
    return value is usual or isinstance(value, types) or (isinstance(value, str) and value == usual)


def _check_science_only(options):
    """Raise an error if the options contain requirements, a sky separation, required targets or keep-out regions."""
    if options.requirements or options.counts or options.sky_separation is not None:
        raise InputError(
            f"allocator must have no requirements and no sky_separation, since all targets are treated as science "
            f"targets, got {options!r}"
        )
    if options.all_constraints or options.rules is not None:
        raise InputError(
            f"allocator must have no required targets and no other constraints, since a collision probability "
            f"describes random configurations, not one field, got {options!r}"
        )


def _check_density(density):
    """Raise an error if ``density`` is not a valid density of independent targets."""
    known = density is None or isinstance(density, Allocation) or (callable(density) and not isinstance(density, type))
    known |= isinstance(density, list | tuple) and len(density) > 0
    if not known and not (isinstance(density, str) and density in DENSITIES):
        names = ", ".join(DENSITIES)
        text = f"density must be one of {names}, an Allocation, a list of Allocations, or a function of points"
        raise refusal(f"{text} on the focal plane", density, str, list, tuple)


def _zero(plane, source):
    """Return the result for a plane in which no arm can touch another arm or an obstacle; no targets are drawn."""
    check_usable(plane)
    nothing = dict.fromkeys(("value", "value_assigned", "low", "high", "standard_error", "pairs_per_positioner"), 0.0)
    per_positioner = np.where(plane.arrays.usable, 0.0, np.nan)
    meta = {"certain": "no two arms can touch", **(source.describe() if source else {})}
    return {**nothing, "n": 0, "n_effective": np.inf, "per_positioner": per_positioner, "meta": meta}
