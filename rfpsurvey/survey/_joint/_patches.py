"""Patches of the sky, which are groups of nearby positioners of all tiles, and an integer program for each patch.

The words *candidate* and *set* are explained in the module that defines `Network`.
"""

import numpy as np
from scipy.sparse import csr_array

from rfpsurvey.allocation import WeightedProblem
from rfpsurvey.survey._joint._network import Network

# Plans whose total weights differ by less than this value may be treated as equal. The weights of targets of
# different priority classes differ by at least 1.
PRECISION = 0.5
# Largest number of nodes of the search tree of an integer program: NODES if the program improves a plan, and
# NODES_OF_BOUND if the program gives a bound.
NODES, NODES_OF_BOUND = 300, 100
# Allowed relative error of an integer program that gives a bound; the bound is valid whatever the error is.
GAP = 2e-4


def divide(network: Network, directions: np.ndarray, size: int, rng: np.random.Generator) -> np.ndarray:
    """Divide positioners into patches of at most about ``size`` candidates, and return the patch of each positioner.

    Groups of positioners are divided repeatedly, usually at the median of a coordinate. The coordinate axes are rotated
    at random. Positioners with only one candidate belong to no patch, which is indicated by -1.
    """
    rotation = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    load = np.diff(network.start)
    label, n = np.full(len(load), -1), 0
    waiting = [np.flatnonzero(load > 1)]
    points = directions @ rotation
    shift = rng.uniform(0.35, 0.65)
    while waiting:
        members = waiting.pop()
        total = load[members].sum()
        if total <= size or len(members) < 2:
            label[members] = n
            n += 1
            continue
        part = points[members]
        axis = int(np.argmax(np.ptp(part, axis=0)))
        members = members[np.argsort(part[:, axis], kind="stable")]
        # the first cuts are not at the median, so that the patches of successive divisions differ
        cut = int(np.searchsorted(np.cumsum(load[members]), (shift if total > 4 * size else 0.5) * total)) + 1
        cut = min(max(cut, 1), len(members) - 1)
        waiting += [members[cut:], members[:cut]]
    return label


class Patches:
    """The patches of one division of the positioners, and the sets that contain candidates of several patches.

    ``members`` contains the positioners of each patch, and ``only`` the candidates of the positioners that have a
    single candidate, and therefore always use it.
    """

    def __init__(self, network: Network, label: np.ndarray):
        self.network, self.label, self.only = network, label, network.start[:-1][label < 0]
        order = np.argsort(label, kind="stable")
        order = order[label[order] >= 0]
        self.n = int(label.max(initial=-1)) + 1
        self.members = np.split(order, np.searchsorted(label[order], np.arange(1, self.n)))
        patch = label[network.positioner]
        inside = np.flatnonzero(patch >= 0)
        part = csr_array((np.ones(len(inside)), (inside, patch[inside])), shape=(len(patch), max(self.n, 1)))
        self._used = network.matrix @ part  # number of candidates of each set in each patch
        self.crosses = np.diff(self._used.indptr) > 1
        self.crosses[len(self.crosses) - network.n_least :] = True  # bounds always use the prices of minima
        x = np.zeros(len(network.target))
        x[self.only] = 1.0
        self.slack = network.most - network.matrix @ x

    def colors(self) -> list[list[int]]:
        """Return groups of patches such that no set contains candidates of two patches of the same group."""
        used, color = self._used[self.crosses], np.full(self.n, -1)
        neighbors = (used.T @ used).tocsr()
        for patch in range(self.n):
            taken = {*color[neighbors.indices[neighbors.indptr[patch] : neighbors.indptr[patch + 1]]].tolist()}
            color[patch] = next(k for k in range(self.n + 1) if k not in taken)
        return [np.flatnonzero(color == k).tolist() for k in range(int(color.max(initial=-1)) + 1)]

    def candidates(self, patch: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the candidates of a patch, and the index of the first candidate of each positioner.

        The array of indices ends with the number of candidates.
        """
        members, start = self.members[patch], self.network.start
        size = start[members + 1] - start[members]
        ends = np.concatenate([[0], np.cumsum(size)])
        return np.repeat(start[members] - ends[:-1], size) + np.arange(ends[-1]), ends

    def can_gain(self, patch: int, chosen: np.ndarray, unmet: np.ndarray) -> bool:
        """Return whether a better plan of a patch may exist.

        A better plan requires two conditions: a positioner of the patch does not yet observe a target of the highest
        priority class in its reach, and a target with remaining visits (``unmet``) is in reach of the patch.
        """
        network, members = self.network, self.members[patch]
        rows, ends = self.candidates(patch)
        rank = network.rank[rows]
        if (network.rank[chosen[members]] == np.minimum.reduceat(rank, ends[:-1])).all():
            return False
        return bool(unmet[network.target[rows]].any())

    def within(
        self,
        patch: int,
        chosen: np.ndarray,
        load: np.ndarray,
        limits: np.ndarray,
        weight: np.ndarray,
        deadline: float,
        precision: float,
    ) -> tuple[np.ndarray, WeightedProblem]:
        """Return the candidates of a patch that can be used while all arms outside the patch remain fixed.

        Also return the integer program that selects the best of these candidates. ``load`` is the number of candidates
        of each set that the plan ``chosen`` uses, followed by the sum of each rule, and ``limits`` are the largest
        allowed values of these numbers.
        """
        network, members = self.network, self.members[patch]
        rows, ends = self.candidates(patch)
        part = network.columns[:, rows]
        now = chosen[members]
        sets = np.unique(part.indices)
        part = part.tocsr()[sets]
        mine = np.searchsorted(rows, now)
        x = np.zeros(len(rows))
        x[mine] = 1.0
        slack = limits[sets] - (load[sets] - part @ x)
        usable = network.usable[rows] | (x > 0)
        is_open, start, sets = _without_full_sets(part, slack, ends, usable, sets >= len(network.most))
        rows, first = rows[is_open], (np.cumsum(is_open) - 1)[mine]
        gap = precision / max(float(np.maximum.reduceat(weight[rows], start[:-1]).sum()), 1.0)
        return rows, WeightedProblem(start, weight[rows], *sets, first, NODES, gap, deadline)

    def alone(self, patch: int, value: np.ndarray, deadline: float) -> WeightedProblem:
        """Return the integer program of a patch; sets that contain candidates of several patches are omitted."""
        network = self.network
        rows, ends = self.candidates(patch)
        part = network.columns[:, rows]
        sets = np.unique(part.indices)
        sets = sets[sets < len(self.crosses)]  # the columns also contain the rules
        sets = sets[~self.crosses[sets]]
        is_open, start, sets = _without_full_sets(part.tocsr()[sets], self.slack[sets], ends)
        return WeightedProblem(start, value[rows[is_open]], *sets, None, NODES_OF_BOUND, GAP, deadline)


def _without_full_sets(part, slack, ends, usable=True, is_rule=False):
    """Return the candidates that are in no full set, their first index for each positioner, and the other sets.

    ``slack`` is the number of candidates of each set (row of ``part``) that may be used. Sets that cannot exceed this
    number are omitted. Rules (``is_rule``) also have elements other than 1, and are never omitted.
    """
    is_open = (part.T @ ((slack < 0.5) & np.logical_not(is_rule)).astype(float) == 0) & usable
    part = part[:, np.flatnonzero(is_open)].tocsr()
    binding = np.flatnonzero((np.diff(part.indptr) > slack) | is_rule)
    return is_open, np.concatenate([[0], np.cumsum(is_open)])[ends], (part[binding], slack[binding])
