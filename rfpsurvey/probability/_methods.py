"""Methods for collision probabilities: functions of a `ProbabilityQuestion` that return fields of an `Estimate`."""

from functools import partial

import numpy as np

from rfpsurvey._progress import Progress
from rfpsurvey.errors import InputError
from rfpsurvey.focal_plane import FocalPlane
from rfpsurvey.probability._closed_form import close_pair, closed_form, overlap_ratio
from rfpsurvey.probability._empirical import as_allocations, pool
from rfpsurvey.probability._quadrature import Quadrature, integrate
from rfpsurvey.probability._question import ProbabilityQuestion
from rfpsurvey.probability._run import run, summarize
from rfpsurvey.probability._targets import Source

__all__ = ["ESTIMANDS", "METHODS", "USES", "cheapest", "check_usable"]

CHUNK = {"monte_carlo": 64, "conditional": 8}
"""Number of realizations that are simulated together, as one task of an executor, by method.

Results depend on this number, but not on the number of workers.
"""
QUEUEING = ("balanced",)
"""Allocators that make a queue of targets for each positioner; ``conditional`` averages over these targets."""


def check_usable(plane: FocalPlane) -> None:
    """Raise an error if no positioner of a focal plane can have a target."""
    if not plane.arrays.usable.any():
        raise InputError("at least one positioner must be usable, but every positioner is disabled or stuck")


def _formula(function, question: ProbabilityQuestion) -> dict:
    check_usable(question.focal_plane)
    per_positioner, meta = function(question.focal_plane, question.variant)
    used = question.focal_plane.arrays.usable
    value = float(per_positioner[used].mean())
    nothing = dict.fromkeys(("low", "high", "standard_error", "n_effective", "pairs_per_positioner"), np.nan)
    return {
        "value": value,
        "value_assigned": value,
        **nothing,
        "n": 0,
        "per_positioner": np.where(used, per_positioner, np.nan),
        "meta": meta,
    }


def _simulated(name: str, question: ProbabilityQuestion) -> dict:
    simulation, given = question.simulation, question.targets.kind == "given"
    task, precision = simulation.draw if name == "monte_carlo" else simulation.expect, question.precision
    if given and name == "conditional" and question.most_entries is None:
        # one realization is sufficient, since it averages over all configurations of the given targets
        tally = task(1, question.rng)
        found = {**summarize(tally, question.focal_plane, precision, question.rng, given=True), "met": True}
    else:
        with Progress(question.progress) as bar:
            tally, found = run(
                task,
                CHUNK[name],
                precision,
                question.focal_plane,
                question.rng,
                question.executor,
                bar,
                given=given,
            )
            bar(1)
    return {
        **_of_tally(tally, found),
        "n": len(tally.pairs),
        "met": found["met"],
        "meta": {
            **question.targets.describe(),
            "allocator": question.options.name,
            "design_effect": found["design_effect"],
            "trials": tally.trials,
            **_reason(found),
        },
    }


def _integrated(question: ProbabilityQuestion) -> dict:
    allocations = as_allocations(question.density, question.focal_plane)
    if allocations is not None:
        tally = pool(question.focal_plane, allocations, parked_obstacles=question.parked_obstacles)
        found = summarize(tally, question.focal_plane, question.precision, question.rng, given=True)
        meta = {"density": "empirical", "n_allocations": len(allocations), **_reason(found)}
        return {**_of_tally(tally, found), "n": int(np.mean([len(a.queues[1]) for a in allocations])), "meta": meta}
    density = question.density
    check_usable(question.focal_plane)
    task = Quadrature(question.focal_plane, density)
    with Progress(question.progress) as bar:
        found = integrate(task, question.precision, question.rng, question.executor, bar)
        bar(1)
    environments = found.pop("n_environments")
    name = density if isinstance(density, str) else "given"
    return {**found, "value_assigned": found["value"], "meta": {"density": name, "environments": environments}}


def _reason(found) -> dict:
    """Return the ``meta`` entry that states why there is no confidence interval; empty if there is an interval."""
    return {"no_interval": found["no_interval"]} if "no_interval" in found else {}


def _of_tally(tally, found) -> dict:
    assigned = tally.rates(2)
    return {
        **{k: found[k] for k in ("value", "low", "high", "standard_error", "n_effective")},
        "value_assigned": float(assigned.mean()) if len(assigned) else np.nan,
        "pairs_per_positioner": float(tally.pair_rates.mean()),
        "per_positioner": tally.per_positioner,
    }


METHODS = {
    "overlap_ratio": partial(_formula, overlap_ratio),
    "closed_form": partial(_formula, closed_form),
    "close_pair": partial(_formula, close_pair),
    "quadrature": _integrated,
    "monte_carlo": partial(_simulated, "monte_carlo"),
    "conditional": partial(_simulated, "conditional"),
}
"""Methods by name; each method is a function that takes a `ProbabilityQuestion`."""

ESTIMANDS = {
    "overlap_ratio": "independent",
    "closed_form": "independent",
    "close_pair": "independent",
    "quadrature": "independent",
    "monte_carlo": "allocated",
    "conditional": "allocated",
}

_SIMULATION = ("targets", "center", "allocator", "precision", "interval", "stop", "rng")
USES = {
    "overlap_ratio": (),
    "closed_form": ("variant",),
    "close_pair": (),
    "quadrature": ("density", "precision", "rng"),
    "monte_carlo": _SIMULATION,
    "conditional": (*_SIMULATION, "most_entries"),
}
"""Names of the options that each method uses. The table does not contain the options that all methods use."""

SHORT = 2.0
"""If there are fewer targets per positioner than this number, ``monte_carlo`` is faster than ``conditional``."""


def reason_of(name: str, source: Source | None, *, chosen: bool) -> str:
    """Return the reason why a method was used; ``chosen`` states whether `cheapest` chose the method."""
    if not chosen:
        return f"{name}, as requested"
    if name == "quadrature":
        return "quadrature, the cheapest method with an error estimate for independent targets"
    if name == "conditional":
        return "conditional, the cheapest method with an error estimate if positioners have queues of targets"
    few = source is not None and source.kind not in ("given", "sampler") and source.each < SHORT
    why = f"there are fewer than {SHORT:g} targets per positioner" if few else "this allocator makes no queues"
    return f"monte_carlo, since {why}"


def cheapest(estimand: str, allocator: str, source: Source | None = None) -> str:
    """Return the name of the fastest method that estimates both the given estimand and the error of this estimate.

    ``conditional`` averages over the targets of the queues. Longer queues increase the computing time per realization,
    but they decrease the variance by a much larger factor. If each queue has one target, ``conditional`` has the same
    variance as ``monte_carlo``.
    """
    if source is not None and source.kind not in ("given", "sampler") and source.each < SHORT:
        return "monte_carlo"
    if estimand == "independent":
        return "quadrature"
    return "conditional" if allocator in QUEUEING else "monte_carlo"
