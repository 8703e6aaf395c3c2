"""The command ``rfpsurvey reproduce``."""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import rfpsurvey as rs
from rfpsurvey._cli import _app, _examples, _groups, _print
from rfpsurvey._cli._command import command


@dataclass(frozen=True)
class ReproduceOutputKeys:
    """The files that the command writes.

    Parameters
    ----------
    folder : Path, optional
        Folder for the tables, the figures, and the list of the claims of the paper.
    """

    folder: Path = Path("reproduction")
    report: _groups.Report = None
    overwrite: _groups.Overwrite = False
    plot = None


@dataclass(frozen=True, kw_only=True)
class ReproduceKeys:
    """The keys of the command.

    Parameters
    ----------
    experiment : str, optional
        Experiment: small, large, poisson, fit, intervals, speed, or all.
    quick : bool, optional
        Run a short test with few designs and repetitions.
    workers : int, optional
        Number of threads; by default, the number of cores.
    """

    experiment: str = "all"
    quick: bool = False
    workers: Annotated[int | None, 1] = None
    rng: _groups.Seed = 0
    output: ReproduceOutputKeys


@command(
    ReproduceKeys,
    "output.folder quick workers rng output.report output.overwrite",
    argument="experiment",
    epilog=_examples.REPRODUCE_EXAMPLES,
)
def reproduce(keys: ReproduceKeys) -> None:
    """Repeat the experiments of Chen et al. (2024), arXiv:2409.07288, and compare the results with the paper."""
    output = keys.output
    _app.check_outputs(output)
    options = {"quick": keys.quick, "workers": keys.workers, "rng": keys.rng, "overwrite": output.overwrite}
    claims = rs.reproduction.reproduce(keys.experiment, output.folder, progress=sys.stderr.isatty(), **options)
    with _print.files(output, report=(claims, {"data": "claims.ecsv"})):
        for row in claims:
            print(f"{row['experiment']}: {row['claim']}\n    paper: {row['paper']}\n    here: {row['ours']}")
            print(f"    {row['verdict']} ({row['reading']})")
        print(f"wrote {output.folder}")
