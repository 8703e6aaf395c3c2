"""Repeat a simulation until its interval is narrow enough."""

import sys
from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass

import numpy as np
from astropy.utils.console import ProgressBar

from rfpsurvey._executors import map_in_order
from rfpsurvey.errors import InputError
from rfpsurvey.focal_plane import FocalPlane
from rfpsurvey.probability._intervals import INTERVALS, converged, effective_number, quantile, wilson
from rfpsurvey.probability._simulate import Tally, merge

__all__ = ["Precision", "Progress", "patch_error", "rate_interval", "run", "summarize"]

FIRST_TASKS = 2
"""Tasks before the first look at the error."""
GROWTH = 8
"""The next look comes after at most this many times what has been seen."""
HITS = 25
"""Where most realizations have no collision (or nothing else): so many others it takes to know how rates scatter."""
FORESIGHT = 1.05
"""What is foreseen to be needed is taken a little more of, so that there is rarely another look."""


@dataclass(frozen=True)
class Precision:
    """When to stop."""

    standard_error: float | None
    max_iterations: int
    confidence: float = 0.95
    interval: str = "wilson"
    stop: str = "interval"

    @property
    def half_width(self) -> float:
        """Half width of an interval that is narrow enough."""
        return 0.0 if self.standard_error is None else quantile(self.confidence, np.inf) * self.standard_error


class Progress:
    """A bar on the standard error, if wanted, from 0 to 1."""

    def __init__(self, wanted: bool):
        self.bar = ProgressBar(1000, file=sys.stderr) if wanted else None

    def __call__(self, part: float) -> None:
        if self.bar is not None:
            self.bar.update(round(1000 * min(part, 1.0)))

    def close(self) -> None:
        """End the line."""
        if self.bar is not None:
            self.bar.update(1000)
            self.bar.__exit__(None, None, None)


def run(
    task: Callable[[int, np.random.Generator], Tally],
    chunk: int,
    precision: Precision,
    plane: FocalPlane,
    rng: np.random.Generator,
    executor: Executor | None,
    progress: bool,
    *,
    given: bool,
) -> tuple[Tally, dict]:
    """Return what all realizations say, and the summary of it that met the precision (or came last).

    Tasks and looks depend on the results alone, so that the number of workers has no influence.
    """
    bar = Progress(progress)
    parts: list[Tally] = []
    means, total, used, done = [], 0.0, 0, 0
    goal = min(FIRST_TASKS * chunk, precision.max_iterations)
    while True:
        sizes = [min(chunk, goal - k) for k in range(done, goal, chunk)]
        for part in map_in_order(executor, task, sizes, rng.spawn(len(sizes))):
            parts.append(part)
            rates = part.rates()
            total, used, done = total + float(rates.sum()), used + len(rates), done + len(part.pairs)
            means.append(total / used if used else np.nan)
            bar(0.99 * done / goal)
        parts = [tally := merge(parts)]
        if used == 0 and done < precision.max_iterations:  # nobody has counted yet
            goal = min(GROWTH * done, precision.max_iterations)
            continue
        summary = summarize(tally, plane, precision, rng, given=given)
        wide = summary.pop("half_width")
        met = precision.standard_error is not None and (
            wide <= precision.half_width if precision.stop == "interval" else converged(means, precision.standard_error)
        )
        if met or done >= precision.max_iterations:
            break
        more = done + chunk
        if precision.stop == "interval":
            needed = done * (wide / precision.half_width) ** 2 if precision.half_width > 0 else np.inf
            more = max(more, int(min(FORESIGHT * needed, GROWTH * done)))
        goal = min(-(-more // chunk) * chunk, precision.max_iterations)
    bar.close()
    return tally, {**summary, "met": met}


def summarize(tally: Tally, plane: FocalPlane, precision: Precision, rng: np.random.Generator, *, given: bool) -> dict:
    """Return value, interval and error of what has been seen, and the half width that more iterations can reduce.

    Where the targets are given, or for another reason nothing scatters, there is one sky: what another patch of it
    would say is part of the error.
    """
    rates, normal = tally.rates(), quantile(precision.confidence, np.inf)
    if len(rates) == 0:
        raise InputError("no positioner reaches any target, and none is parked in the way: there is nothing to score")
    n, p = len(rates), min(float(rates.mean()), 1.0)
    scatter = float(rates.std(ddof=1) / np.sqrt(n)) if n > 1 else 0.0
    scatter = 0.0 if scatter < 1e-14 else scatter
    one_sky = given or scatter == 0.0
    error = float(np.hypot(scatter, patch_error(plane, tally.per_positioner))) if one_sky and 0 < p < 1 else scatter
    trials = n if n > 1 else tally.trials / (1 + 2 * len(plane._neighbors) / len(plane))
    number, student = effective_number(p, error, trials), quantile(precision.confidence, n - 1)
    low, high = INTERVALS["wilson" if one_sky else precision.interval](
        rates, p, number, tally.trials, normal if one_sky else student, precision.confidence, rng
    )
    # what iterations can reduce, whatever interval is reported
    half = half_width(wilson(p, effective_number(p, scatter if given else error, trials), student))
    if min(np.count_nonzero(rates > 0), np.count_nonzero(rates < 1)) < min(HITS, n / 2):
        half = max(half, half_width(wilson(0.0, n, normal)))
    return {
        "value": p, "low": low, "high": high, "standard_error": error, "n_effective": number,
        "half_width": half, "design_effect": tally.trials / number,
    }  # fmt: skip


def half_width(interval: tuple[float, float]) -> float:
    """Return half of an interval's length."""
    return (interval[1] - interval[0]) / 2


def patch_error(plane: FocalPlane, risk: np.ndarray, mean: float | None = None) -> float:
    """Return the standard error of the mean over positioners, each correlated with its neighbors.

    It says how far another patch of a sky of the same kind may differ.
    """
    away = np.where(np.isnan(risk), 0.0, risk - (np.nanmean(risk) if mean is None else mean))
    n = np.count_nonzero(~np.isnan(risk))
    own = float(away @ away)
    first, second = plane._neighbors.T
    return float(np.sqrt(max(own + 2 * float(away[first] @ away[second]), own)) / n)


def rate_interval(plane: FocalPlane, risks: list[np.ndarray], confidence: float) -> tuple[float, float, float]:
    """Return the mean over positioners and fields, and its interval: how far other fields of the kind may differ.

    Each row of ``risks`` is a field, with NaN where a positioner does not count.
    """
    counts = np.array([np.count_nonzero(~np.isnan(risk)) for risk in risks])
    n = int(counts.sum())
    if n == 0:
        return np.nan, np.nan, np.nan
    p = min(float(np.nansum(risks) / n), 1.0)
    errors = np.array(
        [patch_error(plane, risk, p) if count else 0.0 for risk, count in zip(risks, counts, strict=True)]
    )
    error = float(np.hypot.reduce(errors * counts) / n) if 0 < p < 1 else 0.0
    trials = n / (1 + 2 * len(plane._neighbors) / len(plane))
    return p, *wilson(p, effective_number(p, error, trials), quantile(confidence, np.inf))
