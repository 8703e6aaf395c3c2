"""``rfpsurvey benchmark``."""

import sys
from pathlib import Path
from typing import Annotated

import typer

import rfpsurvey as rs
from rfpsurvey._cli import _app, _options
from rfpsurvey.instrument import as_instrument

benchmark = typer.Typer(
    no_args_is_help=True, help="Measure the speed and the errors of methods, for the arms of an instrument."
)
_app.app.add_typer(benchmark, name="benchmark")


@benchmark.command(epilog=_options.BENCHMARK_EXAMPLES)
def collisions(
    instrument: _options.InstrumentOption = "lamost",
    method: Annotated[
        list[str] | None, typer.Option(help="Method to compare; may be repeated. By default, all are compared.")
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
    table = rs.benchmark.benchmark_collisions(as_instrument(instrument), **options)
    _app.finish_table(table, rs.plot.plot_speed_accuracy, output, plot, report, overwrite=overwrite)


@benchmark.command(epilog=_options.BENCHMARK_EXAMPLES)
def batches(
    instrument: _options.InstrumentOption = "lamost",
    repeats: Annotated[int, typer.Option(help="Number of calls with the same settings; the median time is shown.")] = 5,
) -> None:
    """Measure the time of scoring many configurations in one call, on CPU threads and on a GPU if there is one."""
    _app.print_table(rs.benchmark.benchmark_batches(as_instrument(instrument), repeats=repeats))
