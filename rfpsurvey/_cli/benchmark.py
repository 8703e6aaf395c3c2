"""``rfpsurvey benchmark``."""

import sys
from pathlib import Path
from typing import Annotated

import typer

import rfpsurvey as rs
from rfpsurvey._cli import _app, _options
from rfpsurvey.instrument import as_instrument

benchmark = typer.Typer(no_args_is_help=True, help="Time the methods side by side, on the arms of an instrument.")
_app.app.add_typer(benchmark, name="benchmark")


@benchmark.command(epilog=_options.BENCHMARK_EXAMPLES)
def collisions(
    instrument: _options.InstrumentOption = "lamost",
    method: Annotated[list[str] | None, typer.Option(help="These methods only; may be repeated.")] = None,
    repeats: Annotated[int, typer.Option(help="How often each method runs at most.")] = 15,
    seed: Annotated[int, typer.Option(help="Of the random targets.")] = 0,
    plot: Annotated[Path, typer.Option(help="Chart, .png, .pdf or .svg; the table is written beside it.")] = Path(
        "benchmark_collisions.png"
    ),
    report: _options.ReportOption = None,
    overwrite: _options.OverwriteOption = False,
) -> None:
    """Chart the speed of every method of finding collisions against its errors."""
    output = _app.check_chart(plot, report, overwrite=overwrite)
    options = {"methods": method, "repeats": repeats, "rng": seed, "progress": sys.stderr.isatty()}
    table = rs.benchmark.benchmark_collisions(as_instrument(instrument), **options)
    _app.finish_table(table, rs.plot.plot_speed_accuracy, output, plot, report, overwrite=overwrite)


@benchmark.command(epilog=_options.BENCHMARK_EXAMPLES)
def batches(
    instrument: _options.InstrumentOption = "lamost",
    repeats: Annotated[int, typer.Option(help="Calls of each kind, of which the median counts.")] = 5,
) -> None:
    """Time the scoring of many configurations at once, on processor threads and a GPU if there is one."""
    _app.print_table(rs.benchmark.benchmark_batches(as_instrument(instrument), repeats=repeats))
