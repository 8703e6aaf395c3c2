"""``rfpsurvey benchmark probability``."""

import sys
from pathlib import Path
from typing import Annotated

import typer

import rfpsurvey as rs
from rfpsurvey._cli import _app, _options
from rfpsurvey._cli.benchmark import benchmark
from rfpsurvey.instrument import as_instrument


@benchmark.command(epilog=_options.BENCHMARK_EXAMPLES)
def probability(
    instrument: _options.InstrumentOption = "lamost",
    repeats: Annotated[
        int, typer.Option(help="Number of runs of each method and effort, with different random numbers.")
    ] = 30,
    seed: Annotated[int, typer.Option(help="Seed of the random numbers.")] = 0,
    plot: Annotated[
        Path, typer.Option(help="Plot (.png, .pdf or .svg); the table is written to the same folder.")
    ] = Path("benchmark_probability.png"),
    report: _options.ReportOption = None,
    overwrite: _options.OverwriteOption = False,
) -> None:
    """Compare the time and the error of the methods for collision probabilities, and print the bias of each density."""
    output, model = _app.check_chart(plot, report, overwrite=overwrite), as_instrument(instrument)
    _app.print_table(rs.benchmark.benchmark_densities(model, rng=seed))
    table = rs.benchmark.benchmark_probability(model, repeats=repeats, rng=seed, progress=sys.stderr.isatty())
    _app.finish_table(table, rs.plot.plot_probability_accuracy, output, plot, report, overwrite=overwrite)
