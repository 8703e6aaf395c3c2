"""The state of a survey with cadences: when its tiles were observed, and which epochs of targets are complete."""

from pathlib import Path

import numpy as np
from astropy.time import Time

from rfpsurvey._sky.catalog import Catalog
from rfpsurvey._survey.cadences import Cadences, Windows, brightness_of, days_of
from rfpsurvey._survey.history.events import Events, TileState
from rfpsurvey._survey.history.replay import TileStates, visits_of
from rfpsurvey._survey.source import digest
from rfpsurvey._survey.tiling.tiling import Tiling
from rfpsurvey.errors import InputError, number_of, refusal


def check_dates(folder: Path, request: dict, visits: object, tiling: Tiling | None, rule: object) -> None:
    """Raise an error unless the cadences and the times of tiles are those of the first plan; ``rule`` must be empty."""
    if "cadences" not in request:
        if isinstance(visits, Cadences):
            raise InputError(f"visits must be numbers, as in the survey in {folder}, got cadences")
        return
    if not isinstance(visits, Cadences):
        raise refusal(f"visits must be the Cadences of the survey in {folder}", visits)
    if rule:
        raise InputError("a survey with cadences must have no rule for visits, got a rule")
    if visits.record != request["cadences"]:
        raise InputError(f"visits must be the cadences of the first plan, {request['cadences']}, got {visits.record}")
    if not isinstance(tiling, Tiling):
        raise refusal("tiles must be the Tiling of a survey with cadences", tiling)
    recorded = str(request.get("first", request).get("dates", request.get("dates")))
    n = int(recorded.partition(" ")[0])
    if dates_record(days_of(tiling)[:n], brightness_of(visits, tiling)[:n]) != recorded:
        raise InputError(
            f"tiles must be those of the first plan, {recorded}, got tiles with other times or another brightness"
        )


def dates_record(days: np.ndarray, brightness: np.ndarray) -> str:
    """Return the number of tiles, and a digest of their times and brightness."""
    return f"{number_of(len(days), 'tile')}, digest {digest(days, brightness)}"


def observed_time(date: str, day: float) -> float:
    """Return when a tile was observed (MJD); ``day`` is its planned time.

    This is the planned time if the date is that of this time or, because dates can be those of nights, the date before;
    otherwise, the planned time of day on the date.
    """
    if not date:
        return day
    recorded = Time(date, scale="utc").mjd
    return day if recorded <= day < recorded + 2 else recorded + day % 1


def times_of(tiling: Tiling, states: TileStates) -> tuple[np.ndarray, list[int]]:
    """Return the time of each tile (MJD), and the rows of tiles that lie in the past without having been observed.

    Observed tiles have the times of their observations. Tiles before the last observation, successful or not, lie in
    the past, and so do tiles of failed observations. Partly observed tiles will be completed, not before this time.
    """
    days = days_of(tiling)
    now = max((observed_time(event.date, days[event.row]) for event in states.attempts), default=-np.inf)
    is_past = days < now
    for row, event in ((row, states.state_of(row)) for row in states.rows()):
        is_past[row] |= bool(states.of(row)) and days[row] <= now
        if event.state == TileState.DONE:
            days[row] = observed_time(event.date, days[row])
        elif event.state == TileState.PARTLY:
            days[row] = now
        is_past[row] &= event.state == TileState.PLANNED
    return days, np.flatnonzero(is_past).tolist()


def replay_windows(events: Events, states: TileStates, cadences: Cadences, catalog: Catalog, tiling: Tiling) -> Windows:
    """Return the windows of all targets, in the order of rows, after the observations in the order of their times.

    Successful visits outside of the window of a target are not counted.
    """
    days = times_of(tiling, states)[0]
    windows = Windows(cadences, cadences.of(catalog), days, brightness_of(cadences, tiling))
    done = [event for event in map(states.state_of, states.rows()) if event.state == TileState.DONE]
    for event in sorted(done, key=lambda event: days[event.row]):
        target, good, _ = visits_of(event, events.observed(event)[0])
        windows.observe(target[good], event.row)
    return windows
