"""Observing conditions of tiles: those of the tiling, with a time or hour angle for each tile."""

from dataclasses import replace

import astropy.units as u
import numpy as np
from astropy.time import Time

from rfpsurvey._units import to_plain
from rfpsurvey.errors import InputError
from rfpsurvey.observing import ObservingConditions
from rfpsurvey.tiling._tiling import Tiling

__all__ = ["conditions_of_tiles"]

COLUMNS = ("time", "hour_angle")


def conditions_of_tiles(tiling: Tiling) -> list[ObservingConditions] | None:
    """Return the observing conditions of each tile, or None if the tiling has no conditions."""
    common = tiling.conditions
    if common is None:
        return None
    there = [name for name in COLUMNS if name in tiling.table.colnames]
    if len(there) == 2:
        raise InputError("a tiling with observing conditions must have a column time or hour_angle, got both")
    if not there:
        return [common] * len(tiling)
    times, angles = [None] * len(tiling), [None] * len(tiling)
    if there == ["time"]:
        times = _times(tiling.table["time"])
    else:
        angles = _hour_angles(tiling.table["hour_angle"])
    return [replace(common, time=time, hour_angle=angle) for time, angle in zip(times, angles, strict=True)]


def _times(column) -> list:
    """Return the times of a column of times or text."""
    if isinstance(column, Time):
        return list(column)
    try:
        return list(Time(to_plain(column, "time", "text").astype(str), scale="utc"))
    except ValueError as error:
        raise InputError(f"time must be a date and time for every tile, {error}") from None


def _hour_angles(column) -> list:
    """Return the hour angles of a column; numbers without a unit are in hours."""
    try:
        angles = u.Quantity(to_plain(column).astype(float), getattr(column, "unit", None) or u.hourangle)
        angles = angles.value * u.hourangle if angles.unit.is_equivalent(u.h) and angles.unit == u.h else angles
        degrees = angles.to_value(u.deg)
    except (TypeError, ValueError) as error:
        raise InputError(f"hour_angle must be an angle for every tile, {error}") from None
    if not np.isfinite(degrees).all():
        raise InputError(f"hour_angle must be a finite angle for every tile, got {degrees[~np.isfinite(degrees)][0]}")
    return list(angles)
