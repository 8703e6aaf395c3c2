"""Checks of new events: contradictions and repetitions of earlier records, swaps, and dates of observations."""

from collections.abc import Callable, Iterable

import astropy.units as u
import numpy as np
from astropy.time import Time

from rfpsurvey._instruments.instrument import Instrument
from rfpsurvey._instruments.states import states_of
from rfpsurvey._survey.history.event_files import History, on_date
from rfpsurvey._survey.history.events import Events, TileEvent, TileState
from rfpsurvey._survey.work import FASTEST, TIME, reach_of
from rfpsurvey.errors import InputError, listed, number_of, warn

MOST_MOVED = 0.1
"""Distance in arcsec that a target may move between the time of the plan and the observation without a warning."""
NIGHT = 2 * u.day
"""An observation with a date is between 0 h UTC of this date and this time later, for every definition of a night."""
MOST_NAMES = 5
"""Largest number of tiles or positioners that a warning lists."""
MOST_SWAPS = 10
"""Largest number of swaps that a warning lists."""


def check_possible(event: TileEvent, history: History) -> None:
    """Raise an error if an event contradicts the observations of its tile."""
    attempts, name = history.states.of(event.row), event.tile
    done = [past for past in attempts if past.state == TileState.DONE and past.observation != event.observation]
    if event.state == TileState.ADDED and attempts and not np.array_equal(history.place(event.row), event.place):
        raise InputError(f"tile {name} must not be moved, because an observation of it was recorded")
    if event.state == TileState.DROPPED and done:
        raise InputError(f"tile {name} must not be dropped, because it was observed{on_date(done[0].date)}")
    if event.state == TileState.DONE and done:
        raise InputError(
            f"tile {name} must be observed only once, got its observations{on_date(event.date)} and"
            f"{on_date(done[0].date)}; record one of them as bad"
        )


def is_known(event: TileEvent, history: History) -> bool:
    """Return whether an event repeats an earlier record, and warn if this record was corrected since then.

    Without a date, the states ``dropped`` and ``planned`` can be recorded any number of times. A record that changes
    nothing, but states something new, is kept, so that it does not undo a later correction if it is recorded again.
    """
    states, is_dropped, before = history.states, event.row in history.states.dropped, history.earlier(event)
    after = event.after(before)
    is_same = before is not None and before[:7] == after[:7] and before.swaps == after.swaps  # [:7]: up to `failed`
    if event.state == TileState.ADDED:
        is_planned = event.row < history.n_tiles_before and not is_dropped
        is_same = is_planned and np.array_equal(history.place(event.row), event.place)
    elif event.state in (TileState.DROPPED, TileState.PLANNED):
        is_same = is_dropped if event.state == TileState.DROPPED else not is_dropped and not states.of(event.row)
    if not event.date and (is_same or event.state in (TileState.DROPPED, TileState.PLANNED)) and before is None:
        return is_same
    if event.replaces:
        return is_same
    known = any(past.includes(event) for past in history.past.get(event.row, ()))
    if known and not is_same:
        warn(
            f"the state of tile {event.tile}{on_date(event.date)} was corrected after this record, and the correction "
            "is kept; to undo it, record the state planned for this tile, and then its observations"
        )
    return known


def with_swaps_of(columns: dict, rows: list[int], event: TileEvent, history: History) -> TileEvent:
    """Return an event with the swaps in some rows of a table."""
    if not rows:
        return event
    tile = event.tile
    if event.state != "done":
        raise InputError(
            f"the state of tile {tile} must be done if swaps are recorded, because they belong to the observation that "
            f"finishes the tile, got {event.state}"
        )
    request, swaps, far = history.request(), {}, []
    job = request.job(event.row, np.ones_like(request.builder.left))
    targets, ids = job.field.targets, job.field.targets.id.astype(str)
    positioners, pairs = request.instrument.focal_plane.id.astype(str).tolist(), reach_of(job).pairs
    for k in rows:
        name, target = (columns[role][k] if columns[role] else "" for role in ("positioner", "target"))
        if not (name and target):
            raise InputError(f"a swap must have a positioner and a target, got {name or target!r} only in tile {tile}")
        if name not in positioners:
            raise InputError(f"positioner must be a positioner of the instrument, got {name!r}")
        index = np.flatnonzero(ids == target)
        if len(index) != 1:
            raise InputError(
                f"target must be one target in the field of tile {tile}, got {target!r}, which is the identifier of "
                f"{len(index) or 'none'}"
            )
        if not ((pairs.owner == positioners.index(name)) & (pairs.target == index[0])).any():
            far.append(f"{name} ({target})")
        kind = "science" if targets.columns.kind is None else str(targets.columns.kind[index[0]])
        if name in swaps:
            raise InputError(f"positioner must be in one row of swaps of tile {tile}, got {name!r} in several rows")
        swaps[name] = [int(job.field.row[index[0]]), target, kind]
    event = event._replace(swaps=dict(sorted(swaps.items())))
    observed, _ = history.events.observed(event.after(history.earlier(event)))
    row, n = np.unique(observed["target_row"][observed["target_row"] >= 0], return_counts=True)
    if (n > 1).any():
        twice = observed["target_id"][observed["target_row"] == row[n > 1][0]][0]
        raise InputError(f"a target of tile {tile} must be observed by one positioner, got several for {twice}")
    if far:
        warn(f"targets of swaps of tile {tile} are out of reach of their positioners: {listed(far, MOST_SWAPS)}")
    return event


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
