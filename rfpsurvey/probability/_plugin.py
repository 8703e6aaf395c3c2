"""Call user-defined functions and methods of other packages for collision probabilities, and check their results."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import fields
from functools import partial

import numpy as np

from rfpsurvey._plugins import Plugin, find_function
from rfpsurvey._units import to_plain
from rfpsurvey.errors import INCONVERTIBLE, InputError, check_choice
from rfpsurvey.probability._intervals import effective_number, quantile, wilson
from rfpsurvey.probability._methods import ESTIMANDS, METHODS, ProbabilityMethod, check_usable
from rfpsurvey.probability._question import Estimate, ProbabilityQuestion

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
