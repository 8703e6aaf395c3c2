"""Integer programs of joint plans of dated tiles, in which each target uses at most one of all its sequences of tiles.

The variables are the candidates of all positioners, followed by the sequences.
"""

from itertools import combinations
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array, hstack, vstack

from rfpsurvey._assignment.solver import maximize, with_errors
from rfpsurvey._assignment.weighted import WeightedProblem
from rfpsurvey._kernels import windows as kernels

# Effort of a program: its largest number of nodes times its number of variables.
EFFORT = 2e6


class Sequences(NamedTuple):
    """All sequences of all targets."""

    target: np.ndarray
    visits: np.ndarray
    whole: np.ndarray  # whether the sequence completes the cadence
    uses: csr_array  # which places each sequence uses, shape (n_places, n_sequences)


def all_sequences(dates: kernels.Dates, most: int) -> Sequences | None:
    """Return all sequences; None if there are more than ``most``."""
    rows, columns, found = [], [], []
    for t in range(len(dates.p_indptr) - 1):
        for places, visits, whole in _sequences_of(t, dates):
            if len(found) == most:
                return None
            rows += [dates.p_indptr[t] + k for k in places]
            columns += [len(found)] * len(places)
            found.append((t, visits, whole))
    shape = len(dates.p_tile), len(found)
    target, visits, whole = np.array(found, dtype=np.int64).reshape(-1, 3).T
    return Sequences(target, visits, whole, csr_array((np.ones(len(rows)), (rows, columns)), shape=shape))


def _sequences_of(t: int, dates: kernels.Dates):
    """Yield the places of each sequence of a target, its number of visits, and whether it completes the cadence."""
    tiles = dates.p_tile[dates.p_indptr[t] : dates.p_indptr[t + 1]]
    day, brightness, begun = dates.day[tiles], dates.brightness[tiles], dates.begun[t]
    first, end = dates.e_indptr[dates.cadence[t]] + dates.skipped[t], dates.e_indptr[dates.cadence[t] + 1]

    def extend(places: tuple, visits: int, e: int, previous: float):
        usable = [k for k in range(places[-1] + 1 if places else 0, len(tiles)) if brightness[k] <= dates.limit[e]]
        for i in usable:
            start, needed = day[i], dates.n[e]
            if e == first and start - begun <= dates.night:
                start, needed = begun, needed - dates.made[t]
            elif not kernels.is_within(start - previous, dates.low[e], dates.high[e]):
                continue
            same_night = [k for k in usable if k > i and day[k] - start <= dates.night]
            for others in combinations(same_night, needed - 1):
                longer, more = (*places, i, *others), visits + dates.n[e]
                yield longer, more, e + 1 == end
                if e + 1 < end:
                    yield from extend(longer, more, e + 1, start)

    return extend((), 0, first, dates.previous[t]) if first < end else ()


class SequenceProgram:
    """The program of all plans in which targets are observed only in complete epochs.

    ``place`` is the place of each candidate of the ``problem``, or -1.
    """

    def __init__(self, problem: WeightedProblem, place: np.ndarray, sequences: Sequences):
        n, m, k = len(place), len(sequences.target), len(problem.start) - 1
        single = csr_array((np.ones(n), (np.repeat(np.arange(k), np.diff(problem.start)), np.arange(n))), shape=(k, n))
        some = np.flatnonzero(place >= 0)
        visits = csr_array((np.ones(len(some)), (place[some], some)), shape=(sequences.uses.shape[0], n))
        targets, row = np.unique(sequences.target, return_inverse=True)
        at_most_one = csr_array((np.ones(m), (row, np.arange(m))), shape=(len(targets), m))
        top = vstack([single, problem.sets])
        parts = hstack([top, csr_array((top.shape[0], m))]), hstack([csr_array((len(targets), n)), at_most_one])
        self._matrix = vstack([*parts, hstack([visits, -sequences.uses])], format="csr")
        links, free = np.zeros(visits.shape[0]), np.full(len(problem.most) + len(targets), -np.inf)
        self._low = np.concatenate([np.ones(k), free, links])
        self._high = np.concatenate([np.ones(k), problem.most, np.ones(len(targets)), links])
        self.n, self._values, self._deadline = n, None, problem.deadline

    def maximize(self, value: np.ndarray) -> float:
        """Find the plan with the largest sum of the ``value`` of its sequences; return an upper bound of the sum."""
        goal = np.append(np.zeros(self.n), value)
        most, size = np.ones(len(goal)), len(goal)
        gap = 0.5 / max(float(value.max(initial=0.0)) * self._matrix.shape[0], 1.0)
        options = {"integral": True, "gap": gap, "presolve": True, "first": self._values, "nodes": int(EFFORT / size)}
        x, bound = maximize((self._matrix, self._low, self._high), goal, most, self._deadline, **options)
        self._values = self._values if x is None else x
        return with_errors(bound, size)

    def keep(self, value: np.ndarray) -> None:
        """Require the sum of the ``value`` of the sequences of the present plan of all further plans."""
        goal = np.append(np.zeros(self.n), value)
        self._matrix = vstack([self._matrix, csr_array(goal[None, :])], format="csr")
        self._low = np.append(self._low, round(goal @ self._values))
        self._high = np.append(self._high, np.inf)

    @property
    def chosen(self) -> np.ndarray | None:
        """The candidates of the present plan; None if no plan was found."""
        return None if self._values is None else np.flatnonzero(self._values[: self.n] > 0.5)
