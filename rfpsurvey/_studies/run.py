"""Repeat a simulation until the confidence interval is narrow enough."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from rfpsurvey._common.executors import Progress, map_in_order
from rfpsurvey._instruments.focal_plane import FocalPlane
from rfpsurvey._studies.intervals import (
    FEWEST_DEGREES,
    INTERVALS,
    converged,
    effective_number,
    quantile,
    sky_variance,
    wilson,
)
from rfpsurvey._studies.question import ProbabilityQuestion
from rfpsurvey._studies.simulate import CollisionSums, merge
from rfpsurvey.errors import InputError, number_of

FIRST_TASKS = 2
"""Number of tasks (groups of realizations) that are simulated before the error is first estimated."""
GROWTH = 8
"""Largest factor by which the number of realizations grows before the next estimate of the error."""
HITS = 25
"""Minimum number of realizations with a collision, if most realizations have no collision.

With fewer such realizations, the scatter of the collision rates cannot be estimated. Conversely, if all positioners
collide in most realizations, at least this number of realizations must have a positioner that does not collide.
"""
FLOOR = 4.0
"""Factor that determines the minimum number of realizations if collisions are rare.

The minimum number is this factor, divided by the standard error to reach, and multiplied by the collision rate that one
colliding pair causes. Without this minimum, simulations that by chance contain no collision would end too early, and
their errors would be larger than the requested error.
"""
FORESIGHT = 1.05
"""Factor by which the predicted number of realizations is increased, so that this number is rarely too small."""
TOO_FEW = (
    "the focal plane has too few positioners to estimate how much the collision rate differs between sets of targets"
)
"""Message that states why an estimate has no interval."""


@dataclass(eq=False)
class _Half:
    """Independent realizations, and the number of realizations for which they meet the stopping rule."""

    rng: np.random.Generator
    limit: int
    goal: int
    """Number of realizations that are simulated before the rule is applied again."""
    parts: list[CollisionSums] = field(default_factory=list)
    done: int = 0
    enough: int | None = None
    """Number of realizations at which the rule was met, or the limit was reached."""
    met: bool = False


def run(
    question: ProbabilityQuestion, task: Callable[[int, np.random.Generator], CollisionSums], chunk: int
) -> tuple[list[CollisionSums], dict]:
    """Simulate realizations until the requested precision or the maximum number of realizations is reached.

    There are two independent halves of realizations. The stopping rule is applied to each half, and the number of
    realizations that it gives is used for the *other* half. The number of terms of the mean of a half therefore does
    not depend on these terms. Hence each mean is unbiased, and so is the estimate, which is the mean of the two means.
    Without a stopping rule, and with the rule ``convergence``, there is only one part, which contains all realizations.

    The function returns the tally of each half, and the summary of both halves. The number of tasks and the number of
    realizations per task depend only on earlier results. Therefore, the number of workers does not change the result.
    """
    most, precision = question.precision.max_iterations, question.precision
    one_part = precision.standard_error is None or precision.stop == "convergence" or most == 1
    limits = [most] if one_part else [most - most // 2, most // 2]
    first = FIRST_TASKS * chunk // len(limits)
    rngs = [question.rng] if one_part else question.rng.spawn(2)
    halves = [_Half(rng, limit, min(first, limit)) for rng, limit in zip(rngs, limits, strict=True)]
    note = ""
    with Progress(question.progress) as bar:
        while some := [half for half in halves if half.done < half.goal]:
            jobs = [(half, min(chunk, half.goal - k)) for half in some for k in range(half.done, half.goal, chunk)]
            owners, sizes = zip(*jobs, strict=True)
            sources = [half.rng.spawn(1)[0] for half in owners]
            for half, part in zip(owners, map_in_order(question.executor, task, sizes, sources), strict=True):
                half.parts.append(part)
                half.done += len(part.pairs)
                done = sum(half.done for half in halves)
                bar(0.99 * done / sum(half.goal for half in halves), note=f"{number_of(done, 'realization')}{note}")
            for half in some:
                half.parts = [merge(half.parts)]
                if half.enough is None:
                    error = _apply_rule(half, question, chunk, len(halves))
                    note = "" if np.isnan(error) else f", standard error {error:.2g}"
            if all(half.enough for half in halves):
                for half in halves:
                    half.goal = min(max(other_half.enough for other_half in halves), half.limit)
        bar(1)
    tallies = [half.parts[0].first(other_half.enough) for half, other_half in zip(halves, halves[::-1], strict=True)]
    return tallies, {**summarize(tallies, question), "met": all(half.met for half in halves)}


def _apply_rule(half: _Half, question: ProbabilityQuestion, chunk: int, n_halves: int) -> float:
    """Apply the stopping rule to a half, and return the standard error that the estimate would have.

    The other half, if there is one, is assumed to have the same collision rates.
    """
    precision, tally = question.precision, half.parts[0]
    wanted, error, more = precision.standard_error, np.nan, GROWTH * half.done
    if len(tally.rates()):  # otherwise, no positioner has been counted yet
        summary = summarize([tally] * n_halves, question)
        wide, error = summary["half_width"], summary["standard_error"]
        if precision.stop == "interval":
            floor = _fewest(tally, precision) / n_halves
            half.met = wanted is not None and wide <= precision.half_width and half.done >= floor
            needed = half.done * (wide / precision.half_width) ** 2 if precision.half_width > 0 else np.inf
            more = max(half.done + chunk, min(max(FORESIGHT * needed, floor), more))
        else:
            means = [tally.first(n).mean() for n in range(half.done, 0, -chunk)[:4]]
            half.met, more = wanted is not None and converged(means[::-1], wanted), half.done + chunk
    if half.met or half.done >= half.limit:
        half.enough = half.done
    half.goal = min(-(-int(more) // chunk) * chunk, half.limit)
    return error


def _fewest(tally, precision):
    """Return the minimum number of realizations, which is 0 unless collisions or their absence are rare.

    Collisions are rare if fewer than half of the realizations have a collision; their absence is rare if all
    positioners collide in more than half of the realizations. The estimated error grows with the number of rare events,
    and is too small if, by chance, there are too few events.
    """
    rates = tally.rates()
    if precision.standard_error is None or min((rates > 0).mean(), (rates < 1).mean()) >= 0.5:
        return 0.0
    return FLOOR / precision.standard_error * min(1.0, 2 / float(tally.colliding[:, 1].mean()))


def summarize(tallies: list[CollisionSums], question: ProbabilityQuestion) -> dict:
    """Return the mean collision rate of one or two tallies, its confidence interval, standard error and half width.

    If there are two tallies, the mean rate is the mean of their mean rates, whatever their numbers of realizations.
    The half width determines when iterations end: it contains only the error that more iterations reduce. If targets
    or queues are given, or if all realizations have the same rate, the tally is treated as the result for one sky (one
    set of targets). The standard error then states how much the rate may differ from the mean over all skies with the
    same statistical properties. If the focal plane has too few positioners to estimate this error, there is no
    confidence interval, and ``no_interval`` states the reason.
    """
    plane, precision = question.focal_plane, question.precision
    given = question.targets is None or question.targets.kind == "given"
    parts, normal = [part for tally in tallies if len(part := tally.rates())], quantile(precision.confidence, np.inf)
    if not parts:
        raise InputError(
            "at least one positioner must be counted, but no positioner reaches a target, and none is a parked obstacle"
        )
    tally, rates = merge(tallies), np.concatenate(parts)
    n, p = len(rates), min(float(np.mean([part.mean() for part in parts])), 1.0)
    # the weight of a realization is 1 / len(parts) / len(part)
    scatter = float(rates.std(ddof=1) * np.sqrt(sum(1 / len(part) for part in parts)) / len(parts)) if n > 1 else 0.0
    scatter = 0.0 if scatter < 1e-14 else scatter
    student = quantile(precision.confidence, n - 1)
    one_sky = given or scatter == 0.0
    error, number, width = scatter, float(n), student
    if one_sky:
        error, number, width = _of_one_sky(tally, plane, p, scatter, precision.confidence, single=given or n == 1)
    number, low, high = effective_number(p, error, number), np.nan, np.nan
    if not np.isnan(error):
        low, high = INTERVALS["wilson" if one_sky else precision.interval](
            parts, p, number, tally.trials, width, precision.confidence, question.rng
        )
    # the error that more iterations reduce; it may differ from the error that is reported
    reducible = scatter if given or np.isnan(error) else error
    half = float(np.ptp(wilson(p, effective_number(p, reducible, n), student))) / 2
    if min(np.count_nonzero(rates > 0), np.count_nonzero(rates < 1)) < min(HITS, n / 2):
        half = max(half, float(np.ptp(wilson(0.0, n, normal))) / 2)
    reason = {"no_interval": TOO_FEW} if np.isnan(low) else {}
    return {
        "value": (low + high) / 2 if precision.estimator == "midpoint" and not np.isnan(low) else p,
        "low": low,
        "high": high,
        "standard_error": error,
        "n_effective": number,
        "half_width": half,
        "design_effect": tally.trials / number,
        **reason,
    }


def _of_one_sky(tally, plane, p, scatter, confidence, *, single):
    """Return the standard error, the number of trials and the quantile for one sky, or NaN if the plane is too small.

    If ``single`` is false, the tally contains several skies, which all have the same rate. If this rate is 0 or 1, each
    sky is one trial.
    """
    variance, degrees = sky_variance(plane, tally.per_positioner)
    n, certain = len(tally.rates()), p in (0.0, 1.0)
    if degrees < FEWEST_DEGREES and (single or not certain):
        return np.nan, np.nan, np.nan
    if certain:
        return 0.0, _trials(plane, tally.trials / n) if single else float(n), quantile(confidence, np.inf)
    return float(np.hypot(scatter, np.sqrt(variance))), _trials(plane, tally.trials / n), quantile(confidence, degrees)


def _trials(plane, n):
    """Return the effective number of trials of ``n`` positioners if all pairs of neighbors are fully correlated."""
    return n / (1 + 2 * len(plane.arrays.neighbors) / len(plane))


def rate_interval(plane: FocalPlane, probabilities: list[np.ndarray], confidence: float) -> tuple[float, float, float]:
    """Return the mean collision probability over positioners and fields, and the two ends of its confidence interval.

    The interval allows for differences between fields of the same kind. These differences are estimated from the
    scatter between positioners. Each array in ``probabilities`` contains the values of one field, with NaN for
    positioners that are not counted. The ends of the interval are NaN if the fields have too few positioners for this
    estimate.
    """
    counts = np.array([np.count_nonzero(~np.isnan(probability)) for probability in probabilities])
    n = int(counts.sum())
    if n == 0:
        return np.nan, np.nan, np.nan
    p = min(float(np.nansum(probabilities) / n), 1.0)
    spread = np.array(
        [sky_variance(plane, probability) for probability, count in zip(probabilities, counts, strict=True) if count]
    )
    variances, degrees = spread[:, 0] * (counts[counts > 0] / n) ** 2, float(spread[:, 1].sum())
    if degrees < FEWEST_DEGREES or np.isnan(variances).any():
        return p, np.nan, np.nan
    width = quantile(confidence, degrees if 0 < p < 1 else np.inf)
    return p, *wilson(p, effective_number(p, float(np.sqrt(variances.sum())), _trials(plane, n)), width)
