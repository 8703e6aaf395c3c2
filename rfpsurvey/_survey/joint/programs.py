"""Integer programs of joint plans: bounds of values, balanced shares, and sequences of visits.

In a program of *goals*, variables for the uses of candidates are followed by variables that state which goals the uses
reach. A goal is a number of visits of a target. If the smallest finished fraction of the categories is maximized, it is
a further variable, in units of 1 / ``UNITS``.
"""

from dataclasses import replace
from itertools import combinations
from typing import NamedTuple

import numpy as np
from scipy.sparse import block_array, csr_array, vstack

from rfpsurvey._assignment.solver import maximize, one_each, sums_by_group, with_errors
from rfpsurvey._assignment.weighted import WeightedProblem
from rfpsurvey._kernels import windows as kernels
from rfpsurvey._survey.joint.network import Network
from rfpsurvey._survey.joint.values import UNITS, Shares, Steps

# Largest number of nodes of the search tree, times the number of variables, of programs of equal tiles and sequences.
EFFORT, EFFORT_OF_SEQUENCES = 4e5, 2e6


class Goals(NamedTuple):
    """Goals of targets, which are rows from 0."""

    target: np.ndarray
    needed: np.ndarray  # number of visits
    value: np.ndarray
    most: np.ndarray  # how often each goal can be reached


def maximize_goals(
    limits: csr_array,
    high: np.ndarray,
    target: np.ndarray,
    most: np.ndarray,
    goals: Goals,
    shares: Shares | None,
    deadline: float,
    *,
    one_goal: bool = False,
    **settings: object,
) -> tuple[np.ndarray | None, float]:
    """Return the variables with the largest value of the goals, or smallest finished fraction, and an upper bound.

    Parameters
    ----------
    limits : csr_array
        Matrix with a row for each limit of the uses and a column for each candidate.
    high : ndarray of float
        Largest sum of each limit.
    target, most : ndarray
        Target, and largest number of uses, of each candidate.
    goals : Goals
        The goals.
    shares : Shares or None
        The category of each goal; the smallest fraction is maximized instead of the values.
    deadline : float
        Value of `now` at which the search ends.
    one_goal : bool, optional
        Whether a target reaches at most one goal.
    **settings
        Parameters of `maximize`.
    """
    m, n = int(goals.target.max(initial=-1)) + 1, len(target)
    parts = [[limits, None], [sums_by_group(target, m, -1.0), sums_by_group(goals.target, m, goals.needed)]]
    high = np.append(high, np.zeros(m))
    if one_goal:
        parts.append([None, sums_by_group(goals.target, m)])
        high = np.append(high, np.ones(m))
    value, most = np.append(np.zeros(n), goals.value), np.append(most, goals.most)
    if shares is not None:
        unit = csr_array((shares.size * shares.weight / UNITS)[:, None])
        parts = [[*part, None] for part in parts] + [[None, sums_by_group(shares.group, unit.shape[0], -1.0), unit]]
        high = np.append(high, shares.before)
        value, most = np.append(0.0 * value, 1.0), np.append(most, UNITS / shares.weight.min())
    program = block_array(parts, format="csr"), np.full(len(high), -np.inf), high
    x, bound = maximize(program, value, most, deadline, gap=0.0, **settings)
    return x, with_errors(bound, n + len(goals.target))


class EqualTiles:
    """A relaxation in which tiles with equal candidates are one tile, whose candidates are used several times.

    The sum of the uses of the candidates of each positioner, and of each clique, is at most the number of tiles.
    """

    def __init__(self, network: Network, steps: Steps):
        self.network, self.steps, first, tiles = network, steps, network.start[network.first], {}
        self._cliques = network.matrix[: network.n_cliques].tocsc()
        self.equal_to = np.empty(len(network.target), np.int64)  # the same candidate in the first one of equal tiles
        for k in range(len(network.first) - 1):
            part = slice(first[k], first[k + 1])
            starts = network.start[network.first[k] : network.first[k + 1]] - first[k]
            mine = self._cliques[:, part]
            rows = np.unique(mine.indices, return_inverse=True)[1]
            key = (starts, network.target[part], network.side[part], mine.indptr, rows)
            begin = tiles.setdefault(tuple(values.tobytes() for values in key), first[k])
            self.equal_to[part] = begin + np.arange(first[k + 1] - first[k])
        self.has_equal = len(tiles) < len(network.first) - 1

    def solve(self, weights: np.ndarray, deadline: float, shares: Shares | None = None) -> tuple[float, np.ndarray]:
        """Return an upper bound, and whether the solution uses each candidate in a tile or in an equal one.

        The bound is that of the sum of the values, with a weight of each class, or of the smallest finished fraction.
        """
        network, steps = self.network, self.steps
        rows, times = np.unique(self.equal_to, return_counts=True)
        real = network.rank[rows] < network.n_classes
        able = np.bincount(network.target[rows[real]], times[real], len(network.slot))
        weight = np.append(weights, 0.0)[network.rank_of_target[steps.target]]
        keep = (weight > 0) & (steps.number <= able[steps.target])
        targets, goal = np.unique(steps.target[keep], return_inverse=True)
        place = np.full(len(network.slot) + 1, -1)
        place[targets] = np.arange(len(targets))
        place = np.where(real, place[network.target[rows]], -1)
        some = place >= 0
        rows, times, place = rows[some], times[some].astype(float), place[some]
        owner, number = np.unique(network.positioner[rows], return_inverse=True)
        cliques = self._cliques[:, rows].tocsr()
        cliques = cliques[np.flatnonzero(np.diff(cliques.indptr) > 1)]
        limits = vstack([sums_by_group(number, len(owner)), cliques], format="csr")
        # the largest number of uses of a candidate of each limit
        high = np.maximum.reduceat(times[limits.indices], limits.indptr[:-1]) if limits.shape[0] else np.zeros(0)
        goals = Goals(goal, steps.number[keep].astype(float), (weight * steps.value)[keep], np.ones(len(goal)))
        given = None if shares is None else replace(shares, group=shares.group[targets[goal]])
        limit = {"integral": True, "nodes": int(EFFORT / max(len(rows) + len(goal), 1))}
        x, bound = maximize_goals(limits, high, place, times, goals, given, deadline, one_goal=True, **limit)
        is_used = np.zeros(len(network.target), dtype=bool)
        if x is not None:
            is_used[rows] = x[: len(rows)] > 0.5
        return bound if shares is None else (bound + 1.0) / UNITS, is_used[self.equal_to]


def solve_balanced(
    problem: WeightedProblem, goals: np.ndarray, shares: Shares, outside: np.ndarray, rounds: int, deadline: float
) -> tuple[np.ndarray | None, float]:
    """Return the candidate of each positioner in a plan with balanced shares, and a bound of the smallest fraction.

    Parameters
    ----------
    problem : WeightedProblem
        The program; the last candidates are two for each of the targets ``goals``: it is finished, or it is not.
    goals : ndarray of int
        Targets that the program can finish.
    shares : Shares
        The categories.
    outside : ndarray of int
        Number of targets of each category that are finished whatever the program chooses.
    rounds : int
        Number of fractions that are maximized, one after the other.
    deadline : float
        Value of `now` at which the search ends.
    """
    n, m = len(problem.weight), len(problem.start) - 1
    finished = n - 2 * len(goals) + 2 * np.arange(len(goals))
    row = shares.group[goals]
    counts = csr_array((np.ones(len(goals)), (row, finished)), shape=(len(shares.names), n))
    scale, least = shares.size * shares.weight, np.zeros(len(shares.names))
    chosen, bound, is_free = None, np.inf, np.ones(len(scale), dtype=bool)
    settings = {"integral": True, "nodes": problem.nodes}
    single = one_each(problem.start)
    high = np.concatenate([np.ones(m), problem.most, np.full(len(scale), np.inf)])
    most = np.append(np.ones(n), float(np.ceil(UNITS * (1.0 / shares.weight).max())))
    for k in range(rounds + 1):
        # the last program maximizes the weights
        is_last = k == rounds or not is_free.any()
        unit = np.where(is_free & (not is_last), scale / UNITS, 0.0)
        parts = [[single, None], [problem.sets, None], [counts, csr_array(-unit[:, None])]]
        matrix = block_array(parts, format="csr")
        low = np.concatenate([np.ones(m), np.full(problem.sets.shape[0], -np.inf), least - outside])
        goal = np.append(problem.weight, 0.0) if is_last else np.append(np.zeros(n), 1.0)
        x, limit = maximize((matrix, low, high), goal, most, deadline, gap=problem.gap if is_last else 0.0, **settings)
        if k == 0 and np.isfinite(limit):
            bound = (with_errors(limit, n) + 1.0) / UNITS
        if x is None:
            break
        chosen = np.flatnonzero(x[:n] > 0.5)
        if is_last:
            break
        number = outside + counts @ x[:n]
        fractions = np.where(is_free, shares.fractions(number), np.inf)
        worst = fractions <= fractions.min() + 1.0 / UNITS
        # the smallest fraction is kept; all others are at least as large
        least = np.where(worst, number, np.maximum(least, np.floor(fractions.min() * scale * (1 - 1e-9))))
        is_free &= ~worst
    return (chosen if chosen is not None and len(chosen) == m else None), bound


def all_sequences(dates: kernels.Dates, most: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, csr_array] | None:
    """Return all sequences of all targets; None if there are more than ``most``.

    These are the target of each sequence, its number of visits, whether it completes the cadence, and which places it
    uses, as a matrix of the shape (n_places, n_sequences).
    """
    rows, columns, sequences = [], [], []
    for t in range(len(dates.p_indptr) - 1):
        for places, visits, whole in _sequences_of(t, dates):
            if len(sequences) == most:
                return None
            rows += [dates.p_indptr[t] + k for k in places]
            columns += [len(sequences)] * len(places)
            sequences.append((t, visits, whole))
    target, visits, whole = np.array(sequences, dtype=np.int64).reshape(-1, 3).T
    shape = len(dates.p_tile), len(sequences)
    return target, visits, whole, csr_array((np.ones(len(rows)), (rows, columns)), shape=shape)


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

    ``place`` is the place of each candidate of the ``problem``, or -1. ``target`` is the target of each sequence, and
    ``uses`` contains the places that it uses.
    """

    def __init__(self, problem: WeightedProblem, place: np.ndarray, target: np.ndarray, uses: csr_array):
        targets, row = np.unique(target, return_inverse=True)
        single, some = one_each(problem.start), np.flatnonzero(place >= 0)
        visits = csr_array((np.ones(len(some)), (place[some], some)), shape=(uses.shape[0], len(place)))
        parts = [[single, None], [problem.sets, None], [None, sums_by_group(row, len(targets))], [visits, -uses]]
        self._matrix = block_array(parts, format="csr")
        links, free = np.zeros(uses.shape[0]), np.full(len(problem.most) + len(targets), -np.inf)
        self._low = np.concatenate([np.ones(single.shape[0]), free, links])
        self._high = np.concatenate([np.ones(single.shape[0]), problem.most, np.ones(len(targets)), links])
        self.n, self._values, self._deadline = len(place), None, problem.deadline

    def maximize(self, value: np.ndarray) -> float:
        """Find the plan with the largest sum of the ``value`` of its sequences; return an upper bound of the sum."""
        goal, rows = np.append(np.zeros(self.n), value), (self._matrix, self._low, self._high)
        gap = 0.5 / max(float(value.max(initial=0.0)) * self._matrix.shape[0], 1.0)
        limits = {"gap": gap, "first": self._values, "nodes": int(EFFORT_OF_SEQUENCES / len(goal))}
        x, bound = maximize(rows, goal, np.ones(len(goal)), self._deadline, integral=True, **limits)
        self._values = self._values if x is None else x
        return with_errors(bound, len(goal))

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
