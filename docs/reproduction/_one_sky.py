"""How often a confidence interval from one set of targets (sky) contains the mean over all such sets."""

import astropy.units as u
import numpy as np
from astropy.table import QTable

from reproduction._designs import Settings, each, error_of_fraction
from rfpsurvey._studies.run import summarize
from rfpsurvey._studies.simulate import Simulation
from rfpsurvey._studies.targets import make_source
from rfpsurvey.allocation import AllocationOptions
from rfpsurvey.focal_plane import FocalPlane
from rfpsurvey.positioner import Positioner
from rfpsurvey.probability import Precision, ProbabilityQuestion, RandomTargets

__all__ = ["one_sky"]

# central arm, eccentric arm, pitch and half of the minimum separation (mm)
ARMS = {
    "LAMOST": (8.25, 8.25, 25.6, 2.25),
    "SDSS-V": (7.4, 15.0, 22.4, 2.5391),
    "MOONS": (8.0, 17.0, 25.058, 2.0),
}
RINGS = (1, 2, 3, 4, 5, 6, 12)
PER_POSITIONER = (4.0, 1.0)
CLUSTERED = {
    "clusters of 6, 5 mm": [(arms, rings) for arms in ("LAMOST", "SDSS-V") for rings in (3, 5)],
    "clusters of 60, 40 mm": [("LAMOST", 5), ("SDSS-V", 5)],
}
"""Focal planes that are also simulated with clustered targets."""
CLUSTERS = {"clusters of 6, 5 mm": (6.0, 5.0), "clusters of 60, 40 mm": (60.0, 40.0)}
"""Mean number of targets per cluster, and standard deviation (mm) of the target positions along x and along y."""
MOST_LARGE = 800
"""Number of skies (sets of targets) for focal planes of 200 positioners or more; 2000 are used for smaller planes."""
CONFIDENCE = 0.95


def one_sky(settings: Settings) -> QTable:
    """Return how often the confidence interval from one set of targets contains the true value, by focal plane.

    The focal planes have 7 to 469 positioners. The true value is the mean over other random sets of targets (skies).
    """
    jobs = [
        (arms, rings, number, "uniform")
        for arms in ARMS
        for rings in (RINGS if not settings.quick else (1, 3))
        for number in PER_POSITIONER
    ]
    jobs += [(*plane, 4.0, sky) for sky, planes in CLUSTERED.items() for plane in planes]
    rows = each(lambda job: _row(*job, settings), jobs, settings)
    names = (
        "arms",
        "positioners",
        "targets_per_positioner",
        "sky",
        "truth",
        "scatter",
        "estimated_scatter",
        "coverage",
        "coverage_error",
        "half_width",
        "with_interval",
        "skies",
    )
    return QTable(rows=rows, names=names)


def _row(arms, rings, number, sky, settings):
    l1, l2, pitch, d = ARMS[arms]
    plane = FocalPlane.hexagonal(Positioner(l1 * u.mm, l2 * u.mm, d * u.mm), rings=rings, pitch=pitch * u.mm)
    skies = settings.pick(2000 if len(plane) < 200 else MOST_LARGE, 40)
    n_targets = round(number * len(plane))
    source = make_source(plane, None, RandomTargets(number=n_targets))
    if sky in CLUSTERS:
        source = make_source(plane, None, _clustered(n_targets, source.radius, *CLUSTERS[sky]))
    simulation = Simulation(plane, source, AllocationOptions("balanced"))
    seed = [settings.seed, 37, list(ARMS).index(arms), rings, round(10 * number), len(sky)]
    rng, other = np.random.default_rng(seed).spawn(2)
    truth = float(simulation.expect(skies, other).rates().mean())
    given, found = ProbabilityQuestion(plane, precision=Precision(None, 1, CONFIDENCE), rng=rng), []
    for _ in range(skies):
        tally = simulation.expect(1, rng)
        if len(tally.rates()):
            found.append(summarize([tally], given))
    values, low, high, errors = (np.array([f[k] for f in found]) for k in ("value", "low", "high", "standard_error"))
    some = np.isfinite(low)
    n = int(np.count_nonzero(some))
    if n < skies / 2:  # if few skies have an interval, these skies are a biased sample
        return (arms, len(plane), number, sky, truth, float(values.std()), *[np.nan] * 4, n / len(found), skies)
    held = float(np.mean((low <= truth) & (truth <= high), where=some))
    error, half_width = float(np.sqrt(np.mean(errors[some] ** 2))), float(np.mean((high - low)[some]) / 2)
    return (
        arms,
        len(plane),
        number,
        sky,
        truth,
        float(values.std()),
        error,
        held,
        error_of_fraction(held, n),
        half_width,
        n / len(found),
        skies,
    )


def _clustered(n_targets, radius, size, scale):
    """Return a function that draws clustered targets.

    The centers of the clusters are uniform, and the numbers of targets in them have a Poisson distribution.
    """
    wide = radius + 4 * scale

    def sampler(rng):
        centers = rng.poisson(n_targets / size * (wide / radius) ** 2)
        r, angle = wide * np.sqrt(rng.random(centers)), rng.uniform(0, 2 * np.pi, centers)
        sizes = rng.poisson(size, centers)
        parents = np.repeat(np.column_stack([r * np.cos(angle), r * np.sin(angle)]), sizes, axis=0)
        points = parents + rng.normal(0, scale, parents.shape)
        return points[np.hypot(*points.T) < radius] * u.mm

    return sampler
