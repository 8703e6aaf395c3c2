"""Windows: the times in which tiles can be observed, and the reasons why there are none."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import astropy.units as u
import numpy as np
from astropy.coordinates import EarthLocation
from astropy.table import QTable
from astropy.time import Time

from rfpsurvey._common.units import to_axes, to_plain, to_scalar
from rfpsurvey._sky.conditions import as_site
from rfpsurvey._sky.time import any_year, to_time
from rfpsurvey._survey.night.limits import NightLimits, Numbers, limits_of
from rfpsurvey._survey.night.pieces import ALWAYS, NEVER, Pieces, crossing, cut, in_hour_angles, joined
from rfpsurvey._survey.night.sky import NightSky
from rfpsurvey._survey.tiling.tiling import Tiling, as_tiling
from rfpsurvey.errors import InputError, check_keywords, check_whole, listed, number_of, refusing, short

REASONS = (
    "",
    "the Sun is too high",
    "outside the times of the tile",
    "too low",
    "hour angle too large",
    "too near to the zenith",
    "below the horizon",
    "the Moon is too bright",
    "too near to the Moon",
    "too short",
)
"""Reasons why a tile has no window, in the order in which limits are applied; the first is for tiles with windows."""
SUN, OWN, LOW, HOURS, ZENITH, HORIZON, BRIGHT, MOON, SHORT = range(1, 10)
MINUTE = 1 / 1440
# Steps (days) in which the Moon and the horizon are sampled, largest motion of the Moon as seen from a site (rad per
# day), and margin of distances of the Moon (rad).
STEP_MOON, STEP_HORIZON, MOTION, MARGIN = 10 * MINUTE, MINUTE / 2, np.deg2rad(24), np.deg2rad(0.1)


def windows_of_night(
    sky: NightSky, limits: NightLimits, rows: np.ndarray, own: np.ndarray, reason: np.ndarray
) -> Pieces:
    """Return the windows of tiles within their own times (2, n), and write the reasons of tiles without windows."""
    numbers = limits.numbers

    def without(pieces: Pieces, number: int) -> Pieces:
        gone = rows[reason[rows] == 0]
        reason[gone[~np.isin(gone, pieces.tile, kind="table")]] = number
        return pieces

    night = dark_time(sky, numbers)
    pieces = Pieces(rows, np.zeros(len(rows)), np.ones(len(rows)))
    pieces = without(pieces if len(night.tile) else NEVER, SUN)
    pieces = without(pieces.between(*own[:, np.searchsorted(rows, pieces.tile)]).inside(night), OWN)
    pieces = without(in_hour_angles(sky, pieces, 0.0, crossing(sky, numbers.lowest)), LOW)
    pieces = without(in_hour_angles(sky, pieces, 0.0, numbers.hour_angle), HOURS)
    if numbers.highest < np.pi / 2:
        pieces = without(in_hour_angles(sky, pieces, crossing(sky, numbers.highest), np.inf), ZENITH)
    if limits.horizon is not None:
        pieces = without(cut(pieces, lambda *at: _above(sky, limits.horizon, *at), STEP_HORIZON), HORIZON)
    if numbers.moon_illumination < 1:
        bright = lambda time: sky.illumination(time) > numbers.moon_illumination  # noqa: E731
        pieces = without(pieces.inside(_moon_below(sky, numbers.moon_altitude, bright)), BRIGHT)
    if numbers.moon_separation > 0:
        pieces = without(away_from_moon(sky, pieces, numbers.moon_separation), MOON)
    return pieces


def dark_time(sky: NightSky, numbers: Numbers) -> Pieces:
    """Return the intervals in which the Sun is low enough."""
    return cut(ALWAYS, lambda _, time: sky.altitude_of(sky.sun(time), time) <= numbers.sun, MINUTE)


def _moon_below(sky: NightSky, altitude: float, bright: Callable | None = None) -> Pieces:
    """Return the intervals in which the Moon is not above an altitude, or not bright."""

    def allowed(_, time):
        below = sky.altitude_of(sky.moon(time), time) <= altitude
        return below if bright is None else below | ~bright(time)

    return cut(ALWAYS, allowed, MINUTE)


def _events(sky: NightSky, numbers: Numbers) -> list[float]:
    """Return the first and last dark time, and the rise and set of the Moon, as modified Julian dates or NaN."""
    dark, down = dark_time(sky, numbers), _moon_below(sky, 0.0)
    events = dark.start[:1], dark.end[-1:], down.end[down.end < 1][:1], down.start[down.start > 0][:1]
    return [sky.noon + event[0] if len(event) else np.nan for event in events]


def _above(sky: NightSky, horizon: tuple, tile: np.ndarray, time: np.ndarray) -> np.ndarray:
    altitude, azimuth, _ = sky.horizontal(tile, time)
    return np.rad2deg(altitude) >= np.interp(np.rad2deg(azimuth), *np.transpose(horizon), period=360)


def away_from_moon(sky: NightSky, pieces: Pieces, separation: float) -> Pieces:
    """Return the parts of pieces in which the Moon is below the horizon, or at least at a distance (rad)."""
    down = _moon_below(sky, 0.0)
    rises, sets = np.append(0.0, down.end), np.append(down.start, 1.0)
    up = Pieces(np.zeros(len(sets), dtype=np.int64), rises, sets).of(sets > rises)
    parts, pieces = [pieces.inside(down)], pieces.inside(up)
    surplus = sky.separation(pieces.tile, (pieces.start + pieces.end) / 2) - separation
    change = MOTION * (pieces.end - pieces.start) / 2 + MARGIN
    parts += [pieces.of(surplus > change)]
    near = pieces.of(np.abs(surplus) <= change)
    parts += [cut(near, lambda tile, time: sky.separation(tile, time) >= separation, STEP_MOON)]
    return joined(parts)


class WindowArrays(NamedTuple):
    """Windows as arrays: row of the tile, index of the night, and start and end as modified Julian dates (UTC)."""

    tile: np.ndarray
    night: np.ndarray
    start: np.ndarray
    end: np.ndarray


@dataclass(frozen=True, eq=False, repr=False)
class Windows:
    """The times in which tiles can be observed, which `rfpsurvey.night.observing_windows` returns.

    Parameters
    ----------
    tiling : Tiling
        The tiles.
    site : EarthLocation
        The site.
    limits : dict of str to NightLimits
        Limits of the tiles of each program; the key ``""`` is for all other tiles.
    days : ndarray of int, shape (n_nights,)
        Modified Julian date of the date of each night.
    arrays : WindowArrays
        The windows, in the order of nights, tiles and times.
    counts : ndarray of int, shape (n_nights, n_reasons)
        Numbers of tiles without a window, for each reason; the first column contains the number of tiles with windows.
    shortest : float
        Shortest window, in days.
    """

    tiling: Tiling
    site: EarthLocation
    limits: dict[str, NightLimits]
    days: np.ndarray
    arrays: WindowArrays
    counts: np.ndarray
    shortest: float

    def __len__(self):
        return len(self.arrays.tile)

    def __repr__(self):
        tiles, nights = number_of(len(self.tiling), "tile"), number_of(len(self.days), "night")
        return f"<Windows of {tiles} in {nights}: {len(self)}>"

    @cached_property
    def table(self) -> QTable:
        """The windows: columns ``tile``, ``date``, ``start``, ``end`` (UTC) and ``duration``."""
        tile, night, start, end = self.arrays
        columns = [self.tiling.table["tile"][tile], _dates(self.days)[night], times_of_mjd(start), times_of_mjd(end)]
        return QTable([*columns, ((end - start) * u.day).to(u.min)], names=["tile", "date", "start", "end", "duration"])

    @property
    def nights(self) -> QTable:
        """The nights: the numbers of tiles with windows, and of tiles without a window for each reason.

        The columns ``evening`` and ``morning`` (UTC) contain the first and the last time at which the Sun is low enough
        for the limits of any program; ``moonrise`` and ``moonset`` the times at which the center of the Moon is at the
        altitude 0. They are masked if there is no such time in the 24 hours of the night.
        """
        table = QTable({"date": _dates(self.days), "n_tiles": self.counts[:, 0]})
        skies, numbers = [self.sky(k) for k in range(len(self.days))], [one.numbers for one in self.limits.values()]
        events = [_events(sky, max(numbers, key=lambda one: one.sun)) for sky in skies]
        for name, mjd in zip(("evening", "morning", "moonrise", "moonset"), np.transpose(events), strict=True):
            table[name] = times_of_mjd(np.ma.masked_invalid(mjd))
        table["moon_illumination"] = [float(sky.illumination(np.array(0.5))) for sky in skies]
        for number, reason in enumerate(REASONS[1:], 1):
            table[reason] = self.counts[:, number]
        return table

    def reasons(self, date: object = None) -> QTable:
        """Return why tiles have no window in a night.

        Parameters
        ----------
        date : Time, date or str, optional
            One of the dates; by default, the first.

        Returns
        -------
        QTable
            Columns ``tile`` and ``reason``, which is empty if the tile has a window. Limits are applied one after the
            other; the reason is the limit after which no time is left.

        Raises
        ------
        InputError
            If the windows of this date were not computed.
        """
        day = self.days[0] if date is None else day_of(date)
        if day not in self.days:
            raise InputError(f"date must be one of the dates from {_dates(self.days)[0]} on, got {short(date)}")
        _, reason = night_windows(self.sky(int(np.flatnonzero(self.days == day)[0])), self)
        return QTable({"tile": self.tiling.table["tile"], "reason": np.array(REASONS)[reason]})

    @cached_property
    def vectors(self) -> np.ndarray:
        """ICRS unit vectors of the tiles."""
        return to_axes(*(self.tiling.table[name].to_value(u.rad) for name in ("ra", "dec")))[0]

    def sky(self, night: int) -> NightSky:
        """Return the sky of a night.

        Parameters
        ----------
        night : int
            Index of the night.

        Returns
        -------
        NightSky
            The sky; its attributes are in radians and days, for example ``altitude(tile, time)`` for rows of tiles and
            times since local mean noon.
        """
        return NightSky(self.site, self.days[night], self.vectors)

    @cached_property
    def own_times(self) -> np.ndarray:
        """Times (modified Julian dates) between which each tile can be observed, shape (2, n)."""
        n, names = len(self.tiling), ("start", "end")
        given = [_mjd_of(self.tiling.table, name) if name in self.tiling.table.colnames else None for name in names]
        limits = [
            np.full(n, limit) if values is None else values
            for values, limit in zip(given, (-np.inf, np.inf), strict=True)
        ]
        return np.array(
            [np.where(np.isnan(values), limit, values) for values, limit in zip(limits, (-np.inf, np.inf), strict=True)]
        )

    @cached_property
    def groups(self) -> list[tuple[NightLimits, np.ndarray]]:
        """The limits of each program, and the rows of its tiles."""
        names = programs_of(self.tiling)
        known = np.isin(names, [*self.limits])
        if "" not in self.limits and not known.all():
            other = str(names[~known][0])
            whom = f"the program {other!r}, or for the program ''" if other else "tiles without a program (the key '')"
            raise InputError(f"limits must be given for {whom}, got {listed(self.limits)}")
        names = np.where(known, names, "")
        return [(limits, np.flatnonzero(names == name)) for name, limits in self.limits.items()]


def programs_of(tiling: Tiling) -> np.ndarray:
    """Return the program of each tile in lower case; it is empty without a column ``program``."""
    if "program" not in tiling.table.colnames:
        return np.full(len(tiling), "", dtype="U1")
    return np.char.lower(np.asarray(to_plain(tiling.table["program"])).astype(str))


def night_windows(sky: NightSky, windows: Windows) -> tuple[Pieces, np.ndarray]:
    """Return the windows of all tiles in a night, and the number of the reason for each tile."""
    reason, parts = np.zeros(len(windows.tiling), dtype=np.int64), []
    for limits, rows in windows.groups:
        parts.append(windows_of_night(sky, limits, rows, windows.own_times[:, rows] - sky.noon, reason))
    pieces = joined(parts)
    pieces = pieces.of(pieces.end - pieces.start >= windows.shortest)
    found = np.zeros(len(reason), dtype=bool)
    found[pieces.tile] = True
    reason[~found & (reason == 0)] = SHORT
    return pieces, reason


@check_keywords
@any_year()
def observing_windows(
    tiles: object,
    site: EarthLocation | str,
    date: object,
    limits: NightLimits | Mapping[str, NightLimits] | None = None,
    *,
    n_nights: int = 1,
    shortest: u.Quantity = 1 * u.min,
) -> Windows:
    """Return the times in which tiles can be observed.

    Parameters
    ----------
    tiles : Tiling, SkyCoord, QTable or path-like
        The tiles. In a table, the columns ``start`` and ``end`` (Time, modified Julian date, or text) limit the times
        of a tile, and ``program`` names its limits.
    site : EarthLocation or str
        Location of the telescope, or its name, as in `rfpsurvey.ObservingConditions`.
    date : Time, date or str
        Local date of the (first) evening. A night begins at local mean noon of this date, and takes 24 hours.
    limits : NightLimits or dict of str to NightLimits, optional
        Limits for all tiles, or for the tiles of each program; the key ``""`` is for other tiles.
    n_nights : int, optional
        Number of successive nights.
    shortest : Quantity, optional
        Shortest window.

    Returns
    -------
    Windows
        The windows, and the reasons why tiles have none.

    Raises
    ------
    InputError
        If a value is not valid.

    Notes
    -----
    The positions of tiles include precession, nutation and aberration at local midnight, and agree with astropy's
    ``AltAz`` to 4 arcsec. The Sun and the Moon are seen from the site, with an error of a few arcsec. Dates that the
    installed tables of the Earth's rotation do not cover are permitted: UT1 - UTC, which is less than 0.9 s (0.004
    deg), is neglected there. Proper motions and refraction are neglected.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astropy.coordinates import SkyCoord
    >>> from rfpsurvey.night import NightLimits, observing_windows
    >>> tiles = SkyCoord([40, 95, 200] * u.deg, [10, 23, -60] * u.deg)
    >>> windows = observing_windows(tiles, "kitt peak", "2027-01-03", NightLimits(max_airmass=1.5))
    >>> windows.table["tile", "start", "duration"].pprint()  # doctest: +SKIP
    >>> windows.reasons()["reason"].tolist()
    ['', '', 'too low']
    """
    tiling, site, limits = as_tiling(tiles), as_site(site), limits_of(limits)
    days = day_of(date) + np.arange(check_whole(n_nights, "n_nights", high=100_000))
    least = to_scalar(shortest, u.day, "shortest")
    if not 0 <= least <= 1:
        raise InputError(f"shortest must be from 0 to 24 h, got {shortest}")
    windows = Windows(tiling, site, limits, days, WindowArrays(*[np.empty(0)] * 4), np.empty(0), least)
    parts, counts = [], np.zeros((len(days), len(REASONS)), dtype=np.int64)
    for night in range(len(days)):
        sky = windows.sky(night)
        pieces, reason = night_windows(sky, windows)
        counts[night] = np.bincount(reason, minlength=len(REASONS))
        of = np.full(len(pieces.tile), night)
        parts.append(WindowArrays(pieces.tile, of, sky.noon + pieces.start, sky.noon + pieces.end))
    arrays = WindowArrays(*map(np.concatenate, zip(*parts, strict=True)))
    return Windows(tiling, site, limits, days, arrays, counts, least)


def day_of(date: object) -> int:
    """Return the modified Julian date of a date, at 0 h."""
    return int(np.floor(to_time(date, "date", scalar=True).utc.mjd))


def _dates(days: np.ndarray) -> np.ndarray:
    return Time(days.astype(float), format="mjd", scale="tai").strftime("%Y-%m-%d")


@any_year()
def times_of_mjd(mjd: np.ndarray) -> Time:
    """Return modified Julian dates (UTC) as times, which are shown to the second."""
    return Time(Time(mjd, format="mjd", scale="utc"), format="isot", precision=0)


def _mjd_of(table: QTable, name: str) -> np.ndarray:
    """Return times in a column of a table of tiles as modified Julian dates; NaN where there is none."""
    column = table[name]
    if isinstance(column, Time):
        return np.ma.filled(np.ma.asarray(column.utc.mjd, dtype=float), np.nan)
    values = to_plain(column, name)
    if values.dtype.kind in "fiu":
        return values.astype(float)
    known, times = np.char.strip(values.astype(str)) != "", np.full(len(values), np.nan)
    if known.any():
        texts = values[known].tolist()
        with refusing(f"{name} must contain dates and times (UTC) such as 2027-01-04T03:00:00", texts, list):
            times[known] = Time(texts).utc.mjd
    return times
