"""The command ``rfpsurvey probability``."""

import sys
from concurrent.futures import ThreadPoolExecutor
from typing import Annotated

import typer

import rfpsurvey as rs
from rfpsurvey._cli import _app, _examples, _main, _margins, _options, _states
from rfpsurvey._executors import released
from rfpsurvey.errors import listed
from rfpsurvey.probability import METHODS, QUEUEING, Precision, RandomTargets


@_main.app.command(epilog=_examples.PROBABILITY_EXAMPLES)
def probability(
    instrument: Annotated[str, typer.Argument(help="Name of a preset, or path of a TOML file.")] = "lamost",
    arm_model: _options.ArmModelOption = None,
    broken: _states.BrokenOption = None,
    state_time: _states.OwnStateTimeOption = None,
    margins: _margins.MarginsOption = None,
    method: Annotated[
        str,
        typer.Option(
            help=f"Method: {listed(METHODS)}, a method of an installed package, or auto, which selects the fastest "
            "method with an error estimate."
        ),
    ] = "auto",
    estimand: Annotated[
        str | None,
        typer.Option(
            help="Definition of the collision probability, for the method auto: allocated (an allocator assigns the "
            "targets; the default) or independent (each positioner draws its own target)."
        ),
    ] = None,
    precision: Annotated[float | None, typer.Option(help="Standard error at which the computation ends.")] = None,
    max_iterations: Annotated[
        int | None, typer.Option(help="Largest number of iterations, realizations or points, depending on the method.")
    ] = None,
    targets: Annotated[
        str,
        typer.Option(
            help="Targets: uniform, poisson or poisson_disc for random targets, or a catalog, such as "
            "example:anticenter."
        ),
    ] = "uniform",
    hdu: _options.HduOption = None,
    n_targets: Annotated[float | None, typer.Option(help="Number of random targets.")] = None,
    target_radius: Annotated[
        float | None, typer.Option(help="Radius of the circle that contains the random targets (mm).")
    ] = None,
    min_separation: Annotated[
        float | None, typer.Option(help="Minimum separation of the targets, for poisson_disc (mm).")
    ] = None,
    allocator: Annotated[str, typer.Option(help="Allocator that assigns the targets.")] = QUEUEING,
    density: Annotated[
        str | None,
        typer.Option(
            help="Probability density of independent targets in the patrol area: uniform; shared (proportional to "
            "1/k at points that k positioners reach); or voronoi (uniform over the points that are nearer to the "
            "center of the positioner than to any other center)."
        ),
    ] = None,
    dynamic: Annotated[
        float,
        typer.Option(
            help="Probability that a positioner does not reach its target, for example because of a dynamic collision. "
            "Such failures are assumed to be independent."
        ),
    ] = 0.0,
    seed: Annotated[int, typer.Option(help="Seed of the random numbers.", min=0)] = 0,
    workers: Annotated[
        int, typer.Option(help="Number of threads. The result does not depend on this number.", min=1)
    ] = 1,
    output: _options.MapOption = None,
    plot: _options.MapPlotOption = None,
    report: _options.ReportOption = None,
    overwrite: _options.OverwriteOption = False,
) -> None:
    """Estimate the probability that arms collide, with a confidence interval."""
    _app.check_outputs(output, plot, report, overwrite=overwrite, inputs=(targets, instrument, broken))
    model = _app.model_of(instrument, arm_model, broken, state_time, margins=margins)
    options = {"method": method, "estimand": estimand, "allocator": allocator, "density": density}
    options["precision"] = Precision(precision, max_iterations)
    options["targets"] = _targets(targets, hdu, n_targets, target_radius, min_separation)
    options.update(dynamic=dynamic, rng=seed, progress=sys.stderr.isatty())
    with released(ThreadPoolExecutor(workers)) as executor:
        options["executor"] = executor
        estimate = rs.collision_probability(model, **options)
    _app.finish_estimate(estimate, model, output, plot, report, overwrite=overwrite)


def _targets(name, hdu, number, radius, separation):
    """Return random targets if ``name`` is a kind of random targets; otherwise, read a catalog."""
    targets = _app.read_targets(name, hdu)
    if isinstance(targets, str):
        return RandomTargets(targets, number, _app.to_mm(radius), _app.to_mm(separation))
    given = {"--n-targets": number, "--target-radius": radius, "--min-separation": separation}
    for option, value in given.items():
        if value is not None:
            raise rs.InputError(f"{option} can be used only with random targets, but a catalog was given")
    return targets
