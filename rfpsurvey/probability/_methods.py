"""Methods for collision probabilities: functions of a `ProbabilityQuestion` that return fields of an `Estimate`."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from rfpsurvey._methods import Method, table_of
from rfpsurvey.allocation import AllocationOptions
from rfpsurvey.errors import InputError
from rfpsurvey.focal_plane import FocalPlane
from rfpsurvey.probability._closed_form import close_pair, closed_form, overlap_ratio
from rfpsurvey.probability._options import MOST_ITERATIONS
from rfpsurvey.probability._quadrature import Quadrature, integrate
from rfpsurvey.probability._question import ProbabilityQuestion
from rfpsurvey.probability._run import run, summarize
from rfpsurvey.probability._simulate import as_allocations, merge, pool
from rfpsurvey.probability._targets import Source

SHORT = 2.0
"""If there are fewer targets per positioner than this number, ``auto`` selects ``monte_carlo``.

For small standard errors, both methods take the same time at 1.8 to 2.5 targets per positioner, depending on the
instrument. At 2 targets, calls with a precision of 0.001 take 0.4 to 1.0 of the time with ``conditional``.
"""
MOST_ENTRIES = 24
"""Maximum number of targets of each queue that ``auto`` uses, since more targets take more time than they save.

With 40 targets per positioner, calls with a precision of 0.001 then take less time, for SDSS-V, MOONS, DESI and
LAMOST. The time to small standard errors is 0.6 to 1.3 of the time with all targets.
"""


@dataclass(frozen=True)
class ProbabilityMethod(Method):
    """A method that computes collision probabilities; the function takes a `ProbabilityQuestion`."""

    estimand: str = "independent"
    """The quantity that the method estimates."""
    is_formula: bool = False
    """Whether the function evaluates a formula for a focal plane and a variant, without an error estimate."""
    most_iterations: int | None = None
    """Default maximum number of iterations; None if the method does not iterate."""
    powers_of_two: bool = False
    """Whether the number of iterations must be a power of two."""
    chunk: int = 1
    """Number of realizations that are simulated together, as one task of an executor; results depend on this number."""
    supports_outlines: bool = True
    """Whether arms may have outlines."""
    averages_queues: bool = False
    """Whether the method averages over the targets in the queue of each positioner."""
    efforts: tuple[int, ...] = (0,)
    """Numbers of iterations for which a benchmark measures the method; 0 for a formula."""

    def estimate(self, question: ProbabilityQuestion) -> dict:
        """Return fields of an `~rfpsurvey.probability.Estimate`."""
        return _evaluate(self.function, question) if self.is_formula else self.function(question)


def check_usable(plane: FocalPlane) -> None:
    """Raise an error if no positioner of a focal plane can have a target."""
    if not plane.arrays.usable.any():
        raise InputError("at least one positioner must be usable, but every positioner is disabled or stuck")


def _evaluate(function, question: ProbabilityQuestion) -> dict:
    check_usable(question.focal_plane)
    per_positioner, meta = function(question.focal_plane, question.variant)
    used = question.focal_plane.arrays.usable
    values = dict.fromkeys(("value", "value_assigned"), float(per_positioner[used].mean()))
    unknown = dict.fromkeys(("low", "high", "standard_error", "n_effective", "pairs_per_positioner"), np.nan)
    return {**values, **unknown, "n": 0, "per_positioner": np.where(used, per_positioner, np.nan), "meta": meta}


def monte_carlo(question: ProbabilityQuestion) -> dict:
    """For allocated targets: use one configuration for each realization, as in Chen et al. (2024), arXiv:2409.07288."""
    return _simulated(question, question.simulation.draw, METHODS["monte_carlo"].chunk)


def conditional(question: ProbabilityQuestion) -> dict:
    """For allocated targets: average over all configurations that the queues allow, for each realization of targets."""
    # one realization is sufficient if it averages over all configurations of given targets
    once = question.targets.kind == "given" and question.most_entries is None
    return _simulated(question, question.simulation.expect, METHODS["conditional"].chunk, once=once)


def _simulated(question: ProbabilityQuestion, task: Callable, chunk: int, *, once: bool = False) -> dict:
    if once:
        tallies = [task(1, question.rng)]
        stats = summarize(tallies, question)
    else:
        tallies, stats = run(question, task, chunk)
    trials = sum(tally.trials for tally in tallies)
    meta = {"allocator": question.options.name, "design_effect": stats["design_effect"], "trials": trials}
    values = _of_tallies(tallies, stats, sum(len(tally.pairs) for tally in tallies), question.targets.describe() | meta)
    return {**values, "met": stats.get("met", True)}


def quadrature(question: ProbabilityQuestion) -> dict:
    """For independent targets: integrate over the patrol areas of each positioner and its neighbors with Sobol points.

    The points are scrambled.
    """
    allocations = as_allocations(question.density, question.focal_plane)
    if allocations is not None:
        tally = pool(question.focal_plane, allocations, parked_obstacles=question.parked_obstacles)
        stats = summarize([tally], question)
        n = int(np.mean([len(allocation.queues[1]) for allocation in allocations]))
        return _of_tallies([tally], stats, n, {"density": "empirical", "n_allocations": len(allocations)})
    check_usable(question.focal_plane)
    return integrate(Quadrature(question.focal_plane, question.density), question)


def _of_tallies(tallies, stats, n, meta) -> dict:
    """Return fields of an `Estimate`; ``meta`` also states why there is no confidence interval, if there is none."""
    if "no_interval" in stats:
        meta = meta | {"no_interval": stats["no_interval"]}
    assigned = [rate for tally in tallies if not np.isnan(rate := tally.mean(2))]
    return {
        **{k: stats[k] for k in ("value", "low", "high", "standard_error", "n_effective")},
        "value_assigned": float(np.mean(assigned)) if assigned else np.nan,
        "pairs_per_positioner": float(np.mean([pairs.mean() for tally in tallies if len(pairs := tally.pair_rates)])),
        "per_positioner": merge(tallies).per_positioner,
        "n": n,
        "meta": meta,
    }


_SIMULATION = ("targets", "center", "allocator", "precision", "interval", "stop", "estimator", "rng")
METHODS = table_of(
    ProbabilityMethod("overlap_ratio", overlap_ratio, is_formula=True),
    ProbabilityMethod("closed_form", closed_form, ("variant",), is_formula=True, supports_outlines=False),
    ProbabilityMethod("close_pair", close_pair, is_formula=True, supports_outlines=False),
    ProbabilityMethod(
        "quadrature",
        quadrature,
        ("density", "precision", "rng"),
        most_iterations=2**14,
        powers_of_two=True,
        efforts=(32, 64, 128, 256),
    ),
    ProbabilityMethod(
        "monte_carlo",
        monte_carlo,
        _SIMULATION,
        estimand="allocated",
        most_iterations=MOST_ITERATIONS,
        chunk=64,
        efforts=(16, 64, 256),
    ),
    ProbabilityMethod(
        "conditional",
        conditional,
        (*_SIMULATION, "most_entries"),
        estimand="allocated",
        most_iterations=100_000,
        chunk=8,
        averages_queues=True,
        efforts=(4, 16, 64),
    ),
)
"""Methods that compute collision probabilities, by name."""
ESTIMANDS = tuple(dict.fromkeys(method.estimand for method in METHODS.values()))


def automatic(
    estimand: str, options: AllocationOptions, source: Source | None, most_entries: int | None
) -> tuple[ProbabilityMethod, int | None, str]:
    """Return the fastest method that estimates a quantity and its error, and the reason of the choice.

    The second result is ``most_entries`` or, if it is None, the maximum number of targets of each queue that the method
    uses. ``source`` is the source of allocated targets; None for independent targets. ``conditional`` averages over the
    targets of the queues. Longer queues increase the computing time per realization, but they decrease the variance by
    a much larger factor. If each queue has one target, ``conditional`` has the same variance as ``monte_carlo``.
    """
    averages_queues = False
    if source is None:
        why = "the cheapest method with an error estimate for independent targets"
    elif source.compiled and source.each < SHORT and most_entries is None:
        why = f"since there are fewer than {SHORT:g} targets per positioner"
    elif options.method.makes_queues:
        averages_queues, why = True, "the cheapest method with an error estimate if positioners have queues of targets"
        if source.compiled and source.each > MOST_ENTRIES and most_entries is None:
            most_entries, why = MOST_ENTRIES, f"{why}, with at most {MOST_ENTRIES} targets of each queue"
    else:
        why = "since this allocator makes no queues"
    able = (method for method in METHODS.values() if method.estimand == estimand and method.most_iterations is not None)
    chosen = next(method for method in able if method.averages_queues == averages_queues)
    return chosen, most_entries, f"{chosen.name}, {why}"
