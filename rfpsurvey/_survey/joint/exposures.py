"""A plan of finished targets for fields with several exposures, and its upper bounds.

Tiles with the same field are *exposures*. First, the plan decides how often each fiber of a field observes each target,
which requires one number for each pair of a fiber and a target, not one for each exposure. Then, these visits are
scheduled, with collisions. Pairs that collide in every schedule are omitted, and the plan is made again.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import cached_property

import numpy as np
from scipy.sparse import csr_array

from rfpsurvey._assignment.clock import now
from rfpsurvey._assignment.solver import sums_by_group
from rfpsurvey._assignment.weighted import TileCandidates
from rfpsurvey._kernels import exposures as kernels
from rfpsurvey._survey.joint.fixed import TilePlan
from rfpsurvey._survey.joint.network import Network
from rfpsurvey._survey.joint.programs import Goals, maximize_goals
from rfpsurvey._survey.joint.values import UNITS, Shares, starts_of
from rfpsurvey._survey.work import reach_of

# Numbers of reachable pairs of all tiles, and of exposures of each field, above which the search considers only chosen
# targets; number of further targets that it considers, as a fraction of the chosen ones, and in addition.
MOST_PAIRS, FEW_EXPOSURES, FURTHER, MORE = 150_000, 3, 0.1, 100
# Number of plans that are made, and number of turns in which the exposures of a plan are exchanged.
ROUNDS, TURNS = 8, 30
# Largest number of variables of a linear program.
MOST_VARIABLES = 60_000
# Difference of the codes of two positioners, which is larger than the number of targets and sky positions.
STRIDE = 1 << 32


class Exposures:
    """Targets, fibers and exposures of all fields; a fiber of a field stands for its positioner in all exposures.

    Parameters
    ----------
    request : Request
        The request of the survey.
    fixed : dict of int to TilePlan
        The plans of observed tiles.
    class_of : ndarray of int
        Class of each target in the order of slots.
    n_classes : int
        Number of classes; targets in other classes need no visits.
    list_tile : callable
        Function that returns the `TileCandidates` of a job.
    """

    def __init__(self, request, fixed: dict, class_of: np.ndarray, n_classes: int, list_tile: Callable):
        self.request, self._list, self._has_rules, left = request, list_tile, False, request.builder.left
        made = [np.bincount(plan.spent(request.builder), minlength=len(left)) for plan in fixed.values()]
        self.needed = np.maximum(left.astype(np.int64) - sum(made), 0) * (class_of < n_classes)
        self.is_finished = (left > 0) & (class_of < n_classes) & (self.needed == 0)
        self.class_of, self.n_classes, self.groups = class_of, n_classes, self._equal_tiles(fixed)
        self.n_fibers, fiber, slot = len(request.instrument.focal_plane), [], []
        self.in_field = np.zeros(len(left), dtype=bool)  # whether a field contains each target
        for tile in fixed:
            self.in_field[request.job(tile, left).field.slot] = True
        for k, tiles in enumerate(self.groups):
            job = request.job(int(tiles[0]), left)
            pairs = reach_of(job).pairs
            fiber.append(pairs.owner.astype(np.int64) + k * self.n_fibers)
            slot.append(job.field.slot[pairs.target])
            self.in_field[job.field.slot] = True
        self.in_field &= left > 0
        fiber, slot = (np.concatenate([np.empty(0, np.int64), *parts]) for parts in (fiber, slot))
        wanted = self.needed[slot] > 0
        order = np.flatnonzero(wanted)[np.argsort(slot[wanted], kind="stable")]
        self.fiber, self.number = fiber[order], np.array([len(tiles) for tiles in self.groups], dtype=np.int64)
        self.slots, self.target = np.unique(slot[order], return_inverse=True)
        self.target = self.target.reshape(-1)
        self.room = np.repeat(self.number, self.n_fibers)
        n = len(self.number)
        place = np.unique(self.target * n + self.fiber // self.n_fibers)  # a tile observes a target at most once
        self.can_finish = np.bincount(place // max(n, 1), self.number[place % max(n, 1)], len(self.slots))
        self.can_finish = self.can_finish >= self.needed[self.slots]  # whether enough tiles reach each target

    def _equal_tiles(self, fixed: dict) -> list[np.ndarray]:
        """Return the rows of the tiles of each field, without fixed tiles."""
        request, groups = self.request, {}
        for tile in range(len(request.tiling)):
            if tile not in fixed:
                conditions = None if request.conditions is None else str(request.conditions[tile].record)
                years = None if request.years is None else float(request.years[tile])
                key = *request.places[tile].tolist(), years, conditions, id(request.models[tile])
                key = *key, request.closed_to(tile).tobytes()
                groups.setdefault(key, []).append(tile)
        return [np.array(tiles) for tiles in groups.values()]

    @property
    def is_large(self) -> bool:
        """Whether the search has to be limited to chosen targets: many pairs, and several exposures of each field."""
        number = int(self.room[self.fiber].sum())
        return number > max(MOST_PAIRS, FEW_EXPOSURES * len(self.fiber)) and not self._has_rules

    def finish(
        self, plans: list[TilePlan], shares: Shares | None, seed: int, deadline: float, first: np.ndarray | int = 0
    ) -> tuple[list[TilePlan], np.ndarray]:
        """Return plans that finish targets, with the sky positions of given plans, and which targets to list.

        The latter are, for each slot, whether a target is finished or should be considered in addition. Targets of the
        same class are considered in the order of ``first``. No further plan is made after the ``deadline``.
        """
        rng, closed = np.random.default_rng([seed, 5]), [self._closed(tiles, plans) for tiles in self.groups]
        room = np.concatenate([np.empty(0, np.int64), *((slot == -1).sum(axis=0) for slot in closed)])
        needed, rank = self.needed[self.slots], self.class_of[self.slots]
        order = np.lexsort((rng.random(len(needed)), needed, np.zeros(len(needed)) + first, rank))
        order = order[self.can_finish[order]]
        uses, finished = np.zeros(len(self.fiber), np.int64), np.zeros(len(needed), dtype=bool)
        pairs = self._pairs._replace(most=self._pairs.most.copy())
        state, best = (pairs, uses, room, finished), None
        for turn in range(ROUNDS):
            for _ in range(2):  # the first time omits some targets that can be finished
                self._add_targets(order, shares, state)
            schedules = [self._schedule(k, closed[k], uses, finished, rng) for k in range(len(self.groups))]
            bad = np.concatenate([np.empty(0, np.int64), *(schedule[2] for schedule in schedules)])
            placed = np.concatenate([np.empty(0, np.int64), *(schedule[0].ravel() for schedule in schedules)])
            placed = np.bincount(placed[placed >= 0], minlength=len(self.needed))[self.slots]
            lost = finished & (placed < needed)
            value = self._value(finished & ~lost, shares)
            if best is None or value > best[0]:
                best = value, schedules, finished & ~lost
            if turn == ROUNDS - 1 or not lost.any() or now() >= deadline:
                break
            gone = np.flatnonzero(lost[self.target] & (uses > 0))
            np.add.at(room, self.fiber[gone], uses[gone])
            uses[gone], pairs.most[bad], finished[lost] = 0, 0, False
        _, schedules, finished = best
        listed = self.class_of >= self.n_classes  # standards and sky positions
        listed[self.slots[finished]] = True
        rest, result = rng.permutation(self.slots[~finished]), list(plans)
        for level in range(self.n_classes):
            n = int((finished & (rank == level)).sum())
            listed[rest[self.class_of[rest] == level][: int(FURTHER * n) + MORE]] = True
        for tiles, kept, (slot, side, _) in zip(self.groups, closed, schedules, strict=True):
            listed[slot[slot >= 0]] = True  # also targets of which some visits were omitted
            for k, tile in enumerate(tiles):
                is_closed = kept[k] != -1
                slots = np.where(is_closed, plans[tile].slot, slot[k])
                result[tile] = TilePlan(slots, np.where(is_closed, plans[tile].side, side[k]).astype(np.int8))
        return result, listed

    def _value(self, finished: np.ndarray, shares: Shares | None) -> tuple:
        """Return the values of finished targets in the order of their importance."""
        by_class = np.bincount(self.class_of[self.slots[finished]], minlength=self.n_classes).tolist()
        if shares is None:
            return tuple(by_class)
        number = self._count(finished, shares)
        return *np.sort(np.round(shares.fractions(number), 9)).tolist(), *by_class

    def _count(self, finished: np.ndarray, shares: Shares) -> np.ndarray:
        """Return the number of finished targets of each category."""
        is_done = self.is_finished.copy()
        is_done[self.slots[finished]] = True
        return shares.count(is_done)

    def _add_targets(self, order: np.ndarray, shares: Shares | None, state: tuple) -> None:
        """Finish further targets in an order, first such that the finished fractions are balanced."""
        needed, rank, finished = self.needed[self.slots], self.class_of[self.slots], state[-1]
        if shares is not None:
            group, n = shares.group[self.slots], len(shares.size)
            lists = order[np.argsort(group[order], kind="stable")]
            lists = lists[group[lists] >= 0]
            done = self._count(finished, shares)
            scale = shares.size * shares.weight
            given = lists, starts_of(group[lists], n), scale, done
            kernels.finish_targets(*given, needed, *state)
            kernels.balance(*given, group, needed, *state)
        for level in range(self.n_classes):
            mine = order[rank[order] == level]
            one_list = np.array([0, len(mine)]), np.ones(1), np.zeros(1, np.int64)
            kernels.finish_targets(mine, *one_list, needed, *state)

    def bound_of_visits(self, level: int) -> float:
        """Return an upper bound of the number of visits of tiles that are not fixed to the classes up to a level."""
        mine = self.class_of[self.slots] <= level
        wanted = np.minimum(self.needed[self.slots[mine]], int(self.number.sum())).sum()
        return float(min(wanted, self.room[np.unique(self.fiber[mine[self.target]])].sum()))

    def solve(self, weights: np.ndarray, deadline: float, shares: Shares | None = None) -> tuple[float, None]:
        """Return an upper bound of the number of finished targets of the classes with a weight, without collisions.

        With ``shares``, return an upper bound of the smallest finished fraction. The last value, in place of the
        candidates that `EqualTiles.solve` returns, is always None.
        """
        counted, before = (np.append(weights, 0.0)[self.class_of] > 0), self.is_finished
        mine = counted[self.slots] & self.can_finish
        bound = min(self._by_capacity(mine, shares), self.relax(mine.astype(float), deadline, shares)[0])
        return (bound if shares is not None else np.floor(bound) + int((before & counted).sum())), None

    def _by_capacity(self, counted: np.ndarray, shares: Shares | None) -> float:
        """Return a bound that considers only the number of visits of all fibers."""
        needed, room = np.sort(self.needed[self.slots][counted]), float(self.room.sum())
        if shares is None:
            return float(np.searchsorted(np.cumsum(needed), room, side="right"))
        group, low, high = shares.group[self.slots], 0.0, 1.0 / shares.weight.min()
        before, sizes = shares.count(self.is_finished), shares.size * shares.weight
        sums = [
            np.append(0, np.cumsum(np.sort(self.needed[self.slots][counted & (group == k)]))) for k in range(len(sizes))
        ]

        def is_possible(fraction):
            number = np.maximum(fraction * sizes - before, 0.0)
            if any(n > len(total) - 1 for n, total in zip(number, sums, strict=True)):
                return False
            return sum(np.interp(n, np.arange(len(s)), s) for n, s in zip(number, sums, strict=True)) <= room

        for _ in range(50):
            middle = (low + high) / 2
            low, high = (middle, high) if is_possible(middle) else (low, middle)
        return high

    def relax(self, weights: np.ndarray, deadline: float, shares: Shares | None) -> tuple[float, np.ndarray]:
        """Return an upper bound of the weight of the finished targets, or of the smallest finished fraction.

        Also return the order in which targets are considered: 0 for those that the linear program finishes, 1 for those
        that it finishes in part, and 2 for others. A variable of the program is the sum over all targets with the same
        fibers, number of visits, weight and group. Large programs are not solved.
        """
        needed = self.needed[self.slots]
        mine = np.flatnonzero(((weights > 0) & self.can_finish)[self.target])
        rows, number = np.unique(self.target[mine], return_counts=True)
        order = np.full(len(needed), 2)
        group = np.zeros(len(rows), np.int64) if shares is None else shares.group[self.slots[rows]]
        levels, level = np.unique(weights[rows], return_inverse=True)
        table = np.full((len(rows), int(number.max(initial=0)) + 3), -1)
        table[:, :3] = np.column_stack([needed[rows], group, level.reshape(-1)])
        row = np.repeat(np.arange(len(rows)), number)
        table[row, np.arange(len(row)) - np.repeat(np.cumsum(number) - number, number) + 3] = self.fiber[mine]
        kinds, kind_of, size = np.unique(table, axis=0, return_inverse=True, return_counts=True)
        kind, column = np.nonzero(kinds[:, 3:] >= 0)
        n, m, used = len(kind), len(kinds), kinds[kind, column + 3]
        if n == 0 or n + m > MOST_VARIABLES:
            return (0.0 if n == 0 and shares is None else np.inf), order
        fibers, number = np.unique(used, return_inverse=True)
        needed, worth, most = kinds[:, 0].astype(float), levels[kinds[:, 2]], (kinds[:, 0] * size)[kind].astype(float)
        goals = Goals(np.arange(m), needed, worth, size.astype(float))
        program = sums_by_group(number, len(fibers)), self.room[fibers].astype(float), kind, most, goals
        if shares is not None:
            shares = replace(shares, group=kinds[:, 1], before=shares.count(self.is_finished))
        x, bound = maximize_goals(*program, shares, deadline, integral=False)
        if x is not None:
            # the first targets of each kind in a random order are finished
            z, shuffled = x[n : n + m], np.random.default_rng(0).permutation(len(rows))
            kind_of = kind_of.reshape(-1)[shuffled]
            place = np.argsort(kind_of, kind="stable")
            position = np.empty(len(rows))
            position[place] = np.arange(len(rows)) - np.repeat(np.cumsum(size) - size, size)
            rest = np.where(position + 1 <= z[kind_of] + 1e-6, 0, np.where(position < z[kind_of] - 1e-6, 1, 2))
            order[rows[shuffled]] = rest
        return bound / (1 if shares is None else UNITS), order

    @cached_property
    def _pairs(self) -> kernels.Pairs:
        n, m = len(self.slots), len(self.room)
        by_fiber = np.argsort(self.fiber, kind="stable")
        most = np.minimum(self.needed[self.slots[self.target]], self.room[self.fiber])
        starts = starts_of(self.target, n), starts_of(self.fiber, m)
        return kernels.Pairs(starts[0], self.fiber, self.target, starts[1], by_fiber, most)

    def _closed(self, tiles: np.ndarray, plans: list[TilePlan]) -> np.ndarray:
        """Return the slots of targets whose visits do not count, for each exposure and positioner of a field, or -1."""
        slot, n = np.array([plans[tile].slot for tile in tiles]), len(self.needed)
        is_science = (slot >= 0) & (slot < n)
        is_science &= self.class_of[np.where(is_science, slot, 0)] < self.n_classes
        return np.where(is_science, -1, slot)

    def _schedule(self, k: int, closed: np.ndarray, uses, finished, rng) -> tuple:
        """Return the slots and handedness of each exposure and positioner of a field, and pairs that collide."""
        request, tiles, left = self.request, self.groups[k], np.where(self.needed == 0, self.request.builder.left, 0)
        left[self.slots[finished]] = request.builder.left[self.slots[finished]]
        job = request.job(int(tiles[0]), left.astype(request.builder.left.dtype))
        tile, slots = self._list(job), job.field.slot
        owner, n = np.repeat(np.arange(self.n_fibers), np.diff(tile.start)), len(self.needed)
        # sky positions follow the targets of the tile
        row = np.where(tile.target < len(slots), np.append(slots, -1)[np.minimum(tile.target, len(slots))], -1)
        is_counted = (tile.target >= 0) & np.append(self.class_of < self.n_classes, False)[row]
        self._has_rules |= tile.rules.matrix[:, is_counted].nnz > 0
        code = np.where(tile.target >= len(slots), n + tile.target - len(slots), row)
        code = np.where(tile.target < 0, -1, owner * STRIDE + code)
        by_code = np.argsort(code, kind="stable")
        mine = np.flatnonzero((uses > 0) & (self.fiber // self.n_fibers == k))
        pair = self.fiber[mine] % self.n_fibers * STRIDE + self.slots[self.target[mine]]
        low, high = (np.searchsorted(code[by_code], pair, side=side) for side in ("left", "right"))
        starts = np.concatenate([[0], np.cumsum(high - low)])
        candidate = by_code[np.repeat(low - starts[:-1], high - low) + np.arange(starts[-1])]
        poses = kernels.Poses(owner, tile.target.astype(np.int64), *_columns(tile))
        of_closed = np.where(closed < -1, n - 2 - closed, np.where(closed >= n, closed - n, closed))
        of_closed = of_closed + np.arange(self.n_fibers) * STRIDE
        place = np.minimum(np.searchsorted(code[by_code], of_closed), max(len(code) - 1, 0))
        blocked = np.where((closed != -1) & (code[by_code][place] == of_closed), by_code[place], -1)
        plan = np.where(closed != -1, kernels.CLOSED, kernels.FREE)
        load = np.zeros((len(tiles), len(tile.indptr) - 1), np.int32)
        wanted = self.slots[self.target[mine]]
        order = np.lexsort((-self.needed[wanted], self.class_of[wanted]))
        order, rolls = order[(high > low)[order]], rng.integers(0, len(tiles), TURNS)
        kernels.schedule(order, uses[mine], starts, candidate, poses, rolls, blocked, plan, load)
        dropped = np.zeros(len(code), dtype=bool)
        rank = np.append(self.class_of, self.n_classes)[slots]
        kernels.drop_collisions(rank, self.n_classes, poses, plan, load, dropped)
        n_dropped = np.bincount(np.repeat(np.arange(len(mine)), high - low), dropped[candidate], len(mine))
        bad = mine[(n_dropped > 0) | (high == low)]
        slot = np.where(plan >= 0, row[plan], -1)
        return slot, tile.side[plan], bad


def _columns(tile: TileCandidates) -> tuple[np.ndarray, np.ndarray]:
    """Return the cliques of each candidate as compressed rows."""
    shape = len(tile.indptr) - 1, len(tile.target)
    columns = csr_array((np.ones(len(tile.column)), tile.column, tile.indptr), shape=shape).tocsc()
    return columns.indptr.astype(np.int64), columns.indices.astype(np.int64)


def colliding(network: Network, chosen: np.ndarray) -> np.ndarray:
    """Return whether each positioner collides with another one if a plan is used."""
    n = network.n_cliques
    used = np.bincount(chosen, minlength=len(network.target)).astype(float)
    full = (network.matrix[:n] @ used > network.most[:n]).astype(float)
    return (network.matrix[:n].T @ full)[chosen] > 0


def without_collisions(network: Network, chosen: np.ndarray) -> np.ndarray:
    """Return a plan without candidates of targets that collide with others."""
    chosen, can_change = chosen.copy(), np.diff(network.start) > 1
    while True:
        rank = network.rank[chosen]
        bad = np.flatnonzero(colliding(network, chosen) & (rank < network.n_classes) & can_change)
        if len(bad) == 0:
            return chosen
        # only some of the targets of the lowest class, because the others may no longer collide
        rows = bad[rank[bad] == rank[bad].max()][::2]
        chosen[rows] = network.start[rows + 1] - 1
