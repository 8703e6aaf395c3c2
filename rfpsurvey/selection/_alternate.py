"""Realizations of a survey with recorded events: each realization repeats the observations with its own plans.

A survey with events was planned several times. A *generation* is the plan of all tiles that were not observed before.
In each realization, every generation is planned again with the subpriorities of the realization; the tiles that were
observed with the plans of this generation are observed again, and the same positioners fail.
"""

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from rfpsurvey.errors import InputError
from rfpsurvey.selection._state import State
from rfpsurvey.survey import Request, SurveyState


class Generation(NamedTuple):
    """The plan of all tiles that had not been observed when some of the events were recorded."""

    request: Request
    observed: dict[int, np.ndarray]
    """For the row of each tile that was observed with this plan, the rows of the positioners that failed."""

    @property
    def rounds(self) -> list[np.ndarray]:
        """Rows of the tiles of each round; tiles on which no observed tile depends are omitted."""
        request, known = self.request, [*self.request.state.closed, *self.request.state.begun]
        rounds = [tiles[~np.isin(tiles, known)] for tiles in request.rounds]
        if not self.observed:  # the present plan
            return rounds
        vectors, needed = request.tiling.vectors, np.zeros(len(request.tiling), dtype=bool)
        needed[list(self.observed)] = True
        reach = 2 * np.sin(request.radius_rad + request.margin_rad) * (1 + 1e-9)
        for k in range(len(rounds) - 1, 0, -1):
            for one in rounds[k][needed[rounds[k]]].tolist():
                earlier = np.concatenate(rounds[:k])
                needed[earlier] |= np.linalg.norm(vectors[earlier] - vectors[one], axis=1) <= reach
        return [tiles[needed[tiles]] for tiles in rounds]


def generations_of(state: SurveyState, prepare: Callable[[SurveyState], Request]) -> list[Generation]:
    """Return the generations of a survey; ``prepare`` returns the request of a survey with a given state.

    The last generation is the plan of the tiles that remain.
    """
    if {*state.rule.record} - {"visits"}:
        raise InputError(
            "selection probabilities of a survey with recorded events need a rule that has only visits, got "
            f"{', '.join(state.rule.record)}"
        )
    watched: dict[int, dict] = {}
    for row, n in state.generations().items():
        watched.setdefault(n, {})[row] = state.kept[row]
    found = []
    for n in sorted({*watched, len(state.events.files)}):
        request = prepare(state.before(n))
        place = {str(name): k for k, name in enumerate(request.instrument.focal_plane.id.tolist())}
        failed = {row: [place[name] for name in event.failed or ()] for row, event in watched.get(n, {}).items()}
        found.append(Generation(request, {row: np.array(one, dtype=np.int64) for row, one in failed.items()}))
    return found


class History:
    """The visits that the observed tiles made in the realizations of a block.

    Parameters
    ----------
    state : SurveyState
        The recorded events.
    n_targets, n_realizations : int
        Numbers of targets and of realizations.
    """

    def __init__(self, state: SurveyState, n_targets: int, n_realizations: int):
        self._state, self.counts = state, np.zeros((n_realizations, 3), dtype=np.int64)
        self.made = np.zeros((n_targets, n_realizations), dtype=np.uint8)
        self._visits: dict[int, tuple] = {}
        self._closed: set[int] = set()

    def keep(self, row: int, targets: np.ndarray, mask: np.ndarray, good: np.ndarray, counts: np.ndarray) -> None:
        """Keep the visits of an observed tile: the rows of its targets, and masks of planned and of good visits."""
        self._visits[row] = targets, mask, good, counts

    def open_state(self, request: Request) -> State:
        """Return the state of the targets before a generation is planned."""
        n = self.made.shape[1]
        for row in [row for row in self._visits if row in request.state.closed and row not in self._closed]:
            targets, _, good, counts = self._visits[row]
            self._closed.add(row)
            self.counts[:, :2] += counts
            for r in range(n):
                own = targets[(good >> np.uint32(r)) & np.uint32(1) > 0]
                self.made[own, r] += 1
                self.counts[r, 2] += len(own)
        state, builder = State(request.builder, n), request.builder
        size, to_slots = len(request.source), request.source.to_slots
        for r in range(n):
            made = to_slots(self.made[:size, r])
            left = builder.wanted - np.minimum(made, builder.wanted)
            state.left[:, r] = left if builder.reusable is None else np.where(builder.reusable, np.uint8(1), left)
        slot_of = np.empty(size, dtype=np.int64)
        slot_of[to_slots(np.arange(size))] = np.arange(size)
        for row in request.state.begun:
            if row in self._visits:
                targets, mask, _, counts = self._visits[row]
                state.enter(slot_of[targets], _open(mask, state.left[slot_of[targets]]), counts)
        state.is_open = (state.left > 0).any(axis=1).astype(np.uint8)
        return state

    def masks(self, request: Request, state: State, before: np.ndarray) -> np.ndarray:
        """Return a mask of the realizations that observe each target; ``before`` are the remaining visits before."""
        mask = np.zeros(len(state.left), dtype=np.uint32)
        for r in range(self.made.shape[1]):
            seen = (state.left[:, r] < before[:, r]) | (request.source.to_slots(self.made[:, r]) > 0)
            mask |= (seen & state.spends).astype(np.uint32) << np.uint32(r)
        return mask


def _open(mask: np.ndarray, left: np.ndarray) -> np.ndarray:
    """Return the mask without visits to targets that have no remaining visits."""
    for r in range(left.shape[1]):
        mask = mask & ~((left[:, r] == 0).astype(np.uint32) << np.uint32(r))
    return mask


def plan_history(
    generations: list[Generation], state: SurveyState, n: int, plan_rounds: Callable[..., Iterator]
) -> tuple[np.ndarray, np.ndarray]:
    """Plan all generations for the realizations of a block.

    Parameters
    ----------
    generations : list of Generation
        The generations.
    state : SurveyState
        The recorded events.
    n : int
        Number of realizations of the block.
    plan_rounds : callable
        Function of a generation and a `State` that plans the tiles of the generation, records them in the state, and
        yields the job and the result of each tile.

    Returns
    -------
    mask : ndarray of uint32, shape (n_targets,)
        For each target, in the order of slots, the realizations that observe it.
    counts : ndarray of int, shape (n, 3)
        Numbers of assigned positioners, lost targets and visits in each realization.
    """
    history = History(state, len(generations[-1].request.source), n)
    for generation in generations:
        request = generation.request
        now = history.open_state(request)
        before = now.left.copy()
        for job, done in plan_rounds(generation, now):
            if job.tile in generation.observed:
                history.keep(job.tile, job.job.field.row, done.mask, done.good, done.counts)
    return history.masks(request, now, before), history.counts + now.counts
