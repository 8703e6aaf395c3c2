"""Options and output of the command ``select``."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

import rfpsurvey as rs
from rfpsurvey.errors import listed
from rfpsurvey.selection import RULES

RealizationsOption = Annotated[
    int,
    typer.Option(
        "--realizations",
        help="Number of realizations. A multiple of 64 is best, since each integer of the output stores 64 "
        "realizations.",
        min=1,
    ),
]
SelectAllocatorOption = Annotated[
    str,
    typer.Option(
        help=f"Allocator for all realizations. The allocators {listed(RULES)} plan 32 realizations together; all other "
        "allocators plan one realization after the other."
    ),
]
SelectOutputOption = Annotated[
    Path | None,
    typer.Option(
        help="Write the selection probabilities, and the bits that record in which realizations each target is "
        "observed (.fits)."
    ),
]
SelectFolderOption = Annotated[
    Path | None, typer.Option(help="Folder for checkpoints and for the result, selection.fits.")
]
SelectResumeOption = Annotated[
    bool, typer.Option(help="Continue the unfinished computation in the folder given with --folder.")
]

SELECT_EXAMPLES = """\b
Examples:
  rfpsurvey select --realizations 64 --output selection.fits
  rfpsurvey select galaxies.fits --instrument desi --tiles tiles.ecsv --workers 2 --folder selection
  rfpsurvey select galaxies.fits --instrument desi --tiles tiles.ecsv --workers 2 --folder selection --resume
  rfpsurvey select galaxies.fits --instrument desi --tiles tiles.ecsv --order given --kept --output selection.fits
"""


def with_visits(targets, visits: int):
    """Return a copy of a catalog in which every target requires the given number of visits."""
    if isinstance(targets, rs.PartitionedCatalog):
        raise rs.InputError("--visits cannot be used with a partitioned catalog; add the column visits to the catalog")
    return replace(targets, visits=np.full(len(targets), visits))


LINES = {
    "n_realizations": "realizations",
    "n_tiles": "tiles",
    "n_targets": "targets with requested visits",
    "n_unreachable": "targets that no tile can reach",
    "n_never_observed": "targets never observed",
    "n_sometimes_observed": "targets sometimes observed",
    "n_always_observed": "targets always observed",
    "mean_probability": "mean selection probability",
    "n_assigned": "assigned fibers, all realizations",
    "n_lost": "  lost to collisions",
    "n_observed": "visits observed, all realizations",
}


def print_selection(found: "rs.SelectionProbabilities", allocator: str, seconds: float) -> None:
    """Print the summary of selection probabilities, one value per line."""
    s = found.summary
    print(f"{found.provenance['instrument']['name']}, allocator {allocator}")
    print(f"model: {s['model']}")
    for name, label in LINES.items():
        value = s[name]
        print(f"{label:<34}{value:>12.4f}" if isinstance(value, float) else f"{label:<34}{value:>12}")
    plans = s["n_tiles"] * s["n_realizations"]
    print(f"computing time {seconds:.1f} s, {1e3 * seconds / plans:.2f} ms per tile and realization")
