"""Methods for collision probabilities: functions of a `ProbabilityQuestion` that return fields of an `Estimate`.

The results of user-defined functions and of methods of other packages are checked.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, fields
from functools import partial

import numpy as np

from rfpsurvey._assignment.options import AllocationOptions
from rfpsurvey._common.descriptions import Method, table_of
from rfpsurvey._common.plugins import Plugin, find_function
from rfpsurvey._common.units import to_plain
from rfpsurvey._instruments.focal_plane import FocalPlane
from rfpsurvey._studies.intervals import effective_number, quantile, wilson
from rfpsurvey._studies.quadrature import Quadrature, integrate
from rfpsurvey._studies.question import Estimate, ProbabilityQuestion
from rfpsurvey._studies.run import run, summarize
from rfpsurvey._studies.simulate import as_allocations, merge, pool
from rfpsurvey._studies.surrogate import close_pair, closed_form, overlap_ratio
from rfpsurvey._studies.targets import MOST_ITERATIONS, Source
from rfpsurvey.errors import INCONVERTIBLE, InputError, check_choice

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


GROUP = "rfpsurvey.probability_methods"
ANSWERS = sorted({field.name for field in fields(Estimate)} - {"method", "estimand", "seconds"})
PARTS = ("value", "value_assigned", "low", "high", "per_positioner")
"""Fields whose values must be from 0 to 1."""
SLACK = 1e-9


def find_method(given: str | Callable, known: Iterable[str] = (*METHODS, "auto")) -> ProbabilityMethod:
    """Return a method that is given by its name or as a function."""
    if isinstance(given, str) and given in METHODS:
        return METHODS[given]
    plugin = find_function(GROUP, given, known, "method of collision probability")
    with plugin.answering():
        estimand = getattr(plugin.value, "estimand", "independent")
        check_choice(estimand, ESTIMANDS, "estimand")
    return ProbabilityMethod(plugin.name, partial(_ask, plugin), None, estimand=estimand)


def _ask(plugin: Plugin, question: ProbabilityQuestion) -> dict:
    """Call a plugin with a question, and return all fields of an `Estimate`; fields that the plugin omits are added."""
    targets, precision = question.targets, question.precision
    check_usable(question.focal_plane)
    about = {} if targets is None else {**targets.describe(), "allocator": question.options.name}
    with plugin.answering():
        result = _checked(question, plugin.value(question))
    meta = {**about, **result.pop("meta"), **({"software": plugin.software} if plugin.package else {})}
    met = precision.standard_error is None or not result["standard_error"] > precision.standard_error
    return {**result, "met": met, "meta": meta}


def _checked(question: ProbabilityQuestion, given: object) -> dict:
    """Return all fields of an estimate from the result of a plugin, or raise an error if the result is invalid."""
    answer = dict(given) if isinstance(given, Mapping) else {"per_positioner": given}
    for name in answer:
        check_choice(name, ANSWERS, "field of a result")
    plane, meta = question.focal_plane, answer.pop("meta", {})
    if not isinstance(meta, Mapping):
        raise InputError(f"meta must be a dict, got {meta!r}")
    probability = np.full(len(plane), np.nan)
    if "per_positioner" in answer:
        probability = np.where(plane.arrays.usable, _probabilities(answer.pop("per_positioner"), len(plane)), np.nan)
    known = probability[~np.isnan(probability)]
    if "value" not in answer and len(known) == 0:
        raise InputError(
            "the result must contain value, or per_positioner with the probability of at least one positioner that is "
            "neither disabled nor stuck"
        )
    answer = {"value": known.mean() if len(known) else None, **answer}
    answer = {name: _number(name, number) for name, number in answer.items()}
    value, error, low, high, n_effective = answer["value"], answer.get("standard_error", np.nan), *[np.nan] * 3
    if error >= 0:
        n_effective, width = effective_number(value, error, np.inf), quantile(question.precision.confidence, np.inf)
        if n_effective >= 1 and 0 < value < 1:
            low, high = wilson(value, n_effective, width)
        else:  # use a normal interval
            low, high = max(value - width * error, 0.0), min(value + width * error, 1.0)
    usual = {
        "value_assigned": value,
        "low": low,
        "high": high,
        "standard_error": error,
        "n": 0,
        "n_effective": n_effective,
        "pairs_per_positioner": np.nan,
    }
    result = {**usual, **answer, "per_positioner": probability, "meta": dict(meta)}
    low, high = result["low"], result["high"]
    if np.isnan(low) != np.isnan(high) or low > value + SLACK or high < value - SLACK:
        raise InputError(f"low, value and high must be in ascending order, got {low:g}, {value:g} and {high:g}")
    return result


def _probabilities(given: object, n: int) -> np.ndarray:
    """Return the probabilities of positioners as an array, or raise an error if they are invalid."""
    try:
        probability = to_plain(given)
    except INCONVERTIBLE:
        probability = np.empty(0, dtype=object)
    if probability.shape != (n,) or probability.dtype.kind not in "fiu":
        raise InputError(
            f"a method must return a dict, or an array of the shape ({n},) with a probability for each positioner, got "
            f"{type(given).__name__} of the shape {np.shape(probability) if probability.dtype != object else '()'}"
        )
    strange = probability[(probability < -SLACK) | (probability > 1 + SLACK)]
    if len(strange):
        raise InputError(f"per_positioner must be from 0 to 1, or NaN, got {strange[0]:g}")
    return np.clip(probability.astype(float), 0.0, 1.0)


def _number(name: str, given: object) -> float:
    """Return the number in a field, or raise an error if the number is invalid.

    NaN is valid in all fields except ``value`` and ``n``.
    """
    kinds = (int, np.integer) if name == "n" else (int, float, np.integer, np.floating)
    most = 1.0 if name in PARTS else np.inf
    if not isinstance(given, kinds) or not (0 <= given <= most or (np.isnan(given) and name != "value")):
        what = "a whole number" if name == "n" else "a number"
        raise InputError(
            f"{name} must be {what} of at least 0{' and at most 1' if name in PARTS else ''}, got {given!r}"
        )
    return int(given) if name == "n" else float(given)
