"""The history of a survey by night: states of tiles, failed visits, and fibers of all tiles."""

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from rfpsurvey._instruments.focal_plane import FocalPlane
from rfpsurvey._survey import key_objects
from rfpsurvey._survey.columns import NOT_PLANNED, PAST
from rfpsurvey._survey.folder import read_visits
from rfpsurvey._survey.history.events import TileEvent, TileState, grouped, places_of
from rfpsurvey._survey.history.replay import TileStates
from rfpsurvey._survey.history.state import SurveyState
from rfpsurvey._survey.plan_file import keys_in
from rfpsurvey._survey.survey import Survey
from rfpsurvey.errors import InputError

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

    @cached_property
    def events(self) -> list[TileEvent]:
        """The events of tiles."""
        return list(self.state.events.of_tiles(self.state.until))

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
        for row in {*self.state.past} - {*self.attempts}:
            states[row].append((len(self.nights), PAST))
        return states

    @cached_property
    def attempts(self) -> dict[int, list[TileEvent]]:
        """The observations of the tile in each row, in the order of dates."""
        return grouped((event.row, event) for event in self.state.attempts)

    @cached_property
    def failures(self) -> list[tuple[int, int, str, str]]:
        """The failed visits of observed tiles: row of the tile, night, positioner, and reason."""
        done = [event for event in self.state.attempts if event.state == TileState.DONE]
        return [(e.row, self.night(e.date), name, reason) for e in done for name, reason in e.failed.items()]

    @cached_property
    def plane(self) -> FocalPlane | None:
        """The positioners; None if the plan file of the survey does not describe the instrument."""
        with suppress(InputError):
            keys = keys_in(self.state.folder, {"allocator", "tiles", "visits", "rule"})
            return key_objects.model_of(keys.instrument, key_objects.any_time).focal_plane
        return None

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
    kind = visits["kind"] if "kind" in visits.dtype.names else np.full(len(visits), KINDS[0])
    first = np.char.partition(kind.astype(str), "+")[:, 0]  # a target can have several kinds
    code = np.select([first == name for name in KINDS], range(1, 1 + len(KINDS)), 1)
    return np.where(visits["in_collision"], COLLISION, code)
