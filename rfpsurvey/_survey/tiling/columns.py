"""Read the centers, position angles and observing conditions of tiles from the columns of a table.

There are warnings for tables of targets that are given instead of tables of tiles, and for tiles of several programs.
"""

import re
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING

import astropy.units as u
import numpy as np
from astropy.table import QTable, Table
from astropy.time import Time

from rfpsurvey._common.units import to_flags, to_labels, to_plain
from rfpsurvey._field.plan import field_radius_rad
from rfpsurvey._instruments.pfs_files import PFI_ANGLE
from rfpsurvey._sky.columns import Finder
from rfpsurvey._sky.conditions import ObservingConditions, as_hour_angle
from rfpsurvey._sky.observed_field import ObservedField
from rfpsurvey._sky.survey_formats import check_mode
from rfpsurvey._sky.time import any_year, to_moment
from rfpsurvey._sky.wavelengths import observed_light, warn_outside_band
from rfpsurvey.errors import InputError, check_choice, listed, number_of, refusal, short, warn

if TYPE_CHECKING:
    from rfpsurvey._survey.tiling.tiling import Tiling

COLUMNS = ("tile", "ra", "dec", "position_angle", "pass")
# Common names of the columns, in order of preference. Upper case and lower case are not distinguished.
NAMES = {
    "tile": "tile tileid tile_id field field_id fieldid plate plateid plate_id plan ppc_code id name identifier",
    "ra": "ra racen ra_cen tile_ra tilera field_ra center_ra ppc_ra racenter ra_center ra_deg radeg raj2000 ra_icrs",
    "dec": "dec deccen dec_cen decen tile_dec tiledec field_dec center_dec ppc_dec deccenter dec_center dec_deg decdeg "
    "dej2000 decj2000 de_icrs dec_icrs",
    "position_angle": "position_angle positionangle pa field_pa posang pos_angle fieldrot ppc_pa",
    "pass": "pass passnum pass_number layer visit",
}
ANGLES = ("ra", "dec", "position_angle")
OF_TILES = re.compile(
    r".*(tile|plate|field|center|racen|ra_cen|dece?cen|dec_cen|pass|layer|pos_?ang|position_?angle).*|pa|program"
)
OF_TARGETS = re.compile(
    r"(.*_)?(mag|magnitude)s?|.*[a-z0-9]_?mag|mag_.*|(e_)?pm(_?(ra|de).*)?|parallax|plx"
    r"|(source|target|obj|object|gaia|tyc|tycho)\d?_?(id|source_id)|kind|fiber_?type"
)
MANY = 1000


def find_names(table: Table, columns: dict | None) -> dict[str, str]:
    """Return a dict from the role of a column, such as ``ra``, to its name in the table."""
    columns = {} if columns is None else columns
    if not isinstance(columns, dict):
        raise refusal("columns must be a dict from role to column", columns, dict)
    for role, name in columns.items():
        check_choice(role, COLUMNS, "column role of a tiling")
        if name not in table.colnames:
            raise InputError(f"there is no column {name!r} for {role}; {Finder(table).listing()}")
    lower = {c.lower(): c for c in reversed(table.colnames)}
    usual = {role: next((lower[n] for n in words.split() if n in lower), None) for role, words in NAMES.items()}
    names = {role: name for role, name in {**usual, **columns}.items() if name is not None}
    if missing := [role for role in ("ra", "dec") if role not in names]:
        raise Finder(table).missing(" and ".join(missing), "--set tiles.columns.")
    return names


def is_of_pfs(table: Table) -> bool:
    """Return whether a table contains pointings of PFS, in degrees; their columns may have other names in part."""
    return any(name.lower().startswith("ppc_") for name in table.colnames)


def pfs_angle(table: Table, names: dict[str, str]) -> u.Quantity:
    """Return the position angle of the focal plane of PFS at ``ppc_pa`` = 0, or 0 for tables of other surveys.

    An error is raised if the pointings need different resolutions.
    """
    if not is_of_pfs(table):
        return 0 * u.deg
    if mode := next((name for name in table.colnames if name.lower() == "ppc_resolution"), None):
        check_mode(table, mode, "tiles")
    return PFI_ANGLE * u.deg if names.get("position_angle", "ppc_pa").lower() == "ppc_pa" else 0 * u.deg


def without_others(table: Table) -> tuple[Table, str]:
    """Return the tiles that are part of DESI's survey, and text that states how many other tiles are omitted.

    The column ``IN_DESI`` states which tiles are part of the survey; without this column, the text is empty.
    """
    name = next((c for c in table.colnames if c.lower() == "in_desi"), None)
    if name is None:
        return table, ""
    is_part = to_flags(table[name], f"column {name!r}")
    said = f"{np.count_nonzero(~is_part)} of {number_of(len(table), 'tile')} ({name} = 0)"
    if len(table) and not is_part.any():
        raise InputError(f"at least one tile must be part of DESI's survey ({name} = 1), got {len(table)} other tiles")
    if not is_part.all():
        warn(f"{said} are omitted, because they are not part of DESI's survey")
    return table[is_part], said


def read_angles(table: Table, names: dict[str, str], units: dict | None, *, silent: bool) -> dict:
    """Return the angles of the tiles as quantities; the keys are the roles of the columns.

    If neither coordinate has a unit in the table, degrees are assumed, and a warning is issued unless ``silent``.
    """
    units = {} if units is None else units
    if not isinstance(units, dict):
        raise refusal("units must be a dict from role to unit", units, dict)
    for role in units:
        check_choice(role, ANGLES, "column role with a unit")
    angles, assumed = {}, []
    has_units = Finder(table, {role: names[role] for role in ("ra", "dec")}).has_units(("ra", "dec"))
    for role in (role for role in ANGLES if role in names):
        # `Finder` supports only the columns of a catalog; therefore, its role "ra" is used for every angle
        find = Finder(table, {"ra": names[role]}, {"ra": units[role]} if role in units else {}, assume_units=True)
        angles[role] = find.quantity("ra")
        if find.assumed and role != "position_angle":
            assumed.append(names[role])
            if has_units:
                raise InputError(
                    f"column {names[role]!r} has no unit; state the unit, for example units={{{role!r}: 'deg'}} or "
                    f"--set tiles.units.{role}=deg"
                )
    if assumed and not silent:
        warn(
            f"the centers of tiles have no units: the assumed unit of {' and '.join(assumed)} is deg; to use other "
            "units, give units= or --set tiles.units.ra=UNIT"
        )
    return angles


def warn_of_targets(tiling, n_targets: int) -> None:
    """Warn if the table of a tiling seems to be a table of targets; ``n_targets`` is the number of targets.

    There is no warning if the table has a column that occurs only in lists of tiles. Otherwise there is a warning if
    the table has a column that is typical of targets, such as a magnitude, or if it has more than ``MANY`` rows and
    more rows than the survey has targets.
    """
    columns = list(tiling.table.meta["columns"].values())
    columns += [name for name in tiling.table.colnames if name not in COLUMNS]
    if any(OF_TILES.fullmatch(name.lower()) for name in columns):
        return
    target_names = [name for name in columns if OF_TARGETS.fullmatch(name.lower())]
    if target_names or len(tiling) > max(MANY, n_targets):
        columns = ", ".join(target_names[:3] or columns[:5])
        warn(
            f"the {number_of(len(tiling), 'row')} of a table with the columns {columns} are taken as centers of tiles, "
            "one tile per row; if they are targets, give a list of tiles instead (see place_tiles or 'rfpsurvey tile')"
        )


def warn_of_programs(tiling) -> None:
    """Warn if the tiles belong to several programs, such as DARK and BRIGHT of DESI, which the plan does not use."""
    name = next((name for name in tiling.table.colnames if name.lower() == "program"), None)
    names = [] if name is None else np.unique(to_labels(tiling.table[name], f"column {name!r}")).tolist()
    if len(names) > 1:
        warn(
            f"the tiles belong to {len(names)} programs ({name}: {listed(names)}), but every target can be observed on "
            "all tiles; to plan one program, select its tiles"
        )


WHEN = ("time", "hour_angle")
DATES = ("time", "mjd", "date")
FIRST_MJD, LAST_MJD = 40_000, 100_000  # 1968 to 2132
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
    return None if tiling.conditions is None else conditions_of_rows(tiling.conditions, tiling.table)


def conditions_of_rows(common: ObservingConditions, table: QTable) -> list[ObservingConditions]:
    """Return the common conditions with the time or the hour angle of each row of a table of tiles."""
    name = when_of(table)
    if name is None:
        return [common] * len(table)
    values = _read_times(table) if name == "time" else table[name]
    date = None if name == "time" else common.date
    return [replace(common, **{**dict.fromkeys(WHEN), "date": date, name: value}) for value in values]


def places_of_tiles(tiling: "Tiling") -> np.ndarray:
    """Return right ascension, declination and position angle of each tile in degrees, shape (n, 3)."""
    names = ("ra", "dec", "position_angle")
    return np.column_stack([tiling.table[name].to_value(u.deg).astype(float) for name in names])


def times_of_tiles(tiling: "Tiling", *, dates: bool = True) -> Time | None:
    """Return the time of each tile; None if no time is known.

    The time is that of the observing conditions. If these have no time, and ``dates`` is true, it is the time in the
    column ``time``, ``mjd`` or ``date``.
    """
    common = tiling.conditions
    name = None if common is None else when_of(tiling.table)
    if name == "time":
        return _read_times(tiling.table)
    if common is not None and common.time is not None and name is None:
        return common.time + np.zeros(len(tiling)) * u.s
    return _dates_of(tiling) if dates else None


def dates_column(tiling: "Tiling") -> str | None:
    """Return the name of the column with the times of tiles whose observing conditions have no time, or None.

    A column ``time`` with numbers, such as exposure times, is not used, nor the dates of observations of a survey.
    """
    lower = {name.lower(): name for name in reversed(tiling.table.colnames)}
    there = [lower[name] for name in DATES[: 2 if "n_failed" in lower else 3] if name in lower]
    numeric = (c for c in there if c.lower() == "time" and np.asarray(tiling.table[c]).dtype.kind in "iuf")
    return next((name for name in there if name not in {*numeric}), None)


def warn_of_numbers(tiling: "Tiling") -> None:
    """Warn if a column ``time``, which is not used because it contains numbers, seems to contain dates."""
    name = next((name for name in tiling.table.colnames if name.lower() == "time"), None)
    if name is None or dates_column(tiling) is not None or (column := tiling.table[name]).dtype.kind not in "iuf":
        return
    days = to_plain(column).astype(float)
    for scale, offset in {"modified Julian": 0, "Julian": 2400000.5}.items():
        if np.all((days - offset > FIRST_MJD) & (days - offset < LAST_MJD)):
            warn(
                f"the column {name} of the tiles is not used, because it contains numbers, although they can be "
                f"{scale} dates; give modified Julian dates in a column mjd, or dates as text"
            )


@any_year()
def _dates_of(tiling: "Tiling") -> Time | None:
    """Return the times in the column that `dates_column` names; None if there is no such column."""
    if (name := dates_column(tiling)) is None:
        return None
    column, tile = tiling.table[name], tiling.table["tile"]
    _check_shape(column, name)
    if name.lower() == "mjd" and not isinstance(column, Time):
        try:
            days = to_plain(u.Quantity(column, u.day).value if hasattr(column, "to_value") else column).astype(float)
        except (TypeError, ValueError):
            raise InputError(f"the {name} of tiles must be numbers of days, got {short(column)}") from None
        rule = f"a modified Julian date above {FIRST_MJD} and below {LAST_MJD}"
        _check_days(days, tile, name, rule, [f"{day:g}" for day in days])
        return Time(days, format="mjd", scale="utc")
    if np.asarray(column).dtype.kind in "iu":  # such as 20260103
        column = np.array([re.sub(r"^(\d{4})(\d\d)(\d\d)$", r"\1-\2-\3", str(day)) for day in column.tolist()])
    return Time(_times(column, tile, name), scale="utc")


class FieldsOfTiles:
    """The fields of all tiles of a plan.

    Subclasses have the attributes ``tiling``, ``instrument``, ``source`` (the targets) and ``reference`` (the epoch of
    the positions of the targets; None if the targets are not moved to the times of the tiles).
    """

    @cached_property
    def conditions(self) -> list[ObservingConditions] | None:
        """Observing conditions of each tile; None if refraction is neglected."""
        return conditions_of_tiles(self.tiling)

    @property
    def projection(self) -> str:
        """Model of the projection of all tiles; ``auto`` if each tile has the fastest model that is accurate enough."""
        return "radial" if self.tiling.conditions is None else self.tiling.conditions.projection

    @property
    def observed(self) -> dict:
        """The record of the observing conditions and of the wavelengths, which version 0.3 recorded as conditions."""
        if (common := self.tiling.conditions) is None:
            return {}
        entries = {"conditions": self.tiling.table.meta["conditions"]}
        if common.compensator != "none" or None in (common.wavelength, common.guide_wavelength):
            entries["wavelengths"] = observed_light(self.instrument.light, common).record
        return entries

    @property
    def projections(self) -> list[str]:
        """Model of the projection of each tile."""
        choose, places = self.instrument.model_choice, np.deg2rad(self.places)
        return [choose(place, obs).model for place, obs in zip(places, self.conditions, strict=True)]

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
        warn_outside_band(self.instrument.light, self.tiling.conditions)
        for name, place, obs in zip(self.tiling.table["tile"], np.deg2rad(self.places), self.conditions, strict=True):
            try:
                fields.append(self.instrument.field_projection(*place, obs))
            except InputError as error:
                raise InputError(f"tile {name}: {error}") from None
        refracted = [field for field in fields if isinstance(field, ObservedField)]
        lowest = min(refracted, key=lambda field: min(frame[2, 2] for frame in field.frames), default=None)
        return field_radius_rad(self.instrument, lowest) * MARGIN

    @cached_property
    @any_year()
    def years(self) -> np.ndarray | None:
        """Time of each tile since the reference epoch, in years; None if the targets are not moved to these times."""
        return None if self.reference is None else (times_of_tiles(self.tiling).tdb - self.reference.tdb).to_value(u.yr)

    @cached_property
    def margin_rad(self) -> float:
        """Upper limit of the angle (radians) by which any target moves between the reference epoch and a tile."""
        return 0.0 if self.years is None else float(np.abs(self.years).max()) * self.source.fastest_rad


def _read_times(table: QTable) -> Time:
    """Return the times in the column ``time`` of a table of tiles."""
    with any_year():
        return Time(np.asarray(table["time"]), scale="utc")


@any_year()
def _times(column, tile, name: str = "time") -> np.ndarray:
    """Return the times in a column, which contains `Time` objects or text, as text in UTC."""
    _check_shape(column, name)
    if isinstance(column, Time):
        is_valid = column.scale != "local" and not np.any(column.mask)
        times = column.utc if is_valid else _moments(column, tile)
    else:
        values = column if np.asarray(column).dtype.kind in "MO" else to_plain(column, "time").tolist()
        try:
            times = Time(np.asarray(values).astype(str), scale="utc") if len(values) else Time([], format="jd")
            if times.format.endswith("year_str"):
                raise ValueError
        except ValueError:
            times = _moments(values, tile)
    _check_days(times.mjd, tile, name, "a date from 1968 to 2132", times.iso)
    return np.array(Time(times, format="isot", precision=3).value, dtype=str)


def _moments(values, tile) -> Time:
    """Return times that are read one by one, or raise an error that names the first tile with an invalid time."""
    return Time([to_moment(value, f"time of tile {name}") for value, name in zip(values, tile, strict=True)])


def _check_days(days: np.ndarray, tile, name: str, rule: str, texts) -> None:
    if len(bad := np.flatnonzero(~((days > FIRST_MJD) & (days < LAST_MJD)))):
        raise InputError(
            f"the {name} of each tile must be {rule}, got {texts[bad[0]]} for tile {tile[bad[0]]}; rename the column "
            "if it has another meaning"
        )


def _check_shape(column, name: str) -> None:
    if np.ndim(column) != 1:
        raise InputError(f"the {name} of tiles must be one value for each tile, got the shape {np.shape(column)}")


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
