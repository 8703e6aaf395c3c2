"""The command ``rfpsurvey benchmark`` and its subcommands."""

import sys
from pathlib import Path
from typing import Annotated

import typer

import rfpsurvey as rs
from rfpsurvey._cli import _app, _examples, _main, _options, _states

benchmark = typer.Typer(
    no_args_is_help=True,
    help="Measure the speed and the errors of the methods that find collisions or estimate collision probabilities, "
    "for the arms of an instrument.",
)
_main.app.add_typer(benchmark, name="benchmark")


@benchmark.command(epilog=_examples.BENCHMARK_EXAMPLES)
def collisions(
    instrument: _options.InstrumentOption = "lamost",
    arm_model: _options.ArmModelOption = None,
    state_time: _states.OwnStateTimeOption = None,
    method: Annotated[
        list[str] | None, typer.Option(help="Method to compare; may be repeated. By default, all methods are compared.")
    ] = None,
    repeats: Annotated[int, typer.Option(help="Maximum number of runs of each method.")] = 15,
    seed: Annotated[int, typer.Option(help="Seed of the random targets.")] = 0,
    plot: Annotated[
        Path, typer.Option(help="Plot (.png, .pdf or .svg); the table is written to the same folder.")
    ] = Path("benchmark_collisions.png"),
    report: _options.ReportOption = None,
    overwrite: _options.OverwriteOption = False,
) -> None:
    """Compare the speed and the errors of the methods of finding collisions."""
    output = _app.check_chart(plot, report, overwrite=overwrite)
    options = {"methods": method, "repeats": repeats, "rng": seed, "progress": sys.stderr.isatty()}
    table = rs.benchmark.benchmark_collisions(_app.model_of(instrument, arm_model, state_time=state_time), **options)
    _app.finish_table(table, rs.plot.plot_speed_accuracy, output, plot, report, overwrite=overwrite)


@benchmark.command(epilog=_examples.BENCHMARK_EXAMPLES)
def batches(
    instrument: _options.InstrumentOption = "lamost",
    arm_model: _options.ArmModelOption = None,
    state_time: _states.OwnStateTimeOption = None,
    repeats: Annotated[int, typer.Option(help="Number of calls with the same settings; the median time is shown.")] = 5,
) -> None:
    """Measure how long the CPU and, if available, a GPU take to count the collisions of many configurations."""
    _app.print_table(
        rs.benchmark.benchmark_batches(_app.model_of(instrument, arm_model, state_time=state_time), repeats=repeats)
    )


@benchmark.command(epilog=_examples.BENCHMARK_EXAMPLES)
def probability(
    instrument: _options.InstrumentOption = "lamost",
    arm_model: _options.ArmModelOption = None,
    state_time: _states.OwnStateTimeOption = None,
    repeats: Annotated[
        int,
        typer.Option(
            help="Number of runs with different random numbers, for each method and each number of iterations."
        ),
    ] = 30,
    seed: Annotated[int, typer.Option(help="Seed of the random numbers.")] = 0,
    plot: Annotated[
        Path, typer.Option(help="Plot (.png, .pdf or .svg); the table is written to the same folder.")
    ] = Path("benchmark_probability.png"),
    report: _options.ReportOption = None,
    overwrite: _options.OverwriteOption = False,
) -> None:
    """Compare the time and the error of the methods that estimate collision probabilities.

    The command also prints the collision probability of independent targets for several probability densities of the
    targets in the patrol area. For each density, it prints the difference from the collision probability of allocated
    targets.
    """
    output = _app.check_chart(plot, report, overwrite=overwrite)
    model = _app.model_of(instrument, arm_model, state_time=state_time)
    _app.print_table(rs.benchmark.benchmark_densities(model, rng=seed))
    table = rs.benchmark.benchmark_probability(model, repeats=repeats, rng=seed, progress=sys.stderr.isatty())
    _app.finish_table(table, rs.plot.plot_probability_accuracy, output, plot, report, overwrite=overwrite)
