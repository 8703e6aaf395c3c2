"""Coverage of the confidence intervals: the fraction of intervals that contain the true value."""

from dataclasses import replace

import astropy.units as u
import numpy as np
from astropy.table import QTable

from reproduction._claims import NOT_REPRODUCED, REPRODUCED, Claim
from reproduction._designs import Settings, each, error_of_fraction
from reproduction._one_sky import one_sky
from rfpsurvey._studies.intervals import INTERVALS, quantile, wilson
from rfpsurvey._studies.run import run, summarize
from rfpsurvey._studies.simulate import QUEUEING, Simulation
from rfpsurvey._studies.targets import make_source
from rfpsurvey.allocation import AllocationOptions
from rfpsurvey.focal_plane import FocalPlane
from rfpsurvey.positioner import Positioner
from rfpsurvey.probability import METHODS, Precision, ProbabilityQuestion, RandomTargets, collision_probability

__all__ = ["coverage", "intervals"]

# For each instrument: central arm, eccentric arm, pitch and half of the minimum separation (all in mm), and the number
# of targets; then the standard error that each method must reach.
SCENES = {
    "LAMOST": ((8.25, 8.25, 25.6, 2.25, 148), {"monte_carlo": 0.003, "conditional": 0.0015}),
    "SDSS-V": ((7.4, 15.0, 22.4, 2.5391, 148), {"monte_carlo": 0.005, "conditional": 0.003}),
}
CONFIDENCE = 0.95


def intervals(settings: Settings) -> tuple[dict[str, QTable], list[Claim]]:
    """Return the coverage of each kind of confidence interval for each stopping rule, and the claims about coverage."""
    table = coverage(settings)
    claims = []
    for scene in SCENES:
        part = table[(table["scene"] == scene) & (table["method"] == "monte_carlo")]
        rows = {(r["stop"], r["interval"]): r for r in part}
        good, early = rows["interval", "wilson"], rows["convergence", "wilson"]
        expected = np.sqrt(early["iterations"] / good["iterations"])
        claims.append(
            Claim(
                "intervals",
                "the result is more stable with the confidence interval than with convergence as the stopping rule "
                f"({scene})",
                "stated",
                f"root-mean-square error divided by the requested error: {good['error_ratio']:.2f} with the interval "
                f"({good['iterations']:.0f} iterations on average), {early['error_ratio']:.2f} with convergence "
                f"({early['iterations']:.0f} iterations on average); the ratio of the two errors is "
                f"{good['error_ratio'] / early['error_ratio']:.2f}, and {expected:.2f} is expected from the numbers of "
                "iterations alone",
                REPRODUCED if good["error_ratio"] < min(1.1, early["error_ratio"]) else NOT_REPRODUCED,
                "convergence means that the running mean changes by less than the requested error three times in a row",
            )
        )
        naive, single = rows["interval", "wilson_naive"], rows["interval", "wilson_iterations"]
        claims.append(
            Claim(
                "intervals",
                f"Wilson's interval of the simulations has a confidence of 0.95 ({scene})",
                "0.95",
                f"coverage {naive['coverage']:.3f} +- {naive['coverage_error']:.3f} with every positioner as a trial; "
                f"{single['coverage']:.3f} +- {single['coverage_error']:.3f} with every iteration as a trial; "
                f"{good['coverage']:.3f} +- {good['coverage_error']:.3f} with the effective number of trials",
                REPRODUCED if min(abs(r["coverage"] - CONFIDENCE) for r in (naive, single)) < 0.015 else NOT_REPRODUCED,
                "the number of trials is the number of iterations, or the number of iterations times the number of "
                "positioners; the text of the paper allows both interpretations",
            )
        )
    middle = {p: np.mean(wilson(p, 6000, quantile(CONFIDENCE, np.inf))) for p in (0.0007, 0.06, 0.4)}
    claims.append(
        Claim(
            "intervals",
            "the mean of the upper and the lower bound is taken as the collision probability",
            "stated",
            "; ".join(f"{p:g} becomes {value:.4f}" for p, value in middle.items()),
            NOT_REPRODUCED,
            "6000 iterations are the trials of Wilson's interval; the mean of the bounds is biased toward 0.5, and "
            "small probabilities become too large; Precision(max_iterations=6000, interval='wilson_iterations', "
            "estimator='midpoint') is this estimator",
        )
    )
    return {"intervals": table, "one_sky": one_sky(settings)}, claims


def coverage(settings: Settings, repeats: int | None = None) -> QTable:
    """Return how often each kind of interval contains the true value, for plain and for conditional simulation.

    Every repeat runs until its stopping rule is met. The true value is estimated by a conditional simulation. The
    standard error of this estimate is one twentieth (in a quick run, one fifth) of the smallest standard error that the
    repeats must reach.
    """
    repeats = settings.pick(4000, 100) if repeats is None else repeats
    jobs = [
        (scene, method, stop)
        for scene in SCENES
        for method, stop in (("monte_carlo", "interval"), ("monte_carlo", "convergence"), ("conditional", "interval"))
    ]
    rows = [row for rows in each(lambda job: _repeat(*job, repeats, settings), jobs, settings) for row in rows]
    names = (
        "scene",
        "method",
        "stop",
        "interval",
        "truth",
        "coverage",
        "coverage_error",
        "half_width",
        "error_ratio",
        "iterations",
        "repeats",
    )
    return QTable(rows=rows, names=names)


def _repeat(scene, method, stop, repeats, settings):
    (l1, l2, pitch, d, n_targets), precisions = SCENES[scene]
    plane = FocalPlane.hexagonal(Positioner(l1 * u.mm, l2 * u.mm, d * u.mm), rings=3, pitch=pitch * u.mm)
    targets = RandomTargets(number=n_targets)
    finest = min(precisions.values()) / settings.pick(20, 5)
    truth = collision_probability(plane, targets=targets, precision=finest, rng=settings.seed + 1).value
    source = make_source(plane, None, targets)
    simulation = Simulation(plane, source, AllocationOptions(QUEUEING))
    task = simulation.draw if method == "monte_carlo" else simulation.expect
    precision = Precision(precisions[method], 100_000, CONFIDENCE, "wilson", stop)
    kinds = list(INTERVALS) if stop == "interval" else ["wilson"]
    held, widths, errors, iterations = dict.fromkeys(kinds, 0), dict.fromkeys(kinds, 0.0), [], []
    seed = [settings.seed, 95, list(SCENES).index(scene), ("monte_carlo", "conditional").index(method), len(stop)]
    for rng in np.random.default_rng(seed).spawn(repeats):
        question = ProbabilityQuestion(plane, source, precision=precision, rng=rng)
        tallies, found = run(question, task, METHODS[method].chunk)
        errors.append(found["value"] - truth)
        iterations.append(sum(len(tally.pairs) for tally in tallies))
        for kind in kinds:
            own = dict(found)
            if kind != "wilson":
                own = summarize(tallies, replace(question, precision=replace(precision, interval=kind)))
            held[kind] += own["low"] <= truth <= own["high"]
            widths[kind] += (own["high"] - own["low"]) / 2 / repeats
    ratio = float(np.sqrt(np.mean(np.square(errors)))) / precisions[method]
    return [
        (
            scene,
            method,
            stop,
            kind,
            truth,
            held[kind] / repeats,
            error_of_fraction(held[kind] / repeats, repeats),
            widths[kind],
            ratio,
            float(np.mean(iterations)),
            repeats,
        )
        for kind in kinds
    ]
