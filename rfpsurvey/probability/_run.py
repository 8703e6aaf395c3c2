"""Repeat a simulation until the confidence interval is narrow enough."""

from collections.abc import Callable

import numpy as np

from rfpsurvey._executors import map_in_order
from rfpsurvey._progress import Progress
from rfpsurvey.errors import InputError, number_of
from rfpsurvey.focal_plane import FocalPlane
from rfpsurvey.probability._intervals import INTERVALS, converged, effective_number, quantile, wilson
from rfpsurvey.probability._one_sky import FEWEST_DEGREES, sky_variance
from rfpsurvey.probability._options import Precision
from rfpsurvey.probability._question import ProbabilityQuestion
from rfpsurvey.probability._simulate import CollisionSums, merge

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
the mean of many estimates would be too low.
"""
FORESIGHT = 1.05
"""Factor by which the predicted number of realizations is increased, so that this number is rarely too small."""
TOO_FEW = (
    "the focal plane has too few positioners to estimate how much the collision rate differs between sets of targets"
)
"""Message that states why an estimate has no interval."""


def run(
    question: ProbabilityQuestion, task: Callable[[int, np.random.Generator], CollisionSums], chunk: int
) -> tuple[CollisionSums, dict]:
    """Simulate realizations until the requested precision or the maximum number of realizations is reached.

    The function returns the tally of all realizations and its summary. The number of tasks and the number of
    realizations per task depend only on earlier results. Therefore, the number of workers does not change the result.
    """
    precision, rng = question.precision, question.rng
    given = question.targets is not None and question.targets.kind == "given"
    parts: list[CollisionSums] = []
    means, total, used, done = [], 0.0, 0, 0
    note = ""
    goal = min(FIRST_TASKS * chunk, precision.max_iterations)
    with Progress(question.progress) as bar:
        while True:
            sizes = [min(chunk, goal - k) for k in range(done, goal, chunk)]
            for part in map_in_order(question.executor, task, sizes, rng.spawn(len(sizes))):
                parts.append(part)
                rates = part.rates()
                total, used, done = total + float(rates.sum()), used + len(rates), done + len(part.pairs)
                means.append(total / used if used else np.nan)
                bar(0.99 * done / goal, note=f"{number_of(done, 'realization')}{note}")
            parts = [tally := merge(parts)]
            if used == 0 and done < precision.max_iterations:  # no positioner has been counted yet
                goal = min(GROWTH * done, precision.max_iterations)
                continue
            summary = summarize(tally, question.focal_plane, precision, rng, given=given)
            wide = summary.pop("half_width")
            note = "" if np.isnan(summary["standard_error"]) else f", standard error {summary['standard_error']:.2g}"
            floor = _fewest(tally, precision)
            met = precision.standard_error is not None and (
                wide <= precision.half_width and done >= floor
                if precision.stop == "interval"
                else converged(means, precision.standard_error)
            )
            if met or done >= precision.max_iterations:
                break
            more = done + chunk
            if precision.stop == "interval":
                needed = done * (wide / precision.half_width) ** 2 if precision.half_width > 0 else np.inf
                more = max(more, int(min(max(FORESIGHT * needed, floor), GROWTH * done)))
            goal = min(-(-more // chunk) * chunk, precision.max_iterations)
        bar(1)
    return tally, {**summary, "met": met}


def _fewest(tally, precision):
    """Return the minimum number of realizations, which is 0 unless collisions or their absence are rare.

    Collisions are rare if fewer than half of the realizations have a collision; their absence is rare if all
    positioners collide in more than half of the realizations. The estimated error grows with the number of rare events.
    A stopping rule based on this error therefore ends the simulation too early if, by chance, there are too few events.
    A minimum number of realizations that does not depend on the number of events prevents this.
    """
    rates = tally.rates()
    if precision.standard_error is None or min((rates > 0).mean(), (rates < 1).mean()) >= 0.5:
        return 0.0
    return FLOOR / precision.standard_error * min(1.0, 2 / float(tally.colliding[:, 1].mean()))


def summarize(
    tally: CollisionSums, plane: FocalPlane, precision: Precision, rng: np.random.Generator, *, given: bool
) -> dict:
    """Return the mean collision rate of a tally, its confidence interval and standard error, and a half width.

    The half width determines when iterations end: it contains only the error that more iterations reduce. If the
    targets are given, or if all realizations have the same rate, the tally is treated as the result for one sky (one
    set of targets). The standard error then states how much the rate may differ from the mean over all skies with the
    same statistical properties. If the focal plane has too few positioners to estimate this error, there is no
    confidence interval, and ``no_interval`` states the reason.
    """
    rates, normal = tally.rates(), quantile(precision.confidence, np.inf)
    if len(rates) == 0:
        raise InputError(
            "at least one positioner must be counted, but no positioner reaches a target, and none is a parked obstacle"
        )
    n, p = len(rates), min(float(rates.mean()), 1.0)
    scatter = float(rates.std(ddof=1) / np.sqrt(n)) if n > 1 else 0.0
    scatter = 0.0 if scatter < 1e-14 else scatter
    student = quantile(precision.confidence, n - 1)
    one_sky = given or scatter == 0.0
    error, number, width = scatter, float(n), student
    if one_sky:
        error, number, width = _of_one_sky(tally, plane, p, scatter, precision.confidence, single=given or n == 1)
    number, low, high = effective_number(p, error, number), np.nan, np.nan
    if not np.isnan(error):
        low, high = INTERVALS["wilson" if one_sky else precision.interval](
            rates, p, number, tally.trials, width, precision.confidence, rng
        )
    # the error that more iterations reduce; it may differ from the error that is reported
    reducible = scatter if given or np.isnan(error) else error
    half = float(np.ptp(wilson(p, effective_number(p, reducible, n), student))) / 2
    if min(np.count_nonzero(rates > 0), np.count_nonzero(rates < 1)) < min(HITS, n / 2):
        half = max(half, float(np.ptp(wilson(0.0, n, normal))) / 2)
    reason = {"no_interval": TOO_FEW} if np.isnan(low) else {}
    return {
        "value": p,
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
    found = np.array(
        [sky_variance(plane, probability) for probability, count in zip(probabilities, counts, strict=True) if count]
    )
    variances, degrees = found[:, 0] * (counts[counts > 0] / n) ** 2, float(found[:, 1].sum())
    if degrees < FEWEST_DEGREES or np.isnan(variances).any():
        return p, np.nan, np.nan
    width = quantile(confidence, degrees if 0 < p < 1 else np.inf)
    return p, *wilson(p, effective_number(p, float(np.sqrt(variances.sum())), _trials(plane, n)), width)
