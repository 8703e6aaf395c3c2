"""The plan of a night: tiles with their start times, from windows, exposure times, merits and the state of a survey."""

import os
from dataclasses import dataclass

import astropy.units as u
import numpy as np
from astropy.coordinates import EarthLocation
from astropy.table import QTable

from rfpsurvey._common.descriptions import Fact, describe_methods, facts_of
from rfpsurvey._common.io import write_table
from rfpsurvey._common.settings import Option, number_within
from rfpsurvey._common.units import to_scalar, to_unit
from rfpsurvey._instruments.instrument import Instrument, as_instrument, available_instruments
from rfpsurvey._sky.time import any_year
from rfpsurvey._survey.night.candidates import candidates_of
from rfpsurvey._survey.night.order import METHODS, NightProblem, Order, postponed
from rfpsurvey._survey.night.settings import NightSettings, settings_of
from rfpsurvey._survey.night.sky import noon_of
from rfpsurvey._survey.night.windows import Windows, day_of, observing_windows, programs_of, times_of_mjd
from rfpsurvey._survey.survey import Survey
from rfpsurvey.errors import InputError, check_choice, check_keywords, check_switch, check_whole, number_of

DAY = 86400.0
BLOCK = 2000
"""Number of windows whose exposures are computed at a time, which limits the memory."""
NOT_CHOSEN, NO_FIT = "not chosen", "exposure longer than the window"


@dataclass(frozen=True, eq=False, repr=False)
class Night:
    """The plan of a night, which `rfpsurvey.night.plan_night` returns.

    Parameters
    ----------
    table : QTable
        A row for each observation, in the order of times: ``tile``, ``start`` and ``end`` of the exposure (UTC),
        ``exposure_time``, and, at the midpoint of the exposure, ``airmass``, ``hour_angle`` and ``moon_separation``;
        ``merit``, and ``backups``, the names of other tiles that can be observed in its place, best ones first.
    not_observed : QTable
        Columns ``tile`` and ``reason`` of all other tiles.
    summary : dict
        ``date``, ``n_tiles``, ``merit`` (the sum), ``bound`` (no order of tiles has a larger sum), ``is_optimum``,
        ``night`` (duration from the first to the last window, h), ``exposure`` (fraction of this time in exposures),
        ``idle`` (fraction in which no tile is observed or prepared) and ``moon_illumination`` at local midnight.
    windows : Windows
        The windows of the tiles that can be observed.
    """

    table: QTable
    not_observed: QTable
    summary: dict
    windows: Windows

    def __len__(self):
        return len(self.table)

    @any_year()
    def as_text(self) -> QTable:
        """Return the table with its times as text (UTC), as files contain it.

        Returns
        -------
        QTable
            The table.
        """
        table = self.table.copy()
        for name in ("start", "end"):
            table[name] = np.asarray(table[name].isot, dtype=str)
        return table

    def write(self, path: str | os.PathLike, *, overwrite: bool = False) -> None:
        """Write the table to a file.

        Parameters
        ----------
        path : str or path-like
            Path that ends in ``.ecsv``, ``.fits`` or ``.parquet``.
        overwrite : bool, optional
            Whether to replace an existing file.

        Raises
        ------
        InputError
            If the ending is not known, or if the file exists and ``overwrite`` is False.
        """
        write_table(self.as_text(), path, overwrite=overwrite)

    def __repr__(self):
        s = self.summary
        words = "the optimum" if s["is_optimum"] else f"at most {s['bound']:g} possible"
        return f"<Night {s['date']}: {number_of(len(self), 'tile')}, merit {s['merit']:g} ({words})>"


FACTS = (
    Fact("date", "night of"),
    Fact("n_tiles", "tiles", zero=True),
    Fact("merit", "merit of the tiles", zero=True),
    Fact("bound", "largest possible merit", of="merit"),
    Fact("night", "hours from the first to the last window"),
    Fact("exposure", "fraction in exposures", of="night"),
    Fact("idle", "fraction without a tile", of="night", zero=True),
    Fact("moon_illumination", "illuminated fraction of the Moon", zero=True),
)
"""The numbers of the plan of a night that are shown."""


def night_facts(night: Night, *, is_short: bool = False) -> dict:
    """Return the labels and values of the plan of a night."""
    return facts_of(FACTS, night.summary, ("date", "n_tiles", "merit", "bound") if is_short else None)


@describe_methods(METHODS)
@check_keywords
@any_year()
def plan_night(
    tiles: object,
    date: object,
    *,
    instrument: Instrument | str | None = None,
    site: EarthLocation | str | None = None,
    limits: object = None,
    exposure_time: object = None,
    overhead: object = None,
    airmass_exponent: object = None,
    merit: object = None,
    in_passes: bool = False,
    method: str = "greedy",
    slot: u.Quantity = 30 * u.s,
    backups: int = 2,
    time_limit: u.Quantity = 60 * u.s,
) -> Night:
    """Return the tiles that are observed in a night, in their order, with start times.

    Parameters
    ----------
    tiles : Survey, Tiling, SkyCoord or QTable
        A survey in a folder, of which the tiles that are not finished are candidates, or tiles. In a table, the column
        ``merit`` states the merit of a tile (1 by default), ``exposure_time`` its exposure time at airmass 1,
        ``program`` its program, and ``start`` and ``end`` limit its times.
    date : Time, date or str
        Local date of the evening.
    instrument : Instrument or str, optional
        Instrument whose description (section ``[night]``) contains the site, limits, exposure times and overheads that
        are not given. By default, the preset with which a survey was planned.
    site : EarthLocation or str, optional
        Location of the telescope, or its name.
    limits : NightLimits or dict of str to NightLimits, optional
        Limits of all tiles, or of the tiles of each program.
    exposure_time, overhead : Quantity or dict of str to Quantity, optional
        Exposure time at airmass 1, and time between two exposures, for all tiles or for each program.
    airmass_exponent : float or dict of str to float, optional
        Exposure times are multiplied by the airmass at the midpoint of the exposure to the power of this number.
    merit : str or callable, optional
        Merit of the tiles of a survey: ``visits`` (planned visits, the default), ``classes`` (a visit is worth ten
        visits to targets of the next priority), the name of a plugin, or a function that returns the merits for a table
        of tiles. The table has the columns of the survey's tiles, ``n_visits`` and ``n_by_class``, shape (n,
        n_classes), with the highest priority first.
    in_passes : bool, optional
        Whether a tile can be observed only after all tiles of earlier passes whose fields overlap with its field.
    method : str, optional
        {methods}
    slot : Quantity, optional
        Exposures begin at multiples of this time after the beginning of the night, and their durations, with the
        overhead, are rounded up to its multiples.
    backups : int, optional
        Number of other tiles for each observation.
    time_limit : Quantity, optional
        Time limit of the method ``exact``.

    Returns
    -------
    Night
        The plan.

    Raises
    ------
    InputError
        If a value is not valid or not known, if the survey has no folder, or if events were recorded after its last
        plan.

    Notes
    -----
    The model of the weather is that there is none. See :doc:`/night`.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astropy.coordinates import SkyCoord
    >>> from rfpsurvey.night import plan_night
    >>> tiles = SkyCoord([40, 95, 200] * u.deg, [10, 23, -60] * u.deg)
    >>> night = plan_night(tiles, "2027-01-03", instrument="desi")
    >>> night.table["tile", "start", "airmass"].pprint()  # doctest: +SKIP
    """
    number = Option(above=0, high=43200)
    slot_s = number_within(to_scalar(slot, u.s, "slot"), "slot (s)", number)
    limit_s = number_within(to_scalar(time_limit, u.s, "time_limit"), "time_limit (s)", Option(above=0))
    check_choice(method, METHODS, "method")
    check_whole(backups, "backups", low=0, high=100)
    check_switch(in_passes, "in_passes")
    instrument = None if instrument is None else as_instrument(instrument)
    if isinstance(tiles, Survey):
        name = tiles.provenance["instrument"]["name"]
        instrument = as_instrument(name) if instrument is None and name in available_instruments() else instrument
    given = {"exposure_time": exposure_time, "overhead": overhead, "airmass_exponent": airmass_exponent}
    settings = settings_of(instrument, site, limits, **given)
    noon = noon_of(settings.site, day_of(date))
    tiling, merits, excluded = candidates_of(tiles, merit, in_passes, noon, instrument)
    windows = observing_windows(tiling, settings.site, date, settings.limits, shortest=0 * u.s)
    grid = SlotGrid(windows, settings, slot_s)
    problem = NightProblem(grid.length, merits, grid.closes)
    order = postponed(problem, METHODS[method].function(problem, limit_s))
    return _night(order, problem, grid, excluded, backups, windows)


class SlotGrid:
    """Exposures that begin with each slot of a night, for all tiles."""

    def __init__(self, windows: Windows, settings: NightSettings, slot_s: float):
        tile, _, start, end = windows.arrays
        self.sky, n, programs = windows.sky(0), len(windows.tiling), programs_of(windows.tiling)
        table, self.slot = windows.tiling.table, slot_s / DAY
        self.exposure = settings.of("exposure_time", programs)
        if "exposure_time" in table.colnames:
            given = to_unit(table["exposure_time"], u.s, "exposure_time")
            self.exposure = np.where(np.isnan(given), self.exposure, given)
        is_valid = (self.exposure > 0) & (self.exposure <= DAY)
        if not is_valid.all():
            row = int(np.argmin(is_valid))
            got = "none" if np.isnan(self.exposure[row]) else f"{self.exposure[row]:g}"
            text = f"from above 0 to {DAY:g} s for every tile, got {got} for tile {table['tile'][row]}"
            raise InputError(f"exposure_time must be {text}")
        self.exposure, self.overhead = self.exposure / DAY, settings.of("overhead", programs) / DAY
        self.exponent, self.first = settings.of("airmass_exponent", programs), np.min(start, initial=np.inf)
        self.last = np.max(end, initial=-np.inf)
        self.n_slots = max(0, int(np.ceil((self.last - self.first) / self.slot))) if len(tile) else 0
        self.length, self.closes = np.zeros((n, self.n_slots), dtype=np.int32), np.full(n, -np.inf)
        np.maximum.at(self.closes, tile, end)
        low = np.ceil((start - self.first) / self.slot - 1e-6).astype(np.int64)
        high = np.minimum(np.floor((end - self.first) / self.slot).astype(np.int64), self.n_slots - 1)
        for part in np.array_split(np.arange(len(tile)), len(tile) // BLOCK + 1):
            count = np.maximum(high[part] - low[part] + 1, 0)
            of = np.repeat(part, count)
            slots = low[of] + np.arange(len(of)) - np.repeat(np.cumsum(count) - count, count)
            exposure = self.exposure_at(tile[of], slots)
            fits = self.first + slots * self.slot + exposure <= end[of] + 1e-9
            length = np.ceil((exposure + self.overhead[tile[of]]) / self.slot - 1e-6).astype(np.int32)
            self.length[tile[of][fits], slots[fits]] = np.maximum(length[fits], 1)

    def exposure_at(self, tile: np.ndarray, slot: np.ndarray) -> np.ndarray:
        """Return the exposure times (days) of tiles that begin with slots, for the airmass in the midpoint."""
        start = self.first + slot * self.slot - self.sky.noon
        exposure = self.exposure[tile]
        for _ in range(5):  # each value is the exposure for the airmass at the midpoint of the one before
            altitude = self.sky.altitude(tile, start + exposure / 2)
            exposure = self.exposure[tile] * np.sin(np.maximum(altitude, 0.01)) ** -self.exponent[tile]
        return exposure


def _night(
    order: Order, problem: NightProblem, grid: SlotGrid, excluded: dict, backups: int, windows: Windows
) -> Night:
    tile, names = order.tile, windows.tiling.table["tile"]
    exposure = grid.exposure_at(tile, order.slot)
    start = grid.first + order.slot * grid.slot
    midpoint = start + exposure / 2 - grid.sky.noon
    altitude, _, angle = grid.sky.horizontal(tile, midpoint)
    length = problem.length[tile, order.slot]
    used, others = np.zeros(len(problem.merit), dtype=bool), []
    used[tile] = True
    for slot, n in zip(order.slot.tolist(), length.tolist(), strict=True):
        rows = problem.observable(slot, slot + n)
        others.append(" ".join(str(names[row]) for row in rows[~used[rows]][:backups]))
    columns = {
        "tile": names[tile],
        "start": times_of_mjd(start),
        "end": times_of_mjd(start + exposure),
        "exposure_time": (exposure * u.day).to(u.s),
        "airmass": 1 / np.sin(altitude),
        "hour_angle": (angle * u.rad).to(u.deg),
        "moon_separation": (grid.sky.separation(tile, midpoint) * u.rad).to(u.deg),
        "merit": problem.merit[tile],
        "backups": np.array(others, dtype=str),
    }
    if "program" in windows.tiling.table.colnames:
        columns["program"] = windows.tiling.table["program"][tile]
    reason = windows.reasons()["reason"].astype(object)
    reason[(reason == "") & (problem.length > 0).any(axis=1)] = NOT_CHOSEN
    reason[reason == ""] = NO_FIT
    reason = {
        str(name): text for name, text in zip(names[~used].tolist(), reason[~used].tolist(), strict=True)
    } | excluded
    value, duration = float(problem.merit[tile].sum()), max(grid.last - grid.first, 0.0) if grid.n_slots else 0.0
    busy = np.minimum(length, grid.n_slots - order.slot).sum()
    summary = {
        "date": str(windows.nights["date"][0]),
        "n_tiles": len(tile),
        "merit": value,
        "bound": float(order.bound),
        "is_optimum": bool(order.is_optimum),
        "night": float(duration * 24),
        "exposure": float(exposure.sum() / duration) if duration else 0.0,
        "idle": 1 - float(busy) / grid.n_slots if grid.n_slots else 0.0,
        "moon_illumination": float(windows.nights["moon_illumination"][0]),
    }
    rest = QTable({"tile": np.array([*reason], dtype=str), "reason": np.array([*reason.values()], dtype=str)})
    return Night(QTable(columns, meta={"made_by": "plan_night"} | summary), rest, summary, windows)
