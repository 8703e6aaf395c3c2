"""Observing conditions of tiles: the conditions of the tiling, with a time or hour angle for each tile."""

import warnings
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING

import astropy.units as u
import erfa
import numpy as np
from astropy.table import QTable
from astropy.time import Time

from rfpsurvey._units import to_plain
from rfpsurvey.catalog import to_moment
from rfpsurvey.errors import InputError
from rfpsurvey.observing import ObservingConditions, as_hour_angle
from rfpsurvey.pipeline import field_radius_rad

if TYPE_CHECKING:
    from rfpsurvey.tiling._tiling import Tiling

WHEN = ("time", "hour_angle")
# If the tiles have observing conditions, aberration and dispersion change the radius by less than this factor.
MARGIN = 1.001


def when_of(table: QTable) -> str | None:
    """Return the name of the column with a time or hour angle for each tile; None if there is no such column."""
    there = [name for name in WHEN if name in table.colnames]
    if len(there) == 2:
        raise InputError("a tiling with conditions must have at most one of the columns time and hour_angle, got both")
    return there[0] if there else None


def convert_when(table: QTable, tile: np.ndarray) -> None:
    """Convert the times of a table to text (UTC), or its hour angles to degrees, which all file formats support."""
    name = when_of(table)
    if name is not None:
        values = _times(table["time"], tile) if name == "time" else _hour_angles(table["hour_angle"], tile)
        table.replace_column(name, values)


def conditions_of_tiles(tiling: "Tiling") -> list[ObservingConditions] | None:
    """Return the observing conditions of each tile, or None if the tiling has no conditions."""
    common = tiling.conditions
    if common is None:
        return None
    name = when_of(tiling.table)
    if name is None:
        return [common] * len(tiling)
    values = _read_times(tiling) if name == "time" else tiling.table[name]
    return [replace(common, **{**dict.fromkeys(WHEN), name: value}) for value in values]


def places_of_tiles(tiling: "Tiling") -> np.ndarray:
    """Return right ascension, declination and position angle of each tile in degrees, shape (n, 3)."""
    names = ("ra", "dec", "position_angle")
    return np.column_stack([tiling.table[name].to_value(u.deg).astype(float) for name in names])


def times_of_tiles(tiling: "Tiling") -> Time | None:
    """Return the time of each tile; None if the tiling has no conditions, or conditions with hour angles."""
    common = tiling.conditions
    name = None if common is None else when_of(tiling.table)
    if name == "time":
        return _read_times(tiling)
    if common is None or common.time is None or name is not None:
        return None
    return common.time + np.zeros(len(tiling)) * u.s


class FieldsOfTiles:
    """The fields of all tiles of a plan.

    Subclasses have the attributes ``tiling``, ``instrument``, ``source`` (the targets) and ``reference`` (the epoch of
    the positions of the targets; None if the targets are not moved to the times of the tiles).
    """

    @cached_property
    def conditions(self) -> list[ObservingConditions] | None:
        """Observing conditions of each tile; None if refraction is neglected."""
        return conditions_of_tiles(self.tiling)

    @cached_property
    def places(self) -> np.ndarray:
        """Right ascension, declination and position angle of each tile in degrees, shape (n, 3)."""
        return places_of_tiles(self.tiling)

    @cached_property
    def radius_rad(self) -> float:
        """Radius of the largest field in radians; refraction enlarges the field with the lowest altitude the most."""
        if self.conditions is None:
            return field_radius_rad(self.instrument)
        fields = []
        for name, place, obs in zip(self.tiling.table["tile"], np.deg2rad(self.places), self.conditions, strict=True):
            try:
                fields.append(self.instrument.field_projection(*place, obs))
            except InputError as error:
                raise InputError(f"tile {name}: {error}") from None
        lowest = min(fields, key=lambda field: min(frame[2, 2] for frame in field.frames))
        return field_radius_rad(self.instrument, lowest) * MARGIN

    @cached_property
    def years(self) -> np.ndarray | None:
        """Time of each tile since the reference epoch, in years; None if the targets are not moved to these times."""
        return None if self.reference is None else (times_of_tiles(self.tiling).tdb - self.reference.tdb).to_value(u.yr)

    @cached_property
    def margin_rad(self) -> float:
        """Upper limit of the angle (radians) by which any target moves between the reference epoch and a tile."""
        return 0.0 if self.years is None else float(np.abs(self.years).max()) * self.source.fastest_rad


def _read_times(tiling: "Tiling") -> Time:
    """Return the times in the column ``time`` of the table of tiles."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", erfa.ErfaWarning)
        return Time(np.asarray(tiling.table["time"]), scale="utc")


def _times(column, tile) -> np.ndarray:
    """Return the times in a column, which contains `Time` objects or text, as text in UTC."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", erfa.ErfaWarning)  # times far in the future cause an error later
        if isinstance(column, Time) and np.ndim(column) == 1 and not np.any(column.mask):
            times = column.utc
        else:
            dated = isinstance(column, Time) or np.asarray(column).dtype.kind in "MO"
            values = column if dated else to_plain(column, "time").tolist()
            try:
                times = Time(np.asarray(values).astype(str), scale="utc") if len(values) else Time([], format="jd")
                if times.format.endswith("year_str"):
                    raise ValueError
            except ValueError:
                moments = [to_moment(value, f"time of tile {name}") for value, name in zip(values, tile, strict=True)]
                times = Time(moments)
        return np.array(Time(times, format="isot", precision=3).value, dtype=str)


def _hour_angles(column, tile) -> u.Quantity:
    """Return the hour angles of a column in degrees; numbers without a unit are in hours."""
    try:
        unit = getattr(column, "unit", None) or u.hourangle
        degrees = as_hour_angle(u.Quantity(to_plain(column).astype(float), unit)).to_value(u.deg)
    except (TypeError, ValueError) as error:
        raise InputError(f"hour_angle must be an angle for every tile, {error}") from None
    bad = np.flatnonzero(~(np.abs(degrees) < 360))
    if len(bad):
        raise InputError(
            f"hour_angle must be a finite angle above -360 deg and below 360 deg for every tile, got "
            f"{degrees[bad[0]]:g} deg for tile {tile[bad[0]]}"
        )
    return degrees * u.deg
