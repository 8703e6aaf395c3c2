"""The history of a survey by night: states of tiles, visits of each class, failures, and fibers of all tiles."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from rfpsurvey._instruments.focal_plane import FocalPlane
from rfpsurvey._survey.bookkeeping import classes_by_column
from rfpsurvey._survey.columns import NOT_PLANNED, PAST
from rfpsurvey._survey.continue_survey import instrument_in
from rfpsurvey._survey.folder import read_visits
from rfpsurvey._survey.history.events import TileEvent, TileState, grouped, places_of
from rfpsurvey._survey.history.replay import TileStates, visits_of
from rfpsurvey._survey.history.state import SurveyState
from rfpsurvey._survey.source import columns_of, is_science
from rfpsurvey._survey.survey import Survey

NO_TARGET, KINDS, COLLISION = 0, ("science", "standard", "sky"), 4
"""Codes of fibers: without a target, 1 to 3 for the kinds of targets, and lost to a collision."""


@dataclass(frozen=True)
class History:
    """The history of a survey.

    Parameters
    ----------
    survey : Survey
        The survey, as it was planned last.
    state : SurveyState
        The state of the survey.
    """

    survey: Survey
    state: SurveyState
    events: list[TileEvent] = field(init=False, repr=False)

    def __post_init__(self):
        object.__setattr__(self, "events", list(self.state.events.of_tiles(self.state.until)))

    @cached_property
    def nights(self) -> list[str]:
        """All dates of events; a night is the index in this list plus 1, and night 0 is before the first date."""
        return sorted({event.date for event in self.events} - {""})

    def night(self, date: str) -> int:
        """Return the night of a date."""
        return self.nights.index(date) + 1 if date else 0

    @cached_property
    def tiles(self) -> dict[int, tuple[str, np.ndarray]]:
        """The identifier and the place (right ascension, declination, position angle, pass) of the tile in each row."""
        names = np.asarray(self.survey.tiles["tile"]).astype(str).tolist()
        tiles = dict(enumerate(zip(names, places_of(self.survey.tiles), strict=True)))
        return tiles | {row: (event.tile, np.array(event.place)) for row, event in self.state.states.added.items()}

    @cached_property
    def states(self) -> dict[int, list[tuple[int, str]]]:
        """For each row, the nights at which the state of the tile changed, and the states from these nights on."""
        states = {row: [(0, "planned")] for row in self.tiles}
        for row, own in grouped((event.row, event) for event in self.events).items():
            dates = sorted({event.date for event in own})
            # the order of an observation without a date depends on the dates of all tiles
            known = self.events if dates[0] == "" != dates[-1] else own
            for date in dates:
                word = TileStates(event for event in known if event.date <= date).word_of(row)
                if word != states[row][-1][1]:
                    states[row].append((self.night(date), word))
        for row in self.state.past:
            states[row].append((len(self.nights), PAST))
        return states

    @cached_property
    def attempts(self) -> dict[int, list[TileEvent]]:
        """The observations of the tile in each row, in the order of dates."""
        return grouped((event.row, event) for event in self.state.attempts)

    @cached_property
    def classes(self) -> dict[tuple[str, str], tuple[int, np.ndarray]]:
        """For all targets, each priority and each category, the requested visits and those observed up to each night.

        The numbers of the last night are those of `survey_status`.
        """
        state, columns = self.state, columns_of(self.state.catalog, None)
        wanted = state.requested * is_science(state.catalog).astype(np.int64)
        most, made = np.minimum(state.observed, wanted), np.zeros(len(wanted), dtype=np.int64)
        requested = wanted.copy()
        if state.limits is not None:  # visits that expired also define classes, as in the table of the status
            requested[state.limits.row] += state.limits.expired
        columns = classes_by_column(columns["priority"], columns["category"], requested)
        counts = [np.zeros((len(self.nights) + 1, len(names)), dtype=np.int64) for _, names in columns.values()]
        for event in sorted(self.state.attempts, key=lambda event: event.date):
            if event.state != TileState.DONE:
                continue
            target, good, _ = visits_of(event, state.events.observed(event)[0])
            target = target[good]
            made[target] += 1
            counted = target[made[target] <= most[target]]
            for (class_of, names), of_column in zip(columns.values(), counts, strict=True):
                of_column[self.night(event.date)] += np.bincount(class_of[counted], minlength=len(names))
        found = {("all", ""): (int(wanted.sum()), counts[0].sum(axis=1).cumsum())}
        for (column, (class_of, names)), of_column in zip(columns.items(), counts, strict=True):
            total = np.bincount(class_of, weights=wanted, minlength=len(names)).astype(int).tolist()
            if len(names) > 1:
                values = zip(names, total, of_column.cumsum(axis=0).T, strict=True)
                found |= {(column, name): (n, observed) for name, n, observed in values}
        return found

    @cached_property
    def failures(self) -> list[tuple[int, int, str, str]]:
        """The failed visits of observed tiles: row of the tile, night, positioner, and reason."""
        done = [event for event in self.state.attempts if event.state == TileState.DONE]
        return [(e.row, self.night(e.date), name, reason) for e in done for name, reason in e.failed.items()]

    @cached_property
    def plane(self) -> FocalPlane | None:
        """The positioners; None if the plan file of the survey does not describe the instrument."""
        instrument = instrument_in(self.state.folder)
        return None if instrument is None else instrument.focal_plane

    def fibers(self) -> Iterator[tuple[int, np.ndarray, dict]]:
        """Yield the row, the visits and the header cards of each tile that has a plan for its present position.

        Those of an observed or partly observed tile are of the plan with which it was observed, after swaps.
        """
        survey, state = self.survey, self.state
        places = places_of(survey.tiles)
        for row, (name, place) in self.tiles.items():
            if event := state.kept.get(row):
                yield row, *state.events.observed(event)
            elif row < len(survey) and survey._states[row] not in NOT_PLANNED and np.array_equal(places[row], place):
                yield row, *read_visits(survey.folder, row, survey._known, name)


def codes_of(visits: np.ndarray) -> np.ndarray:
    """Return the code of the fiber of each visit."""
    names = visits.dtype.names
    kind = (
        np.char.partition(visits["kind"].astype(str), "+")[:, 0] if "kind" in names else np.full(len(visits), "science")
    )
    code = np.select([kind == name for name in KINDS], range(1, 1 + len(KINDS)), 1)
    return np.where(visits["in_collision"], COLLISION, code)
