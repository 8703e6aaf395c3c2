"""The command ``rfpsurvey reproduce``."""

import sys
from pathlib import Path
from typing import Annotated

import typer

import rfpsurvey as rs
from rfpsurvey._cli import _app, _examples, _main, _options


@_main.app.command(epilog=_examples.REPRODUCE_EXAMPLES)
def reproduce(
    experiment: Annotated[
        str, typer.Argument(help="Experiment: small, large, poisson, fit, intervals, speed, or all.")
    ] = "all",
    folder: Annotated[
        Path, typer.Option(help="Folder for the tables, the figures, and the list of the claims of the paper.")
    ] = Path("reproduction"),
    quick: Annotated[bool, typer.Option("--quick", help="Run a short test with few designs and repetitions.")] = False,
    workers: Annotated[
        int | None, typer.Option(help="Number of threads; by default, the number of cores.", min=1)
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of the random numbers.", min=0)] = 0,
    report: _options.ReportOption = None,
    overwrite: _options.OverwriteOption = False,
) -> None:
    """Repeat the experiments of Chen et al. (2024), arXiv:2409.07288, and compare the results with the paper."""
    _app.check_outputs(None, report=report, overwrite=overwrite)
    options = {"quick": quick, "workers": workers, "rng": seed, "overwrite": overwrite}
    claims = rs.reproduction.reproduce(experiment, folder, progress=sys.stderr.isatty(), **options)
    with _app.files(overwrite=overwrite, report=(report, claims, {"data": "claims.ecsv"})):
        for row in claims:
            print(f"{row['experiment']}: {row['claim']}\n    paper: {row['paper']}\n    here: {row['ours']}")
            print(f"    {row['verdict']} ({row['reading']})")
        print(f"wrote {folder}")
