"""Realizations of a survey with recorded events: each realization repeats the observations with its own plans.

A survey with events was planned several times. A *generation* is the plan of all tiles that were not observed before.
In each realization, every generation is planned again with the subpriorities of the realization; the tiles that were
observed with the plans of this generation are observed again, and positioners fail with the same rates.
"""

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from rfpsurvey._field.targets import FieldBuilder
from rfpsurvey._instruments.focal_plane import FocalPlane
from rfpsurvey._sky.arrays import has_role
from rfpsurvey._survey.bookkeeping import windows_of
from rfpsurvey._survey.history.state import SurveyState
from rfpsurvey._survey.request import Request
from rfpsurvey._survey.selection.work import BlockDone, Failures, State, to_bits, to_mask
from rfpsurvey._survey.source import visits_without_rule
from rfpsurvey.errors import InputError

Observation = tuple[int, tuple[str, ...]]
"""The generation with whose plan a tile was observed, and the names of the positioners that failed."""
LEAST_IN_GROUP = 8
"""Number of visits from which the failure of all visits of a group of positioners is a failure of the group."""


class Generation(NamedTuple):
    """The plan of all tiles that had not been observed when some of the events were recorded."""

    number: int
    """Number of files of events with which the plan was made."""
    request: Request
    requested: np.ndarray
    """Number of visits of each target that is requested before the rule is applied, in the order of rows."""
    kept: dict[int, Observation]
    """For the row of each tile that was not planned, because it had been observed, its observation as known then."""
    observed: dict[int, Failures]
    """For the row of each tile that was observed with this plan, the rates of failures, as known at each later plan."""

    def targets_after(self, made: np.ndarray, failed: np.ndarray) -> FieldBuilder:
        """Return the targets, if the given numbers of visits of each target were made and have failed."""
        state = self.request.state
        columns = {"requested": self.requested, "observed": made, "failed": failed, "priority": None}
        visits = state.rule.apply(columns)[0]
        visits = np.where(state.dropped, np.minimum(visits, made), visits)
        return self.request.builder.after(visits, made, state.dropped)

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
            for tile in rounds[k][needed[rounds[k]]].tolist():
                earlier = np.concatenate(rounds[:k])
                needed[earlier] |= np.linalg.norm(vectors[earlier] - vectors[tile], axis=1) <= reach
        return [tiles[needed[tiles]] for tiles in rounds]


def generations_of(state: SurveyState, prepare: Callable[[SurveyState], Request]) -> list[Generation]:
    """Return the generations of a survey; ``prepare`` returns the request of a survey with a given state.

    The last generation is the plan of the tiles that remain.
    """
    if refused := [name for name in ("table", "function") if name in state.rule.record]:
        raise InputError(
            "selection probabilities of a survey with recorded events need a rule without a table and without a "
            f"function, got a {refused[0]}"
        )
    states, kept, known = {}, {}, {}
    numbers = [len(state.events.files)]
    while numbers:
        n = numbers.pop()
        if n in states:
            continue
        states[n] = state.before(n)
        # an observation that was corrected or partly made before a plan also determines what this plan observed
        kept[n] = {
            row: (earlier, tuple(sorted(states[n].kept[row].failed or ())))
            for row, earlier in states[n].generations().items()
        }
        for row, (earlier, failed) in kept[n].items():
            known.setdefault(earlier, {}).setdefault(row, {}).setdefault(failed, states[n].kept[row])
            numbers.append(earlier)
    generations = []
    for n in sorted(states):
        request, observed = prepare(states[n]), {}
        for row, events in known.get(n, {}).items():
            visits = {failed: state.events.visits(event)[0] for failed, event in events.items()}
            plane = request.instrument.focal_plane
            rates = {failed: failure_rates(plane, table, failed) for failed, table in visits.items()}
            observed[row] = Failures((row, n), rates)
        generations.append(Generation(n, request, visits_without_rule(states[n]), kept[n], observed))
    return generations


def failure_rates(plane: FocalPlane, visits: np.ndarray, failed: tuple[str, ...]) -> np.ndarray:
    """Return the probability that each positioner fails in an observation of a tile.

    The probability is the fraction of the visits to science targets that failed, without visits lost to collisions. It
    is 1 in a group of positioners, such as a petal, of which all visits failed, and these visits do not count.
    """
    ids, names = plane.id.astype(str), visits["positioner"].astype(str)
    counts = visits["observed"].astype(bool) & (visits["target_row"] >= 0)
    if "kind" in visits.dtype.names:
        counts &= has_role(visits["kind"], "science")
    used, single, bad = (np.isin(ids, some) for some in (names, names[counts], failed))
    whole = np.zeros(len(ids), dtype=bool)
    for group in (*plane.spectrograph.reshape(len(ids), -1).T, *(plane.groups or {}).values()):
        number = np.unique(group, return_inverse=True)[1]
        n_used, n_good = np.bincount(number, used), np.bincount(number, used & ~bad)
        whole |= ((n_used >= LEAST_IN_GROUP) & (n_good == 0))[number]
    rate = bad[single & ~whole].mean() if (single & ~whole).any() else 0.0
    return np.where(whole, 1.0, rate) if whole.any() else np.broadcast_to(rate, len(ids))


class History:
    """The visits that the observed tiles made in the realizations of a block."""

    def __init__(self, n_targets: int, n_realizations: int):
        self.counts = np.zeros((n_realizations, 2), dtype=np.int64)
        self.made, self.failed = np.zeros((2, n_realizations, n_targets), dtype=np.uint8)
        self.counted = self.made
        """Number of visits that count before the last generation: with cadences, those of complete epochs."""
        self._visits: dict[tuple[int, int], tuple] = {}
        self._added: dict[int, Observation] = {}

    def keep(self, row: int, generation: Generation, targets: np.ndarray, done: BlockDone, used: np.ndarray) -> None:
        """Keep the visits of a tile that was observed with the plan of a generation.

        ``targets`` are the rows of the targets of its field, and ``used`` selects those whose visits count.
        """
        good = {failed: mask[used] for failed, mask in zip(generation.observed[row].rates, done.good, strict=True)}
        self._visits[row, generation.number] = targets[used], done.mask[used], good, done.counts

    def _add(self, row: int, observation: Observation, sign: int) -> None:
        """Add the visits of an observation; with the sign -1, remove them, because the observation was corrected."""
        number, failed = observation
        targets, mask, good, counts = self._visits[row, number]
        self.counts += sign * counts
        for visits, bits in ((self.made, good[failed]), (self.failed, mask & ~good[failed])):
            # numbers of one byte are modulo 256, where adding 255 subtracts 1
            visits[:, targets] += np.uint8(sign % 256) * to_bits(bits, len(counts)).T

    def open_state(self, generation: Generation) -> State:
        """Return the state of the targets before a generation is planned.

        The visits of partly observed tiles are then already made.
        """
        request = generation.request
        done = {row: observation for row, observation in generation.kept.items() if row in request.state.closed}
        for row in [*self._added]:
            if done.get(row) != self._added[row]:
                self._add(row, self._added.pop(row), -1)
        for row in {*done} - {*self._added}:
            self._added[row] = done[row]
            self._add(row, done[row], 1)
        n, size, to_slots = len(self.counts), len(request.source), request.source.to_slots
        slot_of = np.empty(size, dtype=np.int64)
        slot_of[to_slots(np.arange(size))] = np.arange(size)
        state = State(request.builder, n, windows_of(request, n))
        if state.windows is not None:
            for row in sorted(done, key=lambda row: (request.visit_days[row], row)):
                targets, _, good, _ = self._visits[row, done[row][0]]
                state.windows.observe(state.index_of(slot_of[targets])[to_bits(good[done[row][1]], n)], row)
            self.counted = request.source.by_row(state.windows.counts()[:, 1].astype(np.uint8).reshape(size, n)).T
        state.counts[:, :2] = self.counts
        for r, (made, failed) in enumerate(zip(self.counted[:, :size], self.failed[:, :size], strict=True)):
            state.builder = generation.targets_after(made, failed)
            state.left[:, r] = state.builder.left
            state.counts[r, 2] = made.sum() - state.builder.surplus.sum()
        state.first = state.left.copy()
        for row in request.state.begun:
            targets, mask, _, counts = self._visits[row, generation.kept[row][0]]
            slot = slot_of[targets]
            state.record(row, slot, mask & to_mask(state.open_left(slot, row).T > 0), counts)
        state.restore(state.left, state.counts)
        return state


def plan_history(
    generations: list[Generation], n: int, plan_rounds: Callable[..., Iterator]
) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """Plan all generations for the realizations of a block.

    Parameters
    ----------
    generations : list of Generation
        The generations.
    n : int
        Number of realizations of the block.
    plan_rounds : callable
        Function of a request, rounds of tiles, a `State` and a function that returns the `Failures` of a tile. It plans
        the tiles, records them in the state, and yields the results as `run_rounds` does.

    Returns
    -------
    mask : ndarray of uint32, shape (n_targets,)
        For each target, in the order of slots, the realizations that observe it.
    counts : ndarray of int, shape (n, 3)
        Numbers of assigned positioners, lost targets and visits in each realization.
    visits : ndarray of uint8, shape (n_targets, n), or None
        Number of visits of each target, in the order of slots, that count in each realization; None without cadences.
    """
    history = History(len(generations[-1].request.source), n)
    for generation in generations:
        now = history.open_state(generation)
        for tile, job, done, _ in plan_rounds(generation.request, generation.rounds, now, generation.observed.get):
            if tile in generation.observed:
                used = now.spends[job.field.slot] & (done.mask > 0)  # visits to standards do not count
                history.keep(tile, generation, job.field.row, done, used)
    to_slots = generation.request.source.to_slots
    mask = now.masks() | to_mask(to_slots(made) > 0 for made in history.counted)
    return mask, now.counts, None if now.windows is None else now.made() + to_slots(history.counted.T)
