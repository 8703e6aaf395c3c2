"""The command ``rfpsurvey benchmark`` and its subcommands."""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

import rfpsurvey as rs
from rfpsurvey import inputs
from rfpsurvey._cli import _app, _main, _print
from rfpsurvey._cli._command import command

benchmark = typer.Typer(
    no_args_is_help=True,
    help="Measure the speed and the errors of the methods that find collisions or estimate collision probabilities, "
    "for the arms of an instrument.",
)
_main.app.add_typer(benchmark, name="benchmark")
PLOT = "Plot (.png, .pdf or .svg); the table is written to the same folder."
OPTIONS = "instrument.name instrument.arm_model instrument.state_time repeats"
EXAMPLES = """\b
Examples:
  rfpsurvey benchmark collisions
  rfpsurvey benchmark collisions --instrument sdss_apo --method exact \\
      --method sampled --plot sdss.pdf
  rfpsurvey benchmark batches --instrument moons
  rfpsurvey benchmark probability --instrument moons --plot moons.png
"""
OUTPUT = " rng output.plot output.report output.overwrite"


@dataclass(frozen=True)
class CollisionsOutputKeys(inputs.OutputKeys):
    """The files that the benchmark of collisions writes."""

    plot: Annotated[Path, PLOT] = Path("benchmark_collisions.png")


@dataclass(frozen=True)
class ProbabilityOutputKeys(inputs.OutputKeys):
    """The files that the benchmark of probabilities writes."""

    plot: Annotated[Path, PLOT] = Path("benchmark_probability.png")


@dataclass(frozen=True, kw_only=True)
class CollisionsKeys:
    """The keys of the benchmark of collisions.

    Parameters
    ----------
    methods : list[str], optional
        Methods to compare. By default, all methods are compared.
    repeats : int, optional
        Maximum number of runs of each method.
    """

    instrument: inputs.InstrumentKeys
    methods: list[str] | None = None
    repeats: int = 15
    rng: inputs.Seed = 0
    output: CollisionsOutputKeys


@dataclass(frozen=True, kw_only=True)
class BatchesKeys:
    """The keys of the benchmark of batches.

    Parameters
    ----------
    repeats : int, optional
        Number of calls with the same settings; the median time is shown.
    """

    instrument: inputs.InstrumentKeys
    repeats: int = 5


@dataclass(frozen=True, kw_only=True)
class ProbabilityKeys:
    """The keys of the benchmark of probabilities.

    Parameters
    ----------
    repeats : int, optional
        Number of runs with different random numbers, for each method and each number of iterations.
    """

    instrument: inputs.InstrumentKeys
    repeats: int = 30
    rng: inputs.Seed = 0
    output: ProbabilityOutputKeys


@command(CollisionsKeys, f"{OPTIONS} methods{OUTPUT}", app=benchmark, epilog=EXAMPLES)
def collisions(keys: CollisionsKeys) -> None:
    """Compare the speed and the errors of the methods of finding collisions."""
    output = _app.check_chart(keys.output)
    options = {"methods": keys.methods, "repeats": keys.repeats, "rng": keys.rng, "progress": sys.stderr.isatty()}
    table = rs.benchmark.benchmark_collisions(_app.model_of(keys.instrument), **options)
    _print.finish_table(table, rs.plot.plot_speed_accuracy, output)


@command(BatchesKeys, OPTIONS, app=benchmark, epilog=EXAMPLES)
def batches(keys: BatchesKeys) -> None:
    """Measure how long the CPU and, if available, a GPU take to count the collisions of many configurations."""
    _print.print_table(rs.benchmark.benchmark_batches(_app.model_of(keys.instrument), repeats=keys.repeats))


@command(ProbabilityKeys, OPTIONS + OUTPUT, app=benchmark, epilog=EXAMPLES)
def probability(keys: ProbabilityKeys) -> None:
    """Compare the time and the error of the methods that estimate collision probabilities.

    The command also prints the collision probability of independent targets for several probability densities of the
    targets in the patrol area. For each density, it prints the difference from the collision probability of allocated
    targets.
    """
    output = _app.check_chart(keys.output)
    model, options = _app.model_of(keys.instrument), {"rng": keys.rng}
    _print.print_table(rs.benchmark.benchmark_densities(model, **options))
    options |= {"repeats": keys.repeats, "progress": sys.stderr.isatty()}
    table = rs.benchmark.benchmark_probability(model, **options)
    _print.finish_table(table, rs.plot.plot_probability_accuracy, output)
