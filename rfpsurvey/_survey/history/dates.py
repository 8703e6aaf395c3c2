"""Warn if tiles were observed on other dates than planned, so that positions or states of positioners differ."""

from collections.abc import Callable, Iterable

import astropy.units as u
import numpy as np
from astropy.time import Time

from rfpsurvey._instruments.instrument import Instrument
from rfpsurvey._instruments.states import states_of
from rfpsurvey._survey.history.events import Events, TileEvent
from rfpsurvey._survey.work import FASTEST, TIME
from rfpsurvey.errors import InputError, listed, number_of, warn

MOST_MOVED = 0.1
"""Distance in arcsec that a target may move between the time of the plan and the observation without a warning."""
NIGHT = 2 * u.day
"""An observation with a date is between 0 h UTC of this date and this time later, for every definition of a night."""
MOST_NAMES = 5


def warn_of_dates(
    tiles: Iterable[TileEvent], events: Events, instruments_for: Callable[[Time], list[Instrument]]
) -> None:
    """Warn if targets moved, or states of positioners changed, between the time of a plan and the observation.

    Parameters
    ----------
    tiles : iterable of TileEvent
        The observations.
    events : Events
        The events in the folder of the survey, which give access to its plans.
    instruments_for : callable
        Function that returns the instrument of the survey at each of several times.
    """
    late, moved = [], []
    for event in tiles:
        visits, cards = events.visits(event) if event.date and event.plan else (None, {})
        if TIME not in cards:
            continue
        planned, night = Time(cards[TIME], scale="utc"), Time(event.date, scale="utc")
        observed = min(max(planned, night), night + NIGHT)
        if observed == planned:
            continue
        words = f"tile {event.tile}, planned for {cards[TIME][:10]} and observed on {event.date}"
        late.append((words, visits["positioner"].astype(str), planned, observed))
        arcsec = cards.get(FASTEST, 0.0) / 1000 * abs((observed - planned).to_value(u.yr))
        if arcsec > MOST_MOVED:
            moved.append(f"{words} (up to {arcsec:.2g} arcsec)")
    _warn(f"targets moved by more than {MOST_MOVED} arcsec by their proper motions", moved)
    try:
        times = Time([time.isot for _, _, *pair in late for time in pair], scale="utc") if late else []
        planes = [instrument.focal_plane for instrument in (instruments_for(times) if late else ())]
    except InputError as error:
        warn(f"the states of positioners on the dates of the plan and of the observations were not compared: {error}")
        return
    changed = []
    for (words, used, *_), before, after in zip(late, planes[::2], planes[1::2], strict=True):
        is_same = np.isclose(states_of(before), states_of(after), equal_nan=True).all(axis=1)
        ids = before.id[~is_same].astype(str)
        if len(ids):
            names, n_used = listed(ids.tolist(), MOST_NAMES), np.count_nonzero(np.isin(ids, used))
            changed.append(f"{words} ({number_of(len(ids), 'positioner')}, {n_used} with a planned target: {names})")
    _warn("states of positioners changed", changed)


def _warn(what: str, tiles: list[str]) -> None:
    """Warn that the plans of some tiles do not fit the dates of their observations."""
    if tiles:
        more = f"; and {number_of(len(tiles) - MOST_NAMES, 'further tile')}" if len(tiles) > MOST_NAMES else ""
        warn(f"{what} between the time of the plan and the observation: {'; '.join(tiles[:MOST_NAMES])}{more}")
