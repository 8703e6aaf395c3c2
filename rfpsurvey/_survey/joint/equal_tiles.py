"""An upper bound of the values of the targets of a joint plan, from a program in which equal tiles are one tile."""

import numpy as np
from scipy.sparse import csr_array, hstack, vstack

from rfpsurvey._assignment.solver import maximize, with_errors
from rfpsurvey._survey.joint.network import Network
from rfpsurvey._survey.joint.shares import UNITS, Shares
from rfpsurvey._survey.joint.values import Steps

# Largest number of nodes of the search tree, times the number of variables.
EFFORT = 4e5


class EqualTiles:
    """A relaxation in which tiles with equal candidates are one tile, whose candidates are used several times.

    The sum of the uses of the candidates of each positioner, and of each clique, is at most the number of tiles.
    """

    def __init__(self, network: Network, steps: Steps):
        self.network, self.steps, first, tiles = network, steps, network.start[network.first], {}
        cliques = network.matrix[: network.n_cliques].tocsc()
        for k in range(len(network.first) - 1):
            part = slice(first[k], first[k + 1])
            starts = network.start[network.first[k] : network.first[k + 1]] - first[k]
            mine = cliques[:, part]
            rows = np.unique(mine.indices, return_inverse=True)[1]
            key = (starts, network.target[part], network.side[part], mine.indptr, rows)
            tiles.setdefault(tuple(values.tobytes() for values in key), []).append(k)
        self.first, self.groups, self.has_equal = first, list(tiles.values()), len(tiles) < len(network.first) - 1
        self.rows = np.concatenate([np.arange(first[same[0]], first[same[0] + 1]) for same in tiles.values()])
        self.times = np.concatenate([np.full(first[k[0] + 1] - first[k[0]], len(k)) for k in tiles.values()])

    def solve(self, weights: np.ndarray, deadline: float, shares: Shares | None = None) -> tuple[float, np.ndarray]:
        """Return an upper bound, and whether the solution uses each candidate in a tile or in an equal one.

        The bound is that of the sum of the values, with a weight of each class, or of the smallest finished fraction.
        """
        network, steps, times, rows = self.network, self.steps, self.times.astype(float), self.rows
        real = network.rank[rows] < network.n_classes
        able = np.bincount(network.target[rows[real]], self.times[real], len(network.slot))
        weight = np.append(weights, 0.0)[network.rank_of_target[steps.target]]
        keep = (weight > 0) & (steps.number <= able[steps.target])
        value, needed = (weight * steps.value)[keep], steps.number[keep].astype(float)
        goals, goal = np.unique(steps.target[keep], return_inverse=True)
        place = np.full(len(network.slot) + 1, -1)
        place[goals] = np.arange(len(goals))
        place = np.where(real, place[network.target[rows]], -1)
        keep = place >= 0
        rows, times, place = rows[keep], times[keep], place[keep]
        n, m, q = len(rows), len(goals), len(value)
        owner, number = np.unique(network.positioner[rows], return_inverse=True)
        single = csr_array((np.ones(n), (number.reshape(-1), np.arange(n))), shape=(len(owner), n))
        cliques = network.matrix[: network.n_cliques].tocsc()[:, rows].tocsr()
        cliques = cliques[np.flatnonzero(np.diff(cliques.indptr) > 1)]
        limits = np.concatenate([_largest(part, times) for part in (single, cliques)])
        visits = csr_array((np.full(n, -1.0), (place, np.arange(n))), shape=(m, n))
        # a target has the value of at most one step
        goal = goal.reshape(-1)
        link, once = (csr_array((data, (goal, np.arange(q))), shape=(m, q)) for data in (needed, np.ones(q)))
        top = vstack([single, cliques])
        parts = [[top, csr_array((top.shape[0], q))], [visits, link], [csr_array((m, n)), once]]
        matrix = vstack([hstack(part) for part in parts], format="csr")
        high = np.concatenate([limits, np.zeros(m), np.ones(m)])
        objective, most = np.append(np.zeros(n), value), np.append(times, np.ones(q))
        if shares is not None:
            count = csr_array(
                (np.full(q, -1.0), (shares.group[goals][goal], n + np.arange(q))), shape=(len(shares.size), n + q)
            )
            unit = csr_array((shares.size * shares.weight / UNITS)[:, None])
            matrix = vstack([hstack([matrix, csr_array((len(high), 1))]), hstack([count, unit])], format="csr")
            high = np.append(high, shares.before)
            objective, most = np.append(0.0 * objective, 1.0), np.append(most, UNITS / shares.weight.min())
        program = matrix, np.full(len(high), -np.inf), high
        limits = {"gap": 0.0, "presolve": True, "nodes": int(EFFORT / max(n + q, 1))}
        x, bound = maximize(program, objective, most, deadline, integral=True, **limits)
        bound, is_used = with_errors(bound, n + q), np.zeros(len(network.target), dtype=bool)
        if x is not None:
            is_used[rows] = x[:n] > 0.5
        for same in self.groups:
            begin, size = self.first[same[0]], self.first[same[0] + 1] - self.first[same[0]]
            for k in same[1:]:
                is_used[self.first[k] : self.first[k + 1]] = is_used[begin : begin + size]
        return bound if shares is None else (bound + 1.0) / UNITS, is_used


def _largest(matrix, values):
    """Return the largest value of the columns of each row of a matrix."""
    return np.maximum.reduceat(values[matrix.indices], matrix.indptr[:-1]) if matrix.shape[0] else np.zeros(0)
