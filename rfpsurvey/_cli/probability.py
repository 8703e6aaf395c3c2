"""The command ``rfpsurvey probability``."""

import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import rfpsurvey as rs
from rfpsurvey import inputs
from rfpsurvey._cli import _app, _print
from rfpsurvey._cli._command import command
from rfpsurvey._executors import released
from rfpsurvey.catalog import is_example
from rfpsurvey.errors import listed
from rfpsurvey.inputs import Located, Part
from rfpsurvey.probability import METHODS, QUEUEING, Precision, RandomTargets


@dataclass(frozen=True)
class TargetsKeys:
    """Further keys of targets.

    Parameters
    ----------
    kind : str, optional
        Targets: uniform, poisson or poisson_disc for random targets, or a catalog, such as example:anticenter.
    """

    kind: Annotated[str, Located] = "uniform"


@dataclass(frozen=True, kw_only=True)
class ProbabilityKeys:
    """The keys of the command.

    Parameters
    ----------
    estimand : str, optional
        Definition of the collision probability, for the method auto: allocated (an allocator assigns the targets; the
        default) or independent (each positioner draws its own target).
    allocator : str, optional
        Allocator that assigns the targets.
    density : str, optional
        Probability density of independent targets in the patrol area: uniform; shared (proportional to 1/k at points
        that k positioners reach); or voronoi (uniform over the points that are nearer to the center of the positioner
        than to any other center).
    dynamic : float, optional
        Probability that a positioner does not reach its target, for example because of a dynamic collision. Such
        failures are assumed to be independent.
    """

    instrument: inputs.InstrumentKeys
    targets: Annotated[dict, Part(RandomTargets, TargetsKeys)]
    catalog: inputs.CatalogKeys
    precision: Annotated[dict, Part(Precision)]
    output: inputs.TableOutputKeys
    method: Annotated[
        str,
        f"Method: {listed(METHODS)}, a method of an installed package, or auto, which selects the fastest method with "
        "an error estimate.",
    ] = "auto"
    estimand: str | None = None
    allocator: str = QUEUEING
    density: str | None = None
    dynamic: float = 0.0
    rng: inputs.Seed = 0
    workers: inputs.Workers = 1


@command(
    ProbabilityKeys,
    "method estimand precision.standard_error precision.max_iterations targets.kind allocator density rng workers "
    "output.path output.plot output.report output.overwrite",
    argument="instrument.name",
)
def probability(keys: ProbabilityKeys) -> None:
    r"""Estimate the probability that arms collide, with a confidence interval.

    Examples
    --------
    rfpsurvey probability lamost
    rfpsurvey probability sdss_apo --method monte_carlo --precision 0.002 \
        --workers 2
    rfpsurvey probability moons --estimand independent --density shared
    rfpsurvey probability lamost --targets stars.fits --output map.fits \
        --plot map.png
    """
    kind = keys.targets.get("kind")
    _app.check_outputs(keys.output, (kind, keys.instrument.name, keys.instrument.broken))
    model = _app.model_of(keys.instrument)
    options = {name: getattr(keys, name) for name in ("method", "estimand", "allocator", "density", "dynamic", "rng")}
    options |= {"precision": Precision(**keys.precision), "targets": _targets(keys.catalog, **keys.targets)}
    with released(ThreadPoolExecutor(keys.workers)) as executor:
        options |= {"executor": executor, "progress": sys.stderr.isatty()}
        estimate = rs.collision_probability(model, **options)
    _print.finish_estimate(estimate, model, keys.output)


def _targets(catalog, kind: str = "uniform", **options):
    """Return random targets if ``kind`` is a kind of random targets; otherwise, read a catalog."""
    if not (Path(kind).suffix or is_example(kind)):
        inputs.warn_without_catalog(catalog)
        return RandomTargets(kind, **options)
    for name in options:
        raise rs.InputError(f"targets.{name} can be used only with random targets, but a catalog was given")
    return _app.read_catalog(replace(catalog, path=Path(kind)))
