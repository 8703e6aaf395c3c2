"""Checks whether an event contradicts the observations of its tile, or repeats an earlier record."""

import numpy as np

from rfpsurvey._survey.history.event_files import History, on_date
from rfpsurvey._survey.history.events import TileEvent, TileState
from rfpsurvey.errors import InputError, warn


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
