"""All tiles of a survey as one problem, its division into patches of the sky, and augmenting paths.

A *candidate* is a possible target of a positioner, with the handedness of the arm. The idle arm is also a candidate. A
plan uses exactly one candidate of each positioner, and a limited number of candidates of each *set*. The *rules* are
the requirements of each tile and similar constraints: for each rule, a sum over the candidates in use is limited.

Along an augmenting path, the first positioner moves to a target that requires a visit. Each further positioner, of any
tile, moves to the target that the positioner before it has left.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.sparse import block_diag, csc_array, csr_array, vstack
from scipy.sparse.csgraph import maximum_flow

from rfpsurvey._assignment.weighted import TileCandidates, WeightedProblem
from rfpsurvey._kernels import paths as kernels


@dataclass(frozen=True, eq=False)
class Network:
    """Candidates of the positioners of all tiles; the last candidate of each positioner is its idle arm."""

    start: np.ndarray
    """Index of the first candidate of each positioner, followed by the number of all candidates."""
    target: np.ndarray
    """Index of the target of each candidate; -1 for idle arms."""
    side: np.ndarray
    rank: np.ndarray
    """Priority class of the target of each candidate, 0 for the highest priority.

    It is ``n_classes`` for targets whose visits do not count, such as sky positions, and larger by 1 for idle arms.
    """
    first: np.ndarray
    """Index of the first positioner of each tile, followed by the number of positioners of all tiles."""
    free: np.ndarray
    """For each positioner, whether some of its candidates were omitted."""
    matrix: csr_array
    """Matrix with a row for each set and a column for each candidate.

    The first sets are cliques, that is, sets of candidates that exclude each other, for example because their arms
    collide. A plan uses at most one candidate of each clique. Each further set contains all candidates with the same
    target.
    """
    most: np.ndarray
    """Largest number of candidates of each set that a plan may use."""
    slot: np.ndarray
    """Slot of each target, or a number below -1 for a blank sky position of a tile (see `TilePlan`)."""
    visits: np.ndarray
    """Requested number of visits of each target; the number of tiles if the visits do not count."""
    n_classes: int
    pairs: tuple[np.ndarray, np.ndarray]
    """Positioner and target of each reachable pair; collisions are ignored."""
    rank_of_target: np.ndarray
    n_cliques: int
    """Number of cliques, which are the first rows of ``matrix``."""
    rules: csr_array
    """Matrix with a row for each rule and a column for each candidate."""
    rule_most: np.ndarray
    """Largest sum of each rule over the candidates in use; minima have the opposite sign."""
    is_count: np.ndarray
    """Whether each rule counts candidates."""
    usable: np.ndarray
    """Whether the search for a plan may use each candidate; bounds apply to all candidates."""
    n_least: int = 0
    """Number of sets, the last ones, of which a plan must use at least the number in ``most``."""

    @cached_property
    def positioner(self) -> np.ndarray:
        """Positioner of each candidate."""
        return np.repeat(np.arange(len(self.start) - 1), np.diff(self.start))

    @cached_property
    def columns(self) -> csc_array:
        """The sets and the rules in a format in which those of each candidate are found quickly."""
        return vstack([self.matrix, self.rules]).tocsc() if len(self.rule_most) else self.matrix.tocsc()

    def counts(self, chosen: np.ndarray) -> np.ndarray:
        """Return the number of visits to each priority class, and the number of fibers at other targets.

        ``chosen`` is the candidate of each positioner.
        """
        return np.bincount(self.rank[chosen], minlength=self.n_classes + 2)[:-1]

    def sums(self, chosen: np.ndarray) -> np.ndarray:
        """Return the sum of each rule; ``chosen`` is the candidate of each positioner."""
        return self.rules @ np.bincount(chosen, minlength=len(self.target)).astype(float)

    def with_requirements(self, limits: np.ndarray) -> "Network":
        """Return a copy whose sets contain the rules that count candidates, for bounds of plans within the limits."""
        sign = np.sign(self.rules.sum(axis=1))
        first, last = (np.flatnonzero(self.is_count & (sign == direction)) for direction in (1, -1))
        if len(first) + len(last) == 0:
            return self
        matrix = csr_array(vstack([self.matrix, self.rules[first], -self.rules[last]]))
        most = np.concatenate([self.most, limits[first], -limits[last]])
        return replace(self, matrix=matrix, most=most, n_least=len(last))

    def matching(self, level: int, most_edges: int) -> float:
        """Return the largest possible number of visits to the classes 0 to ``level`` if collisions are ignored.

        If there are more than ``most_edges`` reachable pairs, a simpler upper bound is returned.
        """
        positioner, target = self.pairs
        keep = self.rank_of_target[target] <= level
        positioner, target = positioner[keep].astype(np.int64), target[keep].astype(np.int64)
        n, m = len(self.start) - 1, len(self.slot)
        tile = np.searchsorted(self.first, positioner, side="right") - 1
        place, cell = np.unique(tile * m + target, return_inverse=True)
        simple = min(len(np.unique(positioner)), np.minimum(np.bincount(place % m, minlength=m), self.visits).sum())
        if len(positioner) > most_edges or len(positioner) == 0:
            return float(simple)
        used, positioner = np.unique(positioner, return_inverse=True)
        # flow from positioners to pairs of a tile and a target (at most one visit), and from these to targets
        n, k = len(used), len(place)
        source, sink = n + k + m, n + k + m + 1
        tail = np.concatenate([np.full(n, source), positioner, n + np.arange(k), n + k + np.arange(m)])
        head = np.concatenate([np.arange(n), n + cell, n + k + place % m, np.full(m, sink)])
        size = np.concatenate([np.ones(n), np.ones(len(positioner)), np.ones(k), self.visits]).astype(np.int32)
        graph = csr_array((size, (tail.astype(np.int32), head.astype(np.int32))), shape=(sink + 1, sink + 1))
        return float(maximum_flow(graph, source, sink).flow_value)


def make_network(
    tiles: list[TileCandidates], slots: list, visits: np.ndarray, class_of: np.ndarray, n_classes: int
) -> Network:
    """Return the network of all tiles from the candidates of each tile.

    ``slots`` contains, for each tile, the slots of the targets in its field; further targets of a tile are blank sky
    positions. ``visits`` and ``class_of`` are the requested number of visits and the priority class of each target, in
    the order of slots. The class of targets whose visits do not count is ``n_classes``.
    """
    used = np.unique(np.concatenate([np.empty(0, np.int64), *slots]))
    first = np.cumsum([0, *(len(tile.start) - 1 for tile in tiles)])
    offset = np.cumsum([0, *(len(tile.target) for tile in tiles)])
    last = [int(np.concatenate([tile.target, tile.pairs[1]]).max(initial=-1)) for tile in tiles]
    n_blank = [max(k + 1 - len(slot), 0) for k, slot in zip(last, slots, strict=True)]
    blank = len(used) + np.cumsum([0, *n_blank])
    slot = np.concatenate([used, *(-2 - np.arange(n) for n in n_blank)])
    # the last element is the place of the target -1, which idle arms have
    places = [
        np.concatenate([np.searchsorted(used, slot), b + np.arange(n), [-1]])
        for slot, b, n in zip(slots, blank, n_blank, strict=False)
    ]
    rank_of_target = np.append(class_of[used], np.full(len(slot) - len(used), n_classes))
    n_visits = np.append(visits[used].astype(np.int64), np.zeros(len(slot) - len(used), dtype=np.int64))
    n_visits[rank_of_target == n_classes] = len(tiles)
    target = np.concatenate([place[tile.target] for place, tile in zip(places, tiles, strict=True)])
    start = np.concatenate([*(t.start[:-1] + o for t, o in zip(tiles, offset, strict=False)), offset[-1:]])
    ends = np.cumsum([0, *(tile.indptr[-1] for tile in tiles)])
    indptr = [np.zeros(1, dtype=np.int64), *(t.indptr[1:] + e for t, e in zip(tiles, ends, strict=False))]
    column = [tile.column + o for tile, o in zip(tiles, offset, strict=False)]
    n_cliques = sum(map(len, indptr)) - 1
    # Make a set for each target for which the number of tiles that can observe it exceeds the requested visits.
    tile_of_candidate = np.repeat(np.arange(len(tiles)), np.diff(offset))
    real = np.flatnonzero(target >= 0)
    real = real[np.lexsort((real, target[real]))]
    key = np.unique(target[real] * len(tiles) + tile_of_candidate[real])
    n_tiles = np.bincount(key // max(len(tiles), 1), minlength=len(slot))
    binding = n_tiles > n_visits
    real = real[binding[target[real]]]
    size = np.bincount(target[real], minlength=len(slot))[binding]
    indptr.append(ends[-1] + np.cumsum(size))
    indptr, column = np.concatenate(indptr), np.concatenate([*column, real])
    shape = len(indptr) - 1, len(target)
    kind = np.int32 if max(len(column), shape[1]) < 2**31 else np.int64
    matrix = csr_array((np.ones(len(column)), column.astype(kind), indptr.astype(kind)), shape=shape)
    pairs = [(tile.pairs[0] + f, place[tile.pairs[1]]) for tile, place, f in zip(tiles, places, first, strict=False)]
    return Network(
        start,
        target,
        np.concatenate([tile.side for tile in tiles]),
        np.where(target >= 0, np.append(rank_of_target, 0)[target], n_classes + 1),
        first,
        np.concatenate([tile.shortened for tile in tiles]),
        matrix,
        np.concatenate([np.ones(n_cliques), n_visits[binding].astype(float)]),
        slot,
        n_visits,
        n_classes,
        tuple(np.concatenate(column) for column in zip(*pairs, strict=True)),
        rank_of_target,
        n_cliques,
        csr_array(block_diag([tile.rules.matrix for tile in tiles])),
        *(np.concatenate([getattr(tile.rules, name) for tile in tiles]) for name in ("most", "is_count", "usable")),
    )


# Depths, that is, largest numbers of positioners in a path. The search uses these depths one after the other, because
# short paths are found much faster.
DEPTHS = (4, 16, 64, 256)
# Largest number of times that the search considers all targets of a priority class for each depth.
PASSES = 20


class Paths:
    """The candidates of a network in the order in which the search for augmenting paths requires them."""

    def __init__(self, network: Network):
        self.network = network
        target = np.where(network.rank < network.n_classes, network.target, -1)
        real = np.flatnonzero((target >= 0) & network.usable)
        candidate = real[np.argsort(target[real], kind="stable")]
        number = np.bincount(target[real], minlength=len(network.slot))
        cliques, rules = network.matrix[: network.n_cliques].tocsc(), network.rules.tocsc()
        indices = [network.positioner, target, network.rank, np.concatenate([[0], np.cumsum(number)]), candidate]
        indices += [cliques.indptr, cliques.indices, rules.indptr, rules.indices]
        room = np.zeros(len(network.rule_most))
        self.links = kernels.Links(*(index.astype(np.int64) for index in indices), rules.data.astype(float), room)

    def improve(
        self, chosen: np.ndarray, rng: np.random.Generator, is_over: Callable[[], bool], limits: np.ndarray
    ) -> np.ndarray:
        """Return a plan with at least as many visits as ``chosen``; visits to higher priorities take precedence.

        Parameters
        ----------
        chosen : ndarray of int, shape (n_positioners,)
            Candidate of each positioner in the given plan.
        rng : numpy.random.Generator
            Generator of the random order in which the search considers the targets.
        is_over : callable
            Function that returns True when the time limit has passed.
        limits : ndarray of float, shape (n_rules,)
            Largest sum of each rule.

        Returns
        -------
        ndarray of int, shape (n_positioners,)
            Candidate of each positioner in the improved plan.
        """
        network, chosen = self.network, chosen.astype(np.int64)
        self.links.room[:] = limits - network.sums(chosen)
        used = np.bincount(chosen, minlength=len(network.target))
        load = (network.matrix[: network.n_cliques] @ used).astype(np.int64)
        target = network.target[chosen]
        left = network.visits - np.bincount(target[target >= 0], minlength=len(network.slot))
        for depth in DEPTHS:
            for level in range(network.n_classes):
                mine = np.flatnonzero(network.rank_of_target == level)
                for replaces in (False, True) if level + 1 < network.n_classes else (False,):
                    gained, number = 1, 0
                    while gained and number < PASSES and not is_over():
                        order = rng.permutation(mine[left[mine] > 0])
                        gained = kernels.find_paths(order, level, replaces, depth, self.links, chosen, load, left)
                        number += 1
        return chosen


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
