"""All tiles of a survey as one problem: candidates of all positioners, and sets that limit the use of candidates.

A *candidate* is a possible target of a positioner, with the handedness of the arm. The idle arm is also a candidate. A
plan uses exactly one candidate of each positioner, and a limited number of candidates of each *set*. The *rules* are
the requirements of each tile and similar constraints: for each rule, a sum over the candidates in use is limited.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.sparse import block_diag, csc_array, csr_array, vstack
from scipy.sparse.csgraph import maximum_flow

from rfpsurvey.allocation import TileCandidates


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
