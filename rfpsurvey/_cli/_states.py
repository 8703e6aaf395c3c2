"""Command-line options that state which positioners are broken or stuck, and at which time."""

from pathlib import Path
from typing import Annotated

import typer
from astropy.time import Time

import rfpsurvey as rs
from rfpsurvey._cli import _conditions
from rfpsurvey.catalog import to_time
from rfpsurvey.tiling import times_of_tiles

__all__ = ["BrokenOption", "OwnStateTimeOption", "StateTimeOption", "time_of", "time_of_tiles"]

BrokenOption = Annotated[
    Path | None,
    typer.Option(
        help="Table of broken and stuck positioners (CSV, ECSV, FITS, VOTable or Parquet) with the column id and, "
        "optionally, the columns state (broken, stuck or ok), from and to (dates in UTC), theta and phi (deg)."
    ),
]
StateTimeOption = Annotated[
    str | None,
    typer.Option(
        help="Time (UTC) at which the states of positioners are evaluated, such as 2026-07-01T06:30:00. By default, "
        "the time of the observing conditions or, without such a time, --epoch."
    ),
]
OwnStateTimeOption = Annotated[
    str | None,
    typer.Option(help="Time (UTC) at which the states of positioners are evaluated, such as 2026-07-01T06:30:00."),
]


def time_of(conditions: "rs.ObservingConditions | None", epoch: str | None) -> Time | None:
    """Return the time of the observing conditions or, without such a time, of --epoch; None if no time is known."""
    if conditions is not None and conditions.time is not None:
        return conditions.time
    return None if epoch is None else to_time(epoch, "--epoch")


def time_of_tiles(tiling: "rs.Tiling | None", epoch: str | None, *given: object) -> Time | None:
    """Return the times of all tiles or, without times, the time of --epoch; None if no time is known.

    ``given`` contains the options of the observing conditions, in the order of `conditions_of`.
    """
    if tiling is None:
        return time_of(_conditions.conditions_of(*given) if given else None, epoch)
    times = times_of_tiles(_conditions.tiles_under(tiling, *given) if given else tiling)
    return time_of(None, epoch) if times is None else times
