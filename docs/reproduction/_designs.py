"""The designs of Chen et al. (2024), and estimates of their collision probabilities."""

from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass, replace

import astropy.units as u
import numpy as np
from astropy.table import QTable, Row

from rfpsurvey._common.executors import map_with_progress
from rfpsurvey.errors import used_elsewhere
from rfpsurvey.focal_plane import FocalPlane
from rfpsurvey.positioner import Positioner
from rfpsurvey.probability import Estimate, RandomTargets, collision_probability

__all__ = [
    "LARGE",
    "SMALL",
    "Settings",
    "each",
    "error_of_fraction",
    "estimate",
    "numbers_of",
    "plane_of",
    "random_designs",
    "scaled",
]

D = 4.5
N_TARGETS = 20_000
SMALL = {"rings": 2, "radius": 76.8 * u.mm}
LARGE = {"rings": 12, "radius": 200 * u.mm}
MOST_ENTRIES = 32
"""Maximum number of targets that are used from each queue; a small number allows more realizations in the same time."""


@dataclass(frozen=True)
class Settings:
    """The settings of all experiments."""

    quick: bool = False
    executor: Executor | None = None
    progress: bool = False
    seed: int = 0
    error: float | None = None
    """Standard error to reach for the collision probability of every design.

    By default, it is 0.0001, or 0.002 in a quick run.
    """

    @property
    def precision(self) -> float:
        """Standard error to reach for the collision probability of every design."""
        usual = 2e-3 if self.quick else 1e-4
        return usual if self.error is None else self.error

    def pick(self, full: int, quick: int) -> int:
        """Return the number ``full`` for a full run, and the number ``quick`` for a quick run."""
        return quick if self.quick else full


def plane_of(l1: float, ratio: float, pitch: float, rings: int) -> FocalPlane:
    """Return the focal plane of a design; lengths are in mm."""
    unit = Positioner(l1 * u.mm, l1 * ratio * u.mm, D / 2 * u.mm)
    return FocalPlane.hexagonal(unit, rings=rings, pitch=pitch * u.mm)


def random_designs(settings: Settings) -> QTable:
    """Return the designs of the experiment "large", whose parameters are drawn from uniform distributions."""
    rng = np.random.default_rng([settings.seed, 80])
    l1, ratio, pitch = rng.uniform((7.25, 1, 24.6), (14.5, 2, 35), (80, 3))[: settings.pick(80, 24)].T
    return QTable({"central_arm": l1 * u.mm, "ratio": ratio, "pitch": pitch * u.mm})


def numbers_of(design: Row) -> tuple[float, float, float]:
    """Return the central arm (mm), the ratio of the arms and the pitch (mm) of a design."""
    l1, pitch = (float(design[name].to_value(u.mm)) for name in ("central_arm", "pitch"))
    return l1, float(design["ratio"]), pitch


def estimate(
    l1: float, ratio: float, pitch: float, layout: dict, settings: Settings, seed: list[int], **options: object
) -> Estimate:
    """Return the estimated collision probability of a design, by default for allocated uniform targets."""
    plane = plane_of(l1, ratio, pitch, layout["rings"])
    options = {"targets": RandomTargets(), "precision": settings.precision, **options}
    if options.get("method", "conditional") == "conditional":
        options.setdefault("most_entries", MOST_ENTRIES)
    if isinstance(options["targets"], RandomTargets):
        options["targets"] = replace(options["targets"], number=N_TARGETS, radius=layout["radius"])
    with used_elsewhere():  # methods use different options
        return collision_probability(plane, rng=np.random.default_rng(seed), **options)


def scaled(values: np.ndarray) -> np.ndarray:
    """Return values scaled so that the smallest is 0 and the largest is 1."""
    values = np.asarray(values, dtype=float)
    return (values - values.min()) / (values.max() - values.min())


def error_of_fraction(p: float, n: int) -> float:
    """Return the standard error of a fraction ``p`` of ``n`` trials; the error is never 0."""
    return float(np.sqrt(max(p * (1 - p), 1 / n) / n))


def each(task: Callable, jobs: list, settings: Settings) -> list:
    """Call ``task`` for each job, show the progress, and return the results in the order of the jobs."""
    return map_with_progress(settings.executor, settings.progress, "jobs", task, jobs)
